"""Truth interpolated anywhere: cubic in grid indices and depth, linear in time."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble, Grid

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
        velocity_splines: Splines from (depth, j, i) to local east and north [m/s], one per time.
        time_ns: shape (T,) [ns, UTC], increasing times; a single one is ignored.
        place_spline: Spline from (j, i) to local east and north [m].
        nodes: Grid nodes, for first guesses of (j, i).
    """

    grid: Grid
    velocity_splines: tuple[NdBSpline, ...]
    time_ns: NDArray[np.int64]
    place_spline: NdBSpline
    nodes: cKDTree

    def velocity(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, time_ns: ArrayLike = 0
    ) -> Array:
        """Return the current along the local axes, shape (..., 2) [m/s].

        Above the first level it is constant; it is NaN below the last level, outside the grid, and in cells with a dry corner.

        Args:
            east: [m], local frame; the arguments are broadcast against each other.
            north: [m], local frame.
            depth: [m], positive down.
            time_ns: [ns, UTC], broadcast against the positions; ignored for a truth of one time.

        Raises:
            ForecastError: A time lies outside the truth's.
        """
        east, north, depth = np.broadcast_arrays(
            np.asarray(east, np.float64),
            np.asarray(north, np.float64),
            np.asarray(depth, np.float64),
        )
        shape = east.shape
        places = np.stack([east.ravel(), north.ravel(), depth.ravel()])
        times = np.broadcast_to(np.asarray(time_ns, np.int64), shape).ravel()
        values = np.empty((times.size, 2))
        for start in range(0, times.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            at_east, at_north, at_depth = places[:, part]
            values[part] = self._velocity(at_east, at_north, at_depth, times[part])
        return values.reshape(*shape, 2)

    def _velocity(
        self, east: Array, north: Array, depth: Array, time_ns: NDArray[np.int64]
    ) -> Array:
        """Return ``velocity`` at positions, shape (n, 2)."""
        j, i, inside = grid_indices(self, east, north)
        levels = self.grid.levels
        z = np.maximum(depth, levels[0])
        usable = inside & (z <= levels[-1])
        usable[usable] = _cell_is_wet(self.grid, z[usable], j[usable], i[usable])
        values = np.full((east.size, 2), np.nan)
        if usable.any():
            values[usable] = self._at(np.column_stack([z, j, i])[usable], time_ns[usable])
        return values

    def _at(self, index: Array, time_ns: NDArray[np.int64]) -> Array:
        """Return the current at grid indices, shape (n, 3), and times, shape (n,)."""
        if len(self.velocity_splines) == 1:
            return np.asarray(self.velocity_splines[0](index))
        if time_ns.min() < self.time_ns[0] or time_ns.max() > self.time_ns[-1]:
            first, last = (
                np.datetime_as_string(np.datetime64(int(t), "ns"), unit="s")
                for t in self.time_ns[[0, -1]]
            )
            raise ForecastError(
                f"the truth changes from {first}Z to {last}Z, and the mission goes beyond; take fewer or closer pings"
            )
        before = np.clip(
            np.searchsorted(self.time_ns, time_ns, side="right") - 1, 0, self.time_ns.size - 2
        )
        share = (time_ns - self.time_ns[before]) / (self.time_ns[before + 1] - self.time_ns[before])
        values = np.zeros((len(index), 2))
        for k in np.unique(before).tolist():
            of = before == k
            early, late = (self.velocity_splines[k + step](index[of]) for step in (0, 1))
            values[of] = early + share[of, None] * (late - early)
        return values


def build_field(truth: Ensemble, *later: Ensemble) -> Field:
    """Return the field of a truth, or of a truth at several times.

    Args:
        truth: Ensemble of one.
        later: Truths at later times on the same grid.

    Raises:
        ForecastError: A truth is not an ensemble of one, has no wet point, or is not later than the previous one.
    """
    times = tuple(0 if each.time_ns is None else each.time_ns for each in (truth, *later))
    if any(after <= before for before, after in pairwise(times)):
        raise ForecastError(
            f"{truth.source}: a truth of several times needs times that grow, got {', '.join(map(str, times))}"
        )
    for each in (truth, *later):
        if each.n_members != 1:
            raise ForecastError(
                f"{each.source}: a truth is one member, got {each.n_members}; choose one with FILE#MEMBER"
            )
    grid = replace(
        truth.grid, wet=np.logical_and.reduce([each.grid.wet for each in (truth, *later)])
    )
    if not grid.wet.any():
        raise ForecastError(
            f"{truth.source}: no wet point to sample; give a truth with water in it"
        )
    rows, columns = (np.arange(n, dtype=np.float64) for n in grid.east.shape)
    axes = (grid.levels, rows, columns)
    splines = tuple(
        _tensor_spline(axes, np.moveaxis(_without_land(each.velocity[0], grid.wet), 0, -1))
        for each in (truth, *later)
    )
    places = np.stack([grid.east, grid.north], axis=-1)
    nodes = cKDTree(places.reshape(-1, 2))
    return Field(
        grid, splines, np.array(times, np.int64), _tensor_spline((rows, columns), places), nodes
    )


def grid_indices(field: Field, east: Array, north: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return fractional (j, i) of positions and whether each is in the grid, by Newton's method from the nearest node.

    Args:
        field: The field.
        east: shape (n,) [m], local frame.
        north: shape (n,) [m], local frame.
    """
    rows, columns = field.grid.east.shape
    last = np.array([rows - 1.0, columns - 1.0])
    wanted = np.column_stack([east, north])
    finite = np.isfinite(wanted).all(axis=1)
    index = np.zeros_like(wanted)
    _, nearest = field.nodes.query(wanted[finite])
    index[finite] = np.column_stack(np.unravel_index(nearest, (rows, columns)))
    found = np.zeros(len(wanted), dtype=np.bool_)
    for _ in range(_ITERATIONS):
        active = np.flatnonzero(finite & ~found)
        if active.size == 0:
            break
        at = index[active]
        residual = wanted[active] - field.place_spline(at)
        near = np.hypot(residual[:, 0], residual[:, 1]) < _TOLERANCE
        found[active[near]] = True
        active, at, residual = active[~near], at[~near], residual[~near]
        jacobian = np.stack([field.place_spline(at, nu=nu) for nu in ((1, 0), (0, 1))], axis=-1)
        step = np.linalg.solve(jacobian, residual[..., None])[..., 0]
        # one cell at a time, and one beyond the edge at most, where the extrapolated map is still one to one
        index[active] = np.clip(at + np.clip(step, -1.0, 1.0), -1.0, last + 1.0)
    inside = found & (index >= -_EDGE).all(axis=1) & (index <= last + _EDGE).all(axis=1)
    index = np.clip(index, 0.0, last)
    return index[:, 0], index[:, 1], inside


def _tensor_spline(axes: tuple[Array, ...], values: Array) -> NdBSpline:
    """Return the not-a-knot cubic interpolant of values, shape (*axes, n); axes of fewer than four points get a lower order."""
    knots, orders = [], []
    coefficients = values
    for axis, points in enumerate(axes):
        if points.size == 1:
            knots.append(np.array([points[0], points[0] + 1.0]))
            orders.append(0)
            continue
        spline = make_interp_spline(points, coefficients, k=min(3, points.size - 1), axis=axis)
        # SciPy moves the interpolated axis to the front
        coefficients = np.moveaxis(spline.c, 0, axis)
        knots.append(spline.t)
        orders.append(spline.k)
    return NdBSpline(tuple(knots), np.ascontiguousarray(coefficients), tuple(orders))


def _without_land(velocity: Array, wet: NDArray[np.bool_]) -> Array:
    """Return velocities, shape (2, Z, J, I), with dry points filled by the nearest wet value, for splines."""
    filled = np.where(wet, velocity, 0.0)
    for level, mask in enumerate(wet):
        if mask.any() and not mask.all():
            nearest = distance_transform_edt(~mask, return_distances=False, return_indices=True)
            filled[:, level] = filled[:, level, nearest[0], nearest[1]]
    return filled


def _cell_is_wet(grid: Grid, z: Array, j: Array, i: Array) -> NDArray[np.bool_]:
    """Return whether all corners of the cell around each position are wet."""
    n_levels, rows, columns = grid.wet.shape
    k0 = np.clip(np.searchsorted(grid.levels, z, side="right") - 1, 0, n_levels - 1)
    # on a level, the level below does not count
    k1 = np.where(z > grid.levels[k0], k0 + 1, k0)
    j0 = np.clip(np.floor(j).astype(np.intp), 0, rows - 2)
    i0 = np.clip(np.floor(i).astype(np.intp), 0, columns - 2)
    corners = [grid.wet[k, j0 + dj, i0 + di] for k in (k0, k1) for dj in (0, 1) for di in (0, 1)]
    return np.asarray(np.all(corners, axis=0))
