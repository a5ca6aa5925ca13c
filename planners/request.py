"""Mission request, objective and resulting plan.

``replay_kit/core/extensions.py`` lists the names of the objectives.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from time import monotonic

import numpy as np

from planners.hazards.areas import NoGo
from planners.hazards.domain import Bathymetry
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.extensions import additions, objective_names
from replay_kit.core.plan import Place, PlanStatus


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights of the mission cost.

    Attributes:
        time: Cost of an hour.
        energy: Cost of a kilojoule.
        closest: Cost of a kilometre of miss distance; None to minimise the miss distance first.
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
        """Return the cost of a duration [s], an energy [J] and a summed miss distance [m]."""
        return (
            self.time * duration / 3600.0
            + self.energy * energy / 1e3
            + (self.closest or 0.0) * miss / 1e3
        )


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Properties of a feasible mission by which an objective ranks it.

    Attributes:
        vehicle: Glider.
        glide_angles: Glide angle of each leg, shape (L,) [rad].
        yo_depths: Depths [m] at which each leg begins, turns and ends.
        duration: Duration [s].
        energy: Energy [J].
        miss: Summed miss distance of the goals [m].
    """

    vehicle: Glider
    glide_angles: Array
    yo_depths: tuple[tuple[float, ...], ...]
    duration: float
    energy: float
    miss: float


@dataclass(frozen=True, slots=True)
class Objective:
    """Objective of a mission.

    Attributes:
        weights: Cost minimised for a given number of legs.
        rank: Cost that ranks feasible missions of different legs, routes and departures; None for the cost of ``weights``.
        distance_first: Whether the miss distance takes precedence over the cost.
        earliest_arrival: Whether the earliest arrival selects the departure, so that waiting costs time.
    """

    weights: Weights
    rank: Callable[[Found], float] | None = None
    distance_first: bool = False
    earliest_arrival: bool = False

    def cost(self, found: Found) -> float:
        """Return the ranking cost of a mission."""
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
    """Return a built-in objective or one of an installed extension."""
    if name in OBJECTIVES:
        return OBJECTIVES[name]
    found: Objective = additions(
        "objectives", lambda value: isinstance(value, Objective), "a planners Objective"
    )[name]
    return found


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """Settings of a mission.

    Attributes:
        depth: Dive depth [m].
        yos: Dives per leg, at one heading and glide angle; 0 for a single glide from start to goal.
        surface_time: Drift time at each surfacing [s].
        objective: Name of an objective, or weights.
        tolerance: Miss distance that counts as reached [m].
        legs: Number of legs; None to optimise it.
        max_legs: Largest number of legs; None for the limit of ``max_duration``, 60 for a mooring.
        max_duration: Largest mission duration [s].
        margin: Distance to keep from land, areas, shallows and edges [m].
        clearance: Minimum height above the bathymetry [m].
        time_limit: Search time per mission [s].
        deadline: End of the search for all missions planned together [s, clock of ``time.monotonic``].
        depths: Range of the dive depth optimised for each leg [m].
        speeds: Range of the speed of a propelled vehicle [m/s].
        battery: Available energy [J].
        arrive_by: Latest arrival of a simulated flight [s since the start]; infinite for 1.25 times the planned one.
        radius: Radius within which a simulated flight meets a goal [m]; None for the tolerance.
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
        if not (isinstance(self.objective, Weights) or self.objective in objective_names()):
            raise PlanError(
                f"a mission's objective is {self.objective!r}; expected one of {', '.join(objective_names())}, or weights"
            )
        positive = ("depth", "tolerance", "legs", "max_legs", "max_duration", "time_limit")
        for name in (*positive, "battery", "arrive_by", "radius"):
            if (value := getattr(self, name)) is not None and not value > 0:
                raise PlanError(f"a mission's {name} is {value!r}; expected a number above 0")
        for name in ("yos", "surface_time", "margin", "clearance"):
            if not (value := getattr(self, name)) >= 0.0:
                raise PlanError(f"a mission's {name} is {value!r}; expected 0 or more")
        for name, ends in (("depths", self.depths), ("speeds", self.speeds)):
            if ends is not None and not 0.0 < ends[0] <= ends[1] < inf:
                raise PlanError(f"a mission's {name} are {ends!r}; expected two increasing numbers")

    @property
    def is_late(self) -> bool:
        """Whether the deadline has passed."""
        return monotonic() > self.deadline

    @property
    def most_legs(self) -> float:
        """Largest number of legs; infinite without a limit."""
        return inf if self.max_legs is None else self.max_legs

    @property
    def aim(self) -> Objective:
        """Objective of the mission."""
        return (
            Objective(self.objective)
            if isinstance(self.objective, Weights)
            else objective_named(self.objective)
        )

    @property
    def weights(self) -> Weights:
        """Cost minimised for a given number of legs."""
        return self.aim.weights

    @property
    def weighs_distance(self) -> bool:
        """Whether the miss distance is traded against time or energy."""
        return self.weights.closest is not None

    @property
    def has_ranges(self) -> bool:
        """Whether the depth of dives or the speed is chosen within a range."""
        return self.depths is not None or self.speeds is not None

    @property
    def deepest(self) -> float:
        """Greatest depth that dives may have [m]."""
        return self.depth if self.depths is None else self.depths[1]


@dataclass(frozen=True, slots=True)
class MissionRequest:
    """Request for a mission.

    Attributes:
        start: Start position.
        goals: Goals in order. Each is met at the end of a leg; one below the surface when a dive passes, or finally ends at, its depth.
        vehicle: Glider.
        settings: Mission settings.
        no_go: No-go areas.
        bathymetry: Bottom depth.
        start_time_ns: Start time [ns, UTC].
        shape: Line to follow to the single goal, or mooring there.
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
    """Virtual mooring: station keeping near the goal.

    Attributes:
        radius: Largest distance from the goal [m].
        duration: Minimum duration [s]; the last leg is completed.
        surfacings_only: Whether the radius applies to surfacings only, not to the track between them.
    """

    radius: float
    duration: float
    surfacings_only: bool = False

    def __post_init__(self) -> None:
        """Raise PlanError if the radius or duration is not positive."""
        if not (0.0 < self.radius < inf and 0.0 < self.duration < inf):
            raise PlanError(
                f"a mooring within {self.radius!r} m for {self.duration!r} s: expected two numbers above 0"
            )


