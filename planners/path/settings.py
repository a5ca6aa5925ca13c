"""A vehicle of bounded speed, and how its free path is planned."""

from dataclasses import dataclass, field
from math import inf
from typing import Literal

from planners.route.bottom import Bathymetry
from planners.route.hazards import NoGo
from replay_kit.core.plan import Place


@dataclass(frozen=True, slots=True)
class Auv:
    """A vehicle with a propeller.

    Attributes:
        speed: Most through water [m/s].
        drag: Power of propulsion over the cube of the speed [W s^3/m^3].
        hotel: Power of everything else [W].
        max_depth: Greatest depth that it may go to [m].
    """

    speed: float = 1.0
    drag: float = 40.0
    hotel: float = 20.0
    max_depth: float = inf


@dataclass(frozen=True, slots=True)
class AuvSettings:
    """How a free path is planned.

    Attributes:
        objective: Least time or least energy.
        pieces: Number of pieces of constant velocity through water.
        steps: RK4 steps of each.
        tolerance: A goal met this closely is reached [m].
        max_duration: Longest path considered [s].
        free_depth: Whether the depth is the optimiser's to choose; otherwise it leads evenly from the start's to the goal's.
        margin: Distance kept from where it may not go [m].
        clearance: Least height above the bottom of the bathymetry [m].
    """

    objective: Literal["time", "energy"] = "time"
    pieces: int = 24
    steps: int = 2
    tolerance: float = 50.0
    max_duration: float = 4e5
    free_depth: bool = True
    margin: float = 50.0
    clearance: float = 20.0


@dataclass(frozen=True, slots=True)
class PathRequest:
    """What a free path is planned for.

    Attributes:
        start: Where it begins.
        goal: Where it should end.
        vehicle: The vehicle.
        settings: How the path is planned.
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth; without one, the lowest level that is wet in the forecast limits the depth.
        start_time_ns: When it begins [ns, UTC], for a current that changes; 0 for its first time.
    """

    start: Place
    goal: Place
    vehicle: Auv = field(default_factory=Auv)
    settings: AuvSettings = field(default_factory=AuvSettings)
    no_go: tuple[NoGo, ...] = ()
    bathymetry: Bathymetry | None = None
    start_time_ns: int = 0
