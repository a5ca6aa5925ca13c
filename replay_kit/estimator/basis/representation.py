"""What a basis does not represent of a current that it was not made of, at each node.

The members that a basis was made of it represents far better than a truth: with 80 modes of the North Atlantic set it leaves 0.5 cm/s of
them at the first level, and 1.9 cm/s of copies of them that are shifted by a correlation length, which are possible currents too and none
of which it was made of. What is left varies over the region by several times: most where currents are strong and vary within a few cells.
The part that no flow without divergence carries is in it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.basis.shifts import projector, shift_sources
from replay_kit.estimator.basis.slices import ensemble_slices

# Members whose copies are taken.
_MEMBERS = 12


@dataclass(frozen=True, slots=True, eq=False)
class ErrorField:
    """How the representation error varies over a region.

    Attributes:
        relative: shape (Z, N), the error at each node over its root mean square at the level.
        nodes: shape (N, 2) [m].
    """

    relative: Array
    nodes: Array

    def at(self, places: Array) -> Array:
        """Return the error over the level's root mean square at places, that of the nearest node: shape (P, Z).

        Args:
            places: shape (P, 2) [m], local east and north.
        """
        nearest = cdist(places, self.nodes, "sqeuclidean").argmin(axis=1)
        return np.asarray(self.relative[:, nearest].T)


def error_field(error_std: Array, nodes: Array) -> ErrorField:
    """Return how an error varies over the nodes.

    Args:
        error_std: shape (Z, N) [m/s].
        nodes: shape (N, 2) [m].
    """
    level = np.sqrt(np.mean(error_std**2, axis=1, keepdims=True))
    return ErrorField(
        np.divide(error_std, level, out=np.ones_like(error_std), where=level > 0.0), nodes
    )


def shifted_residual(ensemble: Ensemble, mean: Array, velocity_modes: Array, shift: float) -> Array:
    """Return the root mean square over components of what the modes leave of members shifted to four sides, shape (Z, N) [m/s].

    Some members, evenly spread over the ensemble, are enough, and one at a time is in memory.

    Args:
        ensemble: The members.
        mean: shape (Z, 2N) [m/s], of all members.
        velocity_modes: shape (2N, r) [m/s for a weight of one], the modes at the nodes.
        shift: [m]; 0 for the members themselves.
    """
    to_modes, sources = projector(velocity_modes), shift_sources(ensemble.grid.nodes, shift)[1:]
    square = np.zeros_like(mean)
    chosen = np.unique(
        np.linspace(0, ensemble.n_members - 1, min(_MEMBERS, ensemble.n_members)).astype(np.int64)
    )
    for member in chosen:
        alone = replace(ensemble, velocity=ensemble.velocity[member : member + 1])
        anomaly = ensemble_slices(alone)[0] - mean
        for source in sources:
            copy = anomaly[:, source]
            square += (copy - (copy @ to_modes.T) @ velocity_modes.T) ** 2
    by_component = square.reshape(len(mean), 2, -1) / (len(chosen) * len(sources))
    return np.asarray(np.sqrt(by_component.mean(axis=1)))
