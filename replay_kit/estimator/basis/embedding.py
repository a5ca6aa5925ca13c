"""Kernel embedding: latent values of the flow that fits velocities at nodes.

With the kernel matrix K of the nodes and a nugget n the flow's velocities at the nodes are K (K + n I)^-1 v. For the columns of the kernel
the latent velocities are (K + n I)^-1 v, by its eigenvectors. On a lattice, where K = a G G', the same flow has the coefficients c with

    (G'G + n/a I) c = G'v    (push-through: a G' (a G G' + n I)^-1 = (G'G + n/a I)^-1 G'),

scalar unknowns with a banded matrix, half as many as the velocities for any nodes. The nugget is relative to the largest
eigenvalue of K, as n/a is to that of G'G. The two flows differ only by the truncation of the Gaussians.

A factor larger than 150 MB has single precision; its solution is refined with residuals in double precision.
"""

from collections.abc import Callable, Iterator

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.functions import (
    WINDOW,
    HorizontalFunctions,
    NodeKernel,
    StreamFunctionLattice,
    velocity_kernel,
)

#: Lower band of a symmetric matrix by blocks, shape (R, w, C, C): [i, d] is that of block row i + d and column i, if there is one.
Band = NDArray[np.floating]


def factored(band: Band) -> Band:
    """Return the lower Cholesky factor of a symmetric positive definite band matrix, which it overwrites.

    Raises:
        EstimatorError: The matrix is not positive definite.
    """
    for i, column in enumerate(band):
        below = column[1 : len(band) - i]
        try:
            column[0] = np.linalg.cholesky(column[0])
        except np.linalg.LinAlgError as error:
            raise EstimatorError(
                f"the equations of the basis are singular in row {i} of {len(band)}; set a larger [estimator] nugget"
            ) from error
        rows = below.reshape(-1, band.shape[3])
        below[:] = _solved(column[0], rows.T).T.reshape(below.shape)
        for d in range(len(below)):
            band[i + 1 + d, : len(below) - d] -= below[d:] @ below[d].T
    return band


def solve(factor: Band, right: Array) -> Array:
    """Return the solution of L L' x = right, shape (n, k), in the precision of the factor L; see ``factored``."""
    x = np.array(right, dtype=factor.dtype).reshape(len(factor), factor.shape[2], -1)
    for i, column in enumerate(factor):
        after = x[i + 1 : i + len(column)]
        x[i] = _solved(column[0], x[i])
        after -= column[1 : len(after) + 1] @ x[i]
    for i in reversed(range(len(factor))):
        after, column = x[i + 1 : i + factor.shape[1]], factor[i]
        below = column[1 : len(after) + 1].reshape(len(after) * factor.shape[2], factor.shape[3])
        x[i] -= below.T @ after.reshape(len(below), x.shape[2])
        x[i] = _solved(column[0], x[i], 1)
    return np.asarray(x.reshape(right.shape))


def _solved(lower: Band, right: Band, transposed: int = 0) -> Band:
    found = scipy.linalg.solve_triangular(
        lower, right, trans=transposed, lower=True, check_finite=False
    )
    return np.asarray(found)


def times(band: Band, x: Array) -> Array:
    """Return the product of a symmetric band matrix with a vector, shape (n,); diagonal blocks are stored whole."""
    given = x.reshape(len(band), -1)
    out = np.zeros_like(given)
    for i, column in enumerate(band):
        near = given[i : i + len(column)]
        out[i : i + len(column)] += column[: len(near)] @ given[i]
        out[i] += near[1:].ravel() @ column[1 : len(near)].reshape(near[1:].size, len(out[i]))
    return out.ravel()


