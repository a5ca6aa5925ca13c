"""The instrument's own depth and heading against the vehicle's: a wrong unit, a sensor that is stuck, a clock that is late.

The instrument's depths p at the times t of its pings, and the vehicle's D, interpolated between its positions, are one depth but for a
small offset. Each unit, p = s D(t), and each lag, p = D(t - lag), leaves residuals whose mean square Q, with a variance that is not
known, gives the log-likelihood ratio

    (n / 2) ln[(Q of equality + floor) / (Q of the hypothesis + floor)],

n being half the number of pings, 32 at most, as neighbouring residuals are alike. About the turns of the vehicle, where the depth between
two positions is not known, nothing is compared. A vehicle that dives alike again and again has many lags that fit: the least is given.

A vehicle that moves heads along its course but for a constant turn. With headings h and courses c(t) between its positions, the mean of
exp(i (h - c(t - lag))) has a length of 1 where the lag is right; what it lacks counts as the mean square of what a lag leaves. A vehicle
that holds its course, or drifts, says nothing.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.measurements.checks.fold import Context, Found, Memory, Rows, recalled
from replay_kit.measurements.checks.likelihood import LEAST_GAIN
from replay_kit.measurements.checks.profile import SURFACE

DEPTHS = "depth of the instrument and depth of the vehicle"
CLOCK = "clock of the instrument"
# After any of these the instrument's depth is known to be wrong, or its time.
_EXPLAINED = frozenset({SURFACE, DEPTHS, CLOCK})
# s between depths that are remembered, and their number: of the vehicle for a day, of the instrument for four hours at least.
_SPACING, MOST_OF_VEHICLE, _MOST_OF_PINGS = 60.0, 1500, 256
#: Columns of them.
REMEMBERED = ("time", "value", "number")
# Pings before which nothing is said, and after how many more of the first ones it is asked again.
_LEAST, _EVERY = 12, 8
# m; changes of one depth that show that the vehicle dives, and those of a sensor that is stuck; error of two sound sensors.
_DIVES, _STUCK, _ERROR = 20.0, 1.0, 0.5
# s; positions farther apart say nothing of what is between them.
_LONGEST = 1800.0
# Factor by which a fault reduces the squares, pings that count at most, and by how many standard errors and seconds a lag differs from none.
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


def spaced(memory: Memory, rows: Rows, changes: bool = False) -> Rows:
    """Return values that are remembered and the new ones that are known and late enough after the last.

    Args:
        memory: ``time`` [ns, UTC], ``value`` and ``number``, how many there have been with each.
        rows: The new ones, with ``value``, shape (n, c).
        changes: Whether a change of the last value is late enough, too; else 60 s are.
    """
    known, chosen, apart = (
        np.isfinite(rows["value"][:, 0]).tolist(),
        list[int](),
        int(_SPACING * 1e9),
    )
    old = memory.get("time", np.empty(0, np.int64))
    last_ns = int(old[-1]) if len(old) else None
    states = rows["value"][:, -1].tolist()
    state = memory["value"][-1, -1] if len(old) else math.nan
    for i, (now, new) in enumerate(zip(rows["time"].tolist(), states, strict=True)):
        late = last_ns is None or now - last_ns >= apart
        if known[i] and (late or (changes and now > last_ns and new != state)):
            chosen.append(i)
            last_ns, state = now, new
    number = np.arange(1, len(chosen) + 1) + (int(memory["number"][-1]) if len(old) else 0)
    return recalled(memory, rows.take(np.array(chosen, np.intp)).having(number=number), *REMEMBERED)


def latest(rows: Rows, most: int = MOST_OF_VEHICLE) -> Memory:
    """Return what is remembered of values."""
    return {name: rows[name][-most:] for name in REMEMBERED}


def of_sensors(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return what an instrument's depths establish beside the vehicle's, or of a vehicle that does not dive its headings.

    Args:
        memory: Depths and headings, up to 256, as of ``spaced``, with ``depth`` or ``heading`` before the names.
        pings: Of one instrument.
        context: Has the vehicle's depths and places.
    """
    own, after, asked = dict[str, Rows](), dict[str, NDArray[Any]](), list[tuple[int, str]]()
    for name, column in (("depth", "pressure_depth"), ("heading", "heading")):
        rows = own[name] = spaced(
            remembered(memory, name), pings.having(value=pings[column][:, None])
        )
        after |= {f"{name}{key}": value for key, value in latest(rows, _MOST_OF_PINGS).items()}
        each = np.where(rows["number"] <= 8 * _EVERY, _EVERY, 4 * _EVERY)
        due = (rows.event >= 0) & (rows["number"] >= _LEAST) & (rows["number"] % each == 0)
        asked += [(int(event), name) for event in rows.event[due]]
    for event, name in sorted(asked) if not _EXPLAINED & context.known(pings.instrument) else ():
        depths, headings = (
            own[each].until(event, _MOST_OF_PINGS).columns for each in ("depth", "heading")
        )
        vehicle, places = (each.until(event, MOST_OF_VEHICLE).columns for each in context.vehicle)
        if name == "depth":
            found = found_of_depths(depths, vehicle, pings.topic)
        elif can_compare(depths, vehicle):
            found = None
        else:
            found = found_of_headings(headings, places, pings.topic)
        if found is not None:
            return after, [Found(event, found, _EXPLAINED)]
    return after, []


