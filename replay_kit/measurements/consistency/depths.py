"""The instrument's own depth, by its pressure, against the vehicle's: a wrong unit, a sensor that is stuck, a clock that is late.

The instrument's depths p at the times t of its pings, and the vehicle's D, interpolated between its positions, are one depth but for a
small offset. Each hypothesis of ``_UNITS``, p = s D(t), and each lag, p = D(t - lag), leaves residuals whose sum of squares Q, with a
variance that is not known, gives the log-likelihood ratio

    (n / 2) ln[(Q of equality + floor) / (Q of the hypothesis + floor)],

n being half the number of pings, 32 at most, as neighbouring residuals are alike. About the turns of the vehicle, where the depth between
two positions is not known, nothing is compared. A vehicle that dives alike again and again has many lags that fit: the least is given.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.measurements.consistency import findings

# s between depths that are remembered, and their number: of the vehicle for a day, of the instrument for four hours at least
SPACING, _MOST_OF_VEHICLE, _MOST_OF_PINGS = 60.0, 1500, 256
# Pings before which nothing is said, and after how many more of the first ones it is asked again.
LEAST_PINGS, _EVERY = 12, 8
# m; changes of one depth that show that the vehicle dives, and those of a sensor that is stuck; error of two sound sensors
_DIVES, _STUCK, _ERROR = 20.0, 1.0, 0.5
# s; positions farther apart say nothing of the depth between them
LONGEST = 1800.0
# Log-likelihood ratio from which a fault is named, factor by which it reduces the squares, pings that count at most, and by how many
# standard errors and seconds a lag must differ from none.
LEAST_GAIN, _LEAST_RATIO, MOST_COUNTED, _SIGMAS, _LEAST_LAG = 9.0, 4.0, 32.0, 4.0, 10.0
# s; lags that are tried
_STEP = 60.0
_LAGS = np.arange(-46_800.0, 46_801.0, _STEP)
# How many times as deep the instrument is as the vehicle, and the cause.
_UNITS = (
    (0.1, "the pressure of the pings is in bar, taken for dbar"),
    (10.0, "the pressure of the pings is in kPa, taken for dbar"),
    (3.28084, "the depth of the pings is in feet"),
    (1.4504, "the pressure of the pings is in psi, taken for dbar"),
    (0.3048, "the depth of the vehicle is in feet"),
    (0.01, "the depth of the vehicle is in cm, or the pressure of the pings in units of 100 dbar"),
)


class Depth(NamedTuple):
    """A depth [m] at a time [ns, UTC], and whether the vehicle's position was dead-reckoned: under water there is no fix."""

    time_ns: int
    depth: float
    under_water: bool = True


