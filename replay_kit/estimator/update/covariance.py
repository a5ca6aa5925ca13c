"""The covariance of a posterior's weights, computed in the parts that are asked for, and once."""

from dataclasses import dataclass
from functools import cached_property

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import Levels, symmetric
from replay_kit.core.flow.factors import CovarianceFactors, half_size, n_stored
from replay_kit.core.flow.reduction import Reduction
from replay_kit.estimator.prior.amplitude import hybrid_parts
from replay_kit.estimator.update.posterior import Posterior


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
        prior = hybrid_parts(self.posterior.prior)
        if prior is None:
            return None
        _, n_levels, n_modes = prior.factor.shape
        whole = half_size(n_levels * n_modes)
        most = sum(n_stored(prior, size) < whole for size in range(n_modes + 1)) - 1
        taken = self.posterior.taken(most) if most >= 0 else None
        return None if taken is None else CovarianceFactors(prior, taken[0], symmetric(taken[1]))

    @cached_property
    def _reduction(self) -> Reduction:
        return self.posterior.reduction()

    @cached_property
    def _known(self) -> dict[Levels, Array]:
        return {}