def remembered(memory: Memory, name: str) -> Memory:
    """Return what is remembered of depths or headings."""
    return {key: memory[f"{name}{key}"] for key in REMEMBERED if f"{name}{key}" in memory}


def _values(rows: Memory) -> tuple[Array, Array]:
    """Return times since 1970 [s] and values."""
    return rows["time"] * 1e-9, rows["value"][:, 0]


def can_compare(own: Memory, vehicle: Memory) -> bool:
    """Return whether a log has both depths, and one of them changes by as much as a dive."""
    if len(vehicle["time"]) < _LEAST or len(own["time"]) < _LEAST:
        return False
    return max(float(np.ptp(each["value"][:, 0])) for each in (own, vehicle)) >= _DIVES


def found_of_depths(own: Memory, vehicle: Memory, topic: str) -> Finding | None:
    """Return what the instrument's depths and the vehicle's contradict each other in, if anything.

    Args:
        own: Of the instrument, by its pressure.
        vehicle: Of the vehicle, and whether its position was dead-reckoned.
        topic: Of the pings.
    """
    if not can_compare(own, vehicle):
        return None
    return _stuck(own, vehicle, topic) or _wrong(own, vehicle, topic)


def _stuck(own: Memory, vehicle: Memory, topic: str) -> Finding | None:
    """Return that one of the sensors is stuck while the other dives."""
    (t, p), (times, depths) = _values(own), _values(vehicle)
    known = (vehicle["value"][:, 1] > 0.0) & (times >= t[0]) & (times <= t[-1])
    for name, at, values, others_at, others in (
        (f"the depth of the pings of {topic}", t, p, times[known], depths[known]),
        ("the depth of the vehicle", times[known], depths[known], t, p),
    ):
        if len(values) < _LEAST:
            continue
        moved = np.flatnonzero(np.abs(values - values[-1]) > _STUCK)
        begin = int(moved[-1]) + 1 if moved.size else 0
        during = others[(others_at >= at[begin]) & (others_at <= at[-1])]
        if len(values) - begin >= _LEAST and during.size > 1 and np.ptp(during) > _DIVES:
            return Finding(
                DEPTHS,
                int(at[begin] * 1e9),
                f"{name} stays at {values[-1]:.1f} m while the other one goes from {during.min():.0f} to {during.max():.0f} m",
                "a pressure sensor that is stuck, or a logger that repeats its last depth",
                "correct or leave out the depth that is stuck; profiles are placed by the pings' pressure where they have one",
            )
    return None


#: Mean square of what a hypothesis leaves, and the number of values compared.
Misfit = tuple[float, float]


def _gain(none: Misfit, other: Misfit, floor: float, log_scale: float = 0.0) -> float:
    """Return the log-likelihood ratio of misfits; the numbers of values may differ."""
    n = min(none[1], other[1], 2.0 * _COUNTED) / 2.0
    return n * (0.5 * math.log((none[0] + floor) / (other[0] + floor)) - log_scale)


def _best_lag(
    misfit: Callable[[float], Misfit | None], least: float, slack: Callable[[float], float]
) -> float | None:
    """Return the least of the lags that explain values about as well as any [s]; None where none can be judged.

    Args:
        misfit: Of a lag.
        least: Number of values that must be compared.
        slack: Up to which misfit a lag is as good as the best one, of that one's.
    """
    each = ((lag, misfit(lag)) for lag in _LAGS.tolist())
    known = [(lag, left[0]) for lag, left in each if left is not None and left[1] >= least]
    if not known:
        return None
    most = slack(min(left for _, left in known))
    return float(min((lag for lag, left in known if left <= most), key=lambda lag: (abs(lag), lag)))


