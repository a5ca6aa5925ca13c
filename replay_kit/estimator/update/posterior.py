"""What both representations of the posterior have in common, and the products of a profile's rows with a covariance.

A profile's design is H = R (x) G in the order of ``ProfileRows``: G (2, r) the modes under the profile, R (k, Z) its depth factor. A
covariance enters through its product with G at each level, so a product with H costs two columns instead of 2 k.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import Reduction
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.rows import PredictedObservation, ProfileRows

# A residual of G outside the directions is a new direction above this share of G; below it there is only rounding, which the modes of a
# smooth kernel amplify.
TOLERANCE = 5e-11


def directions(rows: Array) -> Array:
    """Return an orthonormal basis, shape (s, r), of the span of rows, shape (m, r), up to ``TOLERANCE`` of the longest."""
    q, r, _ = scipy.linalg.qr(rows.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.ascontiguousarray(q[:, size > TOLERANCE * size[0]].T)


def new_directions(directions: Array, rows: Array) -> Array:
    """Return orthonormal directions, shape (c, r), c <= 2, of the rows' components outside given directions.

    Args:
        directions: shape (s, r), orthonormal.
        rows: shape (2, r).
    """
    found = np.empty((0, rows.shape[1]))
    bound = TOLERANCE * np.linalg.norm(rows, axis=1)
    residual = rows - (rows @ directions.T) @ directions
    for row, least in zip(residual, bound, strict=True):
        if np.linalg.norm(row) > least:
            # project twice: the residual of a row that is nearly inside the span is mostly rounding
            row = row - (directions @ row) @ directions
            row = row - (found @ row) @ found
            length = np.linalg.norm(row)
            if length > least:
                found = np.vstack([found, row / length])
    return found


def nonzero_mode_std(prior: Prior) -> Array:
    """Return the prior standard deviation of the modes' weights, shape (r,), with zeros replaced by 1e-12 of the largest."""
    std = prior.mode_std()
    return np.asarray(np.maximum(std, 1e-12 * std.max() or 1.0))


# Rows of a symmetric matrix that are updated at once.
_BLOCK = 512
# Below this number of columns a product is tiled; a tile of this shape is small enough for OpenBLAS not to copy it.
_FEW_COLUMNS, _TILE = 32, (64, 512)
# Elements of products with the prior at once, 16 MB: fresh memory for larger ones takes longer than reading the prior again.
_TOGETHER = 2_000_000


# Not slotted: the mean is computed when it is first read.
@dataclass(frozen=True, eq=False)
class Posterior(ABC):
    """The weights' Gaussian after some profiles: an immutable value, although its buffers are shared with later ones.

    Beside the mean it tracks the bias sensitivity: the change of the mean for each instrument error of one unit (Friedland 1969).

    Attributes:
        prior: Gaussian of the weights before the profiles.
        prior_bias_sensitivity: shape (b, Z, r), change of the prior's mean for instrument errors of one unit.
    """

    prior: Prior
    prior_bias_sensitivity: Array

    @property
    def n_levels(self) -> int:
        """Number of levels Z."""
        return int(self.prior_bias_sensitivity.shape[1])

    @property
    def n_weights(self) -> int:
        """Number of weights Z r."""
        return int(self.prior.mean.size)

    @cached_property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level."""
        return np.asarray(means([self])[0])

    @property
    def shared_factor(self) -> Any:
        """Identifies posteriors whose information vectors one call of ``information_vectors`` computes."""
        return self.prior

    @property
    def prefetched_for(self) -> object:
        """Identifies posteriors for which the same ``prefetch`` holds."""
        return self.prior

    @staticmethod
    @abstractmethod
    def information_vectors(posteriors: Sequence[Any]) -> Array:
        """Return s of posteriors with one shared factor, shape (m, Z, r): their means are w0 + P0 s."""

    @abstractmethod
    def bias_information(self) -> Array:
        """Return the same of the instrument errors of one unit, shape (b, Z, r)."""

    def bias_sensitivity(self) -> Array:
        """Return the change of the mean for each instrument error of one unit, shape (b, Z, r)."""
        return self.prior_bias_sensitivity + self.prior.matvec(self.bias_information())

    @abstractmethod
    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""

    @abstractmethod
    def reduction(self) -> Reduction:
        """Return what the rows took from the prior's covariance of sums of levels."""

    @abstractmethod
    def taken(self, most: int) -> tuple[Array, Array] | None:
        """Return B, shape (s, r), and M, shape (Z s, Z s), of what the rows took, P0 (I (x) B') M (I (x) B) P0; None with s > ``most``."""

    @abstractmethod
    def covariance_of(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m).

        Args:
            design: shape (m, Z, r).
        """

    @abstractmethod
    def rescaled(self, prior: Prior, factor: float) -> "Posterior":
        """Return the same mean with the covariance multiplied by a factor.

        Args:
            prior: This posterior's, with its covariance multiplied by the factor.
            factor: Above 0.
        """

    def prefetch(self, profiles: Sequence[ProfileRows]) -> "list[PriorCrossCovariance]":
        """Return the parts of coming predictions that do not depend on the order of assimilation."""
        return [
            PriorCrossCovariance(cross, np.empty((0, 0)), 0)
            for cross in prior_cross_covariances(self.prior, profiles)
        ]

    @abstractmethod
    def predict(
        self, rows: ProfileRows, prefetched: "PriorCrossCovariance"
    ) -> "PredictedObservation[Posterior]":
        """Return the prediction of a profile's rows.

        Args:
            rows: The profile.
            prefetched: Of this profile, computed by this posterior or by an ancestor in the same representation.
        """

    def prior_prediction(self, rows: ProfileRows) -> Array:
        """Return the prior means of a profile's rows and of their bias sensitivity, shape (2 k, 1 + b)."""
        of_prior = self.prior.mean.reshape(1, *self.prior_bias_sensitivity.shape[1:])
        return rows.matvec(np.vstack([of_prior, self.prior_bias_sensitivity])).T


