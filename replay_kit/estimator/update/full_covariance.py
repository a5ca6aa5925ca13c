"""A prior whose covariance is one matrix.

After a long survey the rows outnumber the weights and span all directions. Then nothing is cheaper than the covariance itself: the
posterior becomes such a prior, without rows. Only the blocks on and below the diagonal are kept, one for each pair of levels.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array


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

    def matvec_modes(self, basis: Array) -> Array:
        """Return the covariance of all weights with ``basis``, shape (c, r), at each level: shape (Z, c, Z, r)."""
        n_modes = basis.shape[1]
        n_levels = self.mean.size // n_modes
        out = np.empty((n_levels, len(basis), n_levels, n_modes))
        for level, other, block in self._lower():
            out[level, :, other] = basis @ block
            if level != other:
                out[other, :, level] = basis @ block.T
        return out

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        variances = [np.diagonal(block) for level, other, block in self._lower() if level == other]
        return np.asarray(np.sqrt(np.mean(variances, axis=0)))

    def covariance(self) -> Array:
        """Return the covariance as one matrix, shape (Z r, Z r)."""
        n, r = self.mean.size, self.blocks.shape[1]
        out = np.empty((n, n))
        for level, other, block in self._lower():
            out[level * r : (level + 1) * r, other * r : (other + 1) * r] = block
            out[other * r : (other + 1) * r, level * r : (level + 1) * r] = block.T
        return out

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
        for (level, other), block in zip(zip(*np.tril_indices(n_levels), strict=True), self.blocks, strict=True):
            yield int(level), int(other), block


def full_covariance_prior(mean: Array, covariance: Array, n_levels: int) -> FullCovariancePrior:
    """Return a Gaussian, shapes (Z r,) and (Z r, Z r), as a prior."""
    by_level = covariance.reshape(n_levels, mean.size // n_levels, n_levels, -1)
    level, other = np.tril_indices(n_levels)
    return FullCovariancePrior(mean, by_level[level, :, other])
