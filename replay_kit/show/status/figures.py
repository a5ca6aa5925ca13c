"""The figures of a status: each a small function of what a result holds and of the present time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.as_flown import AsFlown
from replay_kit.core.geodesy import distance, heading_deg, rotate_to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import plan_legs
from replay_kit.core.quantities import parse_time
from replay_kit.show.status.held import Fix, Held

_SECOND, _DAY = 1_000_000_000, 86_400.0
#: A surfacing is overdue by this share of its leg's duration, at least by so many seconds; by all of it after fewer dives than these.
OVERDUE_SHARE, OVERDUE_LEAST, OVERDUE_FEW = 0.2, 1800.0, 3


@dataclass(frozen=True, slots=True)
class Rate:
    """How fast the vehicle came nearer to its goal.

    Attributes:
        days: Over which time.
        km_a_day: [km/day], towards the goal positive.
        error: One standard deviation, from the fixes' error [km/day].
    """

    days: float
    km_a_day: float
    error: float


@dataclass(frozen=True, slots=True)
class Current:
    """A velocity towards true east and north [m/s], and the standard error of each component, NaN where it is not known."""

    east: float
    north: float
    error: float = math.nan

    @property
    def speed(self) -> float:
        """[m/s]."""
        return math.hypot(self.east, self.north)

    @property
    def toward(self) -> float:
        """Direction that it flows to [degrees clockwise from true north]."""
        return float(heading_deg(self.east, self.north))


@dataclass(frozen=True, slots=True)
class DiveCurrent:
    """The current of the last dive beside the estimate's.

    Attributes:
        time_ns: When it was measured [ns, UTC].
        dive: Its number.
        measured: Mean current of the dive, as the log states it; None where neither the log nor the result holds one.
        corrected: The same without the flight model's error; None where there is no correction.
        predicted: By the estimate before it; None where the log states none.
        difference: Length of what was used, corrected or measured, minus predicted; of profiles their RMS component [m/s].
        expected: One standard deviation of a component of the difference, as the estimate expects it [m/s].
        rejected: Whether the gate rejected the mean current.
    """

    time_ns: int
    dive: int
    measured: Current | None
    corrected: Current | None
    predicted: Current | None
    difference: float
    expected: float
    rejected: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class NextSurfacing:
    """The next surfacing of a plan.

    Attributes:
        planned_ns: When the plan begins [ns, UTC].
        leg: As ``planners`` writes it.
        time_ns: When it is expected [ns, UTC].
        margin_s: After which it is overdue [s], given how long the vehicle's dives have taken.
    """

    planned_ns: int
    leg: Mapping[str, float]
    time_ns: int
    margin_s: float

    def late_s(self, now_ns: int) -> float:
        """Return by how much it is overdue [s]; 0 while it is not."""
        late = (now_ns - self.time_ns) / _SECOND
        return late if late > self.margin_s else 0.0


def goal_of(held: Held) -> tuple[float, float, float] | None:
    """Return longitude, latitude [degrees] and depth [m] of the goal of the last plan, or of the run; None without."""
    if held.plans:
        goal = held.plans[-1].goal
        return goal.longitude, goal.latitude, goal.depth
    text = held.metadata.get("replay_kit.options", {}).get("goal", "")
    return tuple(float(part) for part in text.split(",")) if text else None  # type: ignore[return-value]


def made_good(held: Held) -> list[Rate]:
    """Return how fast the vehicle came nearer to the goal: over the last day if there is one, and since its first fix."""
    goal = goal_of(held)
    if goal is None or len(held.fixes) < 2:
        return []
    last, error = held.fixes[-1], float(held.settings.get("measurements", {}).get("fix_std", 0.0))
    earlier: Sequence[Fix] = [fix for fix in held.fixes[-2::-1] if fix.time_ns < last.time_ns]
    rates = []
    for fix in earlier:
        days = (last.time_ns - fix.time_ns) / _SECOND / _DAY
        nearer = far(fix, goal) - far(last, goal)
        rates.append(Rate(days, nearer / 1e3 / days, math.sqrt(2.0) * error / 1e3 / days))
    return rates


def far(fix: Fix, goal: tuple[float, float, float]) -> float:
    """Return how far a goal is from a fix [m]."""
    return float(distance(fix.longitude, fix.latitude, goal[0], goal[1]))


def dive_current(held: Held) -> DiveCurrent | None:
    """Return the current of the last dive beside the predicted one; None without a measurement."""
    dive = held.dive
    if dive is None:
        return None
    last, means = dive["dive"].size - 1, np.flatnonzero(dive["mean_current_kind"] == "dac")
    off = [dive[f"innovation_{end}"] for end in ("east", "north")]
    if not means.size:
        rms, expected = _rms(*off), _rms(dive["innovation_std_east"], dive["innovation_std_north"])
        time_ns, number = int(dive["timestamp"][last]), int(dive["dive"][last])
        return DiveCurrent(time_ns, number, None, None, None, rms, expected)
    row, at = int(means[-1]), held.fixes[-1] if held.fixes else None
    bin_of = int(dive["bins"][:row].sum())

    def current(name: str) -> Current | None:
        east, north, error = (
            float(dive[f"mean_current_{name}_{end}"][row])
            for end in ("east", "north", "standard_error")
        )
        return _true(held.projection, at, east, north, error) if math.isfinite(east) else None

    measured, corrected = current("measured"), current("corrected")
    east, north = (float(each[bin_of]) for each in off)
    less, used = _true(held.projection, at, east, north), corrected or measured
    assert used is not None
    known = math.isfinite(less.speed)
    predicted = Current(used.east - less.east, used.north - less.north) if known else None
    expected = _rms(*(dive[f"innovation_std_{end}"][[bin_of]] for end in ("east", "north")))
    return DiveCurrent(
        int(dive["timestamp"][row]),
        int(dive["dive"][row]),
        measured,
        corrected,
        predicted,
        less.speed,
        expected,
        known and not bool(dive["accepted"][row]),
    )


def _true(
    projection: Projection, at: Fix | None, east: float, north: float, error: float = math.nan
) -> Current:
    """Return a velocity along the local axes as one towards true east and north."""
    if at is None:
        return Current(east, north, error)
    turned = rotate_to_geographic(projection, at.longitude, at.latitude, east, north)
    return Current(float(turned[0]), float(turned[1]), error)


def _rms(east: NDArray[Any], north: NDArray[Any]) -> float:
    """Return the RMS component of what is known of values; NaN of none."""
    values = np.concatenate([east, north]).astype(np.float64)
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def last_plan(held: Held) -> tuple[Mapping[str, Any] | None, int]:
    """Return how the last attempt to plan ended, as the JSON of a summary has it, and when [ns, UTC]; None without a plan."""
    said = None if held.outcome is None else held.outcome.plan
    if said is not None and said["status"] == "failed":
        # no plan was written for it
        return said, held.last_ns
    if not held.plans:
        return None, held.last_ns
    plan = held.plans[-1]
    known = plan.HasField("odds") and plan.odds.n_samples
    odds = {name: getattr(plan.odds, name) for name in ("n_samples", "reached")} if known else None
    return {
        "status": plan.status,
        "message": plan.message,
        "odds": odds,
    }, plan.timestamp.ToNanoseconds()


def statistics_of(plan: Any) -> dict[str, str]:
    """Return what the solver of a plan states, by name."""
    return {pair.name: pair.value for pair in plan.statistics}


def next_surfacing(held: Held) -> NextSurfacing | None:
    """Return the next surfacing of the last plan: that of its first leg, or of the first after the vehicle's last surfacing.

    None without a mission, or when all its legs are over.
    """
    if not held.plans:
        return None
    plan = held.plans[-1]
    planned_ns = plan.timestamp.ToNanoseconds()
    surfaced = sum(one.planned_time.ToNanoseconds() == planned_ns for one in held.outcomes)
    legs = plan_legs(statistics_of(plan))
    if surfaced >= len(legs):
        return None
    leg, flown = legs[surfaced], AsFlown.in_metadata(held.metadata)
    lasts = leg["surfacing_s"] - leg["start_s"]
    # a dive is not late while the longest before it would have gone on, and of few dives the longest may be a short one
    longest, share = 0.0, OVERDUE_SHARE
    if flown is not None:
        longest = flown.longest or flown.duration
        share = 1.0 if flown.longest and flown.dives < OVERDUE_FEW else share
    margin = max(longest - lasts, 0.0) + max(share * max(longest, lasts), OVERDUE_LEAST)
    return NextSurfacing(planned_ns, leg, planned_ns + int(leg["surfacing_s"] * _SECOND), margin)


def forecast_times(held: Held) -> tuple[int, int, bool] | None:
    """Return the first and the last time of the forecast [ns, UTC], and whether the estimate goes through time; None where it has none."""
    record = held.metadata.get("replay_kit.forecast", {})
    if "first" not in record:
        return None
    return parse_time(record["first"]), parse_time(record["last"]), record.get("evolves") == "true"
