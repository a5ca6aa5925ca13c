"""Which bins of a profile an estimate of a region can use, and the innovation of a profile that has none."""

import numpy as np
from numpy.typing import NDArray

from replay_kit.geodesy import inside_grid, to_local, wet_column
from replay_kit.types import Array, Flag, Grid, Innovation, Observation, Reason


def screen(observation: Observation, grid: Grid) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Return flags and reasons of a profile's bins with the region's own checks added.

    Args:
        observation: The profile.
        grid: The region.
    """
    flags, reasons = observation.flags.copy(), observation.reasons.copy()
    east, north = to_local(grid.projection, observation.longitude, observation.latitude)
    outside = np.full(flags.shape, not inside_grid(grid, east, north))
    # the level nearest in depth decides whether a bin is in the forecast's water
    level = np.argmin(np.abs(observation.depth[:, None] - grid.levels), axis=1)
    dry = ~outside & ~wet_column(grid, float(east), float(north))[level]
    below = observation.depth > grid.levels[-1]
    # a velocity relative to a platform of unknown velocity says nothing of the current itself
    relative = np.full(flags.shape, not np.isfinite(observation.common_std))
    for failed, reason in (
        (below, Reason.BELOW_GRID),
        (outside, Reason.OUTSIDE_REGION),
        (dry, Reason.ON_LAND),
        (relative, Reason.PLATFORM_REFERENCE),
    ):
        reasons[failed] |= reason
        flags[failed & usable(flags)] = Flag.FAIL
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
    )


def scatter(size: int, used: NDArray[np.intp], values: Array) -> Array:
    """Return values of the usable bins among all bins, shape (size, 2); NaN for the others."""
    out = np.full((size, 2), np.nan)
    out[used] = values
    return out
