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
from replay_kit.estimator.prior.factor import Parts, process_of
from replay_kit.estimator.prior.fit import LEVEL_ERROR_STD, Members, evenly, withheld
from replay_kit.estimator.prior.hybrid import PriorSettings
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
_STEPS, _SEED = 50, 7


@dataclass(frozen=True, slots=True, eq=False)
class _Others:
    """The prior of an ensemble without some of its members, and one of these.

    Attributes:
        members: All of the ensemble, in few modes.
        member: Position of the one that is measured.
        loading: shape (k, K, r), patterns of the others' unknowns.
        sample: Number of unknowns of their sample, the first.
        anomaly: shape (K, r), of the member about the others' mean.
        own: Value of one of the others' unknown in its own anomaly.
        kept: Number of the others.
        functions: shape (K, Z).
        error: shape (Z, N) [m/s], of what is dropped.
    """

    members: Members
    member: int
    loading: Array
    sample: int
    anomaly: Array
    own: float
    kept: int
    functions: Array
    error: Array

    def measured(self, count: int) -> tuple[Array, Array]:
        """Return the design, shape (m, k), and the values without noise, shape (m,), of columns of the member, over their error."""
        # one error for all: that of what the unknowns do not hold is much smaller
        of_dropped = np.sqrt(np.mean(self.functions**2 @ self.error**2, axis=1))
        noise = np.hypot(LEVEL_ERROR_STD, of_dropped)
        rows = LEVEL_ERROR_STD * self.members.columns(count, self.member)  # (2 n, r)
        design = np.einsum("kfr,mr->mfk", self.loading, rows) / noise[:, None]
        return design.reshape(-1, len(self.loading)), (rows @ self.anomaly.T / noise).ravel()


def _others(
    members: Members, prior: tuple[Array, Array, Parts, Array], member: int, gone: NDArray[np.intp]
) -> _Others:
    """Return the prior without some members, ``gone``, of whom one is measured.

    Without the unknowns of those left out, and with the others' in proportion, the prior is that of the others: their mean differs by a
    combination of the same patterns.
    """
    loading, functions, parts, error = prior
    n, kept = len(members.weights), np.setdiff1d(np.arange(len(members.weights)), gone)
    anomaly = members.weights[member] - members.weights[kept].mean(axis=0)
    # the patterns of the members kept about their own mean, and of all copies of them
    whole = loading[parts.sample].reshape(-1, n, *loading.shape[1:])[:, kept]
    more = np.sqrt((n - 1.0) / (len(kept) - 1.0))
    sample = more * (whole - whole.mean(axis=1, keepdims=True)).reshape(-1, *loading.shape[1:])
    both = np.concatenate([sample, loading[parts.sample.stop :]])
    own = parts.anomaly / more
    return _Others(
        members, member, both, len(sample), functions @ anomaly, own, len(kept), functions, error
    )


def _prior(
    members: Members, settings: PriorSettings, bound: float
) -> tuple[Array, Array, Parts, Array]:
    """Return the loading of all members' unknowns, the vertical functions, the parts, and the error of what is dropped."""
    process, parts, error = process_of(
        members.weights[None], members.shifted(settings), settings, None, 0.0, bound
    )
    return process.loading(0), process.functions, parts, error


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


def calibration(members: Members, settings: PriorSettings, bound: float) -> float:
    """Return the factor on stated variances, at least 1; 1 with too few members to leave out any.

    Args:
        members: All of the ensemble, in few modes.
        settings: Of the prior.
        bound: As of ``process_of`` [m/s].
    """
    n_members = len(members.weights)
    if n_members < 4:
        return 1.0
    prior, groups = _prior(members, settings, bound), alike(members.weights, members.velocity_modes)
    quantiles = [
        np.quantile(_normalised(_others(members, prior, i, groups[i])), 0.9, axis=1)
        for i in withheld(members, _LEFT_OUT)
        if n_members - len(groups[i]) >= 3
    ]
    return max(1.0, float(np.mean(quantiles)) / _NORMAL) if quantiles else 1.0


def _normalised(others: _Others) -> Array:
    """Return the expected squares of a member's errors over stated variances, shape (counts, values); the noise is averaged over."""
    nodes = np.arange(len(others.members.nodes))
    some = nodes[evenly(min(_SCORED, len(nodes)), len(nodes))]
    v = others.members.velocity_modes.reshape(2, len(nodes), -1)[:, some]
    unit = np.einsum("kfr,cnr->ncfk", others.loading, v, optimize=True)
    stated = (others.functions**2 @ others.error[:, some] ** 2).T[:, None]
    actual, scores = np.einsum("fr,cnr->ncf", others.anomaly, v), []
    for count in _COLUMNS:
        design, values = others.measured(count)
        eye = np.eye(design.shape[1])
        lower = np.linalg.cholesky(design.T @ design + eye)
        # P = A'A with A the inverse of the factor, and x = P H' y has the variance P - P P of the noise
        root = solve_triangular(lower, eye, lower=True)
        x = root.T @ (root @ (design.T @ values))
        of_flow = np.square(unit @ root.T).sum(axis=3)
        of_noise = of_flow - np.square((unit @ root.T) @ root).sum(axis=3)
        scores.append((((unit @ x - actual) ** 2 + of_noise) / (of_flow + stated)).ravel())
    return np.array(scores)


def fitted_kernels(members: Members, settings: PriorSettings, bound: float) -> Array:
    """Return the probabilities of the kernels about members, shape (H,), under which members left out are most likely.

    Forecasts that are alike put them on narrow kernels, fields of a climatology on the prior itself. By expectation and maximisation.

    Args:
        members: All of the ensemble, in few modes.
        settings: Of the prior.
        bound: As of ``process_of`` [m/s].
    """
    probability = np.asarray(_BEFORE / _BEFORE.sum())
    if len(members.weights) < 4:
        return probability
    prior = _prior(members, settings, bound)
    likelihoods = np.array(
        [
            _of_kernels(_others(members, prior, i, np.array([i])))
            for i in withheld(members, _OF_KERNELS)
        ]
    )
    for _ in range(_STEPS):
        logs = np.log(probability) + likelihoods
        of_member = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
        probability = (of_member.sum(axis=0) + _BEFORE) / (len(logs) + _BEFORE.sum())
    return probability


def _of_kernels(others: _Others) -> Array:
    """Return the logarithm of the likelihood of each kernel about the others for what is measured of a member, shape (H,)."""
    design, values = others.measured(_FEW_COLUMNS)
    values = values + np.random.default_rng([_SEED, others.member]).standard_normal(len(values))
    sample, found = design[:, : others.sample], []
    total = design @ design.T + np.eye(len(design))
    toward = others.own * sample[:, : others.kept]
    for kernel in KERNELS:
        lower = np.linalg.cholesky(total - (1.0 - kernel) * (sample @ sample.T))
        off = values[:, None] - np.sqrt(1.0 - kernel) * toward
        white = solve_triangular(lower, off, lower=True, check_finite=False)
        logs = -0.5 * np.square(white).sum(axis=0) - np.log(np.diag(lower)).sum()
        found.append(logsumexp(logs) - np.log(others.kept))
    return np.array(found)
