"""Settings of the prior, fitted by cross-validation over ensemble members, never on a truth or the log.

A member is left out, a few columns of it are observed with noise, and the prior of the others predicts the rest of it.
The best settings have the least mean continuous ranked probability score, which measures error and stated uncertainty together.

With R'R the precision of the observed weights of a level, H = N^-1 (x) R with N the error of each level, and P - W'W the posterior
covariance, W = L^-1 H P, L L' = I + H P H'. With 50 modes, 8 functions of depth and 1,200 nodes, six members and six shares take about a
second for any region. So the default is fitted whenever it is built. Shifts of one correlation length were best on most ensembles, of half
of it on others: the default tries the second with the best share of the first. Longer shifts are sometimes chosen on members but err more
on truths, and radii from 4.5 to 9 hardly differ: the default fits neither.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg.blas import dtrsm

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation.evidence import crps_gaussian
from replay_kit.core.words.progress import each_call, step_counter
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior.factor import PriorSettings, local_directions
from replay_kit.estimator.prior.localised import tiles, vertical_functions

# Candidates for the sample covariance's share.
SHARES = (0.3, 0.45, 0.6, 0.75, 0.85, 0.93)
# Of the paper's 22 bins of 9 cm/s some three meet in a level.
LEVEL_ERROR_STD = 0.05
# Sparse, medium and dense logs have equal weight.
_COLUMNS = (5, 25, 150)
# The share hardly depends on the modes and functions of depth of little energy, and the cost goes with the cube of their number.
_MODES, _DEPTH_FUNCTIONS = 50, 8
# Nodes of the localised part, and of the score at most.
_NODES, _SCORED = 1200, 300
_LEFT_OUT = 6
# Share of the distance between two columns by which those of the next member are moved.
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
# In correlation lengths, the other shift that the default tries, and by how much its score must be less, as six members err by it.
_NEARER, _GAIN = 0.5, 0.02
# Where the taper reaches zero; the score hardly changes between 4.5 and 9.
RADIUS_IN_LENGTHS = 6.5
# Of ensembles of fewer than four members, of which none can be spared.
_SHARE_OF_FEW = 2 / 3


@dataclass(frozen=True, slots=True, eq=False)
class Members:
    """Ensemble members in few modes of their basis.

    Attributes:
        weights: Weights of the members, shape (E, Z, r).
        velocity_modes: Modes at the nodes, shape (2N, r) [m/s per unit weight].
        nodes: Positions of the nodes, shape (N, 2) [m].
    """

    weights: Array
    velocity_modes: Array
    nodes: Array

    @staticmethod
    def leading(weights: Array, velocity_modes: Array, nodes: Array) -> "Members":
        """Return the members in the leading modes and vertical functions, at an even subset of nodes.

        The functions are orthonormal, so white noise of every level is white noise of every function. Order, rotation and reflection of
        the input have no effect. Members are sorted by distance from their mean, nodes by tiles of their own frame, in which
        neighbours follow each other.
        """
        weights, at_nodes = weights[..., :_MODES], velocity_modes[:, :_MODES]
        anomalies = weights - weights.mean(axis=0)
        n_nodes, by_distance = len(nodes), np.argsort(np.sum(anomalies**2, axis=(1, 2)))
        order, _ = tiles(_own_frame(nodes, _energy(anomalies, at_nodes)), max(1, n_nodes // _NODES))
        some = order[evenly_spaced(min(_NODES, n_nodes), n_nodes)]
        if weights.shape[1] > _DEPTH_FUNCTIONS:
            functions, _ = vertical_functions(anomalies)
            weights = functions[:_DEPTH_FUNCTIONS] @ weights
        both = np.concatenate([some, some + n_nodes])
        return Members(weights[by_distance], at_nodes[both], nodes[some])

    def columns(self, count: int, member: int) -> Array:
        """Return the observation matrix of columns at nodes for the weights of a level, shape (m, r), m <= r.

        Args:
            count: Number of columns, evenly spread over the order of the nodes.
            member: Position of the member; each has other columns, by the golden section.
        """
        at = evenly_spaced(count, len(self.nodes), (0.5 + member * _GOLDEN) % 1.0)
        return np.asarray(np.linalg.qr(self.at(at), mode="r"))

    def some(self, count: int) -> tuple[NDArray[np.intp], Array]:
        """Return an even subset of at most ``count`` nodes, and the modes there, shape (2 n, r)."""
        nodes = evenly_spaced(min(count, len(self.nodes)), len(self.nodes))
        return nodes, self.at(nodes)

    def at(self, nodes: NDArray[np.intp]) -> Array:
        """Return the modes at some nodes, shape (2 n, r)."""
        return np.asarray(self.velocity_modes[np.concatenate([nodes, nodes + len(self.nodes)])])

    def left_out(self, count: int) -> list[int]:
        """Return the positions of at most ``count`` members to leave out in turn; empty below four members."""
        n = len(self.weights)
        return [int(member) for member in evenly_spaced(min(count, n), n)] if n > 3 else []


def evenly_spaced(count: int, total: int, first: float = 0.5) -> NDArray[np.intp]:
    """Return evenly spaced positions among a total, the first at a fraction of the spacing."""
    return ((np.arange(count) + first) * (total / count)).astype(np.intp)


def _own_frame(nodes: Array, energy: Array) -> Array:
    """Return the nodes along the principal axes of their energy, shape (N, 2) [m]; rotation and reflection have no effect.

    Args:
        nodes: Positions of the nodes, shape (N, 2) [m].
        energy: Weight of each node, shape (N,).
    """
    offset = nodes - energy @ nodes / energy.sum()
    along = offset @ np.linalg.eigh((offset.T * energy) @ offset)[1]
    return np.asarray(np.where(energy @ along**3 < 0.0, -along, along))


def _energy(anomalies: Array, velocity_modes: Array) -> Array:
    """Return the sum of the members' squared anomalies at each node, shape (N,)."""
    rows = anomalies.reshape(-1, anomalies.shape[2])
    square = np.einsum("nr,nr->n", velocity_modes @ (rows.T @ rows), velocity_modes)
    # all nodes count alike where members do not differ
    return np.asarray(square.reshape(2, -1).sum(axis=0) + np.finfo(float).tiny)


