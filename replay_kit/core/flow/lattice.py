"""Stream functions on a regular lattice: the kernel's flows at a cost linear in the number of nodes.

The kernel's Gaussian of lengths l is the product of narrower ones over a lattice of points s with spacings h, up to aliasing:

    exp(-(x - x')^2 / (2 l^2)) = h / (sqrt(pi) w) sum_s g(x - s) g(x' - s),    g(x) = exp(-x^2 / (2 w^2)),  w = l / sqrt(2),

in each direction. Hence K = a G G', where G holds the velocities u = dpsi/dy, v = -dpsi/dx of the lattice's Gaussians at the nodes and a =
sigma^2 hx hy / (pi wx wy), and every flow K(x, nodes) beta is that of the stream function with coefficients a G' beta. The relative error
of aliasing is 2 exp(-2 pi^2 w^2 / h^2) or some 2e-7 of the spacing chosen; beyond 5.5 widths a Gaussian is cut off (3e-7).

Nodes may lie anywhere.
"""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array, Indices
from replay_kit.core.flow.functions import HorizontalKernel, NodeKernel

# Spacing of the lattice in kernel lengths: 0.9 cells where the kernel has two.
_SPACING = 0.45
# Widths of a Gaussian after which it is cut off, and what spacing and cut give: lattice points on either side of a place.
_CUT = 5.5
HALF_WINDOW = int(np.ceil(_CUT / np.sqrt(2.0) / _SPACING))
WINDOW = 2 * HALF_WINDOW
_LINES = np.arange(WINDOW)
# Widths of a Gaussian by which the lattice extends beyond the nodes: coefficients farther away are less than 2e-3, their square counts.
_MARGIN = 4.0
# Lattice cells along a side of the tiles whose points are evaluated together.
_TILE = 8
# Points up to which each is evaluated on its own.
_FEW = 4


class Tile(NamedTuple):
    """Points and the part of the lattice that affects them.

    Attributes:
        points: Indices among all points.
        east: Lattice points along east.
        north: Lattice points along north.
        design: shape (2, P, n_east, n_north) [1/m], velocities of the lattice's Gaussians at the points.
    """

    points: Indices
    east: slice
    north: slice
    design: Array


