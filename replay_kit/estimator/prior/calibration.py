"""What members left out say of the prior: how much larger errors are than stated, and how near the current is to one of the members.

Members of one forecast system resemble each other: of a member left out alone the others still hold a neighbour, which a truth has not. So
for the errors a member is left out with all whose anomaly correlates with its own above a bound, some columns of it are measured, and the
errors of the rest are held against the stated ones. The 90 % quantile of the normalised square over that of a normal variable is the
factor. For the kernels about the members (``update/evidence.py``) a neighbour is what is asked after: it is left out alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior.factor import Parts, PriorSettings, process_of
from replay_kit.estimator.prior.fit import LEVEL_ERROR_STD, Members, predicted
from replay_kit.estimator.update.evidence import KERNELS

# Correlation of anomalies above which members are alike, and the largest share of all that one is left out with.
_ALIKE, _MOST_ALIKE = 0.7, 0.5
# Members left out in turn, and columns measured of each.
_LEFT_OUT, _COLUMNS = 6, (10, 50, 150)
# Nodes at which errors are held against the stated ones, at most.
_SCORED = 60
# Square of the normal variable's 90 % interval.
_NORMAL = 1.645**2
# For kernels: members left out, columns of each, and the word before them of some members, half of them like no other.
_OF_KERNELS, _FEW_COLUMNS = 24, 10
_BEFORE = 7.0 * np.array([0.5, *[0.5 / (KERNELS.size - 1)] * (KERNELS.size - 1)])
_STEPS = 50


@dataclass(frozen=True, slots=True, eq=False)
class MembersPrior:
    """The prior of an ensemble in few modes.

    Attributes:
        members: All of the ensemble.
        loading: shape (k, K, r), patterns of the unknowns.
        functions: shape (K, Z).
        parts: Which unknowns are what.
        error: shape (Z, N) [m/s], of what is dropped.
    """

    members: Members
    loading: Array
    functions: Array
    parts: Parts
    error: Array

    @staticmethod
    def of(members: Members, settings: PriorSettings, bound: float) -> "MembersPrior":
        """Return it of members in few modes; settings and bound as of ``process_of``."""
        modes = ShiftedModes.by(members.velocity_modes, members.nodes, settings.shift)
        process, parts, error = process_of(members.weights[None], modes, settings, None, 0.0, bound)
        return MembersPrior(members, process.loading(0), process.functions, parts, error)

    @property
    def noise(self) -> Array:
        """Error of what is measured of each function, shape (K,) [m/s]: one for all nodes, as that of what is dropped is much smaller."""
        dropped = np.sqrt(np.mean(self.functions**2 @ self.error**2, axis=1))
        return np.asarray(np.hypot(LEVEL_ERROR_STD, dropped))

    def without(self, gone: NDArray[np.intp], member: int) -> tuple[Array, Array, Array]:
        """Return the prior without some members, and one of these about the others' mean.

        Without the unknowns of those left out, and with the others' in proportion, the prior is that of the others: their mean differs by
        a combination of the same patterns.

        Returns:
            shape (F, K, r), patterns of the others and their copies; shape (B, K, r), local ones; shape (K, r), the member's anomaly.
        """
        weights, sample = self.members.weights, self.parts.sample
        n, kept = len(weights), np.setdiff1d(np.arange(len(weights)), gone)
        # the patterns of the members kept about their own mean, and of all copies of them
        whole = self.loading[sample].reshape(-1, n, *self.loading.shape[1:])[:, kept]
        whole = whole - whole.mean(axis=1, keepdims=True)
        of_kept = np.sqrt((n - 1.0) / (len(kept) - 1.0)) * whole.reshape(-1, *whole.shape[2:])
        anomaly = self.functions @ (weights[member] - weights[kept].mean(axis=0))
        return of_kept, self.loading[sample.stop :], anomaly


def alike(weights: Array, velocity_modes: Array) -> list[NDArray[np.intp]]:
    """Return for each member the positions of those like it, its own included.

    Args:
        weights: shape (E, Z, r).
        velocity_modes: shape (2N, r), at the nodes.
    """
    anomalies = weights - weights.mean(axis=0)
    gram = velocity_modes.T @ velocity_modes
    products = np.einsum("ezr,rs,fzs->ef", anomalies, gram, anomalies, optimize=True)
    size = np.sqrt(np.diag(products))
    correlation = products / np.outer(size, size)
    most = max(1, int(_MOST_ALIKE * len(weights)))
    out = []
    for i, row in enumerate(correlation):
        nearest = np.argsort(-row)[:most]
        out.append(np.union1d(nearest[row[nearest] > _ALIKE], [i]))
    return out


def calibration(prior: MembersPrior) -> float:
    """Return the factor on stated variances, at least 1; 1 with too few members to leave out any."""
    members, (some, modes) = prior.members, prior.members.some(_SCORED)
    stated = np.tile(prior.functions**2 @ prior.error[:, some] ** 2, 2)
    groups, quantiles = alike(members.weights, members.velocity_modes), []
    for i in members.left_out(_LEFT_OUT):
        if len(members.weights) - len(groups[i]) < 3:
            continue
        *patterns, anomaly = prior.without(groups[i], i)
        flat = np.concatenate(patterns).reshape(-1, anomaly.size)
        for count in _COLUMNS:
            rows = members.columns(count, i)
            error, variance, of_noise = predicted(anomaly, flat.T @ flat, rows, prior.noise, modes)
            quantiles.append(np.quantile((error**2 + of_noise) / (variance + stated), 0.9))
    return max(1.0, float(np.mean(quantiles)) / _NORMAL) if quantiles else 1.0


def fitted_kernels(prior: MembersPrior) -> Array:
    """Return the probabilities of the kernels about members, shape (H,), under which members left out are most likely.

    Forecasts that are alike put them on narrow kernels, fields of a climatology on the prior itself. By expectation and maximisation.
    """
    probability = np.asarray(_BEFORE / _BEFORE.sum())
    likelihoods = np.array([_of_kernels(prior, i) for i in prior.members.left_out(_OF_KERNELS)])
    for _ in range(_STEPS if len(likelihoods) else 0):
        logs = np.log(probability) + likelihoods
        of_member = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
        probability = (of_member.sum(axis=0) + _BEFORE) / (len(logs) + _BEFORE.sum())
    return probability


def _of_kernels(prior: MembersPrior, member: int) -> Array:
    """Return the logarithm of the likelihood of each kernel about the others for what is measured of a member, shape (H,)."""
    *patterns, anomaly = prior.without(np.array([member]), member)
    rows, others = prior.members.columns(_FEW_COLUMNS, member), len(prior.members.weights) - 1

    def seen(each: Array) -> Array:
        at = np.einsum("mr,kzr,z->mzk", rows, each, 1.0 / prior.noise, optimize=True)
        return np.asarray(at.reshape(len(rows) * len(prior.noise), len(each)))

    (sample, local), found = map(seen, patterns), []
    total = sample @ sample.T + local @ local.T + np.eye(len(sample))
    # of a member among the others
    own = prior.parts.anomaly * np.sqrt((others - 1.0) / others)
    for kernel in KERNELS:
        lower = np.linalg.cholesky(total - (1.0 - kernel) * (sample @ sample.T))
        off = seen(anomaly[None]) - np.sqrt(1.0 - kernel) * own * sample[:, :others]
        white = solve_triangular(lower, off, lower=True, check_finite=False)
        # the mean over the noise of the values, which the density has and they have not
        noise = np.square(solve_triangular(lower, np.eye(len(lower)), lower=True)).sum()
        logs = -0.5 * (np.square(white).sum(axis=0) + noise) - np.log(np.diag(lower)).sum()
        found.append(logsumexp(logs) - np.log(others))
    return np.array(found)
