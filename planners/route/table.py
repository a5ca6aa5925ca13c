"""A flow tabulated on a regular grid: what a search evaluates many times. It is linear between its points, so it is approximate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from planners.route.region import Region
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate

# Table points for each kernel length, and at most how many along a side.
_PER_LENGTH, _MOST_POINTS = 3.0, 120


@dataclass(frozen=True, slots=True, eq=False)
class FlowTable:
    """A flow on a regular grid.

    Attributes:
        origin: shape (2,) [m], east and north of the first point.
        spacing: shape (2,) [m].
        depths: shape (D,) [m].
        velocity: shape (2, D, n_north, n_east) [m/s].
        allowed: shape (Z, n_north - 1, n_east - 1), True where a path may be at all four corners of a cell, between a level and the next.
        region: Where a path may be, point by point.
    """

    origin: Array
    spacing: Array
    depths: Array
    velocity: Array
    allowed: NDArray[np.bool_]
    region: Region

    def velocity_at(self, points: Array) -> Array:
        """Return the flow [m/s], shape (n, 3) with nothing downwards, at points, shape (n, 3) [m]; held constant outside the table."""
        column, row = ((points[:, :2] - self.origin) / self.spacing).T
        layer = np.interp(points[:, 2], self.depths, np.arange(self.depths.size, dtype=np.float64))
        u, v = (
            map_coordinates(component, [layer, row, column], order=1, mode="nearest")
            for component in self.velocity
        )
        return np.column_stack([u, v, np.zeros_like(u)])

    def allowed_at(self, points: Array) -> NDArray[np.bool_]:
        """Return whether a path may be at points, shape (n, 3) [m].

        It may within a cell whose four table points are all allowed. Others lie on an edge or a coast, or the start may be between it
        and the nearest table point: there the region itself is asked. A point that is not a number counts as allowed nowhere.
        """
        cells = np.array(self.allowed.shape[:0:-1])
        cell = np.floor((points[:, :2] - self.origin) / self.spacing)
        within = np.all((cell >= 0) & (cell < cells), axis=1)
        column, row = np.where(within[:, None], cell, 0.0).astype(int).T
        found = within & self.allowed[self.region.level_at(points[:, 2]), row, column]
        unsure = np.flatnonzero(~found & np.isfinite(points).all(axis=1))
        found[unsure] = self.region.allowed(points[unsure])
        return np.asarray(found)


def tabulate(flow: FlowEstimate, region: Region) -> FlowTable:
    """Return a flow on a regular grid over its region, three points a kernel length."""
    grid = flow.grid
    low = np.array([grid.east.min(), grid.north.min()])
    extent = np.array([grid.east.max(), grid.north.max()]) - low
    lengths = np.array([flow.horizontal.kernel.length_east, flow.horizontal.kernel.length_north])
    size = np.clip(np.ceil(extent / lengths * _PER_LENGTH).astype(int) + 1, 2, _MOST_POINTS)
    east, north = (np.linspace(low[i], low[i] + extent[i], size[i]) for i in (0, 1))
    points = np.stack(np.meshgrid(east, north), axis=-1)
    # Hats are linear between levels already; a Gaussian bends between them.
    finer = 1 if flow.depth_functions.kind == "hat" else 4
    depths = np.interp(
        np.arange((flow.levels.size - 1) * finer + 1) / finer,
        np.arange(flow.levels.size),
        flow.levels,
    )
    weights = depth_weights(flow.depth_functions, depths, flow.levels)
    rows = [flow.horizontal.velocity(row, flow.latent) for row in points]
    velocity = np.stack([row @ weights.T for row in rows], axis=1)
    allowed = region.inside_outline(points) & region.wet_by_level(points)
    allowed = allowed[:, 1:, 1:] & allowed[:, 1:, :-1] & allowed[:, :-1, 1:] & allowed[:, :-1, :-1]
    return FlowTable(
        low,
        extent / (size - 1),
        depths,
        np.ascontiguousarray(velocity.transpose(0, 3, 1, 2)),
        allowed,
        region,
    )