def choose_settings(members: Members, length: float, config: EstimatorConfig) -> PriorSettings:
    """Return the configured settings; by default the ensemble's length sets the distances and the share is fitted.

    Args:
        members: All members of the ensemble.
        length: Correlation length [m].
        config: Configuration; settings that are ``None`` are chosen here.
    """
    shift = length if config.shift_distance is None else config.shift_distance
    radius = config.localisation_radius or RADIUS_IN_LENGTHS * length
    if config.sample_share is not None:
        return PriorSettings(config.sample_share, shift, radius)
    start = PriorSettings(_SHARE_OF_FEW, shift, radius)
    left_out = members.left_out(_LEFT_OUT)
    if not left_out:
        return start
    some, fitted = left_out[::2], config.shift_distance is None
    advance = step_counter("fitting the prior", len(left_out) + fitted * len(some))
    each = scores(members, start, SHARES, left_out, advance)
    share = int(np.argmin(each.mean(axis=0)))
    chosen = replace(start, sample_share=SHARES[share])
    if not fitted:
        return chosen
    # most often the first of them say that the other shift suits less well
    nearer = replace(chosen, shift=_NEARER * length)
    least = each.mean(axis=0)[share] - _GAIN
    first = scores(members, nearer, (SHARES[share],), some, advance)[:, 0] - each[::2, share]
    if first.mean() > -_GAIN:
        return chosen
    others = scores(members, nearer, SHARES, left_out).mean(axis=0)
    better = replace(nearer, sample_share=SHARES[int(np.argmin(others))])
    return better if others.min() < least else chosen


def scores(
    members: Members,
    settings: PriorSettings,
    shares: Sequence[float],
    left_out: Sequence[int],
    advance: Callable[[], None] = lambda: None,
) -> Array:
    """Return the logarithmic score of each member left out, shape (members, shares).

    Args:
        members: All members, in few modes.
        settings: Shift and radius; the share is not used.
        shares: Candidate shares of the sample covariance.
        left_out: Positions of the members left out.
        advance: Called after each member.
    """
    found, modes = [], ShiftedModes.by(members.velocity_modes, members.nodes, settings.shift)
    calls = ((members, modes, member, settings, shares) for member in left_out)
    for each in each_call(_score_member, calls):
        found.append(each)
        advance()
    return np.array(found)