@dataclass(frozen=True, slots=True, eq=False)
class PriorCrossCovariance:
    """The cross-covariance of a profile's rows with the prior weights, computed before earlier profiles are assimilated.

    Attributes:
        cross: shape (2 k, Z, r), H P0.
        solved: shape (., 2 k), in observation space the first rows of L^-1 H0 P0 H', with H0 the rows measured so far; else empty.
        n_solved: Number of profiles that those rows belong to.
    """

    cross: Array
    solved: Array
    n_solved: int

    def turned(self, r: Array) -> "PriorCrossCovariance":
        """Return the same of the rows R of this one's, which are those of a column of unknowns; ``r`` has the shape (k, Z)."""
        solved = by_component(r, self.solved.T).T if self.solved.size else self.solved
        return PriorCrossCovariance(by_component(r, self.cross), solved, self.n_solved)


def by_component(r: Array, rows: Array) -> Array:
    """Return R, shape (k, Z), times the rows of each component, shape (2 Z, ...): shape (2 k, ...)."""
    return np.concatenate([np.tensordot(r, part, axes=1) for part in np.split(rows, 2)])


def means(posteriors: Sequence[Posterior]) -> Array:
    """Return the means of posteriors, shape (m, Z r): those of neighbours in one run cost little more than one of them.

    A mean is a product with the prior covariance, whose cost is reading that covariance; several products read it once.
    """
    out: list[Array] = []
    for _, of_prior in groupby(posteriors, key=lambda posterior: id(posterior.prior)):
        same = list(of_prior)
        groups = [
            list(group)
            for _, group in groupby(same, key=lambda posterior: id(posterior.shared_factor))
        ]
        information = np.concatenate([group[0].information_vectors(group) for group in groups])
        prior = same[0].prior
        # without rows the product would read the covariance for nothing
        change = prior.matvec(information) if information.any() else information
        out.append(prior.mean + change.reshape(len(same), -1))
    return np.concatenate(out)


def prior_cross_covariances(prior: Prior, profiles: Sequence[ProfileRows]) -> list[Array]:
    """Return H P0 of each profile, shape (c k, Z, r); the prior covariance is read once for as many as ``_TOGETHER`` allows."""
    if not profiles:
        return []
    n_modes = profiles[0].basis.shape[1]
    n_levels = prior.mean.size // n_modes
    together, out = max(1, _TOGETHER // (2 * n_levels * prior.mean.size)), []
    for start in range(0, len(profiles), together):
        part = profiles[start : start + together]
        at_levels = prior.matvec_modes(
            np.concatenate([rows.basis for rows in part])
        )  # (Z, sum of c, Z, r)
        by_component = at_levels.swapaxes(0, 1).reshape(at_levels.shape[1], n_levels, -1)
        ends = np.cumsum([len(rows.basis) for rows in part])[:-1]
        out += [
            np.matmul(rows.r, of_profile).reshape(-1, n_levels, n_modes)
            for rows, of_profile in zip(part, np.split(by_component, ends), strict=True)
        ]
    return out


def prior_covariance(prior: Prior, profiles: Sequence[ProfileRows]) -> Array:
    """Return the covariance of the rows of all profiles under a prior, without their own noise, shape (R, R)."""
    crosses = [cross.reshape(len(cross), -1) for cross in prior_cross_covariances(prior, profiles)]
    covariance: Array = (
        np.concatenate([rows.design() for rows in profiles]) @ np.concatenate(crosses).T
    )
    return 0.5 * (covariance + covariance.T)


def tiled_product(matrix: Array, columns: Array) -> Array:
    """Return the product of a matrix, shape (n, m), with columns, shape (m, c).

    With few columns the cost is reading the matrix. BLAS first copies a large matrix, but not tiles that are small enough.
    """
    if columns.shape[1] > _FEW_COLUMNS:
        return matrix @ columns
    out = np.zeros((len(matrix), columns.shape[1]))
    for start in range(0, len(columns), _TILE[1]):
        part = slice(start, start + _TILE[1])
        for row in range(0, len(matrix), _TILE[0]):
            out[row : row + _TILE[0]] += matrix[row : row + _TILE[0], part] @ columns[part]
    return out


def rank_k_update(matrix: Array, left: Array, right: Array) -> None:
    """Add left' right, known to be symmetric, to a symmetric matrix in place, by blocks of its lower half: half of the whole work.

    Args:
        matrix: shape (n, n).
        left: shape (k, n).
        right: shape (k, n).
    """
    for start in range(0, matrix.shape[0], _BLOCK):
        stop = min(start + _BLOCK, matrix.shape[0])
        matrix[start:stop, :stop] += left[:, start:stop].T @ right[:, :stop]
        matrix[:start, start:stop] = matrix[start:stop, :start].T


def gram(rows: Array) -> Array:
    """Return the Gram matrix of rows, shape (k, n): shape (n, n)."""
    matrix = np.zeros((rows.shape[1], rows.shape[1]))
    rank_k_update(matrix, rows, rows)
    return matrix
