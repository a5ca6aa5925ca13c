"""Copies of fields shifted to the four sides: what members show at one place is possible nearby."""

import numpy as np
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array


def shifted_copies(fields: Array, nodes: Array, shift: float) -> Array:
    """Return fields and their copies shifted east, west, north and south, weighted: shape (5 E, Z, 2N).

    Their Gram matrix is a mean, in which a field itself counts as much as two of its copies. A copy has at each node
    what the field has at the node nearest to the shifted place, so at the edge it repeats the edge.

    Args:
        fields: shape (E, Z, 2N).
        nodes: shape (N, 2) [m].
        shift: [m].
    """
    offsets = shift * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    _, source = cKDTree(nodes).query(nodes[None] + offsets[:, None])
    both = np.concatenate([source, source + nodes.shape[0]], axis=1)
    weights = np.sqrt(np.array([2.0, 1.0, 1.0, 1.0, 1.0]) / 6.0)
    return np.concatenate([weight * fields[..., indices] for weight, indices in zip(weights, both, strict=True)])
