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
    return k * np.array(
        [[(1 - dy**2 / ly**2) / ly**2, cross], [cross, (1 - dx**2 / lx**2) / lx**2]]
    )


def dense_kernel(points, nodes, lengths, speed):
    """Blocks of points against nodes; both (n, 3) ordered by level; within a level all east, then all north."""

    def order(n_points, levels):
        per_level = n_points // levels
        return [
            (z * per_level + i, c)
            for z in range(levels)
            for c in range(2)
            for i in range(per_level)
        ]

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
    latents = np.array([np.linalg.solve(kernel, member.ravel()) for member in members]).reshape(
        n_members, n_levels, size
    )
    columns = latents.reshape(-1, size).T
    modes = np.linalg.svd(columns, full_matrices=False)[0][:, :n_modes]
    weights = np.array(
        [[modes.T @ latents[e, z] for z in range(n_levels)] for e in range(n_members)]
    )
    return modes, weights, points


def design_matrix(place, depths, points, modes, n_levels, first_level, lengths, speed):
    """H = K(x, data) blockdiag(U .. U) for the bins of one profile: all east, then all north."""
    blocks = np.zeros((n_levels * modes.shape[0], n_levels * modes.shape[1]))
    for z in range(n_levels):
        blocks[
            z * modes.shape[0] : (z + 1) * modes.shape[0],
            z * modes.shape[1] : (z + 1) * modes.shape[1],
        ] = modes
    rows = [
        dense_kernel(np.array([[*place, max(depth, first_level)]]), points, lengths, speed) @ blocks
        for depth in depths
    ]
    return np.vstack([[row[c] for row in rows] for c in range(2)])


def kalman_update(mean, cov, design, value, noise_cov):
    """The textbook update."""
    s = design @ cov @ design.T + noise_cov
    gain = cov @ design.T @ np.linalg.inv(s)
    innovation = value - design @ mean
    return (
        mean + gain @ innovation,
        (np.eye(mean.size) - gain @ design) @ cov,
        float(innovation @ np.linalg.inv(s) @ innovation),
        s,
    )


def correlation_length(members, east, north, wet):
    """Standard deviation over the gradient's, pair of neighbours by pair; ``members`` of shape (E, 2, Z, J, I)."""
    anomalies = members - members.mean(axis=0)
    values = np.moveaxis(anomalies, (2, 3, 4), (0, 1, 2))[wet]
    slopes = []
    for dj, di in ((1, 0), (0, 1)):
        of_direction = []
        for z, j, i in np.argwhere(wet):
            if j + dj < wet.shape[1] and i + di < wet.shape[2] and wet[z, j + dj, i + di]:
                distance = np.hypot(
                    east[j + dj, i + di] - east[j, i], north[j + dj, i + di] - north[j, i]
                )
                of_direction += list(
                    (
                        (anomalies[:, :, z, j + dj, i + di] - anomalies[:, :, z, j, i]) / distance
                    ).ravel()
                    ** 2
                )
        slopes.append(np.mean(of_direction))
    return np.sqrt(np.mean(np.square(values)) / np.mean(slopes))


def tapered(nodes, radius, taper):
    """Taper of the distance of each two nodes, of both components (2N, 2N)."""
    distances = [[taper(np.hypot(*(a - b)), radius) for b in nodes] for a in nodes]
    return np.tile(distances, (2, 2))


def hybrid_covariance(fields, modes, nodes, share, shift, radius, taper):
    """Covariance of the node velocities of all levels, (Z 2N, Z 2N), from members' fields of shape (E, Z, 2N), entry by entry.

    ``modes`` (2N, r) are the velocities of the basis flows: what they cannot show of a shifted copy is left out.
    """
    projector = np.linalg.pinv(modes)
    n_members, n_levels, size = fields.shape
    n_nodes = size // 2
    anomalies = fields - fields.mean(axis=0)
    copies = []
    for east, north, counts in ((0, 0, 2), (1, 0, 1), (-1, 0, 1), (0, 1, 1), (0, -1, 1)):
        for member in anomalies:
            copy = np.empty_like(member)
            for n in range(n_nodes):
                wanted = nodes[n] + shift * np.array([east, north])
                nearest = min(range(n_nodes), key=lambda k: np.hypot(*(nodes[k] - wanted)))
                copy[:, n], copy[:, n + n_nodes] = member[:, nearest], member[:, nearest + n_nodes]
            copies.append(copy @ (modes @ projector).T * np.sqrt(counts / 6 / (n_members - 1)))
    copies = np.array(copies)
    sample = np.einsum("czn,cym->znym", copies, copies)
    by_depth = np.array(
        [
            [
                np.sum((copies[:, z] @ projector.T) * (copies[:, y] @ projector.T))
                for y in range(n_levels)
            ]
            for z in range(n_levels)
        ]
    )
    localised = np.zeros_like(sample)
    weight = tapered(nodes, radius, taper)
    for function in np.linalg.eigh(by_depth)[1].T:
        of_function = np.tensordot(function, copies, axes=(0, 1))
        of_nodes = weight * (of_function.T @ of_function)
        localised += np.einsum("ab,z,y->zayb", of_nodes, function, function)
    return (share * sample + (1 - share) * localised).reshape(n_levels * size, -1)


def log_density(value, mean, cov):
    """Logarithm of a Gaussian density without the constant of 2 pi, by determinant and inverse."""
    residual = value - mean
    return -0.5 * (residual @ np.linalg.inv(cov) @ residual + np.linalg.slogdet(cov)[1])


def localised_covariance(covariance, modes, nodes, radius, taper):
    """Tapered covariance of the modes' amplitudes, (r, r), pair of nodes by pair, from ``modes`` (2N, r) at the nodes."""
    projector = np.linalg.pinv(modes)
    fields = modes @ covariance @ modes.T * tapered(nodes, radius, taper)
    return projector @ fields @ projector.T
