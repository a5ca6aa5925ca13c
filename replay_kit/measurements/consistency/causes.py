"""Which cause explains profiles by the mean currents beside them: all hypotheses of each, compared with those of the others.

What explains the vectors relative to the vehicle (a compass, a mounting) is a rival of what explains the currents themselves (axes, a unit,
an offset). Where heading and current hardly change, several explain the pairs: nothing is then excluded, and the odds of all are given.

A clock that is late is found by the instrument's heading against the course between the vehicle's positions. A vehicle that moves heads
along its course but for a constant turn, of a declination or a mounting. With headings h at the times t of pings and courses c(t), the
mean of exp(i (h - c(t - lag))) has a length of 1 where the lag is right. What it lacks counts as the mean square of what a lag leaves, and
the likelihood ratio of a lag is that of ``depths.py``. A vehicle that holds its course, or drifts, says nothing.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.core.observation import PathMean, VehicleState
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.depths import (
    LEAST_GAIN,
    LEAST_PINGS,
    LONGEST,
    MOST_COUNTED,
    SPACING,
    DepthRecord,
    late_clock,
)
from replay_kit.measurements.consistency.pairs import (
    SCALES,
    Explanation,
    PairStatistics,
    odds,
)
from replay_kit.measurements.consistency.sources import SourceStatistics, metres_per_degree
from replay_kit.measurements.consistency.usual_faults import CAUSES, KINDS, SCALE_CAUSE, kinds_of

#: Pairs before which nothing is said: of mean currents, of dives relative to the vehicle, of the platform's motion.
LEAST_MEANS, LEAST_DIVES, LEAST_MOTIONS = 3, 2, 4
# The same of gross units: one wrong dive is none.
_LEAST_UNITS = 2
# Log-likelihood ratio of a turn relative to the vehicle, and the probability that the named cause has among all. Pairs after which a
# contradiction is named without a cause, but with the odds of all.
_TURN_GAIN, _LIKELY, _ENOUGH = 7.0, 0.98, 6
#: Kinds of hypotheses of directions.
TURNED = ("turn", "mirror")
_UNIT = ("unit",)
# Relative to the vehicle an offset and small scales are also those of its way.
_RELATIVE, _ANY = (*TURNED, "unit"), KINDS
_ADDED = (CAUSES["offset"], CAUSES["drift"])
_OF_VEHICLE = " relative to the vehicle"


def cause_of_pairs(
    sources: SourceStatistics, current: PairStatistics, mean: PathMean, topic: str
) -> Finding | None:
    """Return what a mean current established: of all causes the likeliest, once it is likely enough or there are many pairs."""
    blocks = sources.blocks.explanation(TURNED, LEAST_MOTIONS)
    if blocks is not None:
        return findings.turned(blocks, findings.OF_VEHICLE, mean.time_ns, topic)
    causes = current.causes(_ANY, LEAST_MEANS)
    for cause, gain in sources.vehicle.causes(_RELATIVE, LEAST_DIVES).items():
        # a scale is one, whatever it is relative to
        name = cause if cause == SCALE_CAUSE else f"{cause}{_OF_VEHICLE}"
        causes[name] = float(np.logaddexp(causes.get(name, -math.inf), gain))
    rivals = odds(causes)
    if not rivals:
        return None
    cause, share = rivals[0]
    if cause in _ADDED:
        # what excludes a scale must hold where the current hardly changes, too
        rivals = _beside(causes, current.causes(SCALES, LEAST_MEANS, of_one_current=True))
    best = None
    if cause == SCALE_CAUSE:
        scales = (
            current.explanation(_UNIT, _LEAST_UNITS),
            current.explanation(SCALES, LEAST_MEANS),
            sources.vehicle.explanation(_UNIT, LEAST_MEANS),
        )
        best = max((each for each in scales if each), key=lambda each: each.gain, default=None)
        if best is None or best.fault.kind not in _UNIT or not best.fault.unit:
            # what excludes an offset must be how it fits, not that its size is not known before; no offset is a unit again and again
            rivals = _beside(causes, current.added_by_fit(LEAST_MEANS))
    elif cause.endswith(_OF_VEHICLE):
        best = sources.vehicle.explanation(TURNED, LEAST_DIVES, _TURN_GAIN)
        # what excludes an instrument must be certain
        if best is not None and share >= _LIKELY:
            return findings.turned(best, findings.OF_VEHICLE, mean.time_ns, topic)
    else:
        best = current.explanation(kinds_of(cause, _ANY), LEAST_MEANS)
    share = dict(rivals)[cause]
    if best is None or (share < _LIKELY and best.pairs < _ENOUGH):
        return None
    if share < _LIKELY:
        return findings.undecided(best, rivals, mean, topic)
    return findings.of_sources(best, rivals, mean, topic)


def _beside(causes: dict[str, float], alike: dict[str, float]) -> list[tuple[str, float]]:
    """Return the odds of causes where some count at least as much as another comparison has it."""
    return odds({one: max(gain, alike.get(one, gain)) for one, gain in causes.items()})


def scale_of_motion(track: PairStatistics) -> Explanation | None:
    """Return the scale of a stated motion beside that of positions, once it is likelier than all else; positions may lack the current."""
    explained = track.explanation(SCALES, LEAST_MOTIONS)
    if explained is None:
        return None
    cause, share = odds(track.causes(_ANY, LEAST_MOTIONS))[0]
    return explained if cause == SCALE_CAUSE and share >= _LIKELY else None


# m/s of a vehicle whose heading is its course; mean square error of the two, of 10 degrees; share by which courses must differ
_MOVES, _ERROR, _TURNS = 0.5, 0.03, 0.1
# s; lags that are tried, and those of which it is asked whether they would show; positions that are remembered
_LAGS = np.arange(-46_800.0, 46_801.0, SPACING)
_ASKED = SPACING * 2.0 ** np.arange(10)
_MOST = 1500
#: Latest positions, oldest first.
Positions = tuple[VehicleState, ...]


def with_position(positions: Positions, vehicle: VehicleState) -> Positions:
    """Return the positions with one more, where it comes late enough after the last one."""
    if positions and vehicle.time_ns - positions[-1].time_ns < SPACING * 1e9:
        return positions
    return (*positions[1 - _MOST :], vehicle)


def found_of_headings(own: DepthRecord, positions: Positions, topic: str) -> Finding | None:
    """Return that the instrument's clock is late, if that explains its headings much better than none.

    Args:
        own: Of the instrument, headings [degrees] in place of depths.
        positions: Of the vehicle.
        topic: Of the pings.
    """
    if len(positions) < LEAST_PINGS or len(own.depths) < LEAST_PINGS:
        return None
    t, degrees, _ = own.arrays
    heading, courses = np.exp(1j * np.radians(degrees)), _courses(positions)
    none = _misfit(t, heading, courses)
    if none is None or none[0] < 4.0 * _ERROR:
        return None
    each = [(lag, _misfit(t - lag, heading, courses)) for lag in _LAGS.tolist()]
    known = [
        (lag, misfit) for lag, misfit in each if misfit is not None and misfit[1] >= 0.5 * t.size
    ]
    if not known:
        return None
    # of lags that explain as much the least
    most = min(misfit[0] for _, misfit in known) + 0.1 * _ERROR
    lag, late = min((one for one in known if one[1][0] <= most), key=lambda one: abs(one[0]))
    gain = _gain(none, late)
    if lag == 0.0 or gain < LEAST_GAIN or none[0] < 4.0 * late[0]:
        return None
    return late_clock(f"{topic}: the headings of the pings", int(t[-1] * 1e9), lag, late[1], gain)


def least_lag_of_headings(own: DepthRecord, positions: Positions) -> float:
    """Return the least lag of an instrument's clock that its headings would show [s]; inf where they show none."""
    if len(positions) < LEAST_PINGS or len(own.depths) < LEAST_PINGS:
        return math.inf
    t, courses = own.arrays[0], _courses(positions)
    heading = _at(t, courses)
    for lag in _ASKED.tolist():
        none = _misfit(t - lag, heading, courses)
        if none is not None and _gain(none, (0.0, none[1])) >= LEAST_GAIN:
            return float(lag)
    return math.inf


