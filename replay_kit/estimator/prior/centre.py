"""The centre of the prior after few profiles: moved by a kernel mixture over the members.

The current is near one of the members more than the Gaussian of all of them says: with x_i the members' anomalies, w0 the mean of the
weights, S and L the sample and the localised parts of their covariance s S + (1 - s) L,

    w ~ sum_h pi_h / E sum_i N(w0 + sqrt(1 - h) x_i, h s S + (1 - s) L),

of which h = 1 is the prior itself. Given the profiles, component h i has the weight W_hi in proportion to pi_h times the t-th power of its
likelihood, t = min(1, 6 / n) after n profiles, as the members are few and the profiles are many. The likelihood is averaged over the
variances of the ensemble mean's amplitude. The prior's centre moves by

    delta = sum_hi W_hi sqrt(1 - h) x_i,

its covariance stays: a moved centre may be kept when many profiles have come, a smaller covariance may not.

**The probabilities pi_h** are those under which members left out, of each of which ten columns are given, are most likely: expectation and
maximisation, begun with the word of seven members, half of them like no other. Of the columns' noise the expected squares are taken, so
that no draw decides. Forecasts that are alike put them on narrow kernels, fields
of a climatology on h = 1.
With f_i the member's own copies in the factor of S, and E members, the others have the covariance (E - 1) / (E - 2) (S - f_i f_i').
"""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.amplitude import VARIANCES, WEIGHTS, MeanAmplitude
from replay_kit.estimator.prior.fit import Members, evenly
from replay_kit.estimator.prior.hybrid import PriorSettings, hybrid_prior

#: Shares h of the sample covariance that a component keeps; 1 is the prior.
KERNELS = np.array([1.0, 0.9, 0.8, 0.6, 0.4, 0.25, 0.15])
# Number of profiles whose likelihood counts in full.
_FULL = 6.0
# Their weight before any member is left out [members]: half of it is on the prior, as a truth need not be like a member.
_BEFORE = 7.0 * np.array([0.5, *[0.5 / 6] * 6])
# Members left out at most, columns measured of each, and steps of expectation and maximisation.
_LEFT_OUT, _COLUMNS, _STEPS = 24, 10, 50


def member_shares(
    rows: tuple[Array, Array, Array],
    total: Array,
    innovation: Array,
    amplitude: MeanAmplitude,
    profiles: int,
) -> Array:
    """Return the share of each member's anomaly by which the centre moves, shape (E,).

    Args:
        rows: H of the members' anomalies, shape (K, E); of the factor of s S, shape (K, F); of the ensemble mean, shape (K,).
        total: shape (K, K), covariance of the innovations, the errors of rows of one included, without the mean's amplitude.
        innovation: shape (K,), about w0.
        amplitude: Has the kernels' probabilities; all are equal where it has none.
        profiles: Their number n.
    """
    probability = np.array(amplitude.kernels or (1.0,) * KERNELS.size)
    power = min(1.0, _FULL / profiles)
    likelihoods = _of_components(rows, total, innovation, np.zeros((len(total), 0)))
    log_weights = np.log(probability)[:, None] + power * likelihoods
    return np.asarray(np.sqrt(1.0 - KERNELS) @ np.exp(log_weights - logsumexp(log_weights)))


def fitted_kernels(members: Members, settings: PriorSettings) -> tuple[float, ...]:
    """Return the probabilities of the kernels, fitted to members left out; none with fewer than four.

    Args:
        members: All of the ensemble; the leading modes are used.
        settings: Of the prior.
    """
    few = members.leading()
    n_members = len(few.weights)
    if n_members < 4:
        return ()
    mean = few.weights.mean(axis=0)
    prior = hybrid_prior(few.weights, few.shifted(settings), settings)
    likelihoods = []
    for member in evenly(min(_LEFT_OUT, n_members), n_members):
        rows = few.columns(_COLUMNS, member)
        of_members, factor, of_mean = (
            (weights @ rows.T).reshape(len(weights), -1).T
            for weights in (few.weights - mean, prior.factor, mean[None])
        )
        kept = np.sqrt((n_members - 1.0) / (n_members - 2.0)) * np.delete(
            factor, np.s_[member::n_members], axis=1
        )
        localised = prior.matvec_modes(rows) @ rows.T
        total = localised.reshape(len(factor), -1) - factor @ factor.T + kept @ kept.T
        total[np.diag_indices_from(total)] += 1.0
        truth = of_members[:, member] * n_members / (n_members - 1.0)
        others = np.delete(of_members, member, axis=1) + truth[:, None] / n_members
        found = _of_components((others, kept, of_mean[:, 0]), total, truth, np.eye(len(total)))
        likelihoods.append(logsumexp(found, axis=1) - np.log(n_members - 1.0))
    probability = _BEFORE / _BEFORE.sum()
    for _ in range(_STEPS):
        log_joint = np.log(probability) + likelihoods
        of_member = np.exp(log_joint - logsumexp(log_joint, axis=1, keepdims=True))
        probability = (of_member.sum(axis=0) + _BEFORE) / (len(likelihoods) + _BEFORE.sum())
    return tuple(probability.tolist())


def _of_components(
    rows: tuple[Array, Array, Array], total: Array, innovation: Array, noise: Array
) -> Array:
    """Return the logarithm of the likelihood of each component, shape (7, E).

    Args:
        rows: As of ``member_shares``.
        total: The same.
        innovation: The same.
        noise: shape (K, n), a root of the covariance of noise that the innovation lacks; it adds the squares that are expected.
    """
    members, factor, mean = rows
    sample, found = factor @ factor.T, []
    together = np.column_stack([innovation, mean, members])
    for kernel in KERNELS:
        lower = np.linalg.cholesky(total - (1.0 - kernel) * sample)
        whitened, scatter = (
            solve_triangular(lower, each, lower=True, check_finite=False)
            for each in (together, noise)
        )
        off = whitened[:, :1] - np.sqrt(1.0 - kernel) * whitened[:, 2:]
        of_mean = whitened[:, 1]
        square = np.sum(off**2, axis=0) + np.sum(scatter**2)
        score = (of_mean @ off) ** 2 + np.sum((of_mean @ scatter) ** 2)
        likelihood = _log_likelihood(square, score, float(of_mean @ of_mean))
        found.append(likelihood - np.log(np.diag(lower)).sum())
    return np.array(found)


def _log_likelihood(square: Array, score: Array, information: float) -> Array:
    """Return the logarithm of the likelihood of innovations, shape (E,), averaged over variances of the mean's amplitude.

    Args:
        square: shape (E,), of the whitened innovations.
        score: shape (E,), the square of their product with the whitened mean.
        information: The whitened mean's square.
    """
    spread = VARIANCES / (1.0 + VARIANCES * information)
    averaged = logsumexp(
        0.5 * spread[:, None] * score - 0.5 * np.log1p(VARIANCES * information)[:, None],
        b=WEIGHTS[:, None],
        axis=0,
    )
    return np.asarray(averaged - 0.5 * square)
