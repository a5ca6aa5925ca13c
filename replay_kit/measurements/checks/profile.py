"""Checks of profiles: bins above the surface, speeds that are no current's, noise against its stated error, and one shape in other water."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import IN_MEMORY, Array, one_by_one
from replay_kit.core.errors import Finding, Severity
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.observation import Reason
from replay_kit.measurements.checks.fold import (
    Context,
    Found,
    Memory,
    Rows,
    carried,
    first,
    mean_of,
    upper_median,
)
from replay_kit.measurements.checks.instrument import BEAM, DEAD, LEAST_CELLS

SURFACE = "depths above the surface"
UNIT = "unit of the velocities"
ENSEMBLE = "log and ensemble contradict each other"
ERRORS = "stated errors"
#: Bins bad only in a way that a wrong unit or axis could have made them.
REPAIRABLE = Reason.GROSS_RANGE | Reason.HIGH_SPEED | Reason.OUTLIER
# Pings above the surface, and the share of them, from which depths are wrong; the share of those with an
# echo that look like water, and up to how many times the scatter of water does.
_LEAST_ABOVE, _MOST_ABOVE, _MOST_WATER, _LIKE_WATER = 5, 0.1, 0.5, 1.5
# Pings after which speeds are judged, the factor beyond which they contradict the ensemble, and m/s: faster is no model's, slower lacks
# even the noise of an instrument.
_LEAST_PINGS, _ODD, MOST_SPEED, _LEAST_SPEED = 30, 8.0, 4.0, 0.01
# Pings of which the noise is judged, and how many times as large as stated it may be; median size of a normal variable of unit variance.
_NOISES, _LEAST_NOISE, _MOST_NOISE, _MEDIAN = 40, 0.05, 8.0, 0.6745
# m; by which the water about an instrument is another; degrees that are certainly less. Profiles in a row that are alike there, how much
# their second differences are correlated, and from which share of white noise on what differs between two of them is no water's.
_OTHER_DEPTH, _OTHER_PLACE, _CLOSE, _LEAST_ALIKE, _ALIKE, _WHITE = 20.0, 1000.0, 0.005, 8, 0.7, 0.3
# Causes and advice.
_OF_UNIT = (
    "velocities in cm/s or mm/s that are taken for m/s, or an ensemble in another unit",
    "state measurements.velocity_unit (m/s when the log is right), and check the ensemble's unit",
)
_OF_ENSEMBLE = (
    "an ensemble of another region or season, of too few members, or errors of the profiles that are stated too small",
    "warning only; replay-kit info --ensemble lists faults of the log that would explain it",
)
# Comparisons that are remembered; (m/s)^2, of smooth profiles whose second differences are those of their digits.
_COMPARISONS, _ROUNDING = 30, 1e-10
# m/s; no region's currents have an RMS speed outside, and how fast nearly all of them are.
_LEAST_RMS, _MOST_RMS, _PERCENTILE = 0.004, 1.5, 99.9


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleSpeeds:
    """How fast the currents of an ensemble are.

    Attributes:
        levels: shape (Z,) [m].
        mean_square: shape (Z,), mean squared speed at the levels [m^2/s^2].
    """

    levels: Array
    mean_square: Array


def ensemble_speeds(levels: Array, velocity: Array) -> EnsembleSpeeds:
    """Return the speeds of an ensemble, shape (E, 2, Z, J, I) [m/s], NaN where dry; a dry level has those of the first one."""
    sums, count = np.zeros(levels.size), np.zeros(levels.size, dtype=np.int64)
    for member in one_by_one(velocity):
        squared = np.square(member).sum(axis=0)
        wet = np.isfinite(squared)
        count += wet.sum(axis=(1, 2))
        sums += np.where(wet, squared, 0.0).sum(axis=(1, 2))
    mean = sums / np.maximum(count, 1)
    return EnsembleSpeeds(levels, np.where(count > 0, mean, mean[0]))


def odd_ensemble_speeds(velocity: Array) -> str:
    """Return how the speeds of an ensemble, shape (E, 2, ...) [m/s], cannot be those of currents; empty when they can."""
    # of an ensemble larger than memory some members tell as much
    squared = np.square(velocity[:: max(1, velocity.nbytes // IN_MEMORY)]).sum(axis=1)
    squared = squared[np.isfinite(squared)]
    if not squared.any():
        # without a wet point, or at rest: another matter
        return ""
    rms, fastest = (
        math.sqrt(float(squared.mean())),
        math.sqrt(float(np.percentile(squared, _PERCENTILE))),
    )
    if _LEAST_RMS <= rms <= _MOST_RMS and fastest <= MOST_SPEED:
        return ""
    return f"RMS speed {rms:.3g} m/s, {_PERCENTILE:g} % below {fastest:.3g} m/s"


def repairable(pings: Rows) -> NDArray[np.bool_]:
    """Return which bins are sound, or bad only in a way that a wrong unit or axis could have made them, shape (n, m)."""
    known = np.isfinite(pings["velocity"]).all(axis=2)
    return np.asarray(known & ((pings["reasons"] & ~np.int32(REPAIRABLE)) == 0))


def above_surface(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return that bins are above the surface where no geometry puts them.

    An instrument that looks up from less deep than its middle bin is far has bins above the surface, in which it measures echoes. Such a
    ping speaks against its depths only where those bins scatter no more than water does.

    Args:
        memory: ``counts`` (4,): pings, those with most bins above the surface, pings whose bins are there by geometry, and those like water.
        pings: Of one instrument.
        context: Is not asked.
    """
    velocity, depth = pings["velocity"], pings["depth"]
    if not len(pings):
        return memory, []
    measured = np.isfinite(velocity[..., 0]) & ((pings["reasons"] & Reason.AT_SURFACE) == 0)
    high = measured & (depth < 0.0)
    told, above = measured.any(axis=1), 2 * high.sum(axis=1) > measured.sum(axis=1)
    distance, top = pings["distance"], pings["transducer_depth"]
    middle = upper_median(distance, np.isfinite(distance))
    by_geometry = pings["up"].astype(np.bool_) & (top >= 0.0) & (top < middle)
    echoes, water = _water(pings, high)
    echo = told & by_geometry & echoes
    each = [told & ~by_geometry, told & ~by_geometry & above, echo, echo & water]
    counts = np.cumsum(np.column_stack(each), axis=0) + memory.get("counts", np.zeros(4, np.int64))
    number, over, heard, watery = counts.T
    wrong = (over >= _LEAST_ABOVE) & (over > _MOST_ABOVE * number)
    wrong |= (watery >= _LEAST_ABOVE) & (watery > _MOST_WATER * heard)
    if (at := first(wrong)) is None:
        return {"counts": counts[-1]}, []
    words = (
        f"most bins of {over[at] + watery[at]} of {number[at] + heard[at]} pings lie above the surface",
        "the sign of depth, or an instrument that looks up and is read as looking down, or the other way round",
        "its profiles are not used; check depth_positive and orientation of the mapping, or the ping's orientation",
    )
    return {"counts": counts[-1]}, [pings.found(at, SURFACE, words, distrusts=True)]


