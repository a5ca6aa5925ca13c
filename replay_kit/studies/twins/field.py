"""Truth interpolated anywhere: cubic in grid indices and depth."""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble, Grid

#: Time of a truth that has none of its own [ns, UTC].
EPOCH_NS = 1_542_326_400_000_000_000
_TOLERANCE = 1e-6  # m; places nearer than this are the same
_ITERATIONS = 30
# Places evaluated at once: SciPy's tensor splines take some 12 kB a place.
_CHUNK = 50_000
_EDGE = 1e-7  # of a cell; rounding does not put a point of the edge outside


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Current that can be evaluated anywhere in its grid; created by ``build_field``.

    Attributes:
        grid: Grid of the current.
        time_ns: Time at which missions begin [ns, UTC].
        velocity_spline: Spline from (depth, j, i) to local east and north [m/s].
        place_spline: Spline from (j, i) to local east and north [m].
        nodes: Grid nodes, for first guesses of (j, i).
        wet_cells: shape (Z, J - 1, I - 1), whether the four corners of each cell are wet.
    """

    grid: Grid
    time_ns: int
    velocity_spline: NdBSpline
    place_spline: NdBSpline
    nodes: cKDTree
    wet_cells: Mask

    def velocity(self, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Array:
        """Return the current along the local axes, shape (..., 2) [m/s].

        Above the first level it is constant; it is NaN below the last level, outside the grid, and in cells with a dry corner.

        Args:
            east: [m], local frame; the arguments are broadcast against each other.
            north: [m], local frame.
            depth: [m], positive down.
        """
        columns = np.broadcast_arrays(east, north, depth)
        values = np.full((columns[0].size, 2), np.nan)
        for start in range(0, len(values), _CHUNK):
            part = slice(start, start + _CHUNK)
            x, y, below = (column.reshape(-1)[part] for column in columns)
            j, i, usable = grid_indices(self, x, y)
            z = np.maximum(below, self.grid.levels[0])
            usable &= z <= self.grid.levels[-1]
            usable[usable] = self._wet(z[usable], j[usable], i[usable])
            if usable.any():
                values[part][usable] = self.velocity_spline(np.column_stack([z, j, i])[usable])
        return values.reshape(*columns[0].shape, 2)

    def _wet(self, z: Array, j: Array, i: Array) -> Mask:
        """Return whether all corners of the cell around each position are wet; on a level, the level below does not count."""
        row, column = (
            np.minimum(at.astype(np.intp), n - 1)
            for at, n in zip((j, i), self.wet_cells.shape[1:], strict=True)
        )
        levels = (
            np.searchsorted(self.grid.levels, z, "right") - 1,
            np.searchsorted(self.grid.levels, z),
        )
        above, below = (self.wet_cells[level, row, column] for level in levels)
        return np.asarray(above & below)


def build_field(truth: Ensemble) -> Field:
    """Return the field of a truth.

    Raises:
        ForecastError: The truth is not an ensemble of one, or has no wet point.
    """
    grid, source = truth.grid, truth.source
    if truth.n_members != 1:
        raise ForecastError(
            f"{source}: a truth is one member, got {truth.n_members}; choose one with FILE#MEMBER"
        )
    if not grid.wet.any():
        raise ForecastError(f"{source}: no wet point to sample; give a truth with water in it")
    places = np.stack([grid.east, grid.north], axis=-1)
    indices = [np.arange(n, dtype=np.float64) for n in grid.east.shape]
    return Field(
        grid,
        EPOCH_NS if truth.time_ns is None else truth.time_ns,
        _tensor_spline(
            [grid.levels, *indices], np.moveaxis(_without_land(truth.velocity[0], grid.wet), 0, -1)
        ),
        _tensor_spline(indices, places),
        cKDTree(places.reshape(-1, 2)),
        np.asarray(sliding_window_view(grid.wet, (2, 2), (1, 2)).all(axis=(3, 4))),
    )


def grid_indices(field: Field, east: Array, north: Array) -> tuple[Array, Array, Mask]:
    """Return fractional (j, i) of positions and whether each is in the grid, by Newton's method from the nearest node.

    Args:
        field: The field.
        east: shape (n,) [m], local frame.
        north: shape (n,) [m], local frame.
    """
    shape = field.grid.east.shape
    last = np.array(shape) - 1.0
    wanted = np.column_stack([east, north])
    finite = np.isfinite(wanted).all(axis=1)
    index, found = np.zeros(wanted.shape), np.zeros(len(wanted), dtype=np.bool_)
    _, nearest = field.nodes.query(wanted[finite])
    index[finite] = np.column_stack(np.unravel_index(nearest, shape))
    active = np.flatnonzero(finite)
    for _ in range(_ITERATIONS):
        residual = wanted[active] - field.place_spline(index[active])
        far = np.hypot(*residual.T) >= _TOLERANCE
        found[active[~far]] = True
        active, residual = active[far], residual[far]
        if active.size == 0:
            break
        at = index[active]
        jacobian = np.stack([field.place_spline(at, nu=nu) for nu in ((1, 0), (0, 1))], axis=-1)
        step = np.linalg.solve(jacobian, residual[..., None])[..., 0]
        # one cell at a time, and one beyond the edge at most, where the extrapolated map is still one to one
        index[active] = np.clip(at + np.clip(step, -1.0, 1.0), -1.0, last + 1.0)
    inside = found & ((index >= -_EDGE) & (index <= last + _EDGE)).all(axis=1)
    j, i = np.clip(index, 0.0, last).T
    return j, i, inside


def _tensor_spline(axes: list[Array], values: Array) -> NdBSpline:
    """Return the not-a-knot cubic interpolant of values, shape (*axes, n); axes of fewer than four points get a lower order."""
    knots, orders = [], []
    for axis, points in enumerate(axes):
        order = min(3, points.size - 1)
        orders.append(order)
        if order == 0:
            knots.append(points[0] + [0.0, 1.0])
            continue
        spline = make_interp_spline(points, values, k=order, axis=axis)
        # SciPy moves the interpolated axis to the front
        values = np.moveaxis(spline.c, 0, axis)
        knots.append(spline.t)
    return NdBSpline(tuple(knots), np.ascontiguousarray(values), tuple(orders))


def _without_land(velocity: Array, wet: Mask) -> Array:
    """Return velocities, shape (2, Z, J, I), with dry points filled by the nearest wet value, for splines."""
    filled = np.where(wet, velocity, 0.0)
    for level, mask in enumerate(wet):
        if mask.any():
            j, i = distance_transform_edt(~mask, return_distances=False, return_indices=True)
            filled[:, level] = filled[:, level, j, i]
    return filled
