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

    def ordered(places):
        levels = [places[places[:, 2] == level] for level in np.unique(places[:, 2])]
        return [(place, c) for level in levels for c in range(2) for place in level]

    return np.array(
        [
            [kernel_3d(point, node, lengths, speed)[c, d] for node, d in ordered(nodes)]
            for point, c in ordered(points)
        ]
    )


def paper_basis(members, nodes, levels, lengths, speed, n_modes):
    """Latents of the full kernel, SVD of their level slices, weights of every member; members (E, Z, 2N)."""
    points = np.array([[x, y, z] for z in levels for x, y in nodes])
    kernel = dense_kernel(points, points, lengths, speed)
    latents = [np.linalg.solve(kernel, member.ravel()) for member in members]
    latents = np.reshape(latents, members.shape)
    columns = latents.reshape(-1, members.shape[2]).T
    modes = np.linalg.svd(columns, full_matrices=False)[0][:, :n_modes]
    return modes, latents @ modes, points


def design_matrix(place, depths, points, modes, n_levels, first_level, lengths, speed):
    """H = K(x, data) blockdiag(U .. U) for the bins of one profile: all east, then all north."""
    blocks = np.kron(np.eye(n_levels), modes)
    at = [np.array([[*place, max(depth, first_level)]]) for depth in depths]
    rows = [dense_kernel(one, points, lengths, speed) @ blocks for one in at]
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
    slopes = []
    for dj, di in ((1, 0), (0, 1)):
        of_direction = []
        for z, j, i in np.argwhere(wet[:, : wet.shape[1] - dj, : wet.shape[2] - di]):
            here, there = (j, i), (j + dj, i + di)
            if wet[z][there]:
                apart = np.hypot(east[there] - east[here], north[there] - north[here])
                rise = anomalies[:, :, z, *there] - anomalies[:, :, z, *here]
                of_direction += ((rise / apart) ** 2).ravel().tolist()
        slopes.append(np.mean(of_direction))
    return np.sqrt(np.mean(np.square(anomalies[:, :, wet])) / np.mean(slopes))


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
    weights = copies @ projector.T
    by_depth = np.einsum("czr,cyr->zy", weights, weights)
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