# Largest factor in double precision [bytes].
_DOUBLE = 1.5e8
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
    """Return the map from velocities at nodes, shape (2N, m) [m/s], to latent values of their flows, shape (M, m).

    Args:
        functions: Horizontal functions; M of them.
        nodes: Positions of the nodes, shape (N, 2) [m].
        nugget: Fraction of the kernel matrix's largest eigenvalue added to its diagonal.

    Raises:
        EstimatorError: The nugget is too small for the normal equations of a lattice.
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
    """Return the map from velocities to lattice coefficients, shape (size, m), by the normal equations."""
    equations = NormalEquations(lattice, nodes)
    single = (
        equations.size * WINDOW * equations.shape[1] * 8 > _DOUBLE
        and nugget >= _LEAST_NUGGET_SINGLE
    )
    band = equations.band(np.float32 if single else np.float64)
    ridge = nugget * _largest_eigenvalue(band)
    diagonal = np.arange(band.shape[3])
    band[:, 0, diagonal, diagonal] += ridge
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
    n = band.shape[0] * band.shape[2]
    operator = scipy.sparse.linalg.LinearOperator(
        (n, n), matvec=lambda x: times(band, x), dtype=band.dtype
    )
    (found,) = scipy.sparse.linalg.eigsh(
        operator, k=1, tol=_EIGENVALUE, v0=np.ones(n, band.dtype), return_eigenvectors=False
    )
    return float(found)


class NormalEquations:
    """Normal equations G'G of a lattice and nodes, unknowns ordered along the shorter side for a narrow band.

    Attributes:
        size: Number of unknowns.
        shape: Rows of the lattice and points per row; points within ``WINDOW`` rows are coupled.
    """

    def __init__(self, lattice: StreamFunctionLattice, nodes: Array) -> None:
        self._lattice, self._nodes = lattice, nodes
        self._turned = lattice.shape[0] < lattice.shape[1]
        self.shape = lattice.shape[::-1] if self._turned else lattice.shape
        self.size = lattice.size

    def right(self, velocity: Array) -> Array:
        """Return G'v, shape (size, m), of velocities at the nodes, shape (2N, m)."""
        out, n = np.zeros((*self.shape, velocity.shape[1])), len(self._nodes)
        for points, *at, design in self._tiles():
            here = np.concatenate([velocity[points], velocity[n + points]])
            out[*at] += (design.T @ here).reshape(out[*at].shape)
        return out.reshape(self.size, -1)

    def product(self, coefficients: Array) -> Array:
        """Return G'G times coefficients, shape (size, m)."""
        given = coefficients.reshape(*self.shape, -1)
        out = np.zeros_like(given)
        for _, *at, design in self._tiles():
            here = np.ascontiguousarray(given[*at]).reshape(design.shape[1], -1)
            out[*at] += (design.T @ (design @ here)).reshape(out[*at].shape)
        return out.reshape(self.size, -1)

    def band(self, dtype: type[np.floating]) -> Band:
        """Return the lower band of G'G, a block for each two rows of the lattice."""
        n_rows, n_columns = self.shape
        band = np.zeros((n_rows, WINDOW, n_columns, n_columns), dtype=dtype)
        for _, rows, columns, design in self._tiles():
            n = rows.stop - rows.start, columns.stop - columns.start
            block = (design.T @ design).reshape(*n, *n)
            for i in range(n[0]):
                near = block[i : i + WINDOW, :, i]
                band[rows.start + i, : len(near), columns, columns] += near
        return band

    def by_east(self, coefficients: Array) -> Array:
        """Return coefficients in the lattice's own order, shape (size, m)."""
        if not self._turned:
            return coefficients
        return np.ascontiguousarray(coefficients.reshape(*self.shape, -1).swapaxes(0, 1)).reshape(
            self.size, -1
        )

    def _tiles(self) -> Iterator[tuple[NDArray[np.intp], slice, slice, Array]]:
        """Yield tiles: nodes, the rows and columns of the lattice around them, and G, east then north, shape (2P, n)."""
        for tile in self._lattice.tiles(self._nodes):
            rows, columns, design = tile.east, tile.north, tile.design
            if self._turned:
                rows, columns, design = columns, rows, design.swapaxes(2, 3)
            yield tile.points, rows, columns, design.reshape(2 * tile.points.size, -1)