@dataclass(frozen=True, slots=True)
class StreamFunctionLattice:
    """Gaussians of the stream function on a regular lattice; a latent value is a coefficient [m^2/s], along north first.

    Attributes:
        kernel: Kernel that the Gaussians factor.
        origin: East and north of the first lattice point [m].
        spacing: Spacing along east and north [m].
        shape: Number of points along east and north, at least ``WINDOW`` each.
    """

    kernel: HorizontalKernel
    origin: tuple[float, float]
    spacing: tuple[float, float]
    shape: tuple[int, int]

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.shape[0] * self.shape[1]

    @property
    def key(self) -> Hashable:
        """Key of the lattice: the lattice itself."""
        return self

    @property
    def widths(self) -> tuple[float, float]:
        """Standard deviations of the Gaussians along east and north [m]."""
        return self.kernel.length_east / np.sqrt(2.0), self.kernel.length_north / np.sqrt(2.0)

    def velocity(self, points: Array, latent: Array) -> Array:
        """Return the velocity [m/s], shape (2, P, k), at points, shape (P, 2) [m], of coefficients, shape (size, k) [m^2/s]."""
        k = latent.shape[1]
        if len(points) <= _FEW:
            (east, gx, slope_x), (north, gy, slope_y) = self._windows(points)
            near = latent[
                ((east * self.shape[1])[:, :, None] + north[:, None]).reshape(len(points), -1)
            ]
            design = _velocities(gx, slope_x, gy, slope_y).reshape(2, len(points), 1, -1)
            return np.asarray((design @ near)[..., 0, :])
        on_lattice, out = latent.reshape(*self.shape, k), np.empty((2, len(points), k))
        for tile in self.tiles(points):
            n = tile.points.size
            part = np.ascontiguousarray(on_lattice[tile.east, tile.north]).reshape(-1, k)
            out[:, tile.points] = (tile.design.reshape(2 * n, -1) @ part).reshape(2, n, k)
        return out

    def velocity_of_each(
        self, points: Array, flows: Indices, parts: Sequence[tuple[Array, Array]]
    ) -> Array:
        """Return the velocity [m/s], shape (P, 2), at points that belong to different flows.

        Args:
            points: shape (P, 2) [m].
            flows: shape (P,), index of each point's flow.
            parts: Weights, shape (1,) or (P, 1), and coefficients, shape (K, size) [m^2/s], whose sum is the flow; at least one.
        """
        (first_x, gx, slope_x), (first_y, gy, slope_y) = self._windows(points)
        corner = flows * self.size + first_x[:, 0] * self.shape[1] + first_y[:, 0]
        taken = corner[:, None] + (np.arange(WINDOW)[:, None] * self.shape[1] + _LINES).ravel()
        near = np.zeros(taken.shape)
        for weight, values in parts:
            near += weight * values.ravel().take(taken)
        # first along north, then along east: the products of both are never formed
        along = near.reshape(-1, WINDOW, WINDOW) @ np.stack([slope_y, -gy], axis=2)
        return np.column_stack(
            [np.einsum("pe,pe->p", of, along[..., k]) for k, of in enumerate((gx, slope_x))]
        )

    def tiles(self, points: Array) -> Iterator[Tile]:
        """Yield tiles of neighbouring points, shape (P, 2) [m], with the functions that reach them.

        A function that does not reach a point is zero there, so that velocities do not depend on neighbouring points.
        """
        windows = self._windows(points)
        cells = [lines[:, 0] // _TILE for lines, _, _ in windows]
        tile = cells[0] * (self.shape[1] // _TILE + 1) + cells[1]
        order = np.argsort(tile, kind="stable")
        for chosen in np.split(order, np.flatnonzero(np.diff(tile[order])) + 1):
            if not chosen.size:
                continue
            axes, rows = [], np.arange(chosen.size)[:, None]
            for lines, gaussian, slope in windows:
                near = lines[chosen]
                reach = slice(int(near.min()), int(near.max()) + 1)
                both = np.zeros((2, chosen.size, reach.stop - reach.start))
                both[:, rows, near - reach.start] = gaussian[chosen], slope[chosen]
                axes.append((reach, both))
            (east, (gx, slope_x)), (north, (gy, slope_y)) = axes
            yield Tile(chosen, east, north, _velocities(gx, slope_x, gy, slope_y))

    def _windows(self, points: Array) -> list[tuple[Indices, Array, Array]]:
        """Return the lattice lines near points along each axis, their Gaussians and slopes [1/m], each of shape (P, WINDOW)."""
        found = []
        for axis, at in enumerate(points.T):
            cell = np.floor((at - self.origin[axis]) / self.spacing[axis]) - (HALF_WINDOW - 1)
            first = np.minimum(np.maximum(cell, 0), self.shape[axis] - WINDOW).astype(np.intp)
            lines, inverse = first[:, None] + _LINES, 1.0 / self.widths[axis] ** 2
            distance = at[:, None] - (self.origin[axis] + self.spacing[axis] * lines)
            gaussian = np.exp((-0.5 * inverse) * distance * distance)
            found.append((lines, gaussian, -inverse * distance * gaussian))
        return found


def _velocities(gx: Array, slope_x: Array, gy: Array, slope_y: Array) -> Array:
    """Return the velocities of products of Gaussians [1/m], shape (2, P, n_east, n_north)."""
    return np.stack([gx[:, :, None] * slope_y[:, None], -slope_x[:, :, None] * gy[:, None]])


def lattice_over(kernel: HorizontalKernel, nodes: Array) -> StreamFunctionLattice:
    """Return the lattice for flows known at nodes, shape (N, 2) [m], extended by the reach of the Gaussians."""
    lengths = np.array([kernel.length_east, kernel.length_north])
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    spacing = _SPACING * lengths
    shape = np.maximum(
        np.ceil((high - low + _MARGIN * np.sqrt(2.0) * lengths) / spacing).astype(int) + 1, WINDOW
    )
    origin = 0.5 * (low + high) - 0.5 * (shape - 1) * spacing
    each = (tuple(values.tolist()) for values in (origin, spacing, shape))
    return StreamFunctionLattice(kernel, *each)


#: Divergence-free functions of the horizontal place, of which a flow is a sum: one latent value weights each.
HorizontalFunctions = NodeKernel | StreamFunctionLattice
