"""Shifted copies of ensemble members, and the representation error that a basis leaves of them.

A current that members show at one position is possible nearby. A basis represents its own members far better than a truth. With 80 modes
of the North Atlantic set their residual at the first level is 0.5 cm/s. Copies shifted by a correlation length leave 1.9 cm/s: they are
possible currents too, but the basis was not built from them. The residual varies severalfold over the region, largest where currents are
strong and vary within a few cells. It includes the divergent part.
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

    Their Gram matrix is a mean in which a field has the weight of two copies. A copy takes each node's value from the
    node nearest to the shifted position, so it repeats the edge beyond it.

    Args:
        fields: Fields at the nodes, shape (E, Z, 2N).
        nodes: Positions of the nodes, shape (N, 2) [m].
        shift: Distance [m].
    """
    return np.concatenate(
        [
            weight * fields[..., source]
            for weight, source in zip(SHIFT_WEIGHTS, shift_sources(nodes, shift), strict=True)
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedModes:
    """Modes at the nodes and the operators that shift fields, common to all members.

    A copy at a node is the field at another node, so copy k of the modes V is V with its rows exchanged. Its projection on V
    gives the operator on weights, exactly and without any field.

    Attributes:
        velocity_modes: Modes V at the nodes, shape (2N, r) [m/s per unit weight].
        nodes: East and north of the nodes, shape (N, 2) [m].
        operators: Operators on weights, one for each copy of ``shifted_copies``, shape (5, r, r); without a shift the identity,
            shape (1, r, r).
    """

    velocity_modes: Array
    nodes: Array
    operators: Array

    @classmethod
    def by(cls, modes: Array, nodes: Array, shift: float) -> "ShiftedModes":
        """Return the modes with the operators for copies shifted by a distance [m]; 0 makes none."""
        operators = np.eye(modes.shape[1])[None]
        if shift > 0.0:
            to_modes = projector(modes)
            sources = zip(SHIFT_WEIGHTS, shift_sources(nodes, shift), strict=True)
            operators = np.stack(
                [weight * (to_modes @ modes[source]).T for weight, source in sources]
            )
        return cls(modes, nodes, operators)

    def copies(self, anomalies: Array) -> Array:
        """Return the weighted anomalies and shifted copies in modes, shape (5 E, Z, r), of anomalies, shape (E, Z, r)."""
        _, n_levels, n_modes = anomalies.shape
        copies = np.matmul(anomalies.reshape(1, -1, n_modes), self.operators)
        return np.asarray(copies.reshape(-1, n_levels, n_modes))


def projector(velocity_modes: Array) -> Array:
    """Return the pseudo-inverse of the modes at the nodes, shape (r, 2N); the nugget makes them non-orthonormal.

    Well-conditioned modes, the usual case, are solved by normal equations, an r x r system; others by QR factorisation.

    Args:
        velocity_modes: Modes at the nodes, shape (2N, r).
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
    """Return the row of a field that each row of its copies repeats, shape (5, 2N)."""
    offsets = shift * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    _, source = cKDTree(nodes).query(nodes[None] + offsets[:, None])
    return np.concatenate([source, source + nodes.shape[0]], axis=1)


# Members whose copies are taken, and levels of one that are in memory as copies.
_MEMBERS, _LEVELS = 12, 8


def shifted_residual(
    series: Sequence[Ensemble], mean: Array, velocity_modes: Array, shift: float
) -> Array:
    """Return the RMS residual per component of shifted members fitted by the modes, shape (Z, N) [m/s].

    A sample spread evenly over times and members suffices; one member at a time is in memory.

    Args:
        series: Members at each time.
        mean: Mean of all members, shape (Z, 2N) [m/s].
        velocity_modes: Modes at the nodes, shape (2N, r) [m/s per unit weight].
        shift: Distance [m]; 0 for the members themselves.
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
