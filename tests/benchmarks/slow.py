"""The slow ways that the estimator's benchmarks are measured against; each is as its textbook has it."""

import numpy as np
import scipy.linalg

from replay_kit.core.flow.functions import depth_weights, velocity_kernel
from tests.reference import lattice


def rows(estimator, observation):
    """H, z - offset and the errors' standard deviations of all bins, all east then all north."""
    used = np.arange(observation.depth.size)
    compressed = estimator.rows(observation, used)
    values = compressed.stack.values[0]
    weights = depth_weights(
        estimator.basis.depth_functions, observation.depth, estimator.basis.grid.levels
    )
    design = np.vstack([np.kron(weights, compressed.basis[c]) for c in range(2)])
    return design, values.T.ravel(), np.tile(compressed.stack.layouts[0].std, 2)


def textbook(mean, cov, design, value, error):
    """The update of a full covariance."""
    cov_design = cov @ design.T
    gain = np.linalg.solve(design @ cov_design + np.diag(error**2), cov_design.T).T
    return mean + gain @ (value - design @ mean), cov - gain @ cov_design.T


def batch(estimator, observations, inflation, probes):
    """Mean, and covariance of some probes (p, n) of the weights, from the compressed rows of all profiles at once."""
    designs, values = [], []
    for observation, factor in zip(observations, inflation, strict=True):
        compressed = estimator.rows(observation, np.arange(observation.depth.size))
        designs.append(compressed.design() / np.sqrt(factor))
        values.append(compressed.y / np.sqrt(factor))
    design, prior = np.vstack(designs), estimator.prior.covariance()
    crossed = design @ prior
    factor = scipy.linalg.cho_factor(
        crossed @ design.T + np.eye(len(design)), lower=True, overwrite_a=True, check_finite=False
    )
    innovation = np.concatenate(values) - design @ estimator.prior.mean
    seen = crossed @ probes.T
    cov = probes @ prior @ probes.T - seen.T @ scipy.linalg.cho_solve(
        factor, seen, check_finite=False
    )
    return estimator.prior.mean + crossed.T @ scipy.linalg.cho_solve(
        factor, innovation, check_finite=False
    ), cov


def dense_embedding(ensemble_slices, kernel, nodes, depth_kernel):
    """Latents of all members, shape (E, Z, 2N), from the kernel matrix of all unknowns."""
    n_members, n_levels, size = ensemble_slices.shape
    matrix = np.kron(depth_kernel, velocity_kernel(kernel, nodes, nodes))
    factor = scipy.linalg.cho_factor(matrix, overwrite_a=True, check_finite=False)
    flat = scipy.linalg.cho_solve(
        factor, ensemble_slices.reshape(n_members, -1).T, check_finite=False
    )
    return flat.T.reshape(n_members, n_levels, size)


def grid_std(flow, nodes):
    """Velocity and standard error at every node and level through H, (Z 2N, n): diag(H P H')."""
    at_nodes = lattice.matrix(flow.horizontal, nodes)
    design = np.kron(np.eye(flow.levels.size), at_nodes @ flow.modes)
    return at_nodes @ flow.latent, np.sqrt(
        np.einsum("ij,ij->i", design @ flow.weight_cov, design)
    ).reshape(flow.levels.size, -1)
