"""Functions whose sum is a flow: the incompressible kernel in the horizontal, and functions of depth.

Of the kernel (Lee et al., arXiv 1901.09513; notation in ``replay_kit/core/README.md``) a stream function with a Gaussian
(squared-exponential) covariance k gives velocities u = dpsi/dy, v = -dpsi/dx with

    K(x, x') = k [[(1 - dy^2/ly^2)/ly^2,  dx dy/(lx^2 ly^2)], [ dx dy/(lx^2 ly^2),   (1 - dx^2/lx^2)/lx^2]],     d = x - x',  k = sigma^2
                  exp(-1/2 (dx^2/lx^2 + dy^2/ly^2)),

and sigma = mu lx, so that K(x, x) = mu^2 I when lx = ly. Stacked vectors are all east, then all north.

In depth ``hat`` is piecewise linear between levels. ``gaussian`` is the paper's squared exponential of length lz. Both are constant above
the first level and below the last.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array


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
    return hats(depth, levels)


def hats(at: NDArray[Any], knots: NDArray[Any]) -> Array:
    """Return the weights of increasing knots at positions, shape (n, T): linear between knots, constant outside."""
    if knots.size == 1:
        return np.ones((len(at), 1))
    rows = np.arange(len(at))
    before = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    share = np.clip((at - knots[before]) / np.diff(knots)[before], 0.0, 1.0)
    weights = np.zeros((len(at), knots.size))
    weights[rows, before], weights[rows, before + 1] = 1.0 - share, share
    return weights
