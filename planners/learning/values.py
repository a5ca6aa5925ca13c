"""What a plan that learns is asked for, and what it answers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf

from planners.route.bottom import Bathymetry
from planners.route.hazards import NoGo
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.plan import Place, PlanStatus


@dataclass(frozen=True, slots=True, eq=False)
class OtherProfiles:
    """Profiles that other vehicles bring.

    Attributes:
        longitude: shape (n,) [degrees east].
        latitude: shape (n,) [degrees north].
        time_ns: shape (n,) [ns, UTC].
    """

    longitude: Array
    latitude: Array
    time_ns: Array


@dataclass(frozen=True, slots=True)
class LearnSettings:
    """How profiles are brought and what they are worth.

    Attributes:
        depth: Of the dives, over which currents are averaged [m].
        dives: Between surfacings.
        surface_time: At each surfacing [s].
        error: Standard deviation of the error of a profile's mean current, each component [m/s].
        margin: Distance kept from land, areas and the edge of the region [m].
        clearance: Least height of dives above the bottom [m].
        tolerance: Distance from a goal within which it is met [m].
        arrive: Share of the samples that must meet it for the plan to be ``reached``.
        samples: Of the estimate, in which plans are flown.
        seed: Of the samples.
    """

    depth: float = 500.0
    dives: int = 1
    surface_time: float = 0.0
    error: float = 0.03
    margin: float = 50.0
    clearance: float = 20.0
    tolerance: float = 250.0
    arrive: float = 0.9
    samples: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise PlanError for settings outside their range."""
        for name in ("depth", "dives", "error", "tolerance"):
            if not 0.0 < getattr(self, name) < inf:
                raise PlanError(
                    f"{name} of a plan that learns is {getattr(self, name)!r}; expected a number above 0"
                )
        if not 0.0 <= self.arrive <= 1.0:
            raise PlanError(
                f"arrive of a plan that learns is {self.arrive!r}; expected a share from 0 to 1"
            )
        if self.samples < 20:
            raise PlanError(
                f"samples of a plan that learns: expected 20 or more, from which its figures come, got {self.samples}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class LearnRequest:
    """Where a plan that learns begins, and what it may do.

    Attributes:
        start: Where it begins.
        goals: Where the way after a survey leads, in order; of a map none.
        vehicle: The glider.
        settings: How profiles are brought.
        no_go: Areas that must not be entered; in those for surfacing only a survey does not surface either.
        bathymetry: Bottom depth; None for the lowest level that is wet in the estimate.
        start_time_ns: When it begins [ns, UTC].
        others: Profiles that others bring; None for none.
        profiles: That a map may take.
    """

    start: Place
    goals: tuple[Place, ...]
    vehicle: Glider = field(default_factory=Glider)
    settings: LearnSettings = field(default_factory=LearnSettings)
    no_go: tuple[NoGo, ...] = ()
    bathymetry: Bathymetry | None = None
    start_time_ns: int = 0
    others: OtherProfiles | None = None
    profiles: int = 0


@dataclass(frozen=True, slots=True)
class Candidate:
    """What was found of one candidate.

    Attributes:
        name: Of the candidate.
        predicted: Root mean square error that it leaves: of a place [m], or of a current [m/s]; NaN where it is not predicted.
        found: The figure from closed-loop samples, in the unit of the plan; NaN without.
        low: Lower end of its interval of 90 %.
        high: Upper end.
        within: Share of the samples in which the goal is met within the tolerance; NaN where there is no goal.
        chosen: Whether it is the plan.
    """

    name: str
    predicted: float
    found: float
    low: float
    high: float
    within: float
    chosen: bool = False

    def shortfall(self, settings: LearnSettings) -> str:
        """Return the words of a message that too few samples meet the goal; none where enough do.

        Args:
            settings: Number of the samples, and the share that is asked for.
        """
        # shares of a few samples are rounded by the last bit
        if self.within >= settings.arrive - 1e-9:
            return ""
        return (
            f"; {100.0 * self.within:.0f} % of {settings.samples} samples of the estimate end within the tolerance of "
            f"{settings.tolerance:g} m, {100.0 * settings.arrive:.0f} % are asked for"
        )


@dataclass(frozen=True, slots=True)
class Box:
    """A box whose current is to be known.

    Attributes:
        west: [degrees east].
        south: [degrees north].
        east: [degrees east].
        north: [degrees north].
        depths: At which the current counts [m]; none for its mean over the dives.
    """

    west: float
    south: float
    east: float
    north: float
    depths: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Raise PlanError for sides that are no box."""
        if not (self.west < self.east and -90.0 <= self.south < self.north <= 90.0):
            raise PlanError(
                f"a box from {self.west:g}, {self.south:g} to {self.east:g}, {self.north:g}: expected west, south, east, north in degrees, "
                "with west below east and south below north"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ValueMap:
    """What the next profile is worth, by its place.

    Attributes:
        longitude: shape (n,) [degrees east].
        latitude: shape (n,) [degrees north].
        value: shape (n,), by how much it reduces the error, in the unit of the plan.
        unit: Of the value.
    """

    longitude: Array
    latitude: Array
    value: Array
    unit: str


@dataclass(frozen=True, slots=True)
class LearnLeg:
    """From one surfacing to the next.

    Attributes:
        heading_deg: Through water, clockwise from true north, in the current that is known.
        speed: Horizontal, through water [m/s].
        ends_at: Longitude and latitude of its end [degrees].
        ends_s: When it ends, since the start [s].
        blind: Whether it belongs to the stretch without fixes.
    """

    heading_deg: float
    speed: float
    ends_at: tuple[float, float]
    ends_s: float
    blind: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LearnPlan:
    """A plan that learns, with its evidence.

    Attributes:
        status: ``reached`` where the way after it leads to its goal, in the current that is known and in the share of the samples that is
            asked for; ``uncertain`` where too few of them meet it; ``unreachable`` or ``unsafe`` where the way does not lead there.
        message: The answer in words.
        objective: ``survey`` or ``map``.
        request: What was asked for.
        goal: Where it ends.
        depth: Of the dives [m].
        legs: In order.
        track_time: shape (n,) [s] since the start.
        track: shape (n, 3) [m], local east, north, depth.
        miss: Of the goal, in the current that is known [m]; 0 without.
        before: Error before it, in the unit of ``candidates`` and predicted.
        after: Error after it.
        candidates: The candidates.
        value: Of the next profile, by place.
        found_name: What ``found`` of the candidates is.
        unit: Of it.
        notes: What should be known, as sentences.
        statistics: More figures, by name.
    """

    status: PlanStatus
    message: str
    objective: str
    request: LearnRequest
    goal: Place
    depth: float
    legs: tuple[LearnLeg, ...]
    track_time: Array
    track: Array
    miss: float
    before: float
    after: float
    candidates: tuple[Candidate, ...]
    value: ValueMap
    found_name: str
    unit: str
    notes: tuple[str, ...] = ()
    statistics: Mapping[str, float | int | str] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Of the whole [s]."""
        return self.legs[-1].ends_s if self.legs else 0.0
