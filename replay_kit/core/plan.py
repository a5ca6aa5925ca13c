"""Plans: positions, areas, odds, and the result of a planner."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any, Literal

from replay_kit.core.arrays import Array
from replay_kit.core.words.text import place_text, time_text

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
    """Area that a plan avoids, or fence that it does not leave.

    Attributes:
        name: Name.
        surface_only: Whether only surfacing is forbidden.
        corners: Longitude and latitude [degrees] of the corners, the first not repeated.
        holes: Corners of its holes.
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
    """Return the 90 % interval of a probability from the fraction of successes in at least one independent trial.

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
        reached: Fraction that surfaces within the radius of each goal in time.
        safe: Fraction that violates no constraint.
        radius: Radius of the goals [m].
        deadline: Time limit since the start [s].
        arrival_median: Time since the start at which half have arrived [s]; infinite if fewer do.
        arrival_90_percent: Time at which nine of ten have arrived [s].
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
    """Plan of a glide at constant velocity through water, or of a mission, with its predicted track.

    Attributes:
        status: ``reached`` when the predicted path passes the goal within the tolerance, ``unreachable`` when the best path found does not,
            ``unsafe`` when it or too many samples violate a constraint, ``uncertain`` when too few samples arrive, ``partial`` when it ends
            at a horizon before the goal, ``failed`` when the solver gave no usable path.
        start: Start.
        goal: Goal, the last of several.
        start_time_ns: [ns, UTC].
        heading_deg: Heading, clockwise from true north at the start, in [0, 360).
        glide_angle_deg: Glide angle, positive down.
        speed: Speed through water [m/s].
        velocity_through_water: shape (3,) [m/s], local east, local north, down.
        duration: Time to the closest approach [s].
        closest_approach: Least predicted distance to the goal [m].
        track_time: shape (n,) [s], time since the start.
        track: shape (n, 3) [m], predicted local east, north, depth.
        message: Text for the user, with the binding limit if any.
        statistics: Solver statistics: iterations, starts, return status.
        legs: Legs of a mission: commands, times, surfacing and its ellipse; empty for a glide.
        energy: Energy used [J]; NaN if unknown.
        battery: Energy of the battery [J]; NaN if not stated.
        odds: Odds of arrival; None without samples.
        areas: Areas and fences of the plan.
        bottom: shape (n,) [m], seabed depth under the track; NaN if unknown, None without a bathymetry.
        via: Goals before the last one, in order.
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
    via: tuple[Place, ...] = ()

    def __repr__(self) -> str:
        """Return ends, commands and outcome as text."""
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
    """Return the legs of a mission as entries of a plan's statistics: JSON by number."""
    return {f"leg_{leg['leg']:03d}": json.dumps(leg) for leg in legs}


def plan_legs(statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the legs of a mission from a plan's statistics, in order; empty for a glide."""
    return [json.loads(statistics[name]) for name in sorted(statistics) if name.startswith("leg_")]
