"""The slow obvious estimator: the full 2XYZ kernel, dense matrices, the textbook Kalman filter, one scalar loop at a time."""

import math

import numpy as np


def kernel_3d(a, b, lengths, speed):
    """2 x 2 block between two points (east, north, depth), term by term as in the paper."""
    lx, ly, lz = lengths
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    sigma = speed * lx
    k = sigma**2 * math.exp(-0.5 * ((dx / lx) ** 2 + (dy / ly) ** 2 + (dz / lz) ** 2))
    cross = dx * dy / (lx**2 * ly**2)
    return k * np.array([[(1 - dy**2 / ly**2) / ly**2, cross], [cross, (1 - dx**2 / lx**2) / lx**2]])


def dense_kernel(points, nodes, lengths, speed):
    """Blocks of points against nodes; both (n, 3) ordered by level; within a level all east, then all north."""

    def order(n_points, levels):
        per_level = n_points // levels
        return [(z * per_level + i, c) for z in range(levels) for c in range(2) for i in range(per_level)]

    def levels_of(p):
        return len(np.unique(p[:, 2]))

    rows, columns = order(len(points), levels_of(points)), order(len(nodes), levels_of(nodes))
    out = np.empty((len(rows), len(columns)))
    for r, (i, c) in enumerate(rows):
        for s, (j, d) in enumerate(columns):
            out[r, s] = kernel_3d(points[i], nodes[j], lengths, speed)[c, d]
    return out


def paper_basis(members, nodes, levels, lengths, speed, n_modes):
    """Latents of the full kernel, SVD of their level slices, weights of every member; members (E, Z, 2N)."""
    n_members, n_levels, size = members.shape
    points = np.array([[x, y, z] for z in levels for x, y in nodes])
    kernel = dense_kernel(points, points, lengths, speed)
    latents = np.array([np.linalg.solve(kernel, member.ravel()) for member in members]).reshape(n_members, n_levels, size)
    columns = latents.reshape(-1, size).T
    modes = np.linalg.svd(columns, full_matrices=False)[0][:, :n_modes]
    weights = np.array([[modes.T @ latents[e, z] for z in range(n_levels)] for e in range(n_members)])
    return modes, weights, points


def design_matrix(place, depths, points, modes, n_levels, first_level, lengths, speed):
    """H = K(x, data) blockdiag(U .. U) for the bins of one profile: all east, then all north."""
    blocks = np.zeros((n_levels * modes.shape[0], n_levels * modes.shape[1]))
    for z in range(n_levels):
        blocks[z * modes.shape[0] : (z + 1) * modes.shape[0], z * modes.shape[1] : (z + 1) * modes.shape[1]] = modes
    rows = [dense_kernel(np.array([[*place, max(depth, first_level)]]), points, lengths, speed) @ blocks for depth in depths]
    return np.vstack([[row[c] for row in rows] for c in range(2)])


def kalman_update(mean, cov, design, value, noise_cov):
    """The textbook update."""
    s = design @ cov @ design.T + noise_cov
    gain = cov @ design.T @ np.linalg.inv(s)
    innovation = value - design @ mean
    return mean + gain @ innovation, (np.eye(mean.size) - gain @ design) @ cov, float(innovation @ np.linalg.inv(s) @ innovation), s
