"""The incompressible kernel in the horizontal (Lee et al., arXiv 1901.09513; notation in ``replay_kit/core/README.md``).

A stream function with a Gaussian (squared-exponential) covariance k gives velocities u = dpsi/dy, v = -dpsi/dx with

    K(x, x') = k [[(1 - dy^2/ly^2)/ly^2,  dx dy/(lx^2 ly^2)],
                  [ dx dy/(lx^2 ly^2),   (1 - dx^2/lx^2)/lx^2]],     d = x - x',  k = sigma^2 exp(-1/2 (dx^2/lx^2 + dy^2/ly^2)),

and sigma = mu lx, so that K(x, x) = mu^2 I when lx = ly. Stacked vectors are all east, then all north.
"""

from dataclasses import dataclass

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
