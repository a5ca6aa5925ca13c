"""A prior after rows of any form: in parts, from which the rows take a part of low rank; or as one covariance matrix.

With rows H, L L' = H P0 H' + 1 and A = L^-1 H the covariance is P0 - P0 A' A P0. Further rows H2 with L2 under that covariance P1 add
A2 = L2^-1 H2 (1 - P0 A' A), because P1 H2' L2'^-1 = P0 A2'. So all rows, whenever they came, are one matrix A, which also gives the
covariance in factors as a file keeps it (``core/flow/factors.py``).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import Reduction, reduction_by_products
from replay_kit.estimator.prior.hybrid import Prior, PriorSettings


@dataclass(frozen=True, slots=True, eq=False)
class ConditionedPrior:
    """A Gaussian of the weights: another one's covariance without that of some rows.

    Attributes:
        before: The prior.
        mean: shape (Z r,).
        whitened: shape (m, Z, r), A; empty where ``before`` is one matrix, of which no factors are kept.
        gain: shape (m, Z, r), A P0; the sum of the rows' outer products is taken from the covariance.
    """

    before: Prior
    mean: Array
    whitened: Array
    gain: Array

    @property
    def settings(self) -> PriorSettings | None:
        """The settings of the prior."""
        return self.before.settings

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        return self.less_taken(weights, self.before.matvec(weights))

    def less_taken(self, weights: Array, product: Array) -> Array:
        """Return the covariance times each weight vector, given its product with that of the prior before the rows."""
        rows = self.gain.reshape(-1, self.mean.size)
        taken = (weights.reshape(len(weights), -1) @ rows.T) @ rows
        return np.asarray(product - taken.reshape(weights.shape))

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        of_levels = self.gain if levels is None else self.gain[:, list(levels)]
        at_basis = self.gain @ basis.T  # (m, Z, c)
        return np.asarray(
            self.before.matvec_modes(basis, levels) - np.tensordot(at_basis, of_levels, axes=(0, 0))
        )

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        taken = np.einsum("mzr,mzr->r", self.gain, self.gain) / self.gain.shape[1]
        before = self.before.mode_std() ** 2
        # rounding must not leave a mode without variance
        return np.asarray(np.sqrt(np.maximum(before - taken, 1e-12 * before)))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        chosen = self.gain if levels is None else self.gain[:, list(levels)]
        rows = chosen.reshape(-1, chosen.shape[1] * chosen.shape[2])
        return np.asarray(self.before.covariance(levels) - rows.T @ rows)

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        rows = self.gain[:, list(levels)].sum(axis=1)
        return np.asarray(self.before.of_sum(levels) - rows.T @ rows)

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        return reduction_by_products(self, directions, matrix)

    def after_rows(
        self, innovation: Array, whitened: Array, gain: Array
    ) -> "tuple[ConditionedPrior, Array]":
        """Return the Gaussian after further rows, and the change of its mean for each instrument error of one unit, shape (b, Z, r).

        Args:
            innovation: shape (k, 1 + b): L2^-1 times that of the rows, and effects of instrument errors on it.
            whitened: shape (k, Z, r), L2^-1 H2.
            gain: shape (k, Z, r), the same times this covariance.
        """
        change, rows = np.tensordot(innovation, gain, axes=(0, 0)), self.whitened
        if not isinstance(self.before, FullCovariancePrior):
            size = self.mean.size
            of_before = whitened.reshape(-1, size) @ self.gain.reshape(-1, size).T
            rows = np.concatenate([rows, whitened - np.tensordot(of_before, rows, axes=1)])
        mean, gains = self.mean + change[0].ravel(), np.concatenate([self.gain, gain])
        return ConditionedPrior(self.before, mean, rows, gains), change[1:]

    def scaled(self, before: Prior, factor: float) -> "ConditionedPrior":
        """Return the same with its covariance multiplied by a factor; ``before`` has it already."""
        return ConditionedPrior(
            before, self.mean, self.whitened / np.sqrt(factor), np.sqrt(factor) * self.gain
        )


def as_conditioned(prior: Prior, n_levels: int) -> ConditionedPrior:
    """Return a prior as one after rows: none, or those that it is conditioned on."""
    if isinstance(prior, ConditionedPrior):
        return prior
    none = np.empty((0, n_levels, prior.mean.size // n_levels))
    return ConditionedPrior(prior, prior.mean, none, none)


def is_matrix(prior: Prior) -> bool:
    """Return whether a prior is one matrix, from which rows may still have to be taken."""
    return isinstance(getattr(prior, "before", prior), FullCovariancePrior)


def one_matrix(prior: Prior) -> "FullCovariancePrior":
    """Return a prior that is one matrix, with all rows taken from it."""
    if isinstance(prior, FullCovariancePrior):
        return prior
    assert isinstance(prior, ConditionedPrior)
    assert isinstance(prior.before, FullCovariancePrior)
    return prior.before.downdate(prior.mean, prior.gain.reshape(-1, prior.mean.size))


def conditioned(prior: Prior, design: Array, innovation: Array) -> tuple[ConditionedPrior, Array]:
    """Return a prior after rows y = H w + noise of unit variance, and the change of its mean for each further column.

    Args:
        prior: Gaussian of the weights before.
        design: shape (m, Z, r), H.
        innovation: shape (m, 1 + b): y minus its mean in the first column; effects of instrument errors on y in the others.

    Returns:
        The prior, and shape (b, Z, r).
    """
    size = len(design)
    cross = prior.matvec(design)
    cov = design.reshape(size, -1) @ cross.reshape(size, -1).T
    lower = np.linalg.cholesky(0.5 * (cov + cov.T) + np.eye(size))
    whitened, gain, of_rows = (
        np.asarray(solve_triangular(lower, rows.reshape(size, -1), lower=True))
        for rows in (design, cross, innovation)
    )
    before = as_conditioned(prior, design.shape[1])
    return before.after_rows(of_rows, whitened.reshape(design.shape), gain.reshape(design.shape))


@dataclass(frozen=True, slots=True, eq=False)
class FullCovariancePrior:
    """A Gaussian of the weights whose covariance has no further structure.

    Attributes:
        mean: shape (Z r,).
        blocks: shape (Z (Z + 1) / 2, r, r), covariance of level 0 with 0, 1 with 0, 1 with 1, 2 with 0 ...
        settings: Always None.
    """

    mean: Array
    blocks: Array
    settings: None = None

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        out = np.zeros_like(weights)
        for level, other, block in self._lower():
            out[:, other] += weights[:, level] @ block
            if level != other:
                out[:, level] += weights[:, other] @ block.T
        return out

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        n_modes = basis.shape[1]
        n_levels = self.mean.size // n_modes
        at = {
            level: position
            for position, level in enumerate(range(n_levels) if levels is None else levels)
        }
        out = np.empty((n_levels, len(basis), len(at), n_modes))
        for level, other, block in self._lower():
            if other in at:
                out[level, :, at[other]] = basis @ block
            if level != other and level in at:
                out[other, :, at[level]] = basis @ block.T
        return out

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        variances = [np.diagonal(block) for level, other, block in self._lower() if level == other]
        return np.asarray(np.sqrt(np.mean(variances, axis=0)))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        r = self.blocks.shape[1]
        chosen = range(self.mean.size // r) if levels is None else levels
        parts = {
            level: slice(position * r, (position + 1) * r) for position, level in enumerate(chosen)
        }
        out = np.empty((len(parts) * r, len(parts) * r))
        for level, other, block in self._lower():
            if level in parts and other in parts:
                out[parts[level], parts[other]] = block
                out[parts[other], parts[level]] = block.T
        return out

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        r = self.blocks.shape[1]
        return np.asarray(
            self.covariance(levels).reshape(len(levels), r, len(levels), r).sum(axis=(0, 2))
        )

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        return reduction_by_products(self, directions, matrix)

    def downdate(self, mean: Array, rows: Array) -> "FullCovariancePrior":
        """Return the Gaussian of another mean with the Gram matrix of ``rows``, shape (m, Z r), subtracted from the covariance."""
        by_level = rows.reshape(len(rows), -1, self.blocks.shape[1])
        blocks = self.blocks.copy()
        for (level, other, _), block in zip(self._lower(), blocks, strict=True):
            block -= by_level[:, level].T @ by_level[:, other]
        return FullCovariancePrior(mean, blocks)

    def _lower(self) -> Iterator[tuple[int, int, Array]]:
        """Yield each block with the levels of its rows and its columns."""
        n_levels = self.mean.size // self.blocks.shape[1]
        for (level, other), block in zip(
            zip(*np.tril_indices(n_levels), strict=True), self.blocks, strict=True
        ):
            yield int(level), int(other), block


def full_covariance_prior(mean: Array, covariance: Array, n_levels: int) -> FullCovariancePrior:
    """Return a Gaussian, shapes (Z r,) and (Z r, Z r), as a prior."""
    by_level = covariance.reshape(n_levels, mean.size // n_levels, n_levels, -1)
    level, other = np.tril_indices(n_levels)
    return FullCovariancePrior(mean, by_level[level, :, other])
