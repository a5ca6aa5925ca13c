"""Calibration of the prior on members left out: a factor on stated variances, and kernels about members.

Members of one forecast system resemble each other: a member left out alone has a neighbour among the others, unlike a truth. So it is
left out with all whose anomalies correlate above a bound. Some columns of it are observed, and the errors elsewhere are
compared with the stated ones. The factor is the 90 % quantile of the normalised square over that of a normal variable. The kernels
about members (``update/evidence.py``) seek such neighbours: for them a member is left out alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior.factor import Parts, PriorSettings, process_of
from replay_kit.estimator.prior.fit import LEVEL_ERROR_STD, Members, predicted_errors
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
    """Prior of an ensemble in few modes.

    Attributes:
        members: All members of the ensemble.
        loading: Patterns of the unknowns, shape (k, K, r).
        functions: Vertical functions, shape (K, Z).
        parts: Kinds of the unknowns.
        error: Standard deviation of the dropped patterns, shape (Z, N) [m/s].
    """

    members: Members
    loading: Array
    functions: Array
    parts: Parts
    error: Array

    @staticmethod
    def of(members: Members, settings: PriorSettings, bound: float) -> "MembersPrior":
        """Return the prior of members in few modes; for settings and bound see ``process_of``."""
        modes = ShiftedModes.by(members.velocity_modes, members.nodes, settings.shift)
        process, parts, error = process_of(members.weights[None], modes, settings, None, 0.0, bound)
        return MembersPrior(members, process.loading(0), process.functions, parts, error)

    @property
    def noise(self) -> Array:
        """Observation error of each vertical function, shape (K,) [m/s]: equal at all nodes, as dropped patterns are much weaker."""
        dropped = np.sqrt(np.mean(self.functions**2 @ self.error**2, axis=1))
        return np.asarray(np.hypot(LEVEL_ERROR_STD, dropped))

    def without(self, gone: NDArray[np.intp], member: int) -> tuple[Array, Array, Array]:
        """Return the prior without some members, and the anomaly of one of them about the others' mean.

        Removing their unknowns and rescaling the rest gives the prior of the other members: its mean differs by a combination of
        the same patterns.

        Returns:
            Patterns of the others and their copies, shape (F, K, r); local patterns, shape (B, K, r); the anomaly, shape (K, r).
        """
        weights, sample = self.members.weights, self.parts.sample
        n, kept = len(weights), np.setdiff1d(np.arange(len(weights)), gone)
        # the patterns of the members kept about their own mean, and of all copies of them
        whole = self.loading[sample].reshape(-1, n, *self.loading.shape[1:])[:, kept]
        whole = whole - whole.mean(axis=1, keepdims=True)
        of_kept = np.sqrt((n - 1.0) / (len(kept) - 1.0)) * whole.reshape(-1, *whole.shape[2:])
        anomaly = self.functions @ (weights[member] - weights[kept].mean(axis=0))
        return of_kept, self.loading[sample.stop :], anomaly


def alike_members(weights: Array, velocity_modes: Array) -> list[NDArray[np.intp]]:
    """Return the positions of the members that resemble each member, its own included.

    Args:
        weights: Weights of the members, shape (E, Z, r).
        velocity_modes: Modes at the nodes, shape (2N, r).
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
    """Return the factor on stated variances, at least 1; 1 if there are too few members to leave one out."""
    members, (some, modes) = prior.members, prior.members.some(_SCORED)
    stated = np.tile(prior.functions**2 @ prior.error[:, some] ** 2, 2)
    groups, quantiles = alike_members(members.weights, members.velocity_modes), []
    for i in members.left_out(_LEFT_OUT):
        if len(members.weights) - len(groups[i]) < 3:
            continue
        *patterns, anomaly = prior.without(groups[i], i)
        flat = np.concatenate(patterns).reshape(-1, anomaly.size)
        for count in _COLUMNS:
            rows = members.columns(count, i)
            error, variance, of_noise = predicted_errors(
                anomaly, flat.T @ flat, rows, prior.noise, modes
            )
            quantiles.append(np.quantile((error**2 + of_noise) / (variance + stated), 0.9))
    return max(1.0, float(np.mean(quantiles)) / _NORMAL) if quantiles else 1.0


def fitted_kernels(prior: MembersPrior) -> Array:
    """Return the maximum-likelihood probabilities of the kernels about members, shape (H,), for members left out.

    Similar forecasts favour narrow kernels, fields of a climatology the prior itself. Method: expectation-maximisation.
    """
    probability = np.asarray(_BEFORE / _BEFORE.sum())
    likelihoods = np.array(
        [_kernel_likelihoods(prior, i) for i in prior.members.left_out(_OF_KERNELS)]
    )
    for _ in range(_STEPS if len(likelihoods) else 0):
        logs = np.log(probability) + likelihoods
        of_member = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
        probability = (of_member.sum(axis=0) + _BEFORE) / (len(logs) + _BEFORE.sum())
    return probability


def _kernel_likelihoods(prior: MembersPrior, member: int) -> Array:
    """Return the log likelihood of each kernel about the other members, shape (H,), given observations of one."""
    *patterns, anomaly = prior.without(np.array([member]), member)
    rows, others = prior.members.columns(_FEW_COLUMNS, member), len(prior.members.weights) - 1

    def seen(each: Array) -> Array:
        at = np.einsum("mr,kzr,z->mzk", rows, each, 1.0 / prior.noise, optimize=True)
        return np.asarray(at.reshape(len(rows) * len(prior.noise), len(each)))

    (sample, local), found = map(seen, patterns), []
    total = sample @ sample.T + local @ local.T + np.eye(len(sample))
    # of a member among the others
    anomaly_of_others = prior.parts.anomaly * np.sqrt((others - 1.0) / others)
    for kernel in KERNELS:
        lower = np.linalg.cholesky(total - (1.0 - kernel) * (sample @ sample.T))
        off = seen(anomaly[None]) - np.sqrt(1.0 - kernel) * anomaly_of_others * sample[:, :others]
        white = solve_triangular(lower, off, lower=True, check_finite=False)
        # the mean over the noise of the values, which the density has and they have not
        noise = np.square(solve_triangular(lower, np.eye(len(lower)), lower=True)).sum()
        logs = -0.5 * (np.square(white).sum(axis=0) + noise) - np.log(np.diag(lower)).sum()
        found.append(logsumexp(logs) - np.log(others))
    return np.array(found)
