"""What both forms of the posterior have in common, and the products of a profile's rows with a covariance.

A profile's design is H = R (x) G in the order of ``ProfileRows``: G (2, r) the modes under the profile, R (k, Z) its depth factor. A
covariance is met through ``spread``, its product with G at each level, so a product with H costs two columns instead of 2 k.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.kalman import ProfileRows

# Rows of a symmetric matrix that are updated at once.
_BLOCK = 512
# Columns that are few, and the tile of a matrix that OpenBLAS multiplies with them as it lies.
_FEW_COLUMNS, _TILE = 32, (64, 512)


class Posterior(Protocol):
    """The weights' Gaussian after some profiles; frozen, whatever its buffers share with later ones.

    Beside its mean it follows its answers: what each instrumental error of one unit would have added to the mean (Friedland 1969).
    """

    @property
    def prior(self) -> Prior:
        """What the profiles have changed."""
        ...

    @property
    def family(self) -> Any:
        """What posteriors share whose sources one call computes."""
        ...

    @property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level."""
        ...

    @staticmethod
    def sources(posteriors: Sequence[Any]) -> Array:
        """Return s of posteriors of one family, shape (m, Z, r): their means are w0 + P0 s."""
        ...

    def answers(self) -> Array:
        """Return what errors of one unit would have added to the mean, shape (b, Z, r)."""
        ...

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of the weights of some levels as one matrix, shape (L r, L r); None for all levels."""
        ...

    def ahead(self, profiles: Sequence[ProfileRows]) -> "list[Ahead]":
        """Return what can be computed of coming profiles before any of them counts."""
        ...

    def look(self, rows: ProfileRows, ahead: "Ahead") -> "Look[Posterior]":
        """Return what the posterior expects of a profile's rows.

        Args:
            rows: The profile.
            ahead: Of this profile, by this posterior or one from which it came in the same form.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """What is known of a profile before those ahead of it count.

    Attributes:
        cross: shape (2 k, Z, r), H P0.
        solved: shape (., 2 k), the first rows of L^-1 H0 P0 H' in the dual form, H0 being the rows measured so far.
        n_solved: Number of profiles that those rows belong to.
    """

    cross: Array
    solved: Array
    n_solved: int


After = TypeVar("After")


@dataclass(frozen=True, eq=False)
class Look(Generic[After]):
    """What an estimate expects of an observation's rows, before they count.

    Attributes:
        mean: shape (2 k,), of the rows.
        answers: shape (2 k, b), what the errors that are followed would have added to it.
        cov: shape (2 k, 2 k), of the rows without their own noise.
        absorb: Makes the estimate after the rows, each over an error scale (the last argument), from the Cholesky factor of the scaled
            innovation's covariance and the innovation whitened by it.
    """

    mean: Array
    answers: Array
    cov: Array
    absorb: Callable[[Array, Array, float], After]

    def posterior(self, told: Array, error_scale: float) -> After:
        """Return the posterior after the rows.

        Args:
            told: shape (2 k, 1 + b), see ``told``.
            error_scale: Standard deviation of the rows' independent noise.
        """
        lower = self._factor(len(told), error_scale)
        whitened = scipy.linalg.solve_triangular(lower, told / error_scale, lower=True)
        return self.absorb(lower, np.asarray(whitened), error_scale)

    def told(self, innovation: Array, columns: Array | None) -> Array:
        """Return the innovations of the rows and of the errors that are followed, shape (2 k, 1 + b).

        Args:
            innovation: shape (2 k,), rows minus their mean.
            columns: shape (2 k, b), what errors of one unit do to the rows; None where the log does not say.
        """
        return np.column_stack([innovation, (0.0 if columns is None else columns) - self.answers])

    def mean_after(self, innovation: Array, error_scale: float) -> Array:
        """Return the rows' mean in that posterior, shape (2 k,); arguments as in ``posterior``."""
        lower = self._factor(innovation.size, error_scale)
        gained = scipy.linalg.cho_solve((lower, True), innovation / error_scale)
        return np.asarray(self.mean + self.cov @ gained / error_scale)

    def _factor(self, size: int, error_scale: float) -> Array:
        return np.asarray(np.linalg.cholesky(self.cov / error_scale**2 + np.eye(size)), dtype=np.float64)

    def nis(self, innovation: Array) -> float:
        """Return the normalised innovation squared of the rows, with noise of unit variance."""
        return float(innovation @ np.linalg.solve(self.cov + np.eye(innovation.size), innovation))


def means(posteriors: Sequence[Posterior]) -> Array:
    """Return the means of posteriors, shape (m, Z r): those of neighbours in one run cost little more than one of them.

    A mean is a product with the prior covariance, which is bound by reading it; several products read it once.
    """
    out: list[Array] = []
    for _, of_prior in groupby(posteriors, key=lambda posterior: id(posterior.prior)):
        same = list(of_prior)
        families = [list(family) for _, family in groupby(same, key=lambda posterior: id(posterior.family))]
        sources = np.concatenate([family[0].sources(family) for family in families])
        out.append(same[0].prior.mean + same[0].prior.times(sources).reshape(len(same), -1))
    return np.concatenate(out)


def times_rows(spread: Array, depth: Array) -> Array:
    """Return a covariance times H', transposed: shape (2 k, Z, r).

    Args:
        spread: shape (Z, 2, Z, r), its product with G at each level.
        depth: shape (k, Z), R.
    """
    n_levels, _, _, n_modes = spread.shape
    by_component = spread.transpose(1, 0, 2, 3).reshape(2, n_levels, -1)
    return np.asarray(np.matmul(depth, by_component)).reshape(-1, n_levels, n_modes)


def times_columns(matrix: Array, columns: Array) -> Array:
    """Return the product of a matrix, shape (n, m), with columns, shape (m, c).

    With few columns it is bound by reading the matrix. BLAS copies a large one first; tiles that are small enough it does not.
    """
    if columns.shape[1] > _FEW_COLUMNS:
        return matrix @ columns
    out = np.zeros((len(matrix), columns.shape[1]))
    for start in range(0, len(columns), _TILE[1]):
        part = slice(start, start + _TILE[1])
        for row in range(0, len(matrix), _TILE[0]):
            out[row : row + _TILE[0]] += matrix[row : row + _TILE[0], part] @ columns[part]
    return out


def add_gram(matrix: Array, rows: Array, sign: float) -> None:
    """Add sign * rows' rows to a symmetric matrix in place; ``rows`` of shape (m, n)."""
    add_symmetric(matrix, rows, sign * rows)


def add_symmetric(matrix: Array, left: Array, right: Array) -> None:
    """Add left' right, known to be symmetric, to a symmetric matrix in place, by blocks of its lower half: half of the whole work.

    Args:
        matrix: shape (n, n).
        left: shape (m, n).
        right: shape (m, n).
    """
    for start in range(0, matrix.shape[0], _BLOCK):
        stop = min(start + _BLOCK, matrix.shape[0])
        matrix[start:stop, :stop] += left[:, start:stop].T @ right[:, :stop]
        matrix[:start, start:stop] = matrix[start:stop, :start].T
