"""Checks of an instrument's depth and heading against the vehicle's: wrong unit, stuck sensor, late clock.

The instrument's depths p at the times t of its pings equal the vehicle's D, interpolated between its positions, up to a small offset. Each
unit, p = s D(t), and each lag, p = D(t - lag), has residuals whose mean square Q, with unknown variance, gives the log-likelihood ratio

    (n / 2) ln[(Q of equality + floor) / (Q of the hypothesis + floor)],

with n half the number of pings, at most 32, as neighbouring residuals are correlated. Turns of the vehicle, with unknown depth between two
positions, are excluded. Of several lags that fit repeated dives the least is given.

A moving vehicle heads along its course up to a constant angle. With headings h and courses c(t) between its positions, the mean of exp(i (h
- c(t - lag))) has length 1 for the right lag; the deficit is the mean square of the residuals. A vehicle on constant course or adrift gives
no result.
"""

import math
from collections.abc import Callable

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.measurements.checks.fold import (
    Context,
    Found,
    Judged,
    Memory,
    Rows,
    displacements,
    history,
)
from replay_kit.measurements.checks.likelihood import LEAST_GAIN, Complex
from replay_kit.measurements.checks.profile import SURFACE

DEPTHS = "depth of the instrument and depth of the vehicle"
CLOCK = "clock of the instrument"
# After any of these the instrument's depth is known to be wrong, or its time.
_EXPLAINED = {SURFACE, DEPTHS, CLOCK}
# s between depths that are remembered, and their number: of the vehicle for a day, of the instrument for four hours at least.
_SPACING, _MOST_OF_VEHICLE, _MOST_OF_PINGS = 60.0, 1500, 256
# Pings before which nothing is said, and after how many more of the first ones it is asked again.
_LEAST, _EVERY = 12, 8
# m; changes of one depth that show that the vehicle dives, and those of a sensor that is stuck; error of two sound sensors.
_DIVES, _STUCK, _ERROR = 20.0, 1.0, 0.5
# s; positions farther apart say nothing of what is between them.
_LONGEST = 1800.0
# Factor by which a fault reduces the squares, pings that count at most, by how many standard errors and seconds a lag differs from none.
_RATIO, _COUNTED, _SIGMAS, _LEAST_LAG = 4.0, 32.0, 4.0, 10.0
# s; lags that are tried, and those of which it is asked whether they would show.
_LAGS = np.arange(-46_800.0, 46_801.0, _SPACING)
_ASKED = _SPACING * 2.0 ** np.arange(10)
# m/s of a vehicle whose heading is its course; mean square error of the two, of 10 degrees; share by which courses must differ.
_MOVES, _HEADING_ERROR, _TURNS = 0.5, 0.03, 0.1
# How many times as deep the instrument is as the vehicle, and the cause.
_UNITS = (
    (0.1, "the pressure of the pings is in bar, taken for dbar"),
    (10.0, "the pressure of the pings is in kPa, taken for dbar"),
    (3.28084, "the depth of the pings is in feet"),
    (1.4504, "the pressure of the pings is in psi, taken for dbar"),
    (0.3048, "the depth of the vehicle is in feet"),
    (0.01, "the depth of the vehicle is in cm, or the pressure of the pings in units of 100 dbar"),
)
#: Mean square of what a hypothesis leaves, and the number of values compared; NaN where few or none can be.
Misfit = tuple[float, float]
_UNKNOWN = math.nan, math.nan
# Columns of an instrument, or of the vehicle.
Columns = Memory | Rows


def vehicle_history(memory: Memory, positions: Rows) -> tuple[Memory, list[Found], Rows]:
    """Return the new memory of the vehicle's depths and positions, no finding, and their rows of the last day."""
    names = "time", "depth", "dead_reckoned", "longitude", "latitude"
    rows, after = history(memory, positions, names, _SPACING, _MOST_OF_VEHICLE)
    return after, [], rows


