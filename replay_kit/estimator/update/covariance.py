"""The covariance of a posterior's weights, computed in the parts that are asked for, and once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import Levels, Reduction, symmetric
from replay_kit.core.flow.factors import CovarianceFactors, half_size, n_stored
from replay_kit.estimator.prior.amplitude import hybrid_parts
from replay_kit.estimator.prior.conditioned import ConditionedPrior
from replay_kit.estimator.update.posterior import Posterior
from replay_kit.estimator.update.subspace import directions as orthonormal
from replay_kit.estimator.update.subspace import nonzero_mode_std


# Not slotted: the parts are computed when they are first asked for.
@dataclass(frozen=True, eq=False)
class PosteriorCovariance:
    """The covariance of a posterior's weights, a ``FactoredCovariance``.

    Attributes:
        posterior: The posterior.
    """

    posterior: Posterior

    def __call__(self, levels: Levels | None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        return self.posterior.covariance(levels)

    def of_sum(self, levels: Levels) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        if levels not in self._known:
            self._known[levels] = self.posterior.prior.of_sum(levels) - self._reduction(levels)
        return self._known[levels]

    def of_combinations(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m); ``design`` of shape (m, Z, r)."""
        return self.posterior.covariance_of(design)

    def factors(self) -> CovarianceFactors | None:
        """Return the factors to keep; None where the matrix has fewer elements, or the prior is of another kind."""
        conditioned = (
            self.posterior.prior if isinstance(self.posterior.prior, ConditionedPrior) else None
        )
        prior = hybrid_parts(self.posterior.prior if conditioned is None else conditioned.before)
        if prior is None:
            return None
        _, n_levels, n_modes = prior.factor.shape
        whole = half_size(n_levels * n_modes)
        most = sum(n_stored(prior, size) < whole for size in range(n_modes + 1)) - 1
        taken = self.posterior.taken(most) if most >= 0 else None
        if conditioned is not None and taken is not None:
            taken = taken_in_all(conditioned, *taken, most)
        return None if taken is None else CovarianceFactors(prior, taken[0], symmetric(taken[1]))

    @cached_property
    def _reduction(self) -> Reduction:
        return self.posterior.reduction()

    @cached_property
    def _known(self) -> dict[Levels, Array]:
        return {}


def taken_in_all(
    prior: ConditionedPrior, directions: Array, matrix: Array, most: int
) -> tuple[Array, Array] | None:
    """Return what all rows took from the covariance before any of them, as ``Posterior.taken`` does; None with more than ``most``.

    Args:
        prior: After the first rows.
        directions: shape (s, r), B of further rows.
        matrix: shape (Z s, Z s), M of what they took from the prior's covariance.
        most: Number of directions.
    """
    n_rows, n_levels, n_modes = prior.whitened.shape
    mode_std = nonzero_mode_std(prior.before)
    own, further = prior.whitened.reshape(-1, n_modes) * mode_std, directions * mode_std
    # rows enter by what they span, however long they are
    spanning = np.concatenate([each / (np.linalg.norm(each) or 1.0) for each in (own, further)])
    if len(spanning) > n_modes:
        spanning = scipy.linalg.qr(spanning, mode="r")[0][:n_modes]
    found = orthonormal(spanning)
    if len(found) > most:
        return None
    inside = (own @ found.T).reshape(n_rows, n_levels * len(found))
    change = np.einsum("yz,sd->yszd", np.eye(n_levels), further @ found.T).reshape(
        len(matrix), inside.shape[1]
    )
    change -= (prior.gain @ directions.T).reshape(n_rows, len(matrix)).T @ inside
    return found / mode_std, inside.T @ inside + change.T @ matrix @ change