def _water(pings: Rows, high: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return of which pings bins above the surface tell, and of which they scatter as little as the water below it, shapes (n,)."""
    if high.shape[1] < 3:
        return np.zeros(len(high), np.bool_), np.zeros(len(high), np.bool_)
    second = np.abs(np.diff(pings["velocity"], 2, axis=1))
    finite, error = np.isfinite(second).all(axis=2), pings["error_std"]
    scatter = [_MEDIAN * math.sqrt(6.0) * mean_of(error, np.isfinite(error))]
    for known in (finite & ~high[:, 2:] & ~high[:, :-2], finite & high[:, 2:] & high[:, :-2]):
        size = upper_median(second.reshape(len(second), -1), np.repeat(known, 2, axis=1))
        scatter.append(np.where(known.sum(axis=1) >= 3, size, np.inf))
    stated, below, above = scatter
    return np.isfinite(above), above < _LIKE_WATER * np.minimum(stated, below)


def speeds(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return that the speeds are no current's, or that they contradict the ensemble's; a ping counts by the median of its bins.

    Args:
        memory: ``counts`` (4,): absolute pings, those faster than eight times the ensemble, those slower than an eighth of it, and those
            of both that no current explains; ``log_ratio`` (1,), sum of the logarithms of how many times as fast they are.
        pings: Of one instrument.
        context: Has the ensemble's speeds.
    """
    ensemble = context.ensemble
    if ensemble is None or not len(pings):
        return memory, []
    squared, error_std = np.square(pings["velocity"]).sum(axis=2), pings["error_std"]
    good = repairable(pings) & np.isfinite(squared + error_std)
    good &= np.isfinite(pings["common_std"])[:, None]
    measured = upper_median(squared, good)
    typical = mean_of(np.interp(pings["depth"], ensemble.levels, ensemble.mean_square), good)
    error = 2.0 * mean_of(error_std, good) ** 2
    told = good.any(axis=1) & (measured > 0.0) & (typical > 0.0)
    fast = told & (measured - error > _ODD**2 * typical)
    slow = told & (measured < typical / _ODD**2)
    impossible = (fast & (measured > MOST_SPEED**2)) | (slow & (measured < _LEAST_SPEED**2))
    each = np.column_stack([told, fast, slow, impossible])
    counts = np.cumsum(each, axis=0) + memory.get("counts", np.zeros(4, np.int64))
    log = np.zeros(len(pings))
    log[told] = 0.5 * np.log(measured[told] / typical[told])
    logs = np.cumsum(np.concatenate([memory.get("log_ratio", np.zeros(1)), log]))[1:]
    contradict = (counts[:, 0] >= _LEAST_PINGS) & (
        2 * np.maximum(counts[:, 1], counts[:, 2]) > counts[:, 0]
    )
    odd = contradict & (2 * counts[:, 3] > counts[:, 0])
    found = list[Found]()
    for at, of_unit in ((first(contradict & ~odd), False), (first(odd), True)):
        if at is not None:
            ratio = math.exp(logs[at] / counts[at, 0])
            fast_by = (
                f"{ratio:.3g} times as fast" if ratio > 1.0 else f"{1 / ratio:.3g} times as slow"
            )
            evidence = f"{counts[at, 0]} pings are {fast_by} as the ensemble's currents"
            if of_unit:
                found.append(pings.found(at, UNIT, (evidence, *_OF_UNIT), "unusable"))
            else:
                words = (evidence, *_OF_ENSEMBLE)
                found.append(pings.found(at, ENSEMBLE, words, "warning", unless={UNIT}))
    return {"counts": counts[-1], "log_ratio": logs[-1:]}, found


def ensemble_contradicts(evidence: str) -> Finding:
    """Return the warning that a log and an ensemble do not fit."""
    return Finding(ENSEMBLE, 0, evidence, *_OF_ENSEMBLE, "warning")


def noise(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return that neighbouring bins scatter far more, or less, than their stated errors, in the median of 40 pings.

    Second differences along a profile leave the current out; of white noise they have six times its variance. Bins whose errors are
    correlated say nothing. Less scatter than stated harms nothing: it is a warning.

    Args:
        memory: ``log_ratio`` (up to 40,), logarithm of scatter over stated error of the latest pings that tell.
        pings: Of one instrument.
        context: Is not asked.
    """
    second = np.abs(np.diff(pings["velocity"], 2, axis=1))
    if not second.size:
        return memory, []
    good = np.isfinite(second).all(axis=2) & ~(pings["correlation_depth"] > 0.0)[:, None]
    size = upper_median(second.reshape(len(second), -1), np.repeat(good, 2, axis=1))
    stated = mean_of(pings["error_std"][:, 1:-1], good)
    told = (pings["bins"] >= LEAST_CELLS) & good.any(axis=1) & (size > 0.0) & (stated > 0.0)
    at = np.flatnonzero(told)
    new = np.log(size[at] / (_MEDIAN * math.sqrt(6.0)) / stated[at])
    ratios = carried(memory, "log_ratio", new, _NOISES)
    after: Memory = {"log_ratio": ratios[-_NOISES:]}
    if len(ratios) < _NOISES:
        return after, []
    window = np.sort(np.lib.stride_tricks.sliding_window_view(ratios, _NOISES), axis=1)
    middle = np.exp(window[:, _NOISES // 2])
    last = np.arange(len(middle)) + _NOISES - 1 - (len(ratios) - len(new))
    odd = first(((middle <= _LEAST_NOISE) | (middle >= _MOST_NOISE)) & (last >= 0))
    if odd is None:
        return after, []
    row = int(at[last[odd]])
    large = middle[odd] > 1.0
    words = (
        f"neighbouring bins scatter {middle[odd]:.2g} times as much as their stated errors",
        "errors in another unit, of single pings where these are means, or of means where these are single pings"
        if large
        else "errors in another unit, of single pings where these are means, or profiles of a model, which have no noise",
        "correct the stated errors (velocity_std), or leave them out and set measurements.velocity_std",
    )
    # wrong units and a bad beam, which explain it, are found in fewer pings
    severity: Severity = "inconsistent" if large else "warning"
    return after, [pings.found(row, ERRORS, words, severity, unless={UNIT, BEAM})]


def one_shape(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return that profiles keep one shape while the instrument moves through other water: it repeats itself, with some noise.

    Second differences of eight profiles in a row are correlated by .7 and more, each with those before it 20 m or 1 km away, and what
    differs between two of them is white along the profile: smooth water is alike, too, but what differs there is smooth.

    Args:
        memory: ``profile`` (1, m, k), the one with which the next is compared; ``place`` (3,), its depth [m], longitude and latitude;
            ``products`` (up to 30, 6) of the latest comparisons: time, products of one with the other and of each with itself, mean square
            of the second differences of what differs and what white noise would give.
        pings: Of one instrument; stuck cells are left out.
        context: Is not asked.
    """
    stuck = (pings["reasons"] & Reason.DEAD) != 0
    raw, found = pings["raw"], list[Found]()
    before, place = memory.get("profile"), memory.get("place")
    times = list(memory.get("times", np.empty(0, np.int64)))
    products = list(memory.get("products", np.empty((0, 5))))
    places = np.column_stack([pings["depth"][:, 0], pings["longitude"], pings["latitude"]])
    told = has_texture(pings)
    for i in _moves(places, told, place).tolist():
        now = np.where(stuck[i, :, None], np.nan, raw[i])
        if before is not None and before.shape[1:] == now.shape:
            products.append(_product(before[0], now))
            times.append(pings.time(i))
            products, times = products[-_COMPARISONS:], times[-_COMPARISONS:]
            if len(products) >= _LEAST_ALIKE and not found:
                found += _alike(np.array(products), times, pings, i)
        before, place = now[None], places[i]
    if before is None or place is None:
        return memory, found
    return {
        "profile": before,
        "place": place,
        "times": np.array(times, np.int64),
        "products": np.array(products).reshape(-1, 5),
    }, found


def has_texture(pings: Rows) -> NDArray[np.bool_]:
    """Return which pings have cells enough, of which those that are known differ or are five."""
    known = np.isfinite(pings["raw"][..., :2]).all(axis=2).sum(axis=1)
    return np.asarray((pings["bins"] >= LEAST_CELLS) & (known >= LEAST_CELLS))


def _moves(places: Array, told: NDArray[np.bool_], last: Array | None) -> NDArray[np.intp]:
    """Return the rows that are in other water than the one chosen before: the first, and each 20 m deeper or less deep, or 1 km away."""
    chosen, place = list[int](), None if last is None else tuple(last.tolist())
    for i, (use, here) in enumerate(zip(told.tolist(), places.tolist(), strict=True)):
        if not use:
            continue
        if place is not None and abs(here[0] - place[0]) < _OTHER_DEPTH:
            east, north = here[1] - place[1], here[2] - place[2]
            if abs(east) < _CLOSE and abs(north) < _CLOSE:
                continue
            of_east, of_north = metres_per_degree(place[2])
            if math.hypot(of_east * east, of_north * north) < _OTHER_PLACE:
                continue
        chosen.append(i)
        place = here
    return np.array(chosen, np.intp)


def _product(before: Array, now: Array) -> list[float]:
    """Return the products of the second differences of two profiles, shape (m, k), and how white it is what differs between them."""
    one, other = np.diff(before, 2, axis=0), np.diff(now, 2, axis=0)
    both = np.isfinite(one + other)
    a, b, second = one[both], other[both], (other - one)[both]
    difference = now - before
    known = np.isfinite(difference)
    left = difference[known] - (difference[known].mean() if known.any() else 0.0)
    return [
        float(a @ b),
        float(a @ a),
        float(b @ b),
        float(second @ second) / max(1, second.size),
        6.0 * float(left @ left) / max(1, left.size),
    ]


def _alike(products: Array, times: Sequence[int], pings: Rows, row: int) -> list[Found]:
    """Return the finding that the latest comparisons are of one shape, if they are."""
    one, first_square, second, white, expected = products[-_LEAST_ALIKE:].sum(axis=0).tolist()
    size = math.sqrt(first_square * second)
    if size < _ROUNDING or one < _ALIKE * size or white < _WHITE * expected:
        return []
    # by the latest comparisons alone: those before were of a living instrument
    unlike = np.flatnonzero(products[:, 0] < 0.5 * np.sqrt(products[:, 1] * products[:, 2]))
    begin = min(int(unlike[-1]) + 1 if unlike.size else 0, len(products) - 1)
    finding = Finding(
        DEAD,
        int(times[begin]),
        f"{pings.topic}: {_LEAST_ALIKE} profiles in a row, at other depths or places, have one shape "
        f"(correlation of second differences {one / size:.2f})",
        "an instrument that hangs, whose last profile is logged with some noise",
        "its profiles are not used; check the instrument's power and its logger",
        distrusts=True,
    )
    return [Found(int(pings.event[row]), finding)]
