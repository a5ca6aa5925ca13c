"""Functions whose sum is a flow: the incompressible kernel in the horizontal, and functions of depth.

Of the kernel (Lee et al., arXiv 1901.09513; notation in ``replay_kit/core/README.md``) a stream function with a Gaussian
(squared-exponential) covariance k gives velocities u = dpsi/dy, v = -dpsi/dx with

    K(x, x') = k [[(1 - dy^2/ly^2)/ly^2,  dx dy/(lx^2 ly^2)], [ dx dy/(lx^2 ly^2),   (1 - dx^2/lx^2)/lx^2]],     d = x - x',  k = sigma^2
                  exp(-1/2 (dx^2/lx^2 + dy^2/ly^2)),

and sigma = mu lx, so that K(x, x) = mu^2 I when lx = ly. Stacked vectors are all east, then all north.

In depth ``hat`` is piecewise linear between levels. ``gaussian`` is the paper's squared exponential of length lz. Both are constant above
the first level and below the last.

A lattice of stream functions gives these flows at a cost linear in the number of nodes, which may lie anywhere. The kernel's Gaussian of
lengths l is the product of narrower ones over a lattice of points s with spacings h, up to aliasing:

    exp(-(x - x')^2 / (2 l^2)) = h / (sqrt(pi) w) sum_s g(x - s) g(x' - s),    g(x) = exp(-x^2 / (2 w^2)),  w = l / sqrt(2),

in each direction. Hence K = a G G', where G holds the velocities u = dpsi/dy, v = -dpsi/dx of the lattice's Gaussians at the nodes and a =
sigma^2 hx hy / (pi wx wy), and every flow K(x, nodes) beta is that of the stream function with coefficients a G' beta. The relative error
of aliasing is 2 exp(-2 pi^2 w^2 / h^2) or some 2e-7 of the spacing chosen; beyond 5.5 widths a Gaussian is cut off (3e-7).
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.arrays import Array, Indices
from replay_kit.core.errors import EstimatorError


@dataclass(frozen=True, slots=True)
class HorizontalKernel:
    """Parameters of the kernel.

    Attributes:
        length_east: lx [m].
        length_north: ly [m].
        speed: mu [m/s], the amplitude.
    """

    length_east: float
    length_north: float
    speed: float

    @property
    def lengths(self) -> Array:
        """Both lengths, shape (2,) [m]."""
        return np.array([self.length_east, self.length_north])


def velocity_kernel(kernel: HorizontalKernel, points: Array, nodes: Array) -> Array:
    """Return K between points and nodes, shape (2P, 2N) [m^2/s^2].

    Args:
        kernel: Parameters.
        points: shape (P, 2) [m], east and north.
        nodes: shape (N, 2) [m], east and north.
    """
    (dx, dy), (p, n) = points.T[:, :, None] - nodes.T[:, None], (len(points), len(nodes))
    sx, sy = dx / kernel.length_east**2, dy / kernel.length_north**2
    k = (kernel.speed * kernel.length_east) ** 2 * np.exp(-0.5 * (sx * dx + sy * dy))
    out = np.empty((2 * p, 2 * n))
    out[:p, :n] = k * (1.0 / kernel.length_north**2 - sy * sy)
    out[p:, n:] = k * (1.0 / kernel.length_east**2 - sx * sx)
    np.multiply(k, sx * sy, out=out[:p, n:])
    out[p:, :n] = out[:p, n:]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class NodeKernel:
    """Columns of the kernel at nodes; latent values are latent velocities, all east then all north.

    Attributes:
        kernel: Parameters.
        nodes: shape (N, 2) [m], east and north.
    """

    kernel: HorizontalKernel
    nodes: Array

    @property
    def size(self) -> int:
        """Number of latent velocities, two per node."""
        return 2 * len(self.nodes)

    @property
    def key(self) -> Hashable:
        """Key of the kernel and the nodes, bit for bit."""
        return self.kernel, np.ascontiguousarray(self.nodes).tobytes()

    def velocity(self, points: Array, latent: Array) -> Array:
        """Return the velocity [m/s], shape (2, P, k), at points, shape (P, 2) [m], of latent velocities, shape (2N, k)."""
        stacked = velocity_kernel(self.kernel, points, self.nodes) @ latent
        return np.asarray(stacked.reshape(2, len(points), -1))


@dataclass(frozen=True, slots=True)
class DepthFunctions:
    """Kind and length of the depth functions.

    Attributes:
        kind: ``hat`` or ``gaussian``.
        length: lz [m]; not used by hats.
    """

    kind: Literal["hat", "gaussian"]
    length: float


def depth_weights(functions: DepthFunctions, depth: Array, levels: Array) -> Array:
    """Return the value of each level's function at each depth, shape (n, Z).

    Args:
        functions: Kind and length.
        depth: shape (n,) [m], positive down.
        levels: shape (Z,) [m], increasing.
    """
    if functions.kind == "gaussian":
        depth = np.clip(depth, levels[0], levels[-1])
        return np.asarray(np.exp(-0.5 * ((depth[:, None] - levels) / functions.length) ** 2))
    return hat_weights(depth, levels)


def hat_weights(at: NDArray[Any], knots: NDArray[Any]) -> Array:
    """Return the weights of increasing knots at positions, shape (n, T): linear between knots, constant outside."""
    if knots.size == 1:
        return np.ones((len(at), 1))
    rows = np.arange(len(at))
    before = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    share = np.clip((at - knots[before]) / np.diff(knots)[before], 0.0, 1.0)
    weights = np.zeros((len(at), knots.size))
    weights[rows, before], weights[rows, before + 1] = 1.0 - share, share
    return weights


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
            [
                np.einsum("pe,pe->p", gaussian, along[..., k])
                for k, gaussian in enumerate((gx, slope_x))
            ]
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
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    lengths, spacing = kernel.lengths, _SPACING * kernel.lengths
    shape = np.maximum(
        np.ceil((high - low + _MARGIN * np.sqrt(2.0) * lengths) / spacing).astype(int) + 1, WINDOW
    )
    origin = 0.5 * (low + high) - 0.5 * (shape - 1) * spacing
    each = (tuple(values.tolist()) for values in (origin, spacing, shape))
    return StreamFunctionLattice(kernel, *each)


#: Divergence-free functions of the horizontal place, of which a flow is a sum: one latent value weights each.
HorizontalFunctions = NodeKernel | StreamFunctionLattice


# Points, and places that they lie over, evaluated at once: both bound the matrices to some tens of MB.
_POINTS, _PLACES = 4096, 256
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
    # square by square: a tile of a lattice serves all points near each other
    side = np.abs(points).max(initial=1.0) * np.sqrt(_PLACES / max(1, given.size))
    squares = np.floor(points.imag / side), np.floor(points.real / side)
    order, out = np.lexsort((points.imag, points.real, *squares)), np.empty((points.size, 2))
    # of a grid several depths over each place
    step = min(_POINTS, _PLACES * max(1, points.size // max(1, given.size)))
    for start in range(0, points.size, step):
        part = order[start : start + step]
        places, over = np.unique(points[part], return_inverse=True)
        out[part] = value(np.column_stack([places.real, places.imag]), over, depths[part])
    return out.reshape(*at[1].shape, 2)
