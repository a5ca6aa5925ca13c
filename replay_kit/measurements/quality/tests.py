"""Tests of an ADCP profile's bins: pure functions of arrays, one a test, each giving the QARTOD flag of each bin.

A flag is good, suspect, fail, or not evaluated where the test's input is absent: a test never fails what it cannot judge. Limits
are (suspect, fail); None is no limit. How the flags of all tests become one is ``rolled_up``.

Sources: U.S. IOOS, "Manual for Real-Time Quality Control of In-Situ Current Observations" (QARTOD), which names the tests and leaves
their numbers to the operator; Teledyne's commands WC, WE and its percent good; the toolbox of IMOS (side lobe, error velocity, tilt).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Reason

Flags = NDArray[np.int8]
Limits = tuple[float | None, float | None]
# as numbers of one byte: looking a member of an enumeration up and turning it takes longer than a test
_GOOD, _NOT_EVALUATED, _SUSPECT, _FAIL, _MISSING = (
    np.int8(flag) for flag in (Flag.GOOD, Flag.NOT_EVALUATED, Flag.SUSPECT, Flag.FAIL, Flag.MISSING)
)
# a solution needs so many beams
_BEAMS = 3
# scales a median deviation to the standard deviation of a normal distribution
_MAD = 1.4826
# bins; fewer have no median that one of them could not move
_FEWEST = 4
OFF = "switched off"


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """The result of one test of a ping.

    Attributes:
        test: Its name, as in the configuration.
        reason: What a bin is marked with that it finds suspect or fails.
        flags: shape (n,), QARTOD flags.
        why_not: Why it could not be made; empty when it was.
    """

    test: str
    reason: Reason
    flags: Flags
    why_not: str = ""


def check(n: int, test: str, reason: Reason, values: Array | str, limits: Limits, least: bool) -> Check:
    """Return the result of a test of the numbers of n bins, or why there are none; see ``graded``."""
    if limits != (None, None) and not isinstance(values, str):
        return Check(test, reason, graded(values, limits, least))
    return _not_made(n, test, reason, OFF if limits == (None, None) else str(values))


@lru_cache(maxsize=1024)
def _not_made(n: int, test: str, reason: Reason, why_not: str) -> Check:
    return Check(test, reason, np.full(n, _NOT_EVALUATED, np.int8), why_not)


def graded(values: Array, limits: Limits, least: bool) -> Flags:
    """Return the flags of values against limits; not evaluated where a value is NaN, or without any limit.

    Args:
        values: shape (n,), or (n, b) of beams, of which ``worst_needed`` counts.
        limits: Suspect and fail.
        least: Whether the limits are the least that is good, else the most.
    """
    values = values if values.ndim == 1 else worst_needed(values)
    if limits == (None, None):
        return np.full(values.shape, _NOT_EVALUATED, np.int8)
    flags = np.where(np.isfinite(values), _GOOD, _NOT_EVALUATED)
    for limit, flag in zip(limits, (_SUSPECT, _FAIL), strict=True):
        if limit is not None:
            flags[values < limit if least else values > limit] = flag
    return flags


def worst_needed(beams: Array) -> Array:
    """Return the number on which each cell's solution hangs, shape (n,): that of the third best beam, or of the worst of fewer.

    A single bad beam of four is for the error velocity to find; NaN where fewer beams than are needed have a number.

    Args:
        beams: shape (n, b), correlation, echo or the like of each beam.
    """
    needed = min(_BEAMS, beams.shape[1])
    # NaN sorts last, so beams without a number stand behind all others
    return np.asarray(-np.sort(-beams, axis=1)[:, needed - 1])


def outlyingness(velocity: Array, floor: Array, window: int) -> Array:
    """Return how far each bin is from the median of those around it, in median deviations, shape (n,): Hampel's filter.

    The deviations are scaled to standard deviations, and are those of the window or of the whole profile, whichever are larger; of
    both components the worse counts. At a profile's ends the window is moved inwards. A straight profile gives 1.4 at most, however
    strong its shear, and a step between two layers gives 0. NaN where the bin or all but three of its window are missing.

    Args:
        velocity: shape (n, 2) [m/s]; NaN where missing or failed.
        floor: shape (n,) [m/s], the least deviation that counts, so that the noise of a smooth profile is no outlier.
        window: Bins in a window, odd; of a shorter profile all.
    """
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(velocity).all(axis=1))
    n_finite = np.count_nonzero(finite)
    if n_finite < _FEWEST:
        return np.full(len(velocity), np.nan)
    at = _windows(len(velocity), window)
    around = np.where(finite[:, None], velocity, np.nan)[at]
    count = finite[at].sum(axis=1)
    middle = _median(around, count)
    apart = np.abs(velocity - middle)
    # the few bins of a window often lie close together by chance: what is usual in the profile counts too
    usual = _median(np.where(finite[:, None], apart, np.nan)[None], np.array([n_finite]))
    scale = _MAD * np.maximum(_median(np.abs(around - middle[:, None, :]), count), usual)
    ratio = (apart / np.maximum(scale, floor[:, None])).max(axis=1)
    return np.where(finite & (count >= _FEWEST), ratio, np.nan)


@lru_cache(maxsize=64)
def _windows(n: int, window: int) -> NDArray[np.intp]:
    """Return the bins about each of n, shape (n, window) or, of a shorter profile, (n, n)."""
    width = min(window, n)
    first = np.clip(np.arange(n) - window // 2, 0, n - width)
    return np.asarray(first[:, None] + np.arange(width))


def _median(values: Array, count: NDArray[np.intp]) -> Array:
    """Return medians along the second axis, shape (n, 2), of the ``count`` numbers in it; numpy's own take several times as long."""
    ordered = np.sort(values, axis=1)
    width = values.shape[1]
    if (count == width).all():
        return np.asarray(0.5 * (ordered[:, (width - 1) // 2] + ordered[:, width // 2]))
    rows = np.arange(len(values))
    upper, lower = np.minimum(count // 2, width - 1), np.maximum(count - 1, 0) // 2
    return np.asarray(0.5 * (ordered[rows, lower] + ordered[rows, upper]))


def rolled_up(tests: Sequence[Check], missing: NDArray[np.int32], use_suspect: bool) -> tuple[Flags, NDArray[np.int32]]:
    """Return each bin's flag, the worst that a test gave, and the reasons of all tests that found it suspect or failed it.

    Args:
        tests: The results.
        missing: shape (n,), the reasons of bins that are missing, whatever the tests say; 0 for the others.
        use_suspect: Whether suspect bins stay suspect; else they fail.
    """
    found = np.array([test.flags for test in tests])
    # in the order of their numbers: not evaluated, suspect, fail; a test that was not made says nothing
    bad = found >= _SUSPECT
    if bad.any():
        bits = np.array([test.reason.value for test in tests], np.int32)
        flags = np.where(bad, found, _GOOD).max(axis=0)
        reasons = missing | np.bitwise_or.reduce(np.where(bad, bits[:, None], np.int32(0)), axis=0)
    else:
        flags, reasons = np.full(missing.shape, _GOOD), missing.copy()
    if not use_suspect:
        flags[flags == _SUSPECT] = _FAIL
    flags[missing != 0] = _MISSING
    return flags, reasons
