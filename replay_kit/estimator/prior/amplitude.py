"""The amplitude of a prior's covariance, fitted to innovations.

Where members were not made as an ensemble (lagged forecasts, fields of other times, several models), how much they differ says little of
how much they err. With rows y = H w + noise of unit variance, the prior covariance P times an amplitude a, and d = y - H m, the innovations
have the covariance a H P H' + 1. With the eigenvalues s of H P H' and the components c of d along its eigenvectors, minus twice the
logarithm of the likelihood is, up to a constant,

    sum log(a s + 1) + c^2 / (a s + 1)

(Dee 1995, Mon. Wea. Rev. 123, 1128-1145, for one parameter). A mean of c^2 / s alone would weigh directions in which the prior has hardly
any variance as much as the others. The first profiles of a log have few independent directions: a normal prior of log a, centred on what is
expected, with a standard deviation of log 2, adds (log(a / expected) / log 2)^2 (maximum a posteriori).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import HybridCovariance, Reduction, symmetric
from replay_kit.estimator.prior.hybrid import HybridPrior, Prior, PriorSettings
from replay_kit.estimator.prior.mean_amplitude import AmplitudePrior

#: Least and largest amplitude that a fit gives.
AMPLITUDES = (0.05, 20.0)
_STEPS = 61
# Of the logarithm of an amplitude, about the one expected.
_EXPECTED_STD = np.log(2.0)


def fit_amplitude(innovation: Array, prior_cov: Array, expected: float | None = None) -> float:
    """Return the factor on the prior's part of the innovation covariance that is most probable, within ``AMPLITUDES``.

    Args:
        innovation: shape (m,), measured minus predicted by the prior, in units of the measurement's error.
        prior_cov: shape (m, m), the prior's part of its covariance, in the same units.
        expected: The amplitude expected before; None for maximum likelihood.
    """
    values, vectors = np.linalg.eigh(prior_cov)
    variance, square = np.maximum(values, 0.0), np.square(vectors.T @ innovation)

    def deviance(log_amplitude: float) -> float:
        total = np.exp(log_amplitude) * variance + 1.0
        doubt = 0.0 if expected is None else (log_amplitude - np.log(expected)) / _EXPECTED_STD
        return float(np.sum(np.log(total) + square / total) + doubt**2)

    # the likelihood may have several maxima; the bracket about the best of a grid has the highest
    grid = np.log(np.geomspace(AMPLITUDES[0], AMPLITUDES[1], _STEPS))
    best = int(np.argmin([deviance(point) for point in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, _STEPS - 1)]
    found = minimize_scalar(deviance, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(np.exp(found.x))


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPrior:
    """A prior whose covariance is multiplied by an amplitude.

    Attributes:
        unscaled: The prior.
        amplitude: Factor on its covariance.
    """

    unscaled: Prior
    amplitude: float

    @property
    def settings(self) -> PriorSettings | None:
        """The settings of the unscaled prior."""
        return self.unscaled.settings

    @property
    def mean(self) -> Array:
        """Mean, shape (Z r,)."""
        return self.unscaled.mean

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        return self.amplitude * self.unscaled.matvec(weights)

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        return self.amplitude * self.unscaled.matvec_modes(basis, levels)

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        return np.asarray(np.sqrt(self.amplitude) * self.unscaled.mode_std())

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        return self.amplitude * self.unscaled.covariance(levels)

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        return self.amplitude * self.unscaled.of_sum(levels)

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        unscaled = self.unscaled.reduction(directions, matrix)
        return lambda levels: self.amplitude**2 * unscaled(levels)


def scaled_prior(prior: Prior, spread: str | float | None) -> Prior:
    """Return a prior with the factor on its covariance that is configured; as it is where that is no number."""
    return ScaledPrior(prior, spread) if isinstance(spread, float) else prior


def hybrid_parts(prior: Prior) -> HybridCovariance | None:
    """Return the parts of a hybrid prior's covariance, an amplitude included; None of another prior."""
    if isinstance(prior, ScaledPrior):
        parts = hybrid_parts(prior.unscaled)
        if parts is None:
            return None
        return HybridCovariance(
            np.sqrt(prior.amplitude) * parts.factor,
            parts.vertical,
            prior.amplitude * parts.horizontal,
        )
    if isinstance(prior, AmplitudePrior):
        return hybrid_parts(prior.whole)
    if not isinstance(prior, HybridPrior):
        return None
    n_modes = prior.factor.shape[2]
    horizontal = np.array([symmetric(each) for each in prior.horizontal]).reshape(
        -1, n_modes, n_modes
    )
    return HybridCovariance(prior.factor, prior.vertical, horizontal)
