"""From velocities at nodes to a flow everywhere: latent values of the horizontal functions.

With the kernel matrix K of the nodes and a nugget n the flow's velocities at the nodes are K (K + n I)^-1 v. For the columns of the kernel
the latent velocities are (K + n I)^-1 v, by its eigenvectors. On a lattice, where K = a G G', the same flow has the coefficients c with

    (G'G + n/a I) c = G'v    (push-through: a G' (a G G' + n I)^-1 = (G'G + n/a I)^-1 G'),

scalar unknowns with a banded matrix, half as many as the velocities and whatever the nodes. The nugget is a share of the largest
eigenvalue of K, and so is n/a of that of G'G. The flows of both ways differ by what the cut of the Gaussians leaves.

A factor larger than half a gigabyte is made in single precision, and its solution refined with residuals in double precision.
"""

from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse.linalg
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.linalg.blas import dsbmv, dtrsm, ssbmv, strsm

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.functions import NodeKernel, velocity_kernel
from replay_kit.core.flow.lattice import WINDOW, HorizontalFunctions, StreamFunctionLattice

#: Lower band of a symmetric matrix, shape (n, b + 1): element [j, d] is that of row j + d and column j; single or double precision.
Band = NDArray[np.floating]

_BLOCK = 256


def rows_and_columns(band: Band) -> Band:
    """Return a view of a lower band, shape (n, n), by column and row; only elements between the diagonal and the band's edge are meant."""
    n, step, item = len(band), band.shape[1] - 1, band.itemsize
    return np.lib.stride_tricks.as_strided(band, (n, n), (step * item, item))


def factored(band: Band) -> Band:
    """Return the lower Cholesky factor in the place of a symmetric positive definite band.

    Raises:
        EstimatorError: The matrix is not positive definite.
    """
    factor = lapack.spbtrf if band.dtype == np.float32 else lapack.dpbtrf
    lower, info = factor(band.T, lower=1, overwrite_ab=1)
    if info > 0:
        raise EstimatorError(
            f"the equations of the basis are singular at unknown {info} of {len(band)}; set a larger [estimator] nugget"
        )
    return np.asarray(lower.T)


def solve(factor: Band, right: Array) -> Array:
    """Return the solution, shape (n, k), of L L' x = right, from the factor that ``factored`` returns; in its precision."""
    x = np.array(right, dtype=factor.dtype, order="C")
    triangular = strsm if factor.dtype == np.float32 else dtrsm
    blocks = list(_blocks(factor))
    for at in blocks:
        x[at.columns] = triangular(1.0, at.diagonal, x[at.columns], lower=1)
        x[at.full_rows] -= at.full.T @ x[at.columns]
        x[at.last_rows] -= at.last.T @ x[at.columns]
    for at in reversed(blocks):
        x[at.columns] -= at.full @ x[at.full_rows]
        x[at.columns] -= at.last @ x[at.last_rows]
        x[at.columns] = triangular(1.0, at.diagonal, x[at.columns], lower=1, trans_a=1)
    return np.asarray(x)


class _Block:
    """Some columns of a lower band: the block on the diagonal, the rows below that have all of them, and those after with the last ones."""

    def __init__(self, elements: Band, width: int, start: int, stop: int) -> None:
        n = len(elements)
        self.elements, self.columns = elements, slice(start, stop)
        self.full_rows = slice(stop, max(stop, min(n, start + width + 1)))
        self.last_rows = slice(self.full_rows.stop, max(self.full_rows.stop, min(n, stop + width)))

    @property
    def diagonal(self) -> Band:
        """By row and column; above the diagonal it has no meaning."""
        return self.elements[self.columns, self.columns].T

    @property
    def full(self) -> Band:
        """By column and row."""
        return self.elements[self.columns, self.full_rows]

    @property
    def last(self) -> Band:
        """By column and row, zero beyond the band's edge."""
        return np.tril(self.elements[self.columns, self.last_rows], -1)


def _blocks(factor: Band) -> Iterator[_Block]:
    elements, width = rows_and_columns(factor), factor.shape[1] - 1
    step = min(_BLOCK, width + 1)
    for start in range(0, len(factor), step):
        yield _Block(elements, width, start, min(start + step, len(factor)))


# Largest factor in double precision [bytes].
_DOUBLE = 5e8
# Relative error of the largest eigenvalue.
_EIGENVALUE = 1e-3
# Least nugget for which the matrix is positive definite in double precision.
LEAST_NUGGET = 1e-11
# Least nugget for which single precision keeps the matrix positive definite.
_LEAST_NUGGET_SINGLE = 5e-7
# Largest residual that is not refined, relative to the right-hand sides, and most rounds.
_RESIDUAL, _ROUNDS = 1e-6, 5


def embed(functions: HorizontalFunctions, nodes: Array, velocity: Array, nugget: float) -> Array:
    """Return the latent values, shape (M, m), of flows with given velocities at nodes, shape (2N, m) [m/s]; see ``embedding``."""
    return embedding(functions, nodes, nugget)(velocity)


