"""Checks of profiles: bins above the surface, impossible speeds, noise against stated errors, repeated shapes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import IN_MEMORY, Array, Mask, Values, all_along, one_by_one
from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.observation import Reason
from replay_kit.measurements.checks.fold import (
    Context,
    Found,
    Holds,
    Judged,
    Memory,
    Rows,
    latest_rows,
    mean_of,
    running_sums,
    spaced,
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
# Pings of which the noise is judged, and how many times as large as stated it may be; second differences of bins from which it is known,
# and their median size where it is of unit variance.
_NOISES, _LEAST_NOISE, _MOST_NOISE, _LEAST_BINS, _SIZE = 40, 0.05, 8.0, 3, 0.6745 * math.sqrt(6.0)
# m/s; the scatter of bins on a straight line is rounding
_TINY = 1e-6
# m; by which the water about an instrument is another; degrees that are certainly less. Profiles in a row that are alike there, how much
# their second differences are correlated, and from which share of white noise on what differs between two of them is no water's.
_OTHER_DEPTH, _OTHER_PLACE, _CLOSE, _LEAST_ALIKE, _ALIKE, _WHITE = 20.0, 1000.0, 0.006, 8, 0.7, 0.3
# Causes and advice.
_OF_UNIT = (
    "velocities in cm/s or mm/s that are taken for m/s, or an ensemble in another unit",
    "state measurements.velocity_unit (m/s when the log is right), and check the ensemble's unit",
)
_OF_ENSEMBLE = (
    "an ensemble of another region or season, of too few members, or stated errors that are too small",
    "warning only; replay-kit info --ensemble lists faults of the log that would explain it",
)
# Comparisons that are remembered; (m/s)^2, of smooth profiles whose second differences are those of their digits.
_COMPARISONS, _ROUNDING = 30, 1e-10
# m/s; no region's currents have an RMS speed outside, and how fast nearly all of them are.
_LEAST_RMS, _MOST_RMS, _PERCENTILE = 0.004, 1.5, 99.9


class EnsembleSpeeds(NamedTuple):
    """Speeds of the currents of an ensemble.

    Attributes:
        levels: shape (Z,) [m].
        mean_square: shape (Z,), mean squared speed at the levels [m^2/s^2].
    """

    levels: Array
    mean_square: Array


def ensemble_speeds(levels: Array, velocity: Values) -> EnsembleSpeeds:
    """Return the speeds of an ensemble, shape (E, 2, Z, J, I) [m/s], NaN where dry; dry levels take those of the first."""
    sums, count = np.zeros(levels.size), np.zeros(levels.size, dtype=np.int64)
    for member in one_by_one(velocity):
        squared = np.square(member).sum(axis=0)
        wet = np.isfinite(squared)
        count += wet.sum(axis=(1, 2))
        sums += np.where(wet, squared, 0.0).sum(axis=(1, 2))
    mean = sums / np.maximum(count, 1)
    return EnsembleSpeeds(levels, np.where(count > 0, mean, mean[0]))


def odd_ensemble_speeds(velocity: Values) -> str:
    """Return why the speeds of an ensemble, shape (E, 2, ...) [m/s], are impossible; empty if they are not."""
    # of an ensemble larger than memory some members tell as much
    squared = np.square(velocity[:: max(1, velocity.nbytes // IN_MEMORY)]).sum(axis=1)
    squared = squared[np.isfinite(squared)]
    if not squared.any():
        # without a wet point, or at rest: another matter
        return ""
    rms, fastest = np.sqrt([squared.mean(), np.percentile(squared, _PERCENTILE)])
    if _LEAST_RMS <= rms <= _MOST_RMS and fastest <= MOST_SPEED:
        return ""
    return f"RMS speed {rms:.3g} m/s, {_PERCENTILE:g} % below {fastest:.3g} m/s"


def repairable(pings: Rows) -> Mask:
    """Return the mask of bins that are good, or bad in a way that a wrong unit or axis explains, shape (n, m)."""
    known = all_along(np.isfinite(pings["velocity"]))
    return np.asarray(known & ((pings["reasons"] & ~np.int32(REPAIRABLE)) == 0))


def _scatter(pings: Rows, among: Holds = np.True_) -> tuple[Array, Holds]:
    """Return the standard deviation of bins from second differences, which remove the current, shape (n,) [m/s], and their mask.

    Second differences of white noise have six times its variance.

    Args:
        pings: Pings of one instrument.
        among: shape (n, m - 2), differences to use; the result is infinite if fewer than three are known.
    """
    size = np.abs(np.diff(pings["velocity"], 2, axis=1))
    known = among & all_along(np.isfinite(size))
    middle = upper_median(np.hstack([size[..., 0], size[..., 1]]), np.hstack([known, known]))
    return np.where(known.sum(axis=1) >= _LEAST_BINS, middle / _SIZE, np.inf), known


def above_surface(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check for bins above the surface that the geometry does not explain.

    A shallow upward-looking instrument measures echoes in bins above the surface. Such a ping contradicts its depths only if those bins
    scatter no more than water.

    Args:
        memory: ``counts`` (1, 4): pings, those with most bins above the surface, those explained by geometry, and those like water.
        pings: Pings of one instrument.
        context: Ignored.
    """
    velocity, distance, top = pings["velocity"], pings["distance"], pings["transducer_depth"]
    measured = np.isfinite(velocity[..., 0]) & ((pings["reasons"] & Reason.AT_SURFACE) == 0)
    high = measured & (pings["depth"] < 0.0)
    over = 2 * high.sum(axis=1) > measured.sum(axis=1)
    by_geometry = pings["up"].astype(np.bool_) & (top >= 0.0)
    by_geometry[by_geometry] = top[by_geometry] < upper_median(
        distance[by_geometry], np.isfinite(distance[by_geometry])
    )
    told, located, over_it = measured.any(axis=1), pings.take(by_geometry), high[by_geometry]
    echo, _ = _scatter(located, over_it[:, 2:] & over_it[:, :-2])
    below, _ = _scatter(located, ~over_it[:, 2:] & ~over_it[:, :-2])
    stated = mean_of(located["error_std"], np.isfinite(located["error_std"]))
    heard, water = told & by_geometry, np.zeros(len(pings), np.bool_)
    heard[by_geometry] &= np.isfinite(echo)
    water[by_geometry] = echo < _LIKE_WATER * np.minimum(stated, below)
    told &= ~by_geometry
    counts = running_sums(
        memory, "counts", np.column_stack([told, told & over, heard, heard & water])
    )
    number, over, heard, watery = counts.T
    wrong = (over >= _LEAST_ABOVE) & (over > _MOST_ABOVE * number)
    wrong |= (watery >= _LEAST_ABOVE) & (watery > _MOST_WATER * heard)
    return {"counts": counts[-1:]}, pings.first(
        wrong,
        SURFACE,
        lambda k: (
            f"most bins of {over[k] + watery[k]} of {number[k] + heard[k]} pings lie above the surface"
        ),
        "the sign of depth, or an instrument that looks up read as looking down, or the reverse",
        "its profiles are not used; check depth_positive and orientation",
        distrusts=True,
    )


