"""Where to go, and how to get there."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any, Literal

from replay_kit.core.arrays import Array
from replay_kit.core.text import place_text, time_text

#: Among the statistics of a plan: which numbers of its dives are as flown or assumed, in words; absent where all were stated.
ORIGIN = "dives"


@dataclass(frozen=True, slots=True)
class Place:
    """A point of the ocean.

    Attributes:
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
    """

    longitude: float
    latitude: float
    depth: float


PlanStatus = Literal["reached", "uncertain", "partial", "unreachable", "unsafe", "failed"]


@dataclass(frozen=True, slots=True)
class Area:
    """An area that a plan keeps out of, or a fence that it does not leave.

    Attributes:
        name: Its name.
        surface_only: Whether only surfacing is forbidden in it.
        corners: Longitude and latitude [degrees] of each, the first not repeated.
        holes: Those of its holes.
        fence: Whether it is a fence.
    """

    name: str
    surface_only: bool
    corners: tuple[tuple[float, float], ...]
    holes: tuple[tuple[tuple[float, float], ...], ...] = ()
    fence: bool = False


# Standard deviations between which 90 % of a normal distribution lie.
_NINETY = NormalDist().inv_cdf(0.95)


def share_interval(share: float, count: int) -> tuple[float, float]:
    """Return the interval of 90 % of a probability that was estimated by the share of some independent trials, one at least.

    References:
        Wilson (1927), Probable inference, the law of succession, and statistical inference.
    """
    middle, wide = share + 0.5 * _NINETY**2 / count, 1.0 + _NINETY**2 / count
    half = _NINETY * ((share * (1.0 - share) + 0.25 * _NINETY**2 / count) / count) ** 0.5
    return max((middle - half) / wide, 0.0), min((middle + half) / wide, 1.0)


@dataclass(frozen=True, slots=True)
class Odds:
    """Odds of a plan, from simulated flights that are steered at each surfacing.

    Attributes:
        n_samples: Number of flights.
        reached: Fraction that comes up within the radius of each goal in time.
        safe: Fraction that violates no constraint.
        radius: [m].
        deadline: Since the start [s].
        arrival_median: When half have arrived, since the start [s]; infinite where fewer do.
        arrival_90_percent: When nine of ten have.
    """

    n_samples: int
    reached: float
    safe: float
    radius: float
    deadline: float
    arrival_median: float
    arrival_90_percent: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan:
    """A glide at one constant velocity through water, and where it is predicted to go.

    Attributes:
        status: ``reached`` when the predicted path passes the goal within the tolerance, ``unreachable`` when the best path found
            does not, ``unsafe`` when it or too many samples violate a constraint, ``uncertain`` when too few samples arrive, ``partial``
            when it ends at a horizon before the goal, ``failed`` when the solver gave no usable path.
        start: Where it begins.
        goal: Where it should pass.
        start_time_ns: [ns, UTC].
        heading_deg: Through water, clockwise from true north at the start, in [0, 360).
        glide_angle_deg: Below the horizontal, positive down.
        speed: Through water [m/s].
        velocity_through_water: shape (3,) [m/s], local east, local north, down.
        duration: To the closest approach [s].
        closest_approach: Least predicted distance to the goal [m].
        track_time: shape (n,) [s] since the start.
        track: shape (n, 3) [m], predicted local east, north, depth.
        message: Words for a person, with the limit that binds if any.
        statistics: What the solver did: iterations, starts, return status.
        legs: Of a mission, each by name: commands, times, place of the surfacing and its ellipse; none of a glide.
        energy: [J]; NaN when it is not known.
        battery: Energy that the vehicle has [J]; NaN when it is not stated.
        odds: Of arriving; None without samples.
        areas: That the plan keeps out of.
        bottom: shape (n,) [m], depth of the bottom under the track; NaN where it is not known, None without a bathymetry.
    """

    status: PlanStatus
    start: Place
    goal: Place
    start_time_ns: int
    heading_deg: float
    glide_angle_deg: float
    speed: float
    velocity_through_water: Array
    duration: float
    closest_approach: float
    track_time: Array
    track: Array
    message: str
    statistics: Mapping[str, float | int | str] = field(default_factory=dict)
    legs: tuple[Mapping[str, Any], ...] = ()
    energy: float = float("nan")
    battery: float = float("nan")
    odds: Odds | None = None
    areas: tuple[Area, ...] = ()
    bottom: Array | None = None

    def __repr__(self) -> str:
        """Return its ends, what to steer and how it turns out."""
        ends = " to ".join(
            f"{place_text(end.longitude, end.latitude)}, {end.depth:g} m"
            for end in (self.start, self.goal)
        )
        steer = (
            f"heading {self.heading_deg:.1f} degrees, glide angle {self.glide_angle_deg:.1f} "
            f"degrees, {self.speed:.2f} m/s through water"
        )
        outcome = f"{self.duration / 3600.0:.1f} h, closest approach {self.closest_approach:.0f} m; track of {len(self.track)} points"
        return (
            f"Plan for {time_text(self.start_time_ns)}: {self.status}; {ends}\n  {steer}, {outcome}"
        )


def leg_statistics(legs: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the legs of a mission as a result holds them among the statistics of its plan: JSON by number."""
    return {f"leg_{leg['leg']:03d}": json.dumps(leg) for leg in legs}


def plan_legs(statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the legs of a mission from the statistics of its plan in a result, in order; none of a glide."""
    return [json.loads(statistics[name]) for name in sorted(statistics) if name.startswith("leg_")]
