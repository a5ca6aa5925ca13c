"""The average over the variance of the ensemble mean's amplitude, taken in a state: see ``prior/mean_amplitude.py``.

The posterior in observation space has the rows H and the Cholesky factor L of their covariance. Another Gaussian of the amplitude changes
that covariance by one outer product, and the innovations by a multiple of H m: nothing is assimilated again.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.hybrid import HybridPrior
from replay_kit.estimator.prior.mean_amplitude import AmplitudePrior, MeanAmplitude
from replay_kit.estimator.static.state import FilterState
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.posterior import Posterior


def with_mean_averaged(state: FilterState, mean_weights: Array | None) -> FilterState:
    """Return the state after the average over the amplitude's variance, if it is time.

    Once the posterior is in another form, after a mean along a path or where the basis is small, the Gaussian stays as it is.

    Args:
        state: After a profile or a group of them.
        mean_weights: shape (Z, r), the ensemble mean; None where its amplitude is certain.
    """
    before, posterior = state.mean_amplitude, state.posterior
    if (
        before is None
        or mean_weights is None
        or not isinstance(posterior, ObservationSpacePosterior)
        or not before.is_due(posterior.n)
    ):
        return state
    prior = posterior.prior
    base = prior.base if isinstance(prior, AmplitudePrior) else prior
    if not isinstance(base, HybridPrior):
        return replace(state, mean_amplitude=before.ended())
    rows = posterior.rows_times(mean_weights)
    whitened = posterior.factor.solve(posterior.n, rows[:, None])[:, 0]
    after = before.averaged(
        float(whitened @ whitened), float(whitened @ posterior.forward[:, 0]), posterior.n
    )
    changed = _under(posterior, AmplitudePrior(base, mean_weights, after), rows, before)
    return replace(state, posterior=changed, mean_amplitude=after)


def _under(
    posterior: ObservationSpacePosterior, prior: AmplitudePrior, rows: Array, before: MeanAmplitude
) -> Posterior:
    """Return a posterior under another Gaussian of the amplitude.

    Args:
        posterior: Under the Gaussian ``before``.
        prior: Has the other one.
        rows: shape (K,), H m.
        before: The Gaussian until now.
    """
    lower = posterior.factor.dense(posterior.n)
    innovation = lower @ posterior.forward
    innovation[:, 0] -= (prior.amplitude.shift - before.shift) * rows
    covariance = lower @ lower.T + (prior.amplitude.variance - before.variance) * np.outer(
        rows, rows
    )
    changed = np.linalg.cholesky(covariance)
    forward = solve_triangular(changed, innovation, lower=True, check_finite=False)
    return replace(
        posterior,
        prior=prior,
        factor=posterior.factor.refactored(posterior.n, np.asarray(changed), forward),
    )