def _wrong(own: Memory, vehicle: Memory, topic: str) -> Finding | None:
    """Return that the instrument's depths are in another unit, or late, if that explains them much better than equality."""
    (t, p), (times, depths) = _values(own), _values(vehicle)

    def misfit(lag: float, scale: float = 1.0) -> Misfit | None:
        # errors are those of the deeper of the two
        d = _depth_at(t - lag, times, depths) * min(scale, 1.0)
        left = (p / max(scale, 1.0) - d)[np.isfinite(d)]
        if left.size < _LEAST or np.ptp(d[np.isfinite(d)]) < 1.0:
            return None
        return float(np.mean((left - np.median(left)) ** 2)), float(left.size)

    none, floor = misfit(0.0), _ERROR**2
    if none is None or none[0] < _RATIO * floor:
        return None
    best = (0.0, math.inf, "", "")
    for scale, cause in _UNITS:
        unit = misfit(0.0, scale)
        if (
            unit is not None
            and (gain := _gain(none, unit, floor, np.log(max(scale, 1.0)))) > best[0]
        ):
            words = f"{topic}: the pings are {scale:.3g} times as deep as the vehicle"
            evidence = f"{words} ({none[1]:.0f} pings, likelihood ratio e^{gain:.0f})"
            best = gain, unit[0], evidence, cause
    rates = np.diff(depths) / np.maximum(np.diff(times), 1e-3)
    # half of a step beside the best lag the depths differ by so much
    beside = 2.0 * float(np.mean((0.5 * _SPACING * rates) ** 2)) + floor
    lag = _best_lag(misfit, len(t) / 2.0, lambda least: 2.0 * least + beside)
    lag = None if lag is None else _refined(lag, t, p, times, depths)
    late = None if lag is None else misfit(lag)
    if lag is not None and late is not None and (gain := _gain(none, late, floor)) > best[0]:
        best = gain, late[0], "", ""
    gain, left, evidence, cause = best
    if gain < LEAST_GAIN or none[0] < _RATIO * left:
        return None
    if cause or lag is None or late is None:
        advice = "correct the pressure of the pings, or the depth of the vehicle; profiles are placed by the pings' pressure"
        return Finding(DEPTHS, int(t[-1] * 1e9), evidence, cause, advice)
    return _late(f"{topic}: the depths of the pings", int(t[-1] * 1e9), lag, late[1], gain)


def _refined(lag: float, t: Array, p: Array, times: Array, depths: Array) -> float | None:
    """Return a lag between those tried, where residuals are linear in it [s]; None where it does not differ from zero."""
    known = math.inf
    for _ in range(3):
        step, known = _lag_step(t - lag, p, times, depths)
        lag -= float(np.clip(step, -60.0, 60.0))
    return None if abs(lag) < known else lag


def _late(what: str, time_ns: int, lag: float, pings: float, gain: float) -> Finding:
    """Return the finding of an instrument whose depths or headings are those of the vehicle some time before.

    Args:
        what: Of the pings.
        time_ns: Of the last one.
        lag: By how much the clock is ahead [s].
        pings: Their number.
        gain: Log-likelihood ratio.
    """
    size = abs(lag)
    apart = f"{size / 3600.0:.3g} h" if size >= 3600.0 else f"{size:.0f} s"
    return Finding(
        CLOCK,
        time_ns,
        f"{what} are those of the vehicle {apart} {'earlier' if lag > 0.0 else 'later'} ({pings:.0f} pings, likelihood ratio e^{gain:.0f}; "
        "a vehicle that does alike again leaves other lags possible)",
        f"the clock of the instrument is {apart} {'late' if lag < 0.0 else 'ahead'}, or that of the vehicle the other way",
        "correct the clock of one log; --clock chooses among the times that a log states",
    )


def _depth_at(t: Array, times: Array, depths: Array) -> Array:
    """Return the vehicle's depths at some times [m]; NaN beyond its positions, between those far apart, and about its turns."""
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    rate = np.diff(depths) / np.maximum(np.diff(times), 1e-3)
    leg = rate[after - 1]
    others = rate[np.maximum(after - 2, 0)], rate[np.minimum(after, len(rate) - 1)]
    turns = np.maximum(*(np.abs(leg - other) for other in others)) > 0.3 * np.abs(leg) + 0.01
    far = times[after] - times[after - 1] > _LONGEST
    outside = (t < times[0]) | (t > times[-1])
    return np.where(turns | far | outside, np.nan, np.interp(t, times, depths))


