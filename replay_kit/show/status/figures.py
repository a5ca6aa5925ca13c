"""Figures of a status, as functions of a result's data and the present time."""

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
    """Speed made good towards the goal.

    Attributes:
        days: Averaging time [days].
        km_a_day: Speed made good [km/day], positive towards the goal.
        error: Standard error, from the fixes' error [km/day].
    """

    days: float
    km_a_day: float
    error: float


@dataclass(frozen=True, slots=True)
class Current:
    """Current towards true east and north [m/s], with the standard error of each component, NaN if unknown."""

    east: float
    north: float
    error: float = math.nan

    @property
    def speed(self) -> float:
        """Speed [m/s]."""
        return math.hypot(self.east, self.north)

    @property
    def toward(self) -> float:
        """Direction of flow [degrees clockwise from true north]."""
        return float(heading_deg(self.east, self.north))


@dataclass(frozen=True, slots=True)
class DiveCurrent:
    """Current of the last dive, measured and predicted.

    Attributes:
        time_ns: Time of the measurement [ns, UTC].
        dive: Number of the dive.
        measured: Measured DAC; None if neither log nor result holds one.
        corrected: DAC corrected for the flight-model error; None without a correction.
        predicted: Prediction of the estimate before the dive; None if the log states no DAC.
        difference: Magnitude of the innovation; for profiles its RMS component [m/s].
        expected: Expected standard deviation of an innovation component [m/s].
        rejected: Whether the gate rejected the DAC.
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
    """Next surfacing of a plan.

    Attributes:
        planned_ns: Begin of the plan [ns, UTC].
        leg: Leg as written by ``planners``.
        time_ns: Predicted time [ns, UTC].
        margin_s: Delay that makes it overdue [s], from the durations of past dives.
    """

    planned_ns: int
    leg: Mapping[str, float]
    time_ns: int
    margin_s: float

    def late_s(self, now_ns: int) -> float:
        """Return the delay beyond the margin [s]; 0 if not overdue."""
        late = (now_ns - self.time_ns) / _SECOND
        return late if late > self.margin_s else 0.0


def goal_of(held: Held) -> tuple[float, float, float] | None:
    """Return longitude, latitude [degrees] and depth [m] of the goal of the last plan or the run; None without one."""
    if held.plans:
        goal = held.plans[-1].goal
        return goal.longitude, goal.latitude, goal.depth
    text = held.metadata.get("replay_kit.options", {}).get("goal", "")
    return tuple(float(part) for part in text.split(",")) if text else None  # type: ignore[return-value]


def made_good(held: Held) -> list[Rate]:
    """Return the speed made good towards the goal, over the last day if available and since the first fix."""
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
    """Return the distance of a goal from a fix [m]."""
    return float(distance(fix.longitude, fix.latitude, goal[0], goal[1]))


def dive_current(held: Held) -> DiveCurrent | None:
    """Return the measured and predicted current of the last dive; None without a measurement."""
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
    """Return a velocity along local axes as a current towards true east and north."""
    if at is None:
        return Current(east, north, error)
    turned = rotate_to_geographic(projection, at.longitude, at.latitude, east, north)
    return Current(float(turned[0]), float(turned[1]), error)


def _rms(east: NDArray[Any], north: NDArray[Any]) -> float:
    """Return the RMS component of finite values; NaN without any."""
    values = np.concatenate([east, north]).astype(np.float64)
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def last_plan(held: Held) -> tuple[Mapping[str, Any] | None, int]:
    """Return the JSON record of the last attempt to plan, or None, and its time [ns, UTC]."""
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
    """Return the solver statistics of a plan by name."""
    return {pair.name: pair.value for pair in plan.statistics}


def next_surfacing(held: Held) -> NextSurfacing | None:
    """Return the next surfacing of the last plan after the vehicle's last surfacing.

    None without legs, or after the last of them.
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
    """Return the first and last time of the forecast [ns, UTC] and whether the estimate is time-dependent; None without times."""
    record = held.metadata.get("replay_kit.forecast", {})
    if "first" not in record:
        return None
    return parse_time(record["first"]), parse_time(record["last"]), record.get("evolves") == "true"