def speeds(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check for speeds that are impossible or contradict the ensemble's, by the median of each ping's bins.

    Args:
        memory: ``counts`` (1, 5): absolute pings, those faster than eight times the ensemble, those slower than an eighth of it, those of
            both that no current explains, and the sum of the log ratios of speed.
        pings: Pings of one instrument.
        context: Speeds of the ensemble.
    """
    ensemble = context.ensemble
    if ensemble is None:
        return memory, []
    squared, error_std = sum(np.square(np.moveaxis(pings["velocity"], 2, 0))), pings["error_std"]
    good = repairable(pings) & np.isfinite(error_std)
    good &= np.isfinite(pings["common_std"])[:, None]
    measured = upper_median(squared, good)
    typical = mean_of(np.interp(pings["depth"], ensemble.levels, ensemble.mean_square), good)
    told = good.any(axis=1) & (measured > 0.0) & (typical > 0.0)
    fast = told & (measured - 2.0 * mean_of(error_std, good) ** 2 > _ODD**2 * typical)
    slow = told & (measured < typical / _ODD**2)
    impossible = (fast & (measured > MOST_SPEED**2)) | (slow & (measured < _LEAST_SPEED**2))
    log = 0.5 * np.log(np.where(told, measured, 1.0) / np.where(told, typical, 1.0))
    counts = running_sums(memory, "counts", np.column_stack([told, fast, slow, impossible, log]))
    number, faster, slower, odd, logs = counts.T
    contradict = (number >= _LEAST_PINGS) & (2 * np.maximum(faster, slower) > number)
    of_unit = contradict & (2 * odd > number)

    def evidence(k: int) -> str:
        ratio = math.exp(logs[k] / number[k])
        times = f"{ratio:.3g} times as fast" if ratio > 1.0 else f"{1 / ratio:.3g} times as slow"
        return f"{number[k]:.0f} pings are {times} as the ensemble's currents"

    found = pings.first(of_unit, UNIT, evidence, *_OF_UNIT, "unusable")
    found += pings.first(
        contradict & ~of_unit, ENSEMBLE, evidence, *_OF_ENSEMBLE, "warning", unless=(UNIT,)
    )
    return {"counts": counts[-1:]}, found


def ensemble_contradicts(evidence: str) -> Finding:
    """Return the warning that a log and an ensemble are inconsistent."""
    return Finding(ENSEMBLE, 0, evidence, *_OF_ENSEMBLE, "warning")


def noise(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check for scatter of neighbouring bins far from their stated errors, by the median of 40 pings.

    Bins with correlated errors are ignored. Less scatter than stated is only a warning.

    Args:
        memory: ``log_ratio`` (40,), log ratio of scatter to stated error of the latest informative pings.
        pings: Pings of one instrument.
        context: Ignored.
    """
    size, known = _scatter(pings)
    stated = mean_of(pings["error_std"][:, 1:-1], known)
    told = np.isfinite(size) & (stated > 0.0)
    told &= (pings["bins"] >= LEAST_CELLS) & ~(pings["correlation_depth"] > 0.0)
    ratios = latest_rows(
        memory, "log_ratio", np.log(np.maximum(size, _TINY)[told] / stated[told]), _NOISES
    )
    middle = np.exp(np.sort(ratios, axis=1)[:, _NOISES // 2])
    found = list[Found]()
    for large, cause in (
        (True, "of single pings where these are means, or of means where these are single pings"),
        (
            False,
            "of single pings where these are means, or profiles of a model, which have no noise",
        ),
    ):
        odd = middle >= _MOST_NOISE if large else middle <= _LEAST_NOISE
        found += pings.take(told).first(
            odd & np.isfinite(ratios[:, 0]),
            ERRORS,
            lambda k: (
                f"neighbouring bins scatter {middle[k]:.2g} times as much as their stated errors"
            ),
            f"errors in another unit, {cause}",
            "correct velocity_std, or leave it out and set measurements.velocity_std",
            "inconsistent" if large else "warning",
            # wrong units and a bad beam, which explain it, are found in fewer pings
            unless=(UNIT, BEAM),
        )
    return {"log_ratio": ratios[-1]}, found


def one_shape(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check for profiles that keep one shape, with some noise, while the instrument moves.

    Second differences of eight consecutive profiles, 20 m or 1 km apart, are correlated by at least 0.7, and differences between two are
    white along the profile. In smooth water such differences are smooth.

    Args:
        memory: ``profile`` (2, m, k), the last two compared; ``place`` (1, 3), depth [m], longitude and latitude of the last; of the latest
            comparisons ``times`` (30,) [ns] and ``products`` (30, 6), the four products of second differences, the mean square of their
            difference, and its variance.
        pings: Pings of one instrument; stuck cells are excluded.
        context: Ignored.
    """
    known = all_along(np.isfinite(pings["raw"][..., :2])).sum(axis=1)
    pings = pings.take((pings["bins"] >= LEAST_CELLS) & (known >= LEAST_CELLS))
    places = np.column_stack([pings["depth"][:, 0], pings["longitude"], pings["latitude"]])
    last = memory.get("place", places[:0])
    chosen = spaced(places.tolist(), last.tolist(), _in_other_water)
    pings, last = pings.take(chosen), np.concatenate([last, places[chosen]])
    stuck = (pings["reasons"] & Reason.DEAD) != 0
    profile = latest_rows(memory, "profile", np.where(stuck[..., None], np.nan, pings["raw"]), 2)
    second = np.diff(profile[1:], 2, axis=2)
    known = np.isfinite(second).all(axis=1, keepdims=True)
    number = known.sum(axis=(1, 2, 3))
    told = number > 0
    second = np.where(known, second, 0.0)[told]
    of_each = np.einsum("nimk,njmk->nij", second, second).reshape(-1, 4)
    white = (of_each @ (1, -1, -1, 1)) / number[told]
    variance = np.nanvar(np.diff(profile[1:][told], axis=1), axis=(1, 2, 3))
    pings, new = pings.take(told), np.column_stack([of_each, white, variance])
    products = latest_rows(memory, "products", new, _COMPARISONS)
    times = latest_rows(memory, "times", pings["time"], _COMPARISONS)
    first, one, _, other, white, variance = products[:, -_LEAST_ALIKE:].sum(axis=1).T
    size = np.sqrt(first * other)

    def since(k: int) -> int:
        # by the latest comparisons alone: those before were of a living instrument
        first, one, _, other, *_ = products[k].T
        unlike = np.flatnonzero(~(one >= 0.5 * np.sqrt(first * other)))
        return int(times[k, min(unlike.max(initial=-1) + 1, _COMPARISONS - 1)])

    found = pings.first(
        (size >= _ROUNDING) & (one >= _ALIKE * size) & (white >= _WHITE * 6.0 * variance),
        DEAD,
        lambda k: (
            f"{_LEAST_ALIKE} profiles in a row, at other depths or places, have one shape "
            f"(correlation of second differences {one[k] / size[k]:.2f})"
        ),
        "an instrument that hangs, whose last profile is logged with some noise",
        "its profiles are not used; check the instrument's power and its logger",
        distrusts=True,
        since=since,
    )
    after = {"place": last[-1:], "profile": profile[-1], "products": products[-1]}
    return {**after, "times": times[-1]}, found


def _in_other_water(one: Sequence[float], other: Sequence[float]) -> bool:
    """Return whether two positions, depth, longitude and latitude, are 20 m apart in depth or 1 km horizontally."""
    depth, longitude, latitude = (other[0] - one[0], other[1] - one[1], other[2] - one[2])
    if depth >= _OTHER_DEPTH or depth <= -_OTHER_DEPTH:
        return True
    if -_CLOSE < longitude < _CLOSE and -_CLOSE < latitude < _CLOSE:
        return False
    east, north = metres_per_degree(one[2])
    return math.hypot(east * longitude, north * latitude) >= _OTHER_PLACE