def against_vehicle(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check an instrument's depths, or without dives its headings, against the vehicle's.

    Args:
        memory: ``time`` [ns], ``pressure_depth`` [m] and ``heading`` [degrees] of the latest pings that state either, up to 256, and their
            ``number`` so far.
        pings: Pings of one instrument.
        context: Depths and positions of the vehicle.
    """
    known = np.isfinite(pings["pressure_depth"]) | np.isfinite(pings["heading"])
    names = "time", "pressure_depth", "heading"
    sampled, after = history(memory, pings.take(known), names, _SPACING, _MOST_OF_PINGS)
    for event in sampled.due(_EVERY) if _EXPLAINED.isdisjoint(context.known) else ():
        both = sampled.until(event, _MOST_OF_PINGS), context.vehicle.until(event, _MOST_OF_VEHICLE)
        found = (_depth_finding if _can_compare(*both) else _heading_finding)(*both)
        if found is not None:
            return after, [Found(event, found, _EXPLAINED)]
    return after, []


def _known_values(rows: Columns, name: str) -> tuple[Array, Array]:
    """Return times since 1970 [s] and known values of a column."""
    known = np.isfinite(rows[name])
    return rows["time"][known] * 1e-9, rows[name][known]


def _can_compare(sensor: Columns, vehicle: Columns) -> bool:
    """Return whether a log has both depths, one of which varies as in a dive."""
    both = _known_values(sensor, "pressure_depth")[1], _known_values(vehicle, "depth")[1]
    return min(map(len, both)) >= _LEAST and bool(max(map(np.ptp, both)) >= _DIVES)


def _gain(none: Misfit, other: Misfit, floor: float, scale: float = 1.0) -> float:
    """Return the log-likelihood ratio of misfits, also for different numbers of values or a scale of their errors."""
    n = min(none[1], other[1], 2.0 * _COUNTED) / 2.0
    return n * (0.5 * math.log((none[0] + floor) / (other[0] + floor)) - math.log(scale))


def _best_lag(
    misfit: Callable[[float], Misfit], least: float, slack: Callable[[float], float]
) -> float:
    """Return the least lag that fits about as well as the best [s]; NaN if no lag can be tested.

    Args:
        misfit: Returns the misfit of a lag.
        least: Least number of compared values.
        slack: Returns the largest equivalent misfit for the best misfit.
    """
    each = [(lag, *misfit(lag)) for lag in _LAGS.tolist()]
    known = [(lag, left) for lag, left, number in each if number >= least]
    most = slack(min((left for _, left in known), default=math.nan))
    fits = (lag for lag, left in known if left <= most)
    return min(fits, key=lambda lag: (abs(lag), lag), default=math.nan)


def _depth_finding(sensor: Rows, vehicle: Rows) -> Finding | None:
    """Return the finding that a depth is stuck, or the instrument's are in another unit or late."""
    (t, p) = _known_values(sensor, "pressure_depth")
    (times, depths) = _known_values(vehicle, "depth")
    time_ns = int(t[-1] * 1e9)
    reckoned = vehicle["dead_reckoned"][np.isfinite(vehicle["depth"])] & (times >= t[0])
    known = reckoned & (times <= t[-1])
    series = ((t, p), (times[known], depths[known]))
    names = f"the depth of the pings of {sensor.topic}", "the depth of the vehicle"
    for name, (at, values), (others_at, others) in zip(names, series, series[::-1], strict=True):
        begin = np.flatnonzero(np.abs(values - values[-1:]) > _STUCK).max(initial=-1) + 1
        if len(values) - begin < _LEAST:
            continue
        during = others[(others_at >= at[begin]) & (others_at <= at[-1])]
        if during.size > 1 and np.ptp(during) > _DIVES:
            return Finding(
                DEPTHS,
                int(at[begin] * 1e9),
                f"{name} stays at {values[-1]:.1f} m while the other one goes from {during.min():.0f} to {during.max():.0f} m",
                "a pressure sensor that is stuck, or a logger that repeats its last depth",
                "correct or leave out the depth that is stuck; profiles are placed by the pings' pressure where they have one",
            )

    def misfit(lag: float, scale: float = 1.0) -> Misfit:
        # errors are those of the deeper of the two
        d = _depth_at(t - lag, times, depths) * min(scale, 1.0)
        left = (p / max(scale, 1.0) - d)[np.isfinite(d)]
        if left.size < _LEAST or np.ptp(d[np.isfinite(d)]) < 1.0:
            return _UNKNOWN
        return float(np.mean((left - np.median(left)) ** 2)), float(left.size)

    none, floor = misfit(0.0), _ERROR**2
    if not none[0] >= _RATIO * floor:
        return None
    rates = np.diff(depths) / np.maximum(np.diff(times), 1e-3)
    # half of a step beside the best lag the depths differ by so much
    beside = 2.0 * float(np.mean((0.5 * _SPACING * rates) ** 2)) + floor
    lag = _best_lag(misfit, len(t) / 2.0, lambda least: 2.0 * least + beside)
    for _ in range(3):
        # between those tried, where residuals are linear in it
        step, least = _lag_step(t - lag, p, times, depths)
        lag -= float(np.clip(step, -60.0, 60.0))
    best, late = (0.0, math.inf, 0.0, ""), misfit(lag)
    for scale, cause in _UNITS:
        unit = misfit(0.0, scale)
        best = max(best, (_gain(none, unit, floor, max(scale, 1.0)), unit[0], scale, cause))
    gain, left, scale, cause = best
    if abs(lag) >= least and _gain(none, late, floor) > gain:
        return _lag_finding(
            f"{sensor.topic}: the depths of the pings", time_ns, lag, none, late, floor
        )
    if gain < LEAST_GAIN or none[0] < _RATIO * left:
        return None
    return Finding(
        DEPTHS,
        time_ns,
        f"{sensor.topic}: the pings are {scale:.3g} times as deep as the vehicle ({none[1]:.0f} pings, likelihood ratio e^{gain:.0f})",
        cause,
        "correct the pressure of the pings, or the depth of the vehicle; profiles are placed by the pings' pressure",
    )


def _lag_finding(
    what: str, time_ns: int, lag: float, none: Misfit, late: Misfit, floor: float
) -> Finding | None:
    """Return the finding of late depths or headings, if a lag explains them much better than equality.

    Args:
        what: Quantity of the pings.
        time_ns: Time of the last ping [ns, UTC].
        lag: Lag of the clock [s].
        none: Misfit without a lag.
        late: Misfit with the lag.
        floor: Mean square error of working sensors.
    """
    gain, size = _gain(none, late, floor), abs(lag)
    if not (gain >= LEAST_GAIN and none[0] >= _RATIO * late[0]):
        return None
    apart = f"{size / 3600.0:.3g} h" if size >= 3600.0 else f"{size:.0f} s"
    return Finding(
        CLOCK,
        time_ns,
        f"{what} are those of the vehicle {apart} {'earlier' if lag > 0.0 else 'later'} ({late[1]:.0f} pings, "
        f"likelihood ratio e^{gain:.0f}; repeated dives leave other lags possible)",
        f"the clock of the instrument is {apart} {'late' if lag < 0.0 else 'ahead'}, or that of the vehicle the other way",
        "correct the clock of one log; --clock chooses among the times that a log states",
    )


def _depth_at(t: Array, times: Array, depths: Array) -> Array:
    """Return the vehicle's depths at some times [m]; NaN outside its positions, in long gaps and near turns."""
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    rate = np.pad(np.diff(depths) / np.maximum(np.diff(times), 1e-3), 1, "edge")
    leg = rate[after]
    turns = np.maximum(abs(leg - rate[after - 1]), abs(leg - rate[after + 1]))
    far = times[after] - times[after - 1] > _LONGEST
    unknown = far | (turns > 0.3 * np.abs(leg) + 0.01)
    return np.where(unknown, np.nan, np.interp(t, times, depths, np.nan, np.nan))


def _lag_step(t: Array, p: Array, times: Array, depths: Array) -> tuple[float, float]:
    """Return the lag from the slopes of the depths, and the least detectable lag [s]: inf without slopes."""
    d, later = _depth_at(t, times, depths), _depth_at(t + 1.0, times, depths)
    known = np.isfinite(d) & np.isfinite(later)
    slope, left = (later - d)[known], (p - d)[known]
    if known.sum() < _LEAST or not np.ptp(slope):
        return 0.0, math.inf
    slope, left = slope - slope.mean(), left - left.mean()
    squares = float(slope @ slope)
    error = math.sqrt((float(left @ left) / left.size + _ERROR**2) / squares)
    return float(slope @ left) / squares, max(_LEAST_LAG, _SIGMAS * error)


def _heading_finding(sensor: Rows, vehicle: Rows) -> Finding | None:
    """Return the finding of a late clock, if it explains the headings much better than none."""
    t, degrees = _known_values(sensor, "heading")
    # a constant turn is free
    heading, course = np.exp(-1j * np.radians(degrees)), _course_of(vehicle)

    def misfit(lag: float) -> Misfit:
        return _turns(heading, course(t - lag))

    none = misfit(0.0)
    if not none[0] >= _RATIO * _HEADING_ERROR:
        return None
    lag = _best_lag(misfit, 0.5 * t.size, lambda least: least + 0.1 * _HEADING_ERROR)
    what, time_ns = f"{sensor.topic}: the headings of the pings", int(t[-1] * 1e9)
    return _lag_finding(what, time_ns, lag, none, misfit(lag), _HEADING_ERROR)


def least_lag(sensor: Memory, vehicle: Memory) -> float:
    """Return the least detectable lag of an instrument's clock by depths or headings [s]; inf without any.

    Args:
        sensor: Remembered depths and headings of the instrument.
        vehicle: Remembered depths and positions of the vehicle.
    """
    found = list[float]()
    if _can_compare(sensor, vehicle):
        depths = *_known_values(sensor, "pressure_depth"), *_known_values(vehicle, "depth")
        found.append(_lag_step(*depths)[1])
    (t, _), course = _known_values(sensor, "heading"), _course_of(vehicle)
    for lag in _ASKED.tolist():
        none = _turns(course(t), course(t - lag))
        if _gain(none, (0.0, none[1]), _HEADING_ERROR) >= LEAST_GAIN:
            found.append(lag)
    return min(found, default=math.inf)


def _course_of(vehicle: Columns) -> Callable[[Array], Complex]:
    """Return a function that returns the vehicle's course at times; 0 where it hardly moves or is unknown."""
    times, (way, seconds) = vehicle["time"] * 1e-9, displacements(vehicle)
    if len(times) < _LEAST:
        return lambda t: np.zeros(len(t), np.complex128)
    moves = (np.abs(way) >= _MOVES * seconds) & (seconds <= 2.0 * _LONGEST)
    # none before the first position, nor after the last
    course = np.pad(np.where(moves, way / np.maximum(np.abs(way), 1e-9), 0.0), 1)
    return lambda t: course[np.searchsorted(times, t, side="right")]


def _turns(heading: Complex, course: Complex) -> Misfit:
    """Return the mean square difference of headings and courses, less a constant angle, and their number; NaN if few turn."""
    known = (course != 0.0) & (heading != 0.0)
    if known.sum() < _LEAST or abs(course[known].mean()) > 1.0 - _TURNS:
        return _UNKNOWN
    mean = np.mean(heading[known] * course[known].conj())
    return 2.0 - 2.0 * abs(complex(mean)), float(known.sum())
