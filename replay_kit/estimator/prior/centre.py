"""The centre of the prior after few profiles: moved by a kernel mixture over the members.

The current is near one of the members more than the Gaussian of all of them says: with x_i the members' anomalies, w0 the mean of the
weights, S and L the sample and the localised parts of their covariance s S + (1 - s) L,

    w ~ sum_h pi_h / E sum_i N(w0 + sqrt(1 - h) x_i, h s S + (1 - s) L),

of which h = 1 is the prior itself. Given the profiles, component h i has the weight W_hi in proportion to pi_h times the t-th power of its
likelihood, t = min(1, 10 / n) after n profiles, as the members are few and the profiles are many. The likelihood is averaged over the
variances of the ensemble mean's amplitude. The prior's centre moves by

    delta = sum_hi W_hi sqrt(1 - h) x_i,

its covariance stays: a moved centre may be kept when many profiles have come, a smaller covariance may not.
"""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from replay_kit.core.arrays import Array

#: Shares of the sample covariance that a component keeps; 1 is the prior.
KERNELS = np.array([1.0, 0.9, 0.8, 0.6, 0.4, 0.25, 0.15])
# Their probabilities: half of it is on the prior, as members that are like the truth are not to be expected.
_SHARES = np.array([0.5, *[0.5 / 6] * 6])
# Number of profiles whose likelihood counts in full.
_FULL = 10.0


def member_shares(
    rows: tuple[Array, Array, Array],
    total: Array,
    innovation: Array,
    variances: tuple[Array, Array],
    profiles: int,
) -> Array:
    """Return the share of each member's anomaly by which the centre moves, shape (E,).

    Args:
        rows: H of the members' anomalies, shape (K, E); of the factor of s S, shape (K, F); of the ensemble mean, shape (K,).
        total: shape (K, K), covariance of the innovations, the errors of rows of one included, without the mean's amplitude.
        innovation: shape (K,), about w0.
        variances: Of the ensemble mean's amplitude, and their probabilities, shape (k,) each.
        profiles: Their number n.
    """
    members, factor, mean = rows
    sample = factor @ factor.T
    log_weights = np.empty((KERNELS.size, members.shape[1]))
    for k, kernel in enumerate(KERNELS):
        lower = np.linalg.cholesky(total - (1.0 - kernel) * sample)
        together = np.column_stack([innovation, mean, members])
        whitened = solve_triangular(lower, together, lower=True, check_finite=False)
        off = whitened[:, :1] - np.sqrt(1.0 - kernel) * whitened[:, 2:]
        log_weights[k] = np.log(_SHARES[k]) + min(1.0, _FULL / profiles) * _log_likelihood(
            off, whitened[:, 1], np.log(np.diag(lower)).sum(), variances
        )
    shares = np.exp(log_weights - logsumexp(log_weights))
    return np.asarray(np.sqrt(1.0 - KERNELS) @ shares)


def _log_likelihood(
    off: Array, mean: Array, half_log_determinant: float, variances: tuple[Array, Array]
) -> Array:
    """Return the logarithm of the likelihood of whitened innovations, shape (K, E), averaged over variances of the mean's amplitude."""
    variance, probability = variances
    information, score = float(mean @ mean), mean @ off
    spread = variance / (1.0 + variance * information)
    averaged = logsumexp(
        0.5 * spread[:, None] * score**2 - 0.5 * np.log1p(variance * information)[:, None],
        b=probability[:, None],
        axis=0,
    )
    return np.asarray(averaged - 0.5 * np.sum(off**2, axis=0) - half_log_determinant)