def _courses(positions: Sequence[VehicleState]) -> tuple[Array, NDArray[np.complex128]]:
    """Return the times of positions [s], and the direction from each to the next; 0 where the vehicle hardly moves or it is not known."""
    times = np.array([one.time_ns for one in positions]) * 1e-9
    longitude, latitude = (
        np.array([getattr(one, name) for one in positions]) for name in ("longitude", "latitude")
    )
    east, north = metres_per_degree(float(latitude[0]))
    way = north * np.diff(latitude) + 1j * east * ((np.diff(longitude) + 180.0) % 360.0 - 180.0)
    seconds = np.maximum(np.diff(times), 1e-3)
    moves = (np.abs(way) >= _MOVES * seconds) & (seconds <= 2.0 * LONGEST)
    return times, np.where(moves, way / np.maximum(np.abs(way), 1e-9), 0.0)


def _at(t: Array, courses: tuple[Array, NDArray[np.complex128]]) -> NDArray[np.complex128]:
    times, course = courses
    at = np.searchsorted(times, t, side="right") - 1
    inside = (at >= 0) & (at < course.size)
    return np.where(inside, course[np.clip(at, 0, course.size - 1)], 0.0)


def _misfit(
    t: Array, heading: NDArray[np.complex128], courses: tuple[Array, NDArray[np.complex128]]
) -> tuple[float, float] | None:
    """Return the mean square of what headings and courses differ in, less a constant turn, and their number; None where few turn."""
    course = _at(t, courses)
    known = (course != 0.0) & (heading != 0.0)
    number = int(known.sum())
    if number < LEAST_PINGS or abs(course[known].mean()) > 1.0 - _TURNS:
        return None
    return 2.0 - 2.0 * abs(complex(np.mean(heading[known] * course[known].conj()))), float(number)


def _gain(none: tuple[float, float], late: tuple[float, float]) -> float:
    number = min(none[1], late[1], 2.0 * MOST_COUNTED)
    return 0.25 * number * math.log((none[0] + _ERROR) / (late[0] + _ERROR))
