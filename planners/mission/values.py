"""What a mission is asked for and what comes of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.plan import Place

MissionStatus = Literal["reached", "unreachable", "unsafe", "failed"]
Objective = Literal["time", "energy", "closest"]


@dataclass(frozen=True, slots=True)
class Weights:
    """A mission's cost as a weighted sum.

    Attributes:
        time: Of an hour.
        energy: Of a kilojoule.
        closest: Of a kilometre by which a goal is missed; None when goals are to be met as closely as can be, whatever that costs.
    """

    time: float = 0.0
    energy: float = 0.0
    closest: float | None = None

    def __post_init__(self) -> None:
        """Refuse weights that are negative or weigh nothing."""
        values = (self.time, self.energy, self.closest or 0.0)
        if not all(0.0 <= value < float("inf") for value in values) or not any(values):
            raise PlanError(f"weights of a mission are {self}; expected numbers of 0 or more, at least one of them above 0")

    def cost(self, duration: float, energy: float, missed: float) -> float:
        """Return what a mission costs: its duration [s], energy [J], and how far it misses its goals in sum [m]."""
        return self.time * duration / 3600.0 + self.energy * energy / 1e3 + (self.closest or 0.0) * missed / 1e3


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """How a mission is flown and planned.

    Attributes:
        depth: Of the dives [m].
        yos: Dives between surfacings; heading and glide angle are held between surfacings.
        surface_time: Spent at each surfacing, adrift [s].
        objective: ``time`` and ``energy`` are least on the way to the goals, ``closest`` only comes as close as it can; or weights of
            all three. With a given number of dives the pump's work is given, and least energy is least time; it differs in how many
            dives it takes.
        tolerance: A goal met this closely is reached [m].
        legs: Number of surfacings; None for as many as is best.
        max_legs: Most surfacings considered.
        max_duration: Longest mission considered [s].
        margin: Distance kept from where it may not go [m].
        steps: Steps of the optimiser for each dive and climb, beside one for every level crossed.
        spline: Coefficients a kernel length of a B-spline that the optimiser flies in, 3 or so; 0 for the flow itself. Its error is in
            ``statistics``, and the plan is checked in the flow itself.
    """

    depth: float = 500.0
    yos: int = 1
    surface_time: float = 0.0
    objective: Objective | Weights = "time"
    tolerance: float = 250.0
    legs: int | None = None
    max_legs: int = 60
    max_duration: float = 1.2e6
    margin: float = 50.0
    steps: int = 1
    spline: int = 0

    def __post_init__(self) -> None:
        """Refuse settings that no mission can have."""
        positive = {name: getattr(self, name) for name in ("depth", "yos", "tolerance", "max_legs", "max_duration", "steps")}
        for name, value in {**positive, "legs": 1 if self.legs is None else self.legs}.items():
            if not value > 0:
                raise PlanError(f"a mission's {name} is {value!r}; expected a number above 0")
        for name in ("surface_time", "margin", "spline"):
            if not getattr(self, name) >= 0.0:
                raise PlanError(f"a mission's {name} is {getattr(self, name)!r}; expected 0 or more")

    @property
    def weights(self) -> Weights:
        """The objective as weights; what only comes close is quickest among equals."""
        if isinstance(self.objective, Weights):
            return self.objective
        return Weights(energy=1.0) if self.objective == "energy" else Weights(time=1.0)

    @property
    def weighs_distance(self) -> bool:
        """Whether missing a goal is weighed against time or energy."""
        return self.weights.closest is not None


@dataclass(frozen=True, slots=True, eq=False)
class MissionPlan:
    """A mission: what to tell the glider at each surfacing, and where that is predicted to lead.

    Attributes:
        status: ``reached`` when every goal is met within the tolerance, ``unreachable`` when the best path found does not,
            ``unsafe`` when the path goes where it may not, ``failed`` when there is no path.
        start: Where it begins.
        goals: Where it should go, in order.
        start_time_ns: [ns, UTC].
        vehicle: What glides.
        settings: How.
        headings_deg: shape (L,), through water, clockwise from true north where the leg begins.
        glide_angles_deg: shape (L,), below the horizontal in dives, above it in climbs.
        pitches_deg: shape (L,), of the hull, with the same sign.
        turns: Depths [m] at which each leg begins, turns and ends.
        surfacings: shape (L, 2), longitude and latitude [degrees] of each leg's end, after the drift.
        surfacing_times: shape (L,) [s] since the start.
        goal_legs: In which leg each goal is met, counted from 1: at its end, or on the way when the goal is below the surface.
        goal_times: shape (G,) [s] since the start, when it is.
        closest_approach: shape (G,) [m], horizontal, then.
        duration: [s].
        energy: [J].
        track_time: shape (n,) [s] since the start.
        track: shape (n, 3) [m], predicted local east, north, depth.
        message: Words for a person, with what prevents it if anything does.
        statistics: What was tried.
    """

    status: MissionStatus
    start: Place
    goals: tuple[Place, ...]
    start_time_ns: int
    vehicle: Glider
    settings: MissionSettings
    headings_deg: Array
    glide_angles_deg: Array
    pitches_deg: Array
    turns: tuple[tuple[float, ...], ...]
    surfacings: Array
    surfacing_times: Array
    goal_legs: tuple[int, ...]
    goal_times: Array
    closest_approach: Array
    duration: float
    energy: float
    track_time: Array
    track: Array
    message: str
    statistics: Mapping[str, float | int | str] = field(default_factory=dict)

    def legs_flown(self, time_ns: int) -> int:
        """Return how many legs count as flown at a time [ns, UTC]: as many as are more than half over.

        A surfacing earlier than planned begins the next leg as well.
        """
        ends = np.concatenate([[0.0], self.surfacing_times])
        return int(np.sum(0.5 * (ends[1:] + ends[:-1]) < (time_ns - self.start_time_ns) / 1e9))
