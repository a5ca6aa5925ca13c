"""The stream function of a flow near many places at once, with its derivatives up to the third order.

With psi = sum_c w_c psi_c over the columns c of the latent values (levels and times) every function of the horizontal here is a sum of
products, so that near each place

    d^(p+q) psi / dx^p dy^q = X_p' (sum_c w_c C_c) Y_q,

where X_p and Y_q, the factors along the axes and their derivatives, are the same for all columns. On a lattice the factors are Gaussians
in a window around the place; of nodes they are the kernel's, all of them; in a spline they are B-splines (``spline.py``).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import NodeKernel
from replay_kit.core.flow.lattice import WINDOW, StreamFunctionLattice

#: Orders of derivatives along each axis: 0 to 3.
ORDERS = 4


class Stream(Protocol):
    """A stream function of several columns of latent values."""

    def derivatives(
        self, place: Array, columns: NDArray[np.intp], weights: Array, orders: int = ORDERS
    ) -> Array:
        """Return d^(p+q) psi / dx^p dy^q, shape (K, m, orders, orders) [m^2/s over m^(p+q)], of m sums of columns near each of K places.

        Args:
            place: shape (K, 2) [m], local east and north.
            columns: shape (K, k), the columns that count at each place.
            weights: shape (K, m, k), their weights in each sum.
            orders: How many of each axis: 2 for velocities, 4 with their second derivatives.
        """


class Separable(Stream, Protocol):
    """A stream function that is a sum of products of factors along each axis."""

    def factors(self, axis: int, sites: Array) -> Array:
        """Return the factors along an axis (0 east, 1 north) at sites, shape (n,) [m]; shape (n, F)."""

    def products(self, east: Array, north: Array) -> Array:
        """Return the stream function of each column, shape (C, n_east, n_north), of factors of either axis, shape (n, F) each."""


@dataclass(frozen=True, slots=True, eq=False)
class LatticeStream:
    """The stream function of a lattice.

    Attributes:
        lattice: Its Gaussians.
        coefficients: shape (C, n_east, n_north) [m^2/s].
    """

    lattice: StreamFunctionLattice
    coefficients: Array

    def derivatives(
        self, place: Array, columns: NDArray[np.intp], weights: Array, orders: int = ORDERS
    ) -> Array:
        """Return the derivatives as ``Stream`` says."""
        first, factors = _window_factors(self.lattice, place, orders)
        windows = np.lib.stride_tricks.sliding_window_view(
            self.coefficients, (WINDOW, WINDOW), axis=(1, 2)
        )
        near = windows[columns, first[:, :1], first[:, 1:]]
        summed = np.matmul(weights, near.reshape(*columns.shape, -1)).reshape(
            *weights.shape[:2], WINDOW, WINDOW
        )
        return np.asarray(factors[0][:, None] @ summed @ factors[1].transpose(0, 2, 1)[:, None])

    def factors(self, axis: int, sites: Array) -> Array:
        """Return the factors as ``Separable`` says."""
        lattice = self.lattice
        lines = lattice.origin[axis] + lattice.spacing[axis] * np.arange(lattice.shape[axis])
        return np.exp(-0.5 * ((sites[:, None] - lines) / lattice.widths[axis]) ** 2)

    def products(self, east: Array, north: Array) -> Array:
        """Return the stream function as ``Separable`` says."""
        return east @ self.coefficients @ north.T


def _window_factors(
    lattice: StreamFunctionLattice, place: Array, orders: int
) -> tuple[NDArray[np.intp], Array]:
    """Return the first lattice lines that count at each place, shape (K, 2), and the Gaussians there, shape (2, K, orders, 18)."""
    origin, spacing, widths = (
        np.array(pair) for pair in (lattice.origin, lattice.spacing, lattice.widths)
    )
    first = np.clip(
        np.floor((place - origin) / spacing) - (WINDOW // 2 - 1),
        0,
        np.array(lattice.shape) - WINDOW,
    )
    x = (
        (place - origin - spacing * first).T[..., None] - spacing[:, None, None] * np.arange(WINDOW)
    ) / widths[:, None, None]
    return first.astype(np.intp), _gaussians(x, widths, orders)


def _gaussians(x: Array, lengths: Array, orders: int) -> Array:
    """Return exp(-x^2 / 2) and its derivatives by the place, shape (2, K, orders, n), at distances in lengths, shape (2, K, n)."""
    slope, term = -1.0 / lengths[:, None, None], np.exp(-0.5 * x * x)
    terms, before = [term], np.zeros_like(x)
    for order in range(orders - 1):
        # the Hermite polynomials: He_(p+1) = x He_p - p He_(p-1), each derivative one more length
        before, term = term, slope * x * term - order * slope**2 * before
        terms.append(term)
    return np.stack(terms, axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class NodeStream:
    """The stream function of the kernel of some nodes.

    Attributes:
        functions: The nodes and their kernel.
        latent: shape (C, 2N), latent velocities.
    """

    functions: NodeKernel
    latent: Array

    def derivatives(
        self, place: Array, columns: NDArray[np.intp], weights: Array, orders: int = ORDERS
    ) -> Array:
        """Return the derivatives as ``Stream`` says."""
        kernel, nodes = self.functions.kernel, self.functions.nodes
        lengths = np.array([kernel.length_east, kernel.length_north])
        factors = _gaussians(
            (place.T[..., None] - nodes.T[:, None]) / lengths[:, None, None], lengths, orders + 1
        )
        used, which = np.unique(columns, return_inverse=True)
        spread = weights @ np.eye(used.size)[which.reshape(columns.shape)]
        latent = (kernel.speed * kernel.length_east) ** 2 * (spread @ self.latent[used])
        n = len(nodes)
        # psi = sum (beta_v d/dx - beta_u d/dy) k
        x, y = factors
        of_u = -(x[:, None, :orders] * latent[:, :, None, :n]) @ y[:, None, 1:].swapaxes(-1, -2)
        of_v = (x[:, None, 1:] * latent[:, :, None, n:]) @ y[:, None, :orders].swapaxes(-1, -2)
        return np.asarray(of_u + of_v)

    def factors(self, axis: int, sites: Array) -> Array:
        """Return the kernel's Gaussian of each node, then its derivative."""
        kernel = self.functions.kernel
        length = (kernel.length_east, kernel.length_north)[axis]
        x = (sites[:, None] - self.functions.nodes[:, axis]) / length
        gaussian = np.exp(-0.5 * x * x)
        return np.concatenate([gaussian, -x / length * gaussian], axis=1)

    def products(self, east: Array, north: Array) -> Array:
        """Return the stream function as ``Separable`` says."""
        kernel, n = self.functions.kernel, len(self.functions.nodes)
        latent = (kernel.speed * kernel.length_east) ** 2 * self.latent
        return np.stack(
            [
                (one[n:] * east[:, n:]) @ north[:, :n].T - (one[:n] * east[:, :n]) @ north[:, n:].T
                for one in latent
            ]
        )


def stream_of(flow: FlowEstimate, latent: Array) -> Separable:
    """Return the stream function of a flow's own functions, for latent values of shape (M, C)."""
    functions = flow.horizontal
    if isinstance(functions, NodeKernel):
        return NodeStream(functions, np.ascontiguousarray(latent.T))
    if not isinstance(functions, StreamFunctionLattice):
        raise TypeError(f"no stream function of {type(functions).__name__} is known")
    return LatticeStream(functions, np.ascontiguousarray(latent.T).reshape(-1, *functions.shape))