def _lag_step(t: Array, p: Array, times: Array, depths: Array) -> tuple[float, float]:
    """Return by how much the times are late by the depths' slopes, and the least lag that differs from none [s]: inf without slopes."""
    d, later = _depth_at(t, times, depths), _depth_at(t + 1.0, times, depths)
    known = np.isfinite(d) & np.isfinite(later)
    slope, left = (later - d)[known], (p - d)[known]
    if known.sum() < _LEAST:
        return 0.0, math.inf
    slope, left = slope - slope.mean(), left - left.mean()
    if (squares := float(slope @ slope)) == 0.0:
        return 0.0, math.inf
    error = math.sqrt((float(left @ left) / left.size + _ERROR**2) / squares)
    return float(slope @ left) / squares, max(_LEAST_LAG, _SIGMAS * error)


def found_of_headings(own: Memory, places: Memory, topic: str) -> Finding | None:
    """Return that the instrument's clock is late, if that explains its headings much better than none.

    Args:
        own: Headings of the instrument.
        places: Longitudes and latitudes of the vehicle.
        topic: Of the pings.
    """
    if len(places["time"]) < _LEAST or len(own["time"]) < _LEAST:
        return None
    (t, degrees), courses = _values(own), _courses(places)
    heading = np.exp(1j * np.radians(degrees))

    def misfit(lag: float) -> Misfit | None:
        return _turns(t - lag, heading, courses)

    none = misfit(0.0)
    if none is None or none[0] < _RATIO * _HEADING_ERROR:
        return None
    lag = _best_lag(misfit, 0.5 * t.size, lambda least: least + 0.1 * _HEADING_ERROR)
    late = None if lag is None else misfit(lag)
    if not lag or late is None or none[0] < _RATIO * late[0]:
        return None
    if (gain := _gain(none, late, _HEADING_ERROR)) < LEAST_GAIN:
        return None
    return _late(f"{topic}: the headings of the pings", int(t[-1] * 1e9), lag, late[1], gain)


def least_lag(depths: Memory, headings: Memory, vehicle: Memory, places: Memory) -> float:
    """Return the least lag of an instrument's clock that its depths or headings would show [s]; inf where they show none.

    Args:
        depths: Of the instrument.
        headings: Of the instrument.
        vehicle: Depths of the vehicle.
        places: Of the vehicle.
    """
    found = (
        _lag_step(*_values(depths), *_values(vehicle))[1]
        if can_compare(depths, vehicle)
        else math.inf
    )
    if len(places["time"]) < _LEAST or len(headings["time"]) < _LEAST:
        return found
    t, courses = _values(headings)[0], _courses(places)
    heading = _course_at(t, courses)
    for lag in _ASKED.tolist():
        none = _turns(t - lag, heading, courses)
        if none is not None and _gain(none, (0.0, none[1]), _HEADING_ERROR) >= LEAST_GAIN:
            return min(found, float(lag))
    return found


Courses = tuple[Array, NDArray[np.complex128]]


def _courses(places: Memory) -> Courses:
    """Return times [s], and the direction from each position to the next; 0 where the vehicle hardly moves or it is not known."""
    times, (longitude, latitude) = places["time"] * 1e-9, places["value"].T
    east, north = metres_per_degree(float(latitude[0]))
    way = north * np.diff(latitude) + 1j * east * ((np.diff(longitude) + 180.0) % 360.0 - 180.0)
    seconds = np.maximum(np.diff(times), 1e-3)
    moves = (np.abs(way) >= _MOVES * seconds) & (seconds <= 2.0 * _LONGEST)
    return times, np.where(moves, way / np.maximum(np.abs(way), 1e-9), 0.0)


def _course_at(t: Array, courses: Courses) -> NDArray[np.complex128]:
    times, course = courses
    at = np.searchsorted(times, t, side="right") - 1
    inside = (at >= 0) & (at < course.size)
    return np.where(inside, course[np.clip(at, 0, course.size - 1)], 0.0)


def _turns(t: Array, heading: NDArray[np.complex128], courses: Courses) -> Misfit | None:
    """Return the mean square of what headings and courses differ in, less a constant turn, and their number; None where few turn."""
    course = _course_at(t, courses)
    known = (course != 0.0) & (heading != 0.0)
    number = int(known.sum())
    if number < _LEAST or abs(course[known].mean()) > 1.0 - _TURNS:
        return None
    return 2.0 - 2.0 * abs(complex(np.mean(heading[known] * course[known].conj()))), float(number)
