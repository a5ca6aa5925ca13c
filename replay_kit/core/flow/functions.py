"""The functions that a flow is a sum of: the incompressible kernel in the horizontal, and functions of depth.

Of the kernel (Lee et al., arXiv 1901.09513; notation in ``replay_kit/core/README.md``) a stream
function with a Gaussian (squared-exponential) covariance k gives velocities u = dpsi/dy, v = -dpsi/dx with

    K(x, x') = k [[(1 - dy^2/ly^2)/ly^2,  dx dy/(lx^2 ly^2)],
                  [ dx dy/(lx^2 ly^2),   (1 - dx^2/lx^2)/lx^2]],     d = x - x',  k = sigma^2 exp(-1/2 (dx^2/lx^2 + dy^2/ly^2)),

and sigma = mu lx, so that K(x, x) = mu^2 I when lx = ly. Stacked vectors are all east, then all north.

In depth ``hat`` is piecewise linear between levels. ``gaussian`` is the paper's squared exponential of length lz. Both are constant
above the first level and below the last: the flow there is that of the nearest level.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

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


def _gaussian(kernel: HorizontalKernel, points: Array, nodes: Array) -> tuple[Array, Array, Array]:
    """Return (dx/lx^2, dy/ly^2, k), each of shape (P, N)."""
    dx = points[:, 0, None] - nodes[:, 0]
    dy = points[:, 1, None] - nodes[:, 1]
    sx = dx / kernel.length_east**2
    sy = dy / kernel.length_north**2
    sigma = kernel.speed * kernel.length_east
    return sx, sy, sigma**2 * np.exp(-0.5 * (sx * dx + sy * dy))


def velocity_kernel(kernel: HorizontalKernel, points: Array, nodes: Array) -> Array:
    """Return K between points and nodes, shape (2P, 2N) [m^2/s^2].

    Args:
        kernel: Parameters.
        points: shape (P, 2) [m], east and north.
        nodes: shape (N, 2) [m], east and north.
    """
    sx, sy, k = _gaussian(kernel, points, nodes)
    p, n = k.shape
    out = np.empty((2 * p, 2 * n))
    out[:p, :n] = k * (1.0 / kernel.length_north**2 - sy * sy)
    out[p:, n:] = k * (1.0 / kernel.length_east**2 - sx * sx)
    np.multiply(k, sx * sy, out=out[:p, n:])
    out[p:, :n] = out[:p, n:]
    return out


class HorizontalFunctions(Protocol):
    """Divergence-free functions of the horizontal place, of which a flow is a sum: one latent value weights each."""

    @property
    def kernel(self) -> HorizontalKernel:
        """The kernel whose lengths they have."""

    @property
    def size(self) -> int:
        """Number of functions, hence of latent values."""

    @property
    def key(self) -> Hashable:
        """What two sets of equal functions share."""

    def velocity(self, points: Array, latent: Array) -> Array:
        """Return the velocity [m/s], shape (2, P, k), east then north, of k sums of the functions.

        Args:
            points: shape (P, 2) [m], east and north.
            latent: shape (size, k).
        """

    def sums(self, points: Array, weights: Array, *latents: Array) -> list[Array]:
        """Return weighted sums over points of the velocities of each latent, shape (2, m, k): without those at the points.

        Args:
            points: shape (P, 2) [m], east and north.
            weights: shape (m, P).
            latents: Each of shape (size, k).
        """


@dataclass(frozen=True, slots=True, eq=False)
class NodeKernel:
    """The columns of the kernel of some nodes: their latent values are latent velocities, all east then all north.

    Attributes:
        kernel: Parameters.
        nodes: shape (N, 2) [m], east and north.
    """

    kernel: HorizontalKernel
    nodes: Array

    @property
    def size(self) -> int:
        """Number of latent velocities, two a node."""
        return 2 * len(self.nodes)

    @property
    def key(self) -> Hashable:
        """The kernel and the nodes, bit for bit."""
        return self.kernel, np.ascontiguousarray(self.nodes).tobytes()

    def velocity(self, points: Array, latent: Array) -> Array:
        """Return the velocity [m/s], shape (2, P, k), at points, shape (P, 2) [m], of latent velocities, shape (2N, k)."""
        return np.asarray(
            (velocity_kernel(self.kernel, points, self.nodes) @ latent).reshape(2, len(points), -1)
        )

    def sums(self, points: Array, weights: Array, *latents: Array) -> list[Array]:
        """Return weighted sums over points, as ``HorizontalFunctions`` has them."""
        design = velocity_kernel(self.kernel, points, self.nodes).reshape(2, len(points), -1)
        return [weights @ design @ latent for latent in latents]


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
    depth = np.clip(depth, levels[0], levels[-1])
    if functions.kind == "gaussian":
        return np.asarray(np.exp(-0.5 * ((depth[:, None] - levels) / functions.length) ** 2))
    weights = np.zeros((depth.size, levels.size))
    if levels.size == 1:
        weights[:, 0] = 1.0
        return weights
    upper = np.clip(np.searchsorted(levels, depth, side="right") - 1, 0, levels.size - 2)
    fraction = (depth - levels[upper]) / (levels[upper + 1] - levels[upper])
    rows = np.arange(depth.size)
    weights[rows, upper] = 1.0 - fraction
    weights[rows, upper + 1] = fraction
    return weights
