"""A stream function on a lattice, one Gaussian at a time, and its fit to velocities by dense normal equations."""

import math
from functools import cache

import numpy as np

from replay_kit.core.flow.functions import NodeKernel, velocity_kernel

# nearest lattice lines that count, on either side of a place
_NEAR = 9


def nearest_lines(at, origin, spacing, count):
    """Numbers of the lines that count; at the lattice's edge they are the outermost."""
    first = math.floor((at - origin) / spacing) - _NEAR + 1
    first = min(max(first, 0), count - 2 * _NEAR)
    return range(first, first + 2 * _NEAR)


def velocities(lattice, east, north):
    """Velocity at a place of each Gaussian with coefficient 1, shape (2, size): u = dpsi/dy, v = -dpsi/dx."""
    out = np.zeros((2, *lattice.shape))
    width = (
        lattice.kernel.length_east / math.sqrt(2.0),
        lattice.kernel.length_north / math.sqrt(2.0),
    )
    for i in nearest_lines(east, lattice.origin[0], lattice.spacing[0], lattice.shape[0]):
        for j in nearest_lines(north, lattice.origin[1], lattice.spacing[1], lattice.shape[1]):
            x = (east - lattice.origin[0] - i * lattice.spacing[0]) / width[0]
            y = (north - lattice.origin[1] - j * lattice.spacing[1]) / width[1]
            psi = math.exp(-0.5 * (x * x + y * y))
            out[:, i, j] = -y / width[1] * psi, x / width[0] * psi
    return out.reshape(2, -1)


def matrix(functions, points):
    """Velocities at points of each function with latent value 1, shape (2P, M), all east then all north."""
    if isinstance(functions, NodeKernel):
        return velocity_kernel(functions.kernel, np.asarray(points), functions.nodes)
    return np.stack([velocities(functions, *point) for point in points], axis=1).reshape(
        2 * len(points), -1
    )


def embed(lattice, nodes, velocity, nugget):
    """Coefficients of the least squares fit, with the share of the largest eigenvalue added."""
    design = matrix(lattice, nodes)
    normal = design.T @ design
    return np.linalg.solve(
        normal + nugget * np.linalg.eigvalsh(normal)[-1] * np.eye(len(normal)), design.T @ velocity
    )


@cache
def _from_nodes(lattice, nodes, nugget):
    nodes = np.array(nodes)
    return embed(lattice, nodes, np.eye(2 * len(nodes)), nugget)


def interpolation(lattice, nodes, place, nugget):
    """The matrix, shape (2, 2N), from velocities at nodes to that at a place."""
    return matrix(lattice, [place]) @ _from_nodes(lattice, tuple(map(tuple, nodes)), nugget)
