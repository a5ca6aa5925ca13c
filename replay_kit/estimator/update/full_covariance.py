"""A prior whose covariance is one matrix.

After a long survey the rows outnumber the weights and span all directions. Then nothing is cheaper than the covariance itself: the
posterior becomes such a prior, without rows. Only the blocks on and below the diagonal are kept, one for each pair of levels.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.reduction import Reduction, reduction_by_products


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

    def after_rows(self, mean: Array, whitened: Array, gain: Array) -> "FullCovariancePrior":
        """Return the Gaussian after rows, as ``ConditionedPrior.after_rows`` does; the rows themselves, ``whitened``, are not kept."""
        return self.downdate(mean, gain.reshape(len(whitened), -1))

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