@dataclass(frozen=True, slots=True)
class Line:
    """Line to follow to the goal, straight in the local frame of the flow.

    Attributes:
        begin: Beginning of the line; None for the start of the mission.
        weight: Cross-track penalty: cost of an hour at a distance of one kilometre, quadratic in the distance [h per h and km].
        width: Largest cross-track distance of a mission with status ``reached`` [m].
    """

    begin: Place | None = None
    weight: float = 10.0
    width: float = 2000.0

    def __post_init__(self) -> None:
        """Raise PlanError for a negative weight or a width that is not positive."""
        if not (0.0 <= self.weight < inf and self.width > 0.0):
            raise PlanError(
                f"a line of weight {self.weight!r} and width {self.width!r} m: expected a number of 0 or more and one above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class MissionPlan:
    """Plan of a mission: commands of each leg and predicted track.

    Attributes:
        status: ``reached`` within the tolerance, otherwise ``unreachable``; ``unsafe`` if it violates a constraint, ``failed`` without a
            path, ``uncertain`` if too few simulated flights arrive, ``partial`` if truncated at a horizon.
        headings_deg: Heading through water, shape (L,), clockwise from true north.
        glide_angles_deg: Glide angle below the horizontal in dives, shape (L,).
        pitches_deg: Pitch of the hull, shape (L,).
        yo_depths: Depths [m] at which each leg begins, turns and ends.
        surfacings: End of each leg after the drift, shape (L, 2), longitude and latitude [degrees].
        surfacing_times: Time of each leg's end, shape (L,) [s since the start].
        goal_legs: Leg in which each goal is met, from 1.
        goal_times: Time at which each goal is met, shape (G,) [s since the start].
        closest_approach: Horizontal distance to each goal at that time, shape (G,) [m].
        duration: Duration [s].
        energy: Energy [J].
        track_time: Times of the track, shape (n,) [s since the start].
        track: Predicted track, shape (n, 3) [m], local east, north and depth.
        message: Outcome and binding limit.
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

    def require_legs(self) -> None:
        """Raise PlanError if the plan has no legs."""
        if len(self.headings_deg) == 0:
            raise PlanError(f"a mission without legs cannot be flown: {self.message}")

    @property
    def is_moored(self) -> bool:
        """Whether the mission is a mooring."""
        return isinstance(self.shape, Mooring)

    def legs_flown(self, time_ns: int) -> int:
        """Return the number of legs more than half completed at a time [ns, UTC].

        An early surfacing therefore also begins the next leg.
        """
        ends = np.concatenate([[0.0], self.surfacing_times])
        return int(np.sum(0.5 * (ends[1:] + ends[:-1]) < (time_ns - self.start_time_ns) / 1e9))
