"""Copies of fields shifted to the four sides: what members show at one place is possible nearby."""

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array

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


def shift_operators(velocity_modes: Array, projector: Array, nodes: Array, shift: float) -> Array:
    """Return what shifts fields in modes: weights times operator k are those of copy k of ``shifted_copies``, shape (5, r, r).

    A copy at a node is the field at another node, so copy k of the modes V is V with its rows exchanged, and its weights are
    those times the projector: exactly the copies' projection on the modes, without a field.

    Args:
        velocity_modes: shape (2N, r), V.
        projector: shape (r, 2N), the pseudo-inverse of V.
        nodes: shape (N, 2) [m].
        shift: [m]; 0 gives the projection of the fields alone, as one operator.
    """
    if shift == 0.0:
        return np.eye(velocity_modes.shape[1])[None]
    sources = zip(SHIFT_WEIGHTS, shift_sources(nodes, shift), strict=True)
    return np.stack([weight * (projector @ velocity_modes[source]).T for weight, source in sources])


def shifted_in_modes(anomalies: Array, operators: Array) -> Array:
    """Return anomalies, shape (E, Z, r), and their shifted copies, weighted, in modes: shape (5 E, Z, r)."""
    _, n_levels, n_modes = anomalies.shape
    return np.asarray(np.matmul(anomalies.reshape(1, -1, n_modes), operators)).reshape(
        -1, n_levels, n_modes
    )


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
