"""Which bins of a profile an estimate of a region can use, and the innovation of a profile that has none."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import inside_grid, to_local, wet_column
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Flag, Innovation, Observation, PathMean, Reason


def screen(observation: Observation, grid: Grid, relative: bool = False) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Return flags and reasons of a profile's bins with the region's own checks added.

    Args:
        observation: The profile.
        grid: The region.
        relative: Whether a profile relative to a platform of unknown velocity can be used.
    """
    flags, reasons = observation.flags.copy(), observation.reasons.copy()
    east, north = to_local(grid.projection, observation.longitude, observation.latitude)
    outside = np.full(flags.shape, not inside_grid(grid, east, north))
    # the level nearest in depth decides whether a bin is in the forecast's water
    level = np.argmin(np.abs(observation.depth[:, None] - grid.levels), axis=1)
    dry = ~outside & ~wet_column(grid, float(east), float(north))[level]
    below = observation.depth > grid.levels[-1]
    wrong = ~np.isfinite(observation.velocity).all(axis=1) | ~(observation.error_std > 0.0) | ~np.isfinite(observation.error_std)
    wrong &= usable(flags)
    for failed, reason in (
        (below, Reason.BELOW_GRID),
        (outside, Reason.OUTSIDE_REGION),
        (dry, Reason.ON_LAND),
        (wrong, Reason.MALFORMED),
    ):
        reasons[failed] |= reason
        flags[failed & usable(flags)] = Flag.FAIL
    # relative to a platform of unknown velocity, bins say something of their differences, and one alone says nothing
    if not np.isfinite(observation.common_std) and (not relative or np.count_nonzero(usable(flags)) < 2):
        reasons |= np.int32(Reason.PLATFORM_REFERENCE)
        flags[usable(flags)] = Flag.FAIL
    return flags, reasons


def usable(flags: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return which bins are used: good ones, and suspect ones, which the measurement step fails where they are not wanted."""
    return np.asarray((flags == Flag.GOOD) | (flags == Flag.SUSPECT))


def rejected(observation: Observation, flags: NDArray[np.int8], reasons: NDArray[np.int32]) -> Innovation:
    """Return the innovation of a profile that has no usable bin."""
    blank = np.full((observation.depth.size, 2), np.nan)
    return Innovation(
        time_ns=observation.time_ns,
        depth=observation.depth,
        innovation=blank,
        innovation_std=blank,
        residual=blank,
        prior_innovation=blank,
        nis=np.nan,
        dof=0,
        accepted=False,
        error_inflation=1.0,
        flags=flags,
        reasons=reasons,
        dive=observation.dive,
        source=observation.source,
        decision="unusable",
    )


def as_profile(observation: Observation | PathMean) -> Observation:
    """Return a profile as it is, a mean along a path as one of one bin: at its mean depth, where it was in the middle of its time."""
    if isinstance(observation, Observation):
        return observation
    mean = observation
    middle = int(np.searchsorted(np.cumsum(mean.weight), 0.5))
    middle = min(middle, mean.weight.size - 1)
    return Observation(
        mean.time_ns,
        float(mean.longitude[middle]),
        float(mean.latitude[middle]),
        np.array([float(mean.weight @ mean.depth)]),
        np.array([mean.velocity]),
        np.array([mean.error_std]),
        "earth",
        np.array([Flag.GOOD], np.int8),
        np.zeros(1, np.int32),
        mean.dive,
        mean.source,
    )


def is_repeated(last: Observation | PathMean | None, observation: Observation | PathMean) -> bool:
    """Return whether an observation is the last one once more, in every number: logged twice, it says nothing new."""
    if last is None or type(last) is not type(observation) or last.time_ns != observation.time_ns:
        return False
    if not (np.array_equal(last.longitude, observation.longitude) and np.array_equal(last.latitude, observation.latitude)):
        return False
    same = np.array_equal(last.depth, observation.depth, equal_nan=True)
    return same and np.array_equal(last.velocity, observation.velocity, equal_nan=True)


def repeated(said: Innovation, reason: Reason) -> Innovation:
    """Return the innovation, made by ``rejected``, of an observation that came twice, or too late."""
    flags = np.where(usable(said.flags), Flag.FAIL, said.flags).astype(np.int8)
    return replace(said, flags=flags, reasons=said.reasons | np.int32(reason), decision="rejected")


def scatter(size: int, used: NDArray[np.intp], values: Array) -> Array:
    """Return values of the usable bins among all bins, shape (size, 2); NaN for the others."""
    out = np.full((size, 2), np.nan)
    out[used] = values
    return out