@dataclass(frozen=True, slots=True)
class DepthRecord:
    """Depths so far, of a vehicle or of an instrument.

    Attributes:
        depths: Latest ones, oldest first.
        number: Number so far, with those that are forgotten.
    """

    depths: tuple[Depth, ...] = ()
    number: int = 0

    def after(self, depth: Depth, most: int = _MOST_OF_VEHICLE) -> "DepthRecord":
        """Return the record with one more depth, where it is known and comes late enough after the last one."""
        last = self.depths[-1] if self.depths else None
        if not math.isfinite(depth.depth) or (
            last is not None
            and depth.time_ns - last.time_ns < SPACING * 1e9
            and (depth.time_ns <= last.time_ns or depth.under_water == last.under_water)
        ):
            return self
        return DepthRecord((*self.depths[1 - most :], depth), self.number + 1)

    def after_ping(self, time_ns: int, depth: float) -> "DepthRecord":
        """Return the record of an instrument with the depth of one more ping."""
        return self.after(Depth(time_ns, depth), _MOST_OF_PINGS)

    @property
    def is_due(self) -> bool:
        """Whether the depths of an instrument are to be compared now: not after every ping."""
        each = _EVERY if self.number <= 8 * _EVERY else 4 * _EVERY
        return self.number >= LEAST_PINGS and self.number % each == 0

    @property
    def arrays(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Times since 1970 [s], depths [m], and which of them are under water."""
        time_ns, depth, under = zip(*self.depths, strict=True)
        return np.array(time_ns) * 1e-9, np.array(depth), np.array(under)


def can_compare(own: DepthRecord, vehicle: DepthRecord) -> bool:
    """Return whether a log has both depths, and one of them changes by as much as a dive."""
    if len(vehicle.depths) < LEAST_PINGS or len(own.depths) < LEAST_PINGS:
        return False
    return max(float(np.ptp(each.arrays[1])) for each in (own, vehicle)) >= _DIVES


def least_lag(own: DepthRecord, vehicle: DepthRecord) -> float:
    """Return the least lag of an instrument's clock that its depths would show [s]; inf where they show none."""
    if not can_compare(own, vehicle):
        return math.inf
    (t, p, _), (times, depths, _) = own.arrays, vehicle.arrays
    return _lag_step(t, p, times, depths)[1]


def found_of_depths(own: DepthRecord, vehicle: DepthRecord, topic: str) -> Finding | None:
    """Return what the instrument's depths and the vehicle's contradict each other in, if anything.

    Args:
        own: Of the instrument, by its pressure.
        vehicle: Of the vehicle.
        topic: Of the pings.
    """
    if not can_compare(own, vehicle):
        return None
    return _stuck(own, vehicle, topic) or _wrong(own, vehicle, topic)


def _stuck(own: DepthRecord, vehicle: DepthRecord, topic: str) -> Finding | None:
    """Return that one of the sensors is stuck while the other dives."""
    (t, p, _), (times, depths, under) = own.arrays, vehicle.arrays
    known = under & (times >= t[0]) & (times <= t[-1])
    for name, at, values, others_at, others in (
        (f"the depth of the pings of {topic}", t, p, times[known], depths[known]),
        ("the depth of the vehicle", times[known], depths[known], t, p),
    ):
        if len(values) < LEAST_PINGS:
            continue
        moved = np.flatnonzero(np.abs(values - values[-1]) > _STUCK)
        begin = int(moved[-1]) + 1 if moved.size else 0
        during = others[(others_at >= at[begin]) & (others_at <= at[-1])]
        if len(values) - begin >= LEAST_PINGS and during.size > 1 and np.ptp(during) > _DIVES:
            return Finding(
                findings.DEPTHS,
                int(at[begin] * 1e9),
                f"{name} stays at {values[-1]:.1f} m while the other one goes from {during.min():.0f} to {during.max():.0f} m",
                "a pressure sensor that is stuck, or a logger that repeats its last depth",
                "correct or leave out the depth that is stuck; profiles are placed by the pings' pressure where they have one",
            )
    return None


def _wrong(own: DepthRecord, vehicle: DepthRecord, topic: str) -> Finding | None:
    """Return that the instrument's depths are in another unit, or late, if that explains them much better than equality."""
    (t, p, _), (times, depths, _) = own.arrays, vehicle.arrays
    none = _misfit(p, _depth_at(t, times, depths))
    if none is None or none[0] < _LEAST_RATIO * _ERROR**2 * none[1]:
        return None
    best = (0.0, math.nan, "", "")
    for scale, cause in _UNITS:
        # errors are those of the deeper of the two
        unit = _misfit(p / max(scale, 1.0), _depth_at(t, times, depths) * min(scale, 1.0))
        if unit is not None and (gain := _gain(none, unit, np.log(max(scale, 1.0)))) > best[0]:
            words = f"{topic}: the pings are {scale:.3g} times as deep as the vehicle"
            best = gain, unit[0], f"{words} ({none[1]:.0f} pings, likelihood ratio e^{gain:.0f})", cause  # fmt: skip
    lag, late = _best_lag(t, p, times, depths)
    if late is not None and (gain := _gain(none, late)) > best[0]:
        best = gain, late[0], "", ""
    gain, left, evidence, cause = best
    if gain < LEAST_GAIN or none[0] < _LEAST_RATIO * left:
        return None
    if cause:
        advice = "correct the pressure of the pings, or the depth of the vehicle; profiles are placed by the pings' pressure"
        return Finding(findings.DEPTHS, int(t[-1] * 1e9), evidence, cause, advice)
    assert late is not None, "nothing else has no cause"
    return late_clock(f"{topic}: the depths of the pings", int(t[-1] * 1e9), lag, late[1], gain)


def late_clock(what: str, time_ns: int, lag: float, pings: float, gain: float) -> Finding:
    """Return the finding of an instrument whose depths or headings are those of the vehicle some time before.

    Args:
        what: Of the pings.
        time_ns: Of the last one.
        lag: By how much the clock is ahead [s].
        pings: Their number.
        gain: Log-likelihood ratio.
    """
    apart, more = (
        _duration(abs(lag)),
        "; a vehicle that does alike again leaves other lags possible",
    )
    return Finding(
        findings.CLOCK,
        time_ns,
        f"{what} are those of the vehicle {apart} {'earlier' if lag > 0.0 else 'later'} "
        f"({pings:.0f} pings, likelihood ratio e^{gain:.0f}{more})",
        f"the clock of the instrument is {apart} {'late' if lag < 0.0 else 'ahead'}, or that of the vehicle the other way",
        "correct the clock of one log; --clock chooses among the times that a log states",
    )


def _duration(seconds: float) -> str:
    return f"{seconds / 3600.0:.3g} h" if seconds >= 3600.0 else f"{seconds:.0f} s"


def _depth_at(t: Array, times: Array, depths: Array) -> Array:
    """Return the vehicle's depths at some times [m]; NaN beyond its positions, between those far apart, and about its turns."""
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    rate = np.diff(depths) / np.maximum(np.diff(times), 1e-3)
    leg, others = rate[after - 1], (rate[np.maximum(after - 2, 0)], rate[np.minimum(after, len(rate) - 1)])  # fmt: skip
    turns = np.maximum(*(np.abs(leg - other) for other in others)) > 0.3 * np.abs(leg) + 0.01
    far = times[after] - times[after - 1] > LONGEST
    outside = (t < times[0]) | (t > times[-1])
    return np.where(turns | far | outside, np.nan, np.interp(t, times, depths))


def _misfit(p: Array, d: Array) -> tuple[float, float] | None:
    """Return the sum of squares of p - d less its mean offset, and the number of depths compared; None with too few."""
    left = (p - d)[np.isfinite(d)]
    if left.size < LEAST_PINGS or np.ptp(d[np.isfinite(d)]) < 1.0:
        return None
    return float(np.sum((left - np.median(left)) ** 2)), float(left.size)


def _gain(none: tuple[float, float], other: tuple[float, float], log_scale: float = 0.0) -> float:
    """Return the log-likelihood ratio of misfits; the numbers of depths may differ."""
    n = min(none[1], other[1], 2.0 * MOST_COUNTED) / 2.0
    ratio = (none[0] / none[1] + _ERROR**2) / (other[0] / other[1] + _ERROR**2)
    return 0.5 * n * math.log(ratio) - n * log_scale


def _best_lag(
    t: Array, p: Array, times: Array, depths: Array
) -> tuple[float, tuple[float, float] | None]:
    """Return the least lag [s] that explains the depths about as well as any, and its misfit; None where none differs from zero."""
    half, found = len(t) / 2.0, list[tuple[float, float, float]]()
    for lag in _LAGS.tolist():
        misfit = _misfit(p, _depth_at(t - lag, times, depths))
        if misfit is not None and misfit[1] >= half:
            found.append((lag, *misfit))
    if not found:
        return 0.0, None
    least = min(squares / number for _, squares, number in found)
    # half of a step beside the best lag the depths differ by so much
    rates = np.diff(depths) / np.maximum(np.diff(times), 1e-3)
    most = 2.0 * least + 2.0 * float(np.mean((0.5 * _STEP * rates) ** 2)) + _ERROR**2
    lag = min((abs(lag), lag) for lag, squares, number in found if squares / number <= most)[1]
    # between the lags tried the residuals are linear in the lag
    known = math.inf
    for _ in range(3):
        step, known = _lag_step(t - lag, p, times, depths)
        lag -= float(np.clip(step, -60.0, 60.0))
    if abs(lag) < known:
        return 0.0, None
    return lag, _misfit(p, _depth_at(t - lag, times, depths))


def _lag_step(t: Array, p: Array, times: Array, depths: Array) -> tuple[float, float]:
    """Return by how much the times are late by the depths' slopes, and the least lag that differs from none [s]: inf without slopes."""
    d, later = _depth_at(t, times, depths), _depth_at(t + 1.0, times, depths)
    known = np.isfinite(d) & np.isfinite(later)
    slope, left = (later - d)[known], (p - d)[known]
    if known.sum() < LEAST_PINGS:
        return 0.0, math.inf
    slope, left = slope - slope.mean(), left - left.mean()
    if (squares := float(slope @ slope)) == 0.0:
        return 0.0, math.inf
    error = math.sqrt((float(left @ left) / left.size + _ERROR**2) / squares)
    return float(slope @ left) / squares, max(_LEAST_LAG, _SIGMAS * error)
