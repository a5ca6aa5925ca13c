"""Screening of the profiles of a group at once: what ``screening.screen`` says of each of them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import inside_grid, rotate_to_local, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Flag, Observation, Reason, usable
from replay_kit.estimator.update.screening import mark_failed


def screen_profiles(
    profiles: Sequence[Observation], grid: Grid
) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Return flags and reasons of the bins of profiles with as many bins each, shapes (n, m), after the region's own checks."""
    flags, reasons = (
        np.stack([each.flags for each in profiles]),
        np.stack([each.reasons for each in profiles]),
    )
    depth, velocity = (
        np.stack([each.depth for each in profiles]),
        np.stack([each.velocity for each in profiles]),
    )
    error_std = np.stack([each.error_std for each in profiles])
    east, north = local_places(profiles, grid)
    outside = np.broadcast_to(~inside_grid(grid, east, north)[:, None], flags.shape)
    level = np.argmin(np.abs(depth[..., None] - grid.levels), axis=-1)
    nearest = np.argmin(
        (grid.east.ravel() - east[:, None]) ** 2 + (grid.north.ravel() - north[:, None]) ** 2,
        axis=1,
    )
    wet = grid.wet.reshape(grid.levels.size, -1)
    dry = ~outside & ~wet[level, nearest[:, None]]
    below = depth > grid.levels[-1]
    wrong = ~np.isfinite(velocity).all(axis=2) | ~(error_std > 0.0) | ~np.isfinite(error_std)
    wrong &= usable(flags)
    mark_failed(flags, reasons, below, outside, dry, wrong)
    relative = np.array([not np.isfinite(each.common_std) for each in profiles])
    alone = relative & (np.count_nonzero(usable(flags), axis=1) < 2)
    reasons[alone] |= np.int32(Reason.PLATFORM_REFERENCE)
    flags[alone[:, None] & usable(flags)] = Flag.FAIL
    return flags, reasons


def local_places(profiles: Sequence[Observation], grid: Grid) -> tuple[Array, Array]:
    """Return the local places of profiles, shape (n,) each [m]."""
    longitude, latitude = np.array([(each.longitude, each.latitude) for each in profiles]).T
    return to_local(grid.projection, longitude, latitude)


def local_velocities(profiles: Sequence[Observation], grid: Grid) -> Array:
    """Return the velocities of profiles along the local axes, shape (n, m, 2) [m/s]."""
    longitude, latitude = np.array([(each.longitude, each.latitude) for each in profiles]).T
    velocity = np.stack([each.velocity for each in profiles])
    turned = rotate_to_local(
        grid.projection, longitude[:, None], latitude[:, None], velocity[..., 0], velocity[..., 1]
    )
    return np.stack(turned, axis=-1)


def relative_velocities(
    profiles: Sequence[Observation], used: NDArray[np.bool_], grid: Grid
) -> Array | None:
    """Return the mean velocity of the used bins relative to the platform, shape (n, 2) [m/s], local axes; None where it is not stated."""
    first = profiles[0]
    platform = np.zeros((len(profiles), 2))
    if first.platform_velocity is not None:
        platform = np.array([each.platform_velocity for each in profiles])
    elif np.isfinite(first.common_std):
        return None
    velocity = np.where(
        used[..., None], np.stack([each.velocity for each in profiles]) - platform[:, None], 0.0
    )
    mean = velocity.sum(axis=1) / np.maximum(used.sum(axis=1), 1)[:, None]
    longitude, latitude = np.array([(each.longitude, each.latitude) for each in profiles]).T
    return np.column_stack(rotate_to_local(grid.projection, longitude, latitude, *mean.T))
