"""How much larger the errors of members left out are than stated, where those like them are left out too.

Members of one forecast system resemble each other: of a member left out alone the others still hold a neighbour, which a truth has not. So
a member is left out with all whose anomaly correlates with its own above a bound, some columns of it are measured, and the errors of the
rest are held against the stated ones. The 90 % quantile of the normalised square over that of a normal variable is the factor.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.flow.process import Process
from replay_kit.estimator.prior.factor import Parts, process_of
from replay_kit.estimator.prior.fit import LEVEL_ERROR_STD, Members, evenly, withheld
from replay_kit.estimator.prior.hybrid import PriorSettings

# Correlation of anomalies above which members are alike, and the largest share of all that one is left out with.
_ALIKE, _MOST_ALIKE = 0.7, 0.5
# Members left out in turn, and columns measured of each.
_LEFT_OUT, _COLUMNS = 6, (10, 50, 150)
# Nodes at which errors are held against the stated ones, at most.
_SCORED = 60
# Square of the normal variable's 90 % interval.
_NORMAL = 1.645**2


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
    process, parts, error = process_of(
        members.weights[None], members.shifted(settings), settings, None, 0.0, bound
    )
    groups = alike(members.weights, members.velocity_modes)
    quantiles = [
        np.quantile(_normalised(members, process, parts, error, (i, groups[i])), 0.9, axis=1)
        for i in withheld(members, _LEFT_OUT)
        if n_members - len(groups[i]) >= 3
    ]
    return max(1.0, float(np.mean(quantiles)) / _NORMAL) if quantiles else 1.0


def _normalised(
    members: Members,
    process: Process,
    parts: Parts,
    error: Array,
    out: tuple[int, NDArray[np.intp]],
) -> Array:
    """Return the expected squares of errors over stated variances for a member left out with others, shape (counts, values).

    Without the unknowns of those left out, and with the others' in proportion, the prior is that of the others: their mean differs by a
    combination of the same patterns. The noise of what is measured is averaged over.
    """
    member, gone = out
    n, nodes = len(members.weights), np.arange(len(members.nodes))
    some = nodes[evenly(min(_SCORED, len(nodes)), len(nodes))]
    kept = np.setdiff1d(np.arange(n), gone)
    mean = members.weights[kept].mean(axis=0)
    loading, functions = process.loading(0), process.functions
    # the patterns of the members kept about their own mean, and of all copies of them
    whole = loading[parts.sample].reshape(-1, n, *loading.shape[1:])[:, kept]
    own = (whole - whole.mean(axis=1, keepdims=True)) * np.sqrt((n - 1.0) / (len(kept) - 1.0))
    loading = np.concatenate([own.reshape(-1, *loading.shape[1:]), loading[parts.sample.stop :]])
    truth = functions @ (members.weights[member] - mean)  # (K, r)
    v = members.velocity_modes.reshape(2, len(nodes), -1)[:, some]
    unit = np.einsum("kfr,cnr->ncfk", loading, v, optimize=True)
    stated = (functions**2 @ error[:, some] ** 2).T[:, None]
    actual, scores = np.einsum("fr,cnr->ncf", truth, v), []
    # one error for all: that of what the unknowns do not hold is much smaller
    noise = np.hypot(LEVEL_ERROR_STD, np.sqrt(np.mean(functions**2 @ error**2, axis=1)))
    for count in _COLUMNS:
        rows = LEVEL_ERROR_STD * members.columns(count, member)  # (2 n, r)
        design = np.einsum("kfr,mr->mfk", loading, rows) / noise[:, None]
        design = design.reshape(-1, len(loading))
        values = (rows @ truth.T / noise).ravel()
        lower = np.linalg.cholesky(design.T @ design + np.eye(len(loading)))
        # P = A'A with A the inverse of the factor, and x = P H' y has the variance P - P P of the noise
        root = solve_triangular(lower, np.eye(len(loading)), lower=True)
        x = root.T @ (root @ (design.T @ values))
        of_flow = np.square(unit @ root.T).sum(axis=3)
        of_noise = of_flow - np.square((unit @ root.T) @ root).sum(axis=3)
        scores.append((((unit @ x - actual) ** 2 + of_noise) / (of_flow + stated)).ravel())
    return np.array(scores)