def _score_member(
    members: Members,
    modes: ShiftedModes,
    member: int,
    settings: PriorSettings,
    shares: Sequence[float],
) -> Array:
    """Return the logarithmic score, shape (shares,), over the numbers of columns."""
    others = np.delete(members.weights, member, axis=0)
    copies = modes.copies((others - others.mean(axis=0)) / np.sqrt(len(others) - 1.0))
    whole = replace(settings, sample_share=0.0)
    heights, directions, _ = local_directions(copies[None], np.ones(1), modes, whole, 0.0)
    local = heights[:, :, None] * directions[:, None]
    flat = (each.reshape(len(each), -1) for each in (copies, local))
    sample, localised = (each.T @ each for each in flat)
    truth = members.weights[member] - others.mean(axis=0)
    found = []
    for n_columns in _COLUMNS:
        rows = members.columns(n_columns, member)
        priors = (share * sample + (1.0 - share) * localised for share in shares)
        found.append([score_withheld(members, truth, prior, rows) for prior in priors])
    return np.asarray(np.mean(found, axis=0), dtype=np.float64)


def score_withheld(members: Members, truth: Array, prior: Array, rows: Array) -> float:
    """Return the logarithm of CRPS over the mean absolute anomaly at some nodes.

    Args:
        members: Members, whose modes are used.
        truth: See ``predicted_errors``.
        prior: See ``predicted_errors``.
        rows: See ``predicted_errors``; one observation error for all levels.
    """
    _, modes = members.some(_SCORED)
    noise = np.full(len(truth), LEVEL_ERROR_STD)
    error, variance, of_noise = predicted_errors(truth, prior, rows, noise, modes)
    std, scatter = np.sqrt(variance), np.sqrt(of_noise)
    relative = np.mean(crps_gaussian(error, std, scatter)) / np.mean(np.abs(truth @ modes.T))
    return float(np.log(relative))


def predicted_errors(
    truth: Array, prior: Array, rows: Array, noise: Array, modes: Array
) -> tuple[Array, Array, Array]:
    """Return the error of currents estimated from observations, their variance, and the error variance due to noise; shapes (Z, n).

    Both are averaged over the noise: with the posterior covariance P and the rows H, the noise n has the part P H' n in the estimate.

    Args:
        truth: Weights about the prior's mean, shape (Z, r).
        prior: Prior covariance, shape (Z r, Z r).
        rows: Observation matrix of each level's weights, shape (m, r).
        noise: Observation error of each level, shape (Z,).
        modes: Modes of the currents, shape (n, r).
    """
    (n_levels, n_modes), size = truth.shape, len(rows) * len(truth)
    by_level = prior.reshape(n_levels, n_modes, n_levels, n_modes)
    cross = (rows @ by_level.reshape(n_levels, n_modes, -1) / noise[:, None, None]).reshape(
        size, -1
    )  # H P
    innovation = (cross.reshape(size, n_levels, n_modes) @ rows.T / noise[:, None]).reshape(
        size, -1
    )
    innovation[np.diag_indices(size)] += 1.0
    factor = scipy.linalg.cholesky(innovation, lower=True, overwrite_a=True, check_finite=False)
    # transposed, arrays are in the order of the Fortran routine
    whitened = dtrsm(1.0, factor, cross.T, side=1, lower=1, trans_a=1).T
    of_noise = dtrsm(1.0, factor, whitened.T, side=1, lower=1).T
    values = (truth @ rows.T / noise[:, None]).ravel()
    error = (values @ of_noise).reshape(truth.shape) - truth

    def variance(covariance: Array) -> Array:
        return np.asarray(np.maximum(np.sum((modes @ covariance) * modes, axis=2), 0.0))

    taken, given = (
        each.reshape(size, n_levels, n_modes).swapaxes(0, 1) for each in (whitened, of_noise)
    )
    same_level = by_level[np.arange(n_levels), :, np.arange(n_levels)]
    posterior = variance(same_level - taken.swapaxes(1, 2) @ taken)
    return error @ modes.T, posterior, variance(given.swapaxes(1, 2) @ given)
