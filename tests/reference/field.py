"""The obvious way to sample a truth: splines of splines, one point at a time, no land."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble


def on_indices(values: Array, j: float, i: float) -> float:
    """Return a (J, I) array at a fractional index: along each row first, then along the column of results."""
    rows, columns = values.shape
    return float(
        CubicSpline(np.arange(rows), [CubicSpline(np.arange(columns), row)(i) for row in values])(j)
    )


def velocity(truth: Ensemble, east: float, north: float, depth: float) -> Array:
    """Return the current, shape (2,), at a place inside the grid and above its last level."""
    grid = truth.grid

    def miss(index: Array) -> list[float]:
        return [on_indices(grid.east, *index) - east, on_indices(grid.north, *index) - north]

    first = np.unravel_index(
        np.argmin((grid.east - east) ** 2 + (grid.north - north) ** 2), grid.east.shape
    )
    j, i = least_squares(miss, np.array(first, dtype=float), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    column = np.array(
        [[on_indices(level, j, i) for level in component] for component in truth.velocity[0]]
    )
    return np.asarray(CubicSpline(grid.levels, column, axis=1)(max(depth, grid.levels[0])))