def embedding(
    functions: HorizontalFunctions, nodes: Array, nugget: float
) -> Callable[[Array], Array]:
    """Return what returns the latent values, shape (M, m), of flows with given velocities at nodes, shape (2N, m) [m/s].

    Args:
        functions: The horizontal functions; M of them.
        nodes: shape (N, 2) [m].
        nugget: Share of the kernel matrix's largest eigenvalue added to its diagonal.

    Raises:
        EstimatorError: The nugget is too small for the equations of a lattice.
    """
    if isinstance(functions, NodeKernel):
        values, vectors = np.linalg.eigh(velocity_kernel(functions.kernel, nodes, nodes))
        scale = (values + nugget * values[-1])[:, None]
        return lambda velocity: np.asarray(vectors @ ((vectors.T @ velocity) / scale))
    assert isinstance(functions, StreamFunctionLattice)
    return _on_lattice(functions, nodes, nugget)


def _on_lattice(
    lattice: StreamFunctionLattice, nodes: Array, nugget: float
) -> Callable[[Array], Array]:
    """Return what returns the coefficients, shape (size, m), from the normal equations."""
    equations = NormalEquations(lattice, nodes)
    single = (
        equations.size * (equations.half_width + 1) * 8 > _DOUBLE and nugget >= _LEAST_NUGGET_SINGLE
    )
    band = equations.band(np.float32 if single else np.float64)
    ridge = nugget * _largest_eigenvalue(band)
    band[:, 0] += ridge
    factor = factored(band)

    def coefficients(velocity: Array) -> Array:
        right = equations.right(velocity)
        solution = np.asarray(solve(factor, right), dtype=np.float64)
        for _ in range(_ROUNDS if single else 0):
            # in place: of a large region each of these arrays is a tenth of the memory that the embedding takes
            residual = equations.product(solution)
            residual += ridge * solution
            np.subtract(right, residual, out=residual)
            if np.all(
                np.linalg.norm(residual, axis=0) <= _RESIDUAL * np.linalg.norm(right, axis=0)
            ):
                break
            solution += solve(factor, residual)
        return equations.by_east(solution)

    return coefficients


def _largest_eigenvalue(band: Band) -> float:
    product, width = ssbmv if band.dtype == np.float32 else dsbmv, band.shape[1] - 1
    operator = scipy.sparse.linalg.LinearOperator(
        (len(band), len(band)),
        matvec=lambda x: product(width, 1.0, band.T, x, lower=1),
        dtype=band.dtype,
    )
    start = np.ones(len(band), dtype=band.dtype)
    return float(
        scipy.sparse.linalg.eigsh(
            operator, k=1, tol=_EIGENVALUE, v0=start, return_eigenvectors=False
        )[0]
    )


class NormalEquations:
    """G'G of a lattice and nodes, with the unknowns along the lattice's shorter side first, so that the band is narrow.

    Attributes:
        size: Number of unknowns.
        half_width: Of the band: the unknowns of ``WINDOW - 1`` rows of the lattice and as many of the next.
    """

    def __init__(self, lattice: StreamFunctionLattice, nodes: Array) -> None:
        self._lattice, self._nodes = lattice, nodes
        self._turned = lattice.shape[0] < lattice.shape[1]
        self._shape = lattice.shape[::-1] if self._turned else lattice.shape
        self.size = lattice.size
        self.half_width = (WINDOW - 1) * (self._shape[1] + 1)

    def right(self, velocity: Array) -> Array:
        """Return G'v, shape (size, m), of velocities at the nodes, shape (2N, m)."""
        out, n = np.zeros((*self._shape, velocity.shape[1])), len(self._nodes)
        for points, *at, design in self._tiles():
            here = np.concatenate([velocity[points], velocity[n + points]])
            out[*at] += (design.T @ here).reshape(out[*at].shape)
        return out.reshape(self.size, -1)

    def product(self, coefficients: Array) -> Array:
        """Return G'G times coefficients, shape (size, m)."""
        given = coefficients.reshape(*self._shape, -1)
        out = np.zeros_like(given)
        for _, *at, design in self._tiles():
            here = np.ascontiguousarray(given[*at]).reshape(design.shape[1], -1)
            out[*at] += (design.T @ (design @ here)).reshape(out[*at].shape)
        return out.reshape(self.size, -1)

    def band(self, dtype: type[np.floating]) -> Band:
        """Return the lower band of G'G, shape (size, half_width + 1)."""
        band = np.zeros((self.size, self.half_width + 1), dtype=dtype)
        elements = rows_and_columns(band).reshape(*self._shape, *self._shape)
        for _, rows, columns, design in self._tiles():
            n = rows.stop - rows.start, columns.stop - columns.start
            block = (design.T @ design).reshape(*n, *n)
            lower = np.tri(n[1]).T
            for i, row in enumerate(range(rows.start, rows.stop)):
                elements[row, columns, row, columns] += block[i, :, i] * lower
                below = min(n[0], i + WINDOW)
                elements[row, columns, row + 1 : rows.start + below, columns] += block[
                    i, :, i + 1 : below
                ]
        return band

    def by_east(self, coefficients: Array) -> Array:
        """Return coefficients, shape (size, m), in the order of the lattice."""
        if not self._turned:
            return coefficients
        return np.ascontiguousarray(coefficients.reshape(*self._shape, -1).swapaxes(0, 1)).reshape(
            self.size, -1
        )

    def _tiles(self) -> Iterator[tuple[NDArray[np.intp], slice, slice, Array]]:
        """Yield nodes, the part of the lattice around them and G there, all east then all north, shape (2P, n)."""
        for tile in self._lattice.tiles(self._nodes):
            rows, columns, design = tile.east, tile.north, tile.design
            if self._turned:
                rows, columns, design = columns, rows, design.swapaxes(2, 3)
            yield tile.points, rows, columns, design.reshape(2 * tile.points.size, -1)
