"""Velocities of latent values, and values at points whose horizontal terms are computed once for each position."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array, Indices
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.lattice import HorizontalFunctions

# Points, and places that they lie over, evaluated at once: both bound the matrices to some tens of MB.
_POINTS, _PLACES = 4096, 128
# Depths so far above the surface are rounded, as those of a planned track [m].
_ROUNDED = 1e-3


def with_potential(
    horizontal: HorizontalFunctions, places: Array, latent: Array, potential: Array | None
) -> Array:
    """Return the velocity of latent values and of the divergent part, shape (2, P, n) [m/s], local axes.

    Args:
        horizontal: The horizontal functions; M of them.
        places: shape (P, 2) [m].
        latent: shape (M, n).
        potential: shape (M, n), or (M, 1) for all; None without one.
    """
    if potential is None:
        return horizontal.velocity(places, latent)
    both = horizontal.velocity(places, np.hstack([latent, potential]))
    flow, turned = np.split(both, [latent.shape[1]], axis=2)
    return flow + gradient(turned)


def gradient(turned: Array) -> Array:
    """Return the gradient of a potential, shape (2, P, n), from its stream-function flow, turned by 90 degrees."""
    return np.stack([-turned[1], turned[0]])


def checked_depth(depth: ArrayLike, above: float = _ROUNDED) -> Array:
    """Return depths [m] after a check.

    Args:
        depth: [m], positive down, any shape.
        above: Largest height above the surface [m].

    Raises:
        EstimatorError: A depth is not finite or too far above the surface.
    """
    values = np.asarray(depth, dtype=np.float64)
    wrong = values[~(np.isfinite(values) & (values >= -above))]
    if wrong.size:
        raise EstimatorError(
            f"depth: depths are positive down, expected finite numbers from 0 m on, got {wrong[0]:g} ({wrong.size} of {values.size}); "
            "change the sign of heights, leave out points of unknown depth"
        )
    return values


def over_places(
    value: Callable[[Array, Indices, Array], Array],
    east: ArrayLike,
    north: ArrayLike,
    depth: ArrayLike,
) -> Array:
    """Return two values at each point of the local frame, shape (..., 2); the last three arguments broadcast together.

    Horizontal terms are computed once for points at one position, as on grids and profiles.

    Args:
        value: Function of horizontal positions, shape (P, 2) [m], the index of each point's position, shape (n,), and its depth, shape (n,)
            [m]; returns values, shape (n, 2).
        east: [m].
        north: [m].
        depth: [m], positive down.
    """
    given = np.asarray(east) + 1j * np.asarray(north)
    at = np.broadcast_arrays(given, checked_depth(depth))
    points, depths = (axis.ravel() for axis in at)
    order, out = np.argsort(points, kind="stable"), np.empty((points.size, 2))
    # of a grid several depths over each place
    step = min(_POINTS, _PLACES * max(1, points.size // max(1, given.size)))
    for start in range(0, points.size, step):
        part = order[start : start + step]
        places, over = np.unique(points[part], return_inverse=True)
        out[part] = value(np.column_stack([places.real, places.imag]), over, depths[part])
    return out.reshape(*at[1].shape, 2)
