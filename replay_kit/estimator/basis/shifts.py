"""Copies of fields shifted to the four sides, and what a basis does not represent of them at each node.

What members show at one place is possible nearby. The members that a basis was made of it represents far better than a truth: with 80 modes
of the North Atlantic set it leaves 0.5 cm/s of them at the first level, and 1.9 cm/s of copies of them that are shifted by a correlation
length, which are possible currents too and none of which it was made of. What is left varies over the region by several times: most where
currents are strong and vary within a few cells. The part that no flow without divergence carries is in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.basis.slices import ensemble_slices

#: A field itself counts as much as two of its copies; the squares sum to one.
SHIFT_WEIGHTS = np.sqrt(np.array([2.0, 1.0, 1.0, 1.0, 1.0]) / 6.0)
# Smallest share of a Gram matrix's largest eigenvalue whose inverse keeps eight digits.
_WELL_CONDITIONED = 1e-8


def shifted_copies(fields: Array, nodes: Array, shift: float) -> Array:
    """Return fields and their copies shifted east, west, north and south, weighted: shape (5 E, Z, 2N).

    Their Gram matrix is a mean, in which a field itself counts as much as two of its copies. A copy has at each node
    what the field has at the node nearest to the shifted place, so at the edge it repeats the edge.

    Args:
        fields: shape (E, Z, 2N).
        nodes: shape (N, 2) [m].
        shift: [m].
    """
    return np.concatenate(
        [
            weight * fields[..., source]
            for weight, source in zip(SHIFT_WEIGHTS, shift_sources(nodes, shift), strict=True)
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedModes:
    """The modes at the nodes, and what shifts fields in them: the same for all members.

    A copy at a node is the field at another node, so copy k of the modes V is V with its rows exchanged, and its weights are
    those times the projector: exactly the copies' projection on the modes, without a field.

    Attributes:
        velocity_modes: shape (2N, r) [m/s for a weight of one], V.
        nodes: shape (N, 2) [m], east and north.
        operators: shape (5, r, r): weights times operator k are those of copy k of ``shifted_copies``; the identity alone, shape
            (1, r, r), without a shift.
    """

    velocity_modes: Array
    nodes: Array
    operators: Array

    @classmethod
    def by(cls, modes: Array, nodes: Array, shift: float) -> "ShiftedModes":
        """Return the same for copies that are shifted by a distance [m]; 0 makes none."""
        operators = np.eye(modes.shape[1])[None]
        if shift > 0.0:
            to_modes = projector(modes)
            sources = zip(SHIFT_WEIGHTS, shift_sources(nodes, shift), strict=True)
            operators = np.stack(
                [weight * (to_modes @ modes[source]).T for weight, source in sources]
            )
        return cls(modes, nodes, operators)

    def copies(self, anomalies: Array) -> Array:
        """Return anomalies, shape (E, Z, r), and their shifted copies, weighted, in modes: shape (5 E, Z, r)."""
        _, n_levels, n_modes = anomalies.shape
        copies = np.matmul(anomalies.reshape(1, -1, n_modes), self.operators)
        return np.asarray(copies.reshape(-1, n_levels, n_modes))


def projector(velocity_modes: Array) -> Array:
    """Return the pseudo-inverse of modes at the nodes, shape (r, 2N): least squares, as a kernel's nugget leaves them not orthonormal.

    Well-conditioned modes, the rule, are solved by their normal equations, an r x r system; others by a QR factorisation.

    Args:
        velocity_modes: shape (2N, r).
    """
    gram = velocity_modes.T @ velocity_modes
    values = np.linalg.eigvalsh(gram)
    if values[0] > _WELL_CONDITIONED * values[-1]:
        return np.asarray(
            scipy.linalg.cho_solve(scipy.linalg.cho_factor(gram, lower=True), velocity_modes.T)
        )
    q, r = np.linalg.qr(velocity_modes)
    return np.asarray(np.linalg.pinv(r) @ q.T)


def shift_sources(nodes: Array, shift: float) -> NDArray[np.intp]:
    """Return for each copy the row of a field, shape (2N,), that each of its rows repeats, shape (5, 2N)."""
    offsets = shift * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    _, source = cKDTree(nodes).query(nodes[None] + offsets[:, None])
    return np.concatenate([source, source + nodes.shape[0]], axis=1)


# Members whose copies are taken, and levels of one that are in memory as copies.
_MEMBERS, _LEVELS = 12, 8


def shifted_residual(
    series: Sequence[Ensemble], mean: Array, velocity_modes: Array, shift: float
) -> Array:
    """Return the root mean square over components of what the modes leave of members shifted to four sides, shape (Z, N) [m/s].

    Some members, evenly spread over the times and members, are enough, and one at a time is in memory.

    Args:
        series: The members at each time.
        mean: shape (Z, 2N) [m/s], of all members.
        velocity_modes: shape (2N, r) [m/s for a weight of one], the modes at the nodes.
        shift: [m]; 0 for the members themselves.
    """
    to_modes, sources = projector(velocity_modes), shift_sources(series[0].grid.nodes, shift)[1:]
    square, n_members = np.zeros_like(mean), series[0].n_members
    n_fields = len(series) * n_members
    chosen = np.unique(np.linspace(0, n_fields - 1, min(_MEMBERS, n_fields)).astype(np.int64))
    for time, member in zip(*divmod(chosen, n_members), strict=True):
        one = series[time]
        alone = replace(one, velocity=one.velocity[member : member + 1])
        anomaly = ensemble_slices(alone)[0] - mean
        for first in range(0, len(mean), _LEVELS):
            # all four together: the modes are read once for them
            levels = anomaly[first : first + _LEVELS]
            copies = levels[:, sources].reshape(-1, anomaly.shape[1])
            left = (copies - (copies @ to_modes.T) @ velocity_modes.T) ** 2
            square[first : first + _LEVELS] += left.reshape(len(levels), len(sources), -1).sum(
                axis=1
            )
    by_component = square.reshape(len(mean), 2, -1) / (len(chosen) * len(sources))
    return np.asarray(np.sqrt(by_component.mean(axis=1)))
