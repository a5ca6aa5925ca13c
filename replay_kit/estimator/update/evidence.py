"""Changes of the prior of some unknowns after assimilation, and their evidence, without the rows.

With x and P the posterior under the prior N(0, 1), the posterior under another prior of some unknowns, part i, is

    variance 1 / (1 + q):    K = P_.i (diag(1 / q) + P_ii)^-1,    x - K x_i,    P - K P_i. mean m:                  x + P_.i m,    P
    marginal N(mu, v) of one unknown a:    K = P_.a / P_aa,    x + K (mu - x_a),    P + K K' (v - P_aa)

and the evidence of N(m, h) against N(0, 1), in the eigenvectors of P_ii, of eigenvalues p, with q = 1 / h - 1, is the logarithm

    sum [(-q x^2 + 2 x m / h + p m^2 / h^2) / (2 (1 + q p)) - m^2 / (2 h)] - sum log(1 + q p) / 2 - n / 2 log h.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dormqr, dptsv, dsytrd
from scipy.special import logsumexp

from replay_kit.core.arrays import Array

# Variances of the ensemble mean's amplitude, and their probabilities; before the log its variance is the prior's own.
AMPLITUDE_VARIANCES = np.array([0.0, 0.03, 0.1, 0.3])
_AMPLITUDE_WEIGHTS = np.array([0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3])
#: Shares of the sample covariance that kernels about the members keep; 1 is the prior itself.
KERNELS = np.array([1.0, 0.4, 0.15])
# Profiles whose likelihood of the kernels counts in full, and number from which on the centre stays.
_FULL, CENTRED = 6.0, 28
#: Numbers of profiles after which the scale of the prior is looked at.
SCALED = (8, 16, 32, 64, 128)
# Standard deviation of the logarithms of the scale and of the errors' factor before the log, and what is tried of both.
_DOUBT, _SCALES = np.log(2.0), np.geomspace(0.05, 20.0, 61)
_RATIO, _STEP = float(_SCALES[1] / _SCALES[0]), 4
_NOISES = _RATIO ** (_STEP * np.arange(8))
# Columns that the reduction to a tridiagonal matrix takes together.
_BLOCK = 64


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """Posterior of some unknowns in the eigenvectors of its covariance.

    Attributes:
        values: shape (n,), eigenvalues p.
        vectors: shape (n, n), eigenvectors.
        x: shape (n,), mean.
    """

    values: Array
    vectors: Array
    x: Array

    @staticmethod
    def of(x: Array, p: Array) -> "Marginal":
        """Return the marginal of a mean, shape (n,), and a covariance, shape (n, n)."""
        values, vectors = np.linalg.eigh(p)
        return Marginal(np.maximum(values, 1e-12), vectors, vectors.T @ x)

    def evidence(self, variance: Array, means: Array) -> Array:
        """Return the evidence of other priors, shape (v, m); see the module.

        Args:
            variance: shape (v,), variances h.
            means: shape (m, n), means m.
        """
        q, m = (1.0 / variance - 1.0)[:, None, None], means @ self.vectors
        h, x, p = variance[:, None, None], self.x, self.values
        top = (-q * x**2 + 2.0 * x * m / h + p * m**2 / h**2) / (2.0 * (1.0 + q * p)) - m**2 / (
            2 * h
        )
        fixed = 0.5 * np.log1p(q * p).sum(axis=2) + 0.5 * len(x) * np.log(variance)[:, None]
        return np.asarray(top.sum(axis=2) - fixed)


def scale_changes(x: Array, p: Array, scales: Array) -> tuple[Array, Array, float]:
    """Return the changes of the misfit y'S^-1 y and of log |S| for other variances of some unknowns, and the explained misfit.

    With q = 1 / variance - 1 they are q x' (1 + q P)^-1 x and log |1 + q P| - n log (1 + q), shape (v,), from a tridiagonal form of P; the
    explained misfit is x' P^-1 x, by which that under the variance 1 is less than y'y.

    Args:
        x: shape (n,), mean under the variance 1.
        p: shape (n, n), lower triangle of the covariance.
        scales: shape (v,), variances.
    """
    reflections, diagonal, beside, factors, _ = dsytrd(p, lower=1, lwork=_BLOCK * len(x))
    turned = x.copy()
    if len(x) > 1:
        below = reflections[1:, :-1]
        turned[1:] = dormqr("L", "T", below, factors, x[1:, None], lwork=_BLOCK)[0][:, 0]
    misfit, determinant = [], []
    for scale in scales.tolist():
        q = 1.0 / scale - 1.0
        pivots, _, solved, _ = dptsv(1.0 + q * diagonal, q * beside, turned)
        misfit.append(q * float(turned @ solved))
        determinant.append(float(np.log(pivots).sum()) + len(x) * np.log(scale))
    explained = float(turned @ dptsv(diagonal, beside, turned)[2])
    return np.array(misfit), np.array(determinant), explained


def fitted_scale(x: Array, p: Array, expected: float, rows: int, square: float) -> float:
    """Return the most probable scale of the prior covariance, under a log-normal prior about an expected one.

    It is estimated with a factor f on the error variance: errors larger than stated, as if correlated along a profile, otherwise look like
    a narrow prior. For m rows S(a, f) = f S(a / f, 1), and the evidence is

        -(y'S(a / f, 1)^-1 y / f + log |S(a / f, 1)| + m log f) / 2.

    Args:
        x: See ``scale_changes``.
        p: See ``scale_changes``.
        expected: Expected scale.
        rows: Number of rows of unit errors m.
        square: Sum of squares of their values, y'y.
    """
    more = _STEP * np.arange(_NOISES.size)
    ratios = _SCALES[0] * _RATIO ** np.arange(-more[-1], _SCALES.size)
    misfit, determinant, explained = scale_changes(x, p, ratios)
    at = np.arange(_SCALES.size)[:, None] + more[-1] - more
    of_values = (square - explained + misfit[at]) / _NOISES
    doubt = (np.log(_SCALES / expected) / _DOUBT)[:, None] ** 2 + (np.log(_NOISES) / _DOUBT) ** 2
    both = -0.5 * (of_values + determinant[at] + rows * np.log(_NOISES) + doubt)
    found = both.max(axis=1)
    best = int(np.argmax(found))
    if not 0 < best < _SCALES.size - 1:
        return float(_SCALES[best])
    near = slice(best - 1, best + 2)
    curve = np.polyfit(np.log(_SCALES[near]), found[near], 2)
    return float(np.exp(-curve[1] / (2.0 * curve[0])))


def member_centre(
    marginal: Marginal, anomaly: float, members: int, profiles: int, probability: Array
) -> Array:
    """Return the prior mean of the sample's unknowns under kernels about the members, shape (n,).

    The current is nearer to one of the members than under the Gaussian of all: with x_i the unknowns of member i's anomaly, a kernel of
    variance h has the mean sqrt(1 - h) x_i. Each is weighted by its evidence to the power min(1, 6 / n) after n profiles, as members are
    few and profiles many.

    Args:
        marginal: Marginal of the sample's unknowns.
        anomaly: Value of a member's own unknown in its anomaly, where all others are 0.
        members: Number of members E, which have the first unknowns.
        profiles: Number n of assimilated profiles.
        probability: shape (H,), probabilities of the kernels.
    """
    unit = np.zeros((members, len(marginal.x)))
    unit[np.arange(members), np.arange(members)] = anomaly
    toward, power = np.sqrt(1.0 - KERNELS), min(1.0, _FULL / profiles)
    logs = np.concatenate(
        [
            marginal.evidence(np.array([h]), near * unit)
            for h, near in zip(KERNELS, toward, strict=True)
        ]
    )
    logs = power * logs + np.log(probability)[:, None]
    weights = np.exp(logs - logsumexp(logs))
    return np.asarray(toward @ weights @ unit)


def amplitude_mixture(mean: float, variance: float, prior_variance: float) -> tuple[float, float]:
    """Return mean and variance of the deviation of the ensemble mean's amplitude, averaged over its prior variances.

    Args:
        mean: Posterior mean of the deviation under ``prior_variance``.
        variance: Its posterior variance.
        prior_variance: Prior variance of the deviation for both.
    """
    information = max(1.0 / variance - 1.0 / prior_variance, 1e-9)
    score = mean / variance
    left = AMPLITUDE_VARIANCES / (1.0 + AMPLITUDE_VARIANCES * information)
    logs = -0.5 * np.log1p(AMPLITUDE_VARIANCES * information) + 0.5 * left * score**2
    logs = logs + np.log(_AMPLITUDE_WEIGHTS)
    weights = np.exp(logs - logsumexp(logs))
    middle = float(weights @ (left * score))
    spread = float(weights @ (left + (left * score - middle) ** 2))
    return middle, min(spread, float(left[-1]))


def with_variance(
    x: Array, p: Array, part: slice, before: float, after: float
) -> tuple[Array, Array]:
    """Return mean and covariance after a change of the prior variance of some unknowns from ``before`` to ``after``."""
    if before == after:
        return x, p
    cross = p[part]
    solved = np.linalg.solve(
        np.eye(len(cross)) / (1.0 / after - 1.0 / before) + cross[:, part], cross
    ).T
    changed = p - solved @ cross
    return x - solved @ x[part], 0.5 * (changed + changed.T)


def with_mean(x: Array, p: Array, part: slice, mean: Array) -> Array:
    """Return the mean after a change of the prior mean of some unknowns."""
    return np.asarray(x + p[:, part] @ mean)


def with_marginal(x: Array, p: Array, at: int, mean: float, variance: float) -> tuple[Array, Array]:
    """Return mean and covariance with another marginal of one unknown, as from a mixture over its prior."""
    gain = p[:, at] / p[at, at]
    return x + gain * (mean - x[at]), p + np.outer(gain, gain) * (variance - p[at, at])
