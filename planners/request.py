"""The request for a mission, what it minimises and what ranks the missions found, and the plan that answers it.

``replay_kit/core/extensions.py`` lists the names of the objectives.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from time import monotonic

import numpy as np

from planners.hazards.areas import NoGo
from planners.hazards.bottom import Bathymetry
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.extensions import additions, is_objective, objective_names
from replay_kit.core.plan import Place, PlanStatus


@dataclass(frozen=True, slots=True)
class Weights:
    """The cost of a mission as a weighted sum.

    Attributes:
        time: Cost of an hour.
        energy: Cost of a kilojoule.
        closest: Cost of a kilometre of miss distance; None when each goal must be met as closely as possible, at any cost.
    """

    time: float = 0.0
    energy: float = 0.0
    closest: float | None = None

    def __post_init__(self) -> None:
        """Raise PlanError for weights that are negative or all zero."""
        values = (self.time, self.energy, self.closest or 0.0)
        if not all(0.0 <= value < float("inf") for value in values) or not any(values):
            raise PlanError(
                f"weights of a mission are {self}; expected numbers of 0 or more, at least one of them above 0"
            )

    def cost(self, duration: float, energy: float, miss: float) -> float:
        """Return the cost of a mission of a duration [s], an energy [J] and a sum of miss distances [m]."""
        return (
            self.time * duration / 3600.0
            + self.energy * energy / 1e3
            + (self.closest or 0.0) * miss / 1e3
        )


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a mission that was found may be ranked by.

    Attributes:
        vehicle: The glider.
        glide_angles: shape (L,) [rad], of each leg.
        yo_depths: Depths [m] at which each leg begins, turns and ends.
        duration: [s].
        energy: [J].
        miss: Sum of the miss distances of the goals [m].
    """

    vehicle: Glider
    glide_angles: Array
    yo_depths: tuple[tuple[float, ...], ...]
    duration: float
    energy: float
    miss: float


@dataclass(frozen=True, slots=True)
class Objective:
    """What a mission minimises.

    Attributes:
        weights: What the optimiser minimises with a given number of legs.
        rank: Cost by which missions that meet their goals are compared: those of other numbers of legs, ways and departures. None: the
            weights' cost.
        distance_first: Whether the miss distance alone counts, and the cost only among equals.
        earliest_arrival: Whether of several departures the one that arrives first is the best, as a wait before it costs time too.
    """

    weights: Weights
    rank: Callable[[Found], float] | None = None
    distance_first: bool = False
    earliest_arrival: bool = False

    def cost(self, found: Found) -> float:
        """Return the cost of a mission that was found."""
        return (
            self.weights.cost(found.duration, found.energy, found.miss)
            if self.rank is None
            else self.rank(found)
        )


OBJECTIVES: dict[str, Objective] = {
    "time": Objective(Weights(time=1.0), earliest_arrival=True),
    "energy": Objective(Weights(energy=1.0)),
    # of the numbers of legs the one with which most samples arrive, by plan_by_odds; without samples as time
    "odds": Objective(Weights(time=1.0), earliest_arrival=True),
    # of two missions that are equally close the quicker one
    "closest": Objective(Weights(time=1.0), distance_first=True),
}


def objective_named(name: str) -> Objective:
    """Return an objective: the project's own, or one that an installed package adds."""
    if name in OBJECTIVES:
        return OBJECTIVES[name]
    found: Objective = additions(
        "objectives", lambda value: isinstance(value, Objective), "a planners Objective"
    )[name]
    return found


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """How a mission is flown and planned.

    Attributes:
        depth: Of the dives [m].
        yos: Dives between surfacings, at one heading and glide angle; 0 for a glide from start to goal.
        surface_time: Drift at each surfacing [s].
        objective: One of ``OBJECTIVES``, or weights.
        tolerance: Miss distance that counts as reached [m].
        legs: Their number; None for the best.
        max_legs: Most considered; None for those of ``max_duration``, of a mooring 60.
        max_duration: Longest mission [s].
        margin: Distance from land, areas, shallows and edges [m].
        clearance: Least height above the bathymetry [m].
        time_limit: After which nothing else is tried [s]; of one mission.
        deadline: On the clock of ``time.monotonic``, after which nothing else is tried [s]; of all missions that are planned together.
        depths: Range [m] in which the depth of each leg is chosen.
        speeds: Range [m/s] in which a propeller's speed is.
        battery: Energy that it may take [J].
        arrive_by: Latest arrival of a simulated flight [s since the start]; infinite for 1.25 times the plan's.
        radius: In which it meets a goal [m]; None for the tolerance.
    """

    depth: float = 500.0
    yos: int = 1
    surface_time: float = 0.0
    objective: str | Weights = "time"
    tolerance: float = 250.0
    legs: int | None = None
    max_legs: int | None = None
    max_duration: float = 1.2e6
    margin: float = 50.0
    clearance: float = 20.0
    time_limit: float = inf
    deadline: float = inf
    depths: tuple[float, float] | None = None
    speeds: tuple[float, float] | None = None
    battery: float = inf
    arrive_by: float = inf
    radius: float | None = None

    def __post_init__(self) -> None:
        """Raise PlanError for settings outside their range."""
        if not isinstance(self.objective, Weights) and not is_objective(self.objective):
            raise PlanError(
                f"a mission's objective is {self.objective!r}; expected one of {', '.join(objective_names())}, or weights"
            )
        names = (
            "depth",
            "tolerance",
            "legs",
            "max_legs",
            "max_duration",
            "time_limit",
            "battery",
            "arrive_by",
            "radius",
        )
        for name, value in {name: getattr(self, name) for name in names}.items():
            if value is not None and not value > 0:
                raise PlanError(f"a mission's {name} is {value!r}; expected a number above 0")
        for name in ("yos", "surface_time", "margin", "clearance"):
            if not getattr(self, name) >= 0.0:
                raise PlanError(
                    f"a mission's {name} is {getattr(self, name)!r}; expected 0 or more"
                )

        for name, ends in (("depths", self.depths), ("speeds", self.speeds)):
            if ends is not None and not 0.0 < ends[0] <= ends[1] < inf:
                raise PlanError(f"a mission's {name} are {ends!r}; expected two increasing numbers")

    @property
    def is_late(self) -> bool:
        """Whether the deadline is over."""
        return monotonic() > self.deadline

    @property
    def most_legs(self) -> float:
        """Largest number of legs considered; infinite without a limit."""
        return inf if self.max_legs is None else self.max_legs

    @property
    def aim(self) -> Objective:
        """The objective."""
        return (
            Objective(self.objective)
            if isinstance(self.objective, Weights)
            else objective_named(self.objective)
        )

    @property
    def weights(self) -> Weights:
        """What the optimiser minimises with a given number of legs."""
        return self.aim.weights

    @property
    def weighs_distance(self) -> bool:
        """Whether the miss distance is weighed against time or energy."""
        return self.weights.closest is not None


