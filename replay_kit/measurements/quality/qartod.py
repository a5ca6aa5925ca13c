"""Tests of ADCP profiles' bins: pure functions of arrays, one a test, each giving the QARTOD flag of each bin.

Many profiles are tested at once, in arrays whose first axis is the profile; what is said of one does not depend on the others.

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


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """The results of one test of s pings of n bins.

    Attributes:
        test: As in ``Check``.
        reason: As in ``Check``.
        n: Number of bins.
        flags: shape (s, n); None where it could be made of no ping.
        why_not: Why it could not be made, of each ping; empty where it was.
    """

    test: str
    reason: Reason
    n: int
    flags: Flags | None
    why_not: Sequence[str]

    def of(self, i: int) -> Check:
        """Return the result of one ping."""
        if self.flags is None or self.why_not[i]:
            return _not_made(self.n, self.test, self.reason, self.why_not[i])
        return Check(self.test, self.reason, self.flags[i])


#: The numbers of s pings, shape (s, n) or, of beams, (s, n, b); or of each ping its own, or why there are none.
Values = Array | Sequence[Array | str]


def check(
    shape: tuple[int, int],
    test: str,
    reason: Reason,
    values: Values,
    limits: Limits | Sequence[Limits],
    least: bool,
) -> Checks:
    """Return the results of a test, s pings of n bins; see ``graded``.

    Args:
        shape: s and n.
        test: Its name.
        reason: What its bins are marked with.
        values: The numbers.
        limits: Of all pings, or of each its own.
        least: As in ``graded``.
    """
    (s, n), all_alike = shape, isinstance(limits, tuple)
    if all_alike and limits == (None, None):
        return Checks(test, reason, n, None, (OFF,) * s)
    if isinstance(values, np.ndarray) and isinstance(limits, tuple):
        return Checks(test, reason, n, graded(_of_bins(values), limits, least), ("",) * s)
    why_not = [value if isinstance(value, str) else "" for value in values]
    if all(why_not):
        return Checks(test, reason, n, None, why_not)
    flags = np.full(shape, _NOT_EVALUATED)
    rows: dict[tuple[int, ...], list[int]] = {}
    for i, value in enumerate(values):
        if not isinstance(value, str):
            rows.setdefault(value.shape, []).append(i)
    for alike in rows.values():
        own = limits if isinstance(limits, tuple) else _column([limits[i] for i in alike])
        flags[alike] = graded(
            _of_bins(np.stack([np.asarray(values[i]) for i in alike])), own, least
        )
    return Checks(test, reason, n, flags, why_not)


def _of_bins(values: Array) -> Array:
    """Return one number a bin, shape (s, n), of numbers with or without beams."""
    return values if values.ndim == 2 else worst_needed(values)


def _column(limits: Sequence[Limits]) -> tuple[Array | None, Array | None]:
    """Return limits that each ping has of its own, shapes (s, 1); a limit is None for all pings or for none."""
    suspect, fail = (
        None
        if limits[0][k] is None
        else np.array([each[k] for each in limits], np.float64)[:, None]
        for k in range(2)
    )
    return suspect, fail


@lru_cache(maxsize=1024)
def _not_made(n: int, test: str, reason: Reason, why_not: str) -> Check:
    return Check(test, reason, np.full(n, _NOT_EVALUATED, np.int8), why_not)


def graded(values: Array, limits: Limits | tuple[Array | None, Array | None], least: bool) -> Flags:
    """Return the flags of values against limits, of the values' shape; not evaluated where a value is NaN, or without any limit.

    Args:
        values: Of any shape.
        limits: Suspect and fail; numbers, or arrays that broadcast to the values.
        least: Whether the limits are the least that is good, else the most.
    """
    if all(limit is None for limit in limits):
        return np.full(values.shape, _NOT_EVALUATED, np.int8)
    flags = np.where(np.isfinite(values), _GOOD, _NOT_EVALUATED)
    for limit, flag in zip(limits, (_SUSPECT, _FAIL), strict=True):
        if limit is not None:
            flags[values < limit if least else values > limit] = flag
    return flags


def worst_needed(beams: Array) -> Array:
    """Return the number on which each cell's solution hangs, shape (..., n): that of the third best beam, or of the worst of fewer.

    A single bad beam of four is for the error velocity to find; NaN where fewer beams than are needed have a number.

    Args:
        beams: shape (..., n, b), correlation, echo or the like of each beam.
    """
    needed = min(_BEAMS, beams.shape[-1])
    # NaN sorts last, so beams without a number stand behind all others
    return np.asarray(-np.sort(-beams, axis=-1)[..., needed - 1])


def outlyingness(velocity: Array, floor: Array, window: int) -> Array:
    """Return how far each bin is from the median of those around it, in median deviations, shape (..., n): Hampel's filter.

    The deviations are scaled to standard deviations, and are those of the window or of the whole profile, whichever are larger; of
    both components the worse counts. At a profile's ends the window is moved inwards. A straight profile gives 1.4 at most, however
    strong its shear, and a step between two layers gives 0. NaN where the bin or all but three of its window are missing.

    Args:
        velocity: shape (..., n, 2) [m/s]; NaN where missing or failed.
        floor: shape (..., n) [m/s], the least deviation that counts, so that the noise of a smooth profile is no outlier.
        window: Bins in a window, odd; of a shorter profile all.
    """
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(velocity).all(axis=-1))
    n_finite = np.count_nonzero(finite, axis=-1)
    at = _windows(velocity.shape[-2], window)
    count = np.count_nonzero(finite[..., at], axis=-1)
    # components first, so that a window's bins are neighbours in memory
    of_each, known = np.ascontiguousarray(velocity.swapaxes(-1, -2)), finite[..., None, :]
    around = np.where(known, of_each, np.nan)[..., at]
    middle = _median(around, count[..., None, :])
    apart = np.abs(of_each - middle)
    # the few bins of a window often lie close together by chance: what is usual in the profile counts too
    usual = _median(np.where(known, apart, np.nan), n_finite[..., None])[..., None]
    spread = _median(np.abs(around - middle[..., None]), count[..., None, :])
    scale = np.maximum(_MAD * np.maximum(spread, usual), floor[..., None, :])
    ratio = (apart / scale).max(axis=-2)
    return np.where(finite & (count >= _FEWEST) & (n_finite >= _FEWEST)[..., None], ratio, np.nan)


@lru_cache(maxsize=64)
def _windows(n: int, window: int) -> NDArray[np.intp]:
    """Return the bins about each of n, shape (n, window) or, of a shorter profile, (n, n)."""
    width = min(window, n)
    first = np.clip(np.arange(n) - window // 2, 0, n - width)
    return np.asarray(first[:, None] + np.arange(width))


def _median(values: Array, count: NDArray[np.intp]) -> Array:
    """Return medians of the ``count`` numbers along the last axis, the others NaN; numpy's own take far longer."""
    ordered, width = np.sort(values, axis=-1), values.shape[-1]
    if np.all(count == width):
        return np.asarray(0.5 * (ordered[..., (width - 1) // 2] + ordered[..., width // 2]))
    at = np.stack([np.maximum(count - 1, 0) // 2, np.minimum(count // 2, width - 1)], axis=-1)
    return np.asarray(0.5 * np.take_along_axis(ordered, at, axis=-1).sum(axis=-1))


def rolled_up(
    tests: Sequence[Check] | Sequence[Checks], missing: NDArray[np.int32], use_suspect: bool
) -> tuple[Flags, NDArray[np.int32]]:
    """Return each bin's flag, the worst that a test gave, and the reasons of all tests that found it suspect or failed it.

    Args:
        tests: The results.
        missing: shape (..., n), the reasons of bins that are missing, whatever the tests say; 0 for the others.
        use_suspect: Whether suspect bins stay suspect; else they fail.
    """
    # in the order of their numbers: not evaluated, suspect, fail; a test that was not made says nothing
    made = [(test.reason.value, test.flags) for test in tests if test.flags is not None]
    flags, reasons = np.full(missing.shape, _GOOD), missing.copy()
    for reason, found in made:
        bad = found >= _SUSPECT
        if bad.any():
            flags = np.where(bad, np.maximum(flags, found), flags)
            reasons |= np.where(bad, np.int32(reason), np.int32(0))
    if not use_suspect:
        flags[flags == _SUSPECT] = _FAIL
    flags[missing != 0] = _MISSING
    return flags, reasons
