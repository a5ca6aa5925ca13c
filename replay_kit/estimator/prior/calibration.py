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
from scipy.linalg.blas import dtrsm
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
        process, parts, error = process_of(
            members.weights[None], members.shifted(settings), settings, None, 0.0, bound
        )
        return MembersPrior(members, process.loading(0), process.functions, parts, error)

    def without(self, gone: NDArray[np.intp], member: int) -> "_Others":
        """Return the prior without some members, of whom one is measured.

        Without the unknowns of those left out, and with the others' in proportion, the prior is that of the others: their mean differs by
        a combination of the same patterns.
        """
        weights, sample, shape = self.members.weights, self.parts.sample, self.loading.shape[1:]
        n, kept = len(weights), np.setdiff1d(np.arange(len(weights)), gone)
        anomaly = weights[member] - weights[kept].mean(axis=0)
        # the patterns of the members kept about their own mean, and of all copies of them
        whole = self.loading[sample].reshape(-1, n, *shape)[:, kept]
        more = np.sqrt((n - 1.0) / (len(kept) - 1.0))
        of_kept = more * (whole - whole.mean(axis=1, keepdims=True)).reshape(-1, *shape)
        return _Others(
            self,
            member,
            np.concatenate([of_kept, self.loading[sample.stop :]]),
            len(of_kept),
            self.functions @ anomaly,
            self.parts.anomaly / more,
            len(kept),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Others:
    """The prior of an ensemble without some of its members, and one of these.

    Attributes:
        whole: Of all members.
        member: Position of the one that is measured.
        loading: shape (k, K, r), patterns of the others' unknowns.
        sample: Number of unknowns of their sample, the first.
        anomaly: shape (K, r), of the member about the others' mean.
        own: Value of one of the others' unknown in its own anomaly.
        kept: Number of the others.
    """

    whole: MembersPrior
    member: int
    loading: Array
    sample: int
    anomaly: Array
    own: float
    kept: int

    def measured(self, count: int) -> tuple[Array, Array]:
        """Return the design, shape (m, k), and the values without noise, shape (m,), of columns of the member, over their error."""
        # one error for all: that of what the unknowns do not hold is much smaller
        of_dropped = np.sqrt(np.mean(self.whole.functions**2 @ self.whole.error**2, axis=1))
        noise = np.hypot(LEVEL_ERROR_STD, of_dropped)
        rows = LEVEL_ERROR_STD * self.whole.members.columns(count, self.member)  # (2 n, r)
        values = (rows @ self.anomaly.T / noise).ravel()
        return self.unit(rows).swapaxes(0, 1).reshape(-1, len(self.loading)) / np.tile(
            noise, len(rows)
        )[:, None], values

    def unit(self, modes: Array) -> Array:
        """Return the effect of one unit of each unknown on the functions' currents, shape (K, m, k), for modes of shape (m, r)."""
        flat = self.loading.swapaxes(0, 1).reshape(-1, self.loading.shape[2])
        return (modes @ flat.T).reshape(len(modes), -1, len(self.loading)).swapaxes(0, 1)


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
    members = prior.members
    n_members = len(members.weights)
    if n_members < 4:
        return 1.0
    groups = alike(members.weights, members.velocity_modes)
    quantiles = [
        np.quantile(_normalised(prior.without(groups[i], i)), 0.9, axis=1)
        for i in withheld(members, _LEFT_OUT)
        if n_members - len(groups[i]) >= 3
    ]
    return max(1.0, float(np.mean(quantiles)) / _NORMAL) if quantiles else 1.0


def _normalised(others: _Others) -> Array:
    """Return the expected squares of a member's errors over stated variances, shape (counts, values); the noise is averaged over."""
    whole, nodes = others.whole, np.arange(len(others.whole.members.nodes))
    some = nodes[evenly(min(_SCORED, len(nodes)), len(nodes))]
    modes = whole.members.velocity_modes[np.concatenate([some, some + len(nodes)])]
    unit = others.unit(modes).reshape(-1, len(others.loading))  # (K 2n, k)
    actual = (others.anomaly @ modes.T).ravel()
    stated = np.tile(whole.functions**2 @ whole.error[:, some] ** 2, 2).ravel()
    scores = []
    for count in _COLUMNS:
        mean, variance, of_noise = _after(unit, *others.measured(count))
        scores.append(((mean - actual) ** 2 + of_noise) / (variance + stated))
    return np.array(scores)


def _after(unit: Array, design: Array, values: Array) -> tuple[Array, Array, Array]:
    """Return mean and variance of sums of the unknowns after rows of unit noise, and the variance that the noise gives the mean.

    Of rows D, S = D D' + 1 = L L', and sums U the covariance U U' - W'W with W = L^-1 D U', and the noise's part of the mean W' L^-1; where
    rows are more than unknowns, the information D'D + 1 is the smaller matrix.

    Args:
        unit: shape (n, k), U.
        design: shape (m, k), D.
        values: shape (m,).
    """
    by_rows = len(design) < design.shape[1]
    small, right = (design, design @ unit.T) if by_rows else (design.T, unit.T)
    lower = np.asarray(np.linalg.cholesky(small @ small.T + np.eye(len(small))))
    both = np.column_stack([right, values if by_rows else design.T @ values])
    white = dtrsm(1.0, lower.T, both.T, side=1).T  # L^-1
    gain = dtrsm(1.0, lower.T, white[:, :-1].T, side=1, trans_a=1).T  # L'^-1 of it
    mean, held, solved = (
        white[:, :-1].T @ white[:, -1],
        *(np.square(each).sum(axis=0) for each in (white[:, :-1], gain)),
    )
    if by_rows:
        return mean, np.square(unit).sum(axis=1) - held, solved
    return mean, held, held - solved


def fitted_kernels(prior: MembersPrior) -> Array:
    """Return the probabilities of the kernels about members, shape (H,), under which members left out are most likely.

    Forecasts that are alike put them on narrow kernels, fields of a climatology on the prior itself. By expectation and maximisation.
    """
    probability = np.asarray(_BEFORE / _BEFORE.sum())
    members = prior.members
    if len(members.weights) < 4:
        return probability
    likelihoods = np.array(
        [_of_kernels(prior.without(np.array([i]), i)) for i in withheld(members, _OF_KERNELS)]
    )
    for _ in range(_STEPS):
        logs = np.log(probability) + likelihoods
        of_member = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
        probability = (of_member.sum(axis=0) + _BEFORE) / (len(logs) + _BEFORE.sum())
    return probability


def _of_kernels(others: _Others) -> Array:
    """Return the logarithm of the likelihood of each kernel about the others for what is measured of a member, shape (H,)."""
    design, values = others.measured(_FEW_COLUMNS)
    sample, found = design[:, : others.sample], []
    total = design @ design.T + np.eye(len(design))
    toward = others.own * sample[:, : others.kept]
    for kernel in KERNELS:
        lower = np.linalg.cholesky(total - (1.0 - kernel) * (sample @ sample.T))
        off = values[:, None] - np.sqrt(1.0 - kernel) * toward
        white = solve_triangular(lower, off, lower=True, check_finite=False)
        # the mean over the noise of the values, which the density has and they have not
        noise = np.square(solve_triangular(lower, np.eye(len(lower)), lower=True)).sum()
        logs = -0.5 * (np.square(white).sum(axis=0) + noise) - np.log(np.diag(lower)).sum()
        found.append(logsumexp(logs) - np.log(others.kept))
    return np.array(found)