@dataclass(frozen=True, slots=True)
class MissionRequest:
    """What a mission is planned for.

    Attributes:
        start: Where it begins.
        goals: Where it should go, in order: met where a leg ends; below the surface by a dive that passes the depth, or at last ends there.
        vehicle: The glider.
        settings: How it is flown and planned.
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth.
        start_time_ns: When it begins [ns, UTC].
        shape: A line that it follows to its one goal, or a mooring there.
    """

    start: Place
    goals: tuple[Place, ...]
    vehicle: Glider = field(default_factory=Glider)
    settings: MissionSettings = field(default_factory=MissionSettings)
    no_go: tuple[NoGo, ...] = ()
    bathymetry: Bathymetry | None = None
    start_time_ns: int = 0
    shape: "Line | Mooring | None" = None


@dataclass(frozen=True, slots=True)
class Mooring:
    """A virtual mooring: the mission stays near its goal.

    Attributes:
        radius: Largest distance allowed [m].
        duration: [s]; the mission lasts as long or, as legs are whole, somewhat longer.
        surfacings_only: Whether only the surfacings must stay within the radius, and not the track between them.
    """

    radius: float
    duration: float
    surfacings_only: bool = False

    def __post_init__(self) -> None:
        """Raise PlanError for a radius or a duration that is not above 0."""
        if not (0.0 < self.radius < inf and 0.0 < self.duration < inf):
            raise PlanError(
                f"a mooring within {self.radius!r} m for {self.duration!r} s: expected two numbers above 0"
            )


@dataclass(frozen=True, slots=True)
class Line:
    """A line that a mission follows to its goal, straight in the flow's local frame.

    Attributes:
        begin: Where the line begins; None for the start of the mission.
        weight: Cross-track penalty [h per h and km]: the cost of an hour at a distance of a kilometre; it grows with the squared distance.
        width: Largest distance of the track from the line for the mission to count as ``reached`` [m].
    """

    begin: Place | None = None
    weight: float = 10.0
    width: float = 2000.0

    def __post_init__(self) -> None:
        """Raise PlanError for a negative weight or a width that is not above 0."""
        if not (0.0 <= self.weight < inf and self.width > 0.0):
            raise PlanError(
                f"a line of weight {self.weight!r} and width {self.width!r} m: expected a number of 0 or more and one above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class MissionPlan:
    """A mission: the commands of each leg and the predicted track.

    Attributes:
        status: ``reached`` within the tolerance, else ``unreachable``; ``unsafe`` where it crosses something, ``failed`` without a path,
            ``uncertain`` where too few samples arrive, ``partial`` where it ends at a horizon.
        headings_deg: shape (L,), through water, clockwise from true north.
        glide_angles_deg: shape (L,), below the horizontal in dives.
        pitches_deg: shape (L,), of the hull.
        yo_depths: Depths [m] at which each leg begins, turns and ends.
        surfacings: shape (L, 2), longitude and latitude [degrees] of each leg's end, after the drift.
        surfacing_times: shape (L,) [s since the start].
        goal_legs: In which leg each goal is met, from 1.
        goal_times: shape (G,) [s since the start].
        closest_approach: shape (G,) [m], horizontal, then.
        duration: [s].
        energy: [J].
        track_time: shape (n,) [s since the start].
        track: shape (n, 3) [m], local east, north, depth.
        message: The outcome with what limits it.
    """

    status: PlanStatus
    start: Place
    goals: tuple[Place, ...]
    start_time_ns: int
    vehicle: Glider
    settings: MissionSettings
    headings_deg: Array
    glide_angles_deg: Array
    pitches_deg: Array
    yo_depths: tuple[tuple[float, ...], ...]
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
    shape: Line | Mooring | None = None

    @property
    def is_moored(self) -> bool:
        """Whether it stays near its goal."""
        return isinstance(self.shape, Mooring)

    def legs_flown(self, time_ns: int) -> int:
        """Return the number of legs that count as flown at a time [ns, UTC]: those that are more than half over.

        A surfacing earlier than planned also begins the next leg.
        """
        ends = np.concatenate([[0.0], self.surfacing_times])
        return int(np.sum(0.5 * (ends[1:] + ends[:-1]) < (time_ns - self.start_time_ns) / 1e9))
