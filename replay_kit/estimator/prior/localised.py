"""Localised covariance of the modes, from pairs of tiles of nodes within reach of each other.

With V (2N, r) the modes at the nodes, P its pseudo-inverse, C the covariance of the modes' amplitudes and T the taper, the localised
covariance is H = P (T o V C V') P'. T is zero for most pairs of nodes of a large region. So nodes are sorted into compact tiles, and H is
the sum over pairs of tiles within the radius of P_i (T_ij o F_i F_j') P_j', with F F' = V C V'. The sum is symmetric, so each pair
counts once, and no N x N matrix is made. In large regions the products are in single precision, whose error, some 1e-7 of the sum,
cancels out over the nodes. If nodes far outnumber modes, neighbours are merged: modes and taper hardly differ there, and
the work grows with the square of the nodes.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.shifts import ShiftedModes, projector

# Nodes in a tile at most.
_TILE = 100
# Fields of so many functions of depth are in memory together [bytes].
_FIELD_BYTES = 1 << 29
# Up to so many nodes double precision costs next to nothing.
_FEW_NODES = 1000
# Share of the variance that the factor of a covariance leaves out.
_DROPPED = 1e-9
# Nodes, or groups of them, at most, and for each mode.
_MOST_NODES, _NODES_A_MODE = 2000, 6
# Depth functions that always have a covariance of their own, and the share of the variance that those with one of their own hold.
_LEAST_APART, _APART = 8, 0.999


def vertical_functions(anomalies: Array) -> tuple[Array, int]:
    """Return the empirical orthogonal functions of depth, by decreasing variance, and the number with separate covariances.

    Each row times its own amplitude's covariance is a part of the localised covariance. The weak ones share one amplitude covariance,
    the mean of theirs; their rows are scaled to their share in it, so that their squares sum to one.

    Args:
        anomalies: Anomalies, shape (F, Z, r), whose outer products sum to the covariance.

    Returns:
        Functions, shape (Z, Z), and a number of at most Z.
    """
    variance, vectors = np.linalg.eigh(
        np.einsum("ezr,eyr->zy", anomalies, anomalies, optimize=True)
    )
    variance, functions = np.maximum(variance[::-1], 0.0), vectors.T[::-1].copy()
    held = np.cumsum(variance) >= _APART * variance.sum()
    apart = max(int(np.argmax(held)) + 1, _LEAST_APART)
    if apart >= variance.size - 1:
        return functions, variance.size
    weak = variance[apart:]
    functions[apart:] *= np.sqrt(
        weak / weak.sum() if weak.sum() > 0.0 else np.full(weak.size, 1.0 / weak.size)
    )[:, None]
    return functions, apart


def localised_part(anomalies: Array, modes: ShiftedModes, radius: float) -> tuple[Array, Array]:
    """Return the vertical functions of anomalies, shape (q, Z), and their tapered covariances, shape (g, r, r), g <= q.

    Functions from the g-th on share the last covariance.

    Args:
        anomalies: Anomalies, shape (F, Z, r), whose outer products sum to the covariance.
        modes: Modes at the nodes.
        radius: Distance at which the taper reaches zero [m].
    """
    functions, apart = vertical_functions(anomalies)
    unit = functions / np.maximum(
        np.linalg.norm(functions, axis=1, keepdims=True), np.finfo(float).tiny
    )
    in_functions: Array = np.einsum("qz,ezr->qer", unit, anomalies, optimize=True)
    covariances = np.matmul(in_functions.swapaxes(1, 2), in_functions)
    if apart < len(functions):
        covariances = np.concatenate(
            [covariances[:apart], covariances[apart:].sum(axis=0, keepdims=True)]
        )
    most = max(_MOST_NODES, _NODES_A_MODE * modes.velocity_modes.shape[1])
    at_nodes = in_groups(modes.velocity_modes, modes.nodes, most)
    return functions, localised(covariances, *at_nodes, radius)


def in_groups(velocity_modes: Array, nodes: Array, most: int) -> tuple[Array, Array]:
    """Return the means of modes over groups of neighbouring nodes, shape (2 n, r), and mean positions, shape (n, 2) [m].

    Args:
        velocity_modes: Modes at the nodes, shape (2N, r).
        nodes: Positions of the nodes, shape (N, 2) [m].
        most: Target number of groups; halving may make twice as many.
    """
    if len(nodes) <= most:
        return velocity_modes, nodes
    order, ends = tiles(nodes, -(-len(nodes) // most))
    starts, counts = np.append(0, ends[:-1]), np.diff(ends, prepend=0)[:, None]
    by_component = velocity_modes.reshape(2, len(nodes), -1)[:, order]
    grouped = np.add.reduceat(by_component, starts, axis=1) / counts
    places = np.add.reduceat(nodes[order], starts, axis=0) / counts
    return grouped.reshape(-1, velocity_modes.shape[1]), places


def localised(covariances: Array, velocity_modes: Array, nodes: Array, radius: float) -> Array:
    """Return covariances of the modes' amplitudes after tapering over the nodes, shape (g, r, r); see the module.

    Args:
        covariances: Covariances of the amplitudes, shape (g, r, r).
        velocity_modes: Modes at the nodes, shape (2N, r).
        nodes: Positions of the nodes, shape (N, 2) [m].
        radius: Distance at which the taper reaches zero [m].
    """
    n_nodes = len(nodes)
    precision: Any = np.float64 if n_nodes <= _FEW_NODES else np.float32
    order, ends = tiles(nodes, _TILE)
    factors = _factors(covariances)
    to_modes = projector(velocity_modes)
    back = np.stack([to_modes[:, part * n_nodes + order].T for part in range(2)], axis=1)
    back, at_nodes = (each.astype(precision) for each in (back, velocity_modes))
    at_once = max(1, _FIELD_BYTES // (factors.shape[2] * back[:, :, 0].nbytes))
    parts = list[Array]()
    for start in range(0, len(factors), at_once):
        # (g, N, 2, f), and ``back`` (N, 2, r), node after node: a run of tiles is adjacent in memory
        some = factors[start : start + at_once].astype(precision)
        fields = np.empty((len(some), n_nodes, 2, factors.shape[2]), dtype=precision)
        for part in range(2):
            here = at_nodes[part * n_nodes + order]
            for field, factor in zip(fields, some, strict=True):
                field[:, part] = here @ factor
        parts.append(_half(fields, back, nodes[order], ends, radius))
    half = np.concatenate(parts)
    whole = half + half.swapaxes(1, 2)
    return _positive(whole) if precision is np.float32 else whole


def _half(
    fields: NDArray[Any], back: NDArray[Any], places: Array, ends: NDArray[np.intp], radius: float
) -> Array:
    """Return half of each sum over pairs of tiles, shape (g, r, r); with its transpose it is the whole.

    Args:
        fields: F at the nodes in the order of the tiles, shape (g, N, 2, f).
        back: P' at the nodes, shape (N, 2, r).
        places: Positions of the nodes, shape (N, 2) [m].
        ends: Ends of the tiles.
        radius: Distance at which the taper reaches zero [m].
    """
    (n_groups, *_), n_modes = fields.shape, back.shape[2]
    half, starts = np.zeros((n_groups, n_modes, n_modes)), np.append(0, ends[:-1])
    low, high = (extreme.reduceat(places, starts, axis=0) for extreme in (np.minimum, np.maximum))
    for tile, first in enumerate(starts):
        of_tile = slice(first, ends[tile])
        here = fields[:, of_tile].reshape(n_groups, -1, fields.shape[3])
        apart = np.maximum(np.maximum(low[tile:] - high[tile], low[tile] - high[tile:]), 0.0)
        near = tile + np.flatnonzero(np.hypot(*apart.T) < radius)
        projected = np.zeros((n_groups, here.shape[1], n_modes), dtype=back.dtype)
        for other in near:
            at = slice(starts[other], ends[other])
            there = fields[:, at].reshape(n_groups, -1, fields.shape[3])
            taper = gaspari_cohn(cdist(places[of_tile], places[at]), radius)
            if other == tile:
                taper *= 0.5
            product = here @ there.swapaxes(1, 2)
            product *= taper.astype(back.dtype).repeat(2, axis=0).repeat(2, axis=1)
            flat = product.reshape(-1, product.shape[2]) @ back[at].reshape(-1, n_modes)
            projected += flat.reshape(projected.shape)
        half += back[of_tile].reshape(-1, n_modes).T @ projected
    return half


def tiles(nodes: Array, size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return an order of nodes, shape (N,), in which tiles follow each other, and the ends of the tiles.

    A tile is half of a larger one, cut across its longer side, so land and curvilinear grids need nothing special.

    Args:
        nodes: Positions of the nodes, shape (N, 2) [m].
        size: Largest number of nodes in a tile.
    """
    done, left = [], [np.arange(len(nodes))]
    while left:
        tile = left.pop()
        if tile.size <= size:
            done.append(tile)
            continue
        places = nodes[tile]
        along = places[:, int(np.argmax(np.ptp(places, axis=0)))]
        by_place = tile[np.argsort(along, kind="stable")]
        left += [by_place[tile.size // 2 :], by_place[: tile.size // 2]]
    return np.concatenate(done), np.cumsum([tile.size for tile in done])


def _factors(covariances: Array) -> Array:
    """Return the factors of covariances, shape (g, r, f), without directions of negligible variance."""
    values, vectors = np.linalg.eigh(covariances)
    values = np.maximum(values, 0.0)
    needed = np.sum(
        np.cumsum(values, axis=1) > _DROPPED * values.sum(axis=1, keepdims=True), axis=1
    )
    kept = slice(values.shape[1] - max(int(needed.max()), 1), None)
    return np.asarray(vectors[:, :, kept] * np.sqrt(values[:, None, kept]))


def _positive(covariances: Array) -> Array:
    """Return the covariances without negative eigenvalues due to rounding."""
    for number, covariance in enumerate(covariances):
        try:
            np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(covariance)
            covariances[number] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return covariances


def gaspari_cohn(distance: Array, radius: float) -> Array:
    """Return the fifth-order taper of Gaspari and Cohn (1999, eq. 4.10): 1 at distance 0, 0 from ``radius`` on.

    Args:
        distance: Distance [m], any shape.
        radius: Twice the function's half-width c [m].
    """
    r, out = 2.0 * np.abs(distance) / radius, np.zeros(np.shape(distance))
    near = r <= 1.0
    x = r[near]
    out[near] = 1.0 + x**2 * (-5.0 / 3.0 + x * (5.0 / 8.0 + x * (0.5 - 0.25 * x)))
    far = (r < 2.0) & ~near
    x = r[far]
    outer = x * (-5.0 + x * (5.0 / 3.0 + x * (5.0 / 8.0 + x * (-0.5 + x / 12.0))))
    out[far] = np.maximum(4.0 + outer - 2.0 / (3.0 * x), 0.0)
    return out
