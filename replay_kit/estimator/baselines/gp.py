"""Gaussian-process regression of an incompressible flow without an ensemble (Lee et al., arXiv 1901.09513).

The prior is f ~ GP(0, K_h x C_z): the incompressible kernel in the horizontal, hat functions of depth between levels of covariance C_z.
The ensemble gives only the variance at each level and the covariance between levels (C_z, the second moments of its slices about zero), and
one length.

At the nodes K_h = V L V'. With the columns of V L^-1/2 as latent modes the flow is sum_z d_z(depth) K(x, nodes) V L^-1/2 w_z, where
w ~ N(0, C_z x I): exactly the process at the grid's points, and a Bayesian linear model that the filter of the reduced basis solves.
Directions of negligible variance are dropped, and their variance is added to the bins' error.
"""

import numpy as np
from scipy.optimize import minimize_scalar

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import HorizontalKernel, NodeKernel, velocity_kernel
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines.columns import HATS
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.basis.slices import cell_size, ensemble_slices
from replay_kit.estimator.prior.hybrid import HybridPrior
from replay_kit.estimator.static.filter import ReducedBasisEstimator

# Lengths tried [cells]: shorter is noise on the grid, longer than this a uniform current.
_SHORTEST, _LONGEST = 0.7, 12.0
# The length is fitted on at most this many nodes, evenly taken.
_FIT_NODES = 250
# Instrument error with which the members would be measured, in the fit [m/s].
_FIT_ERROR_STD = 0.09
# Share of the prior variance that the dropped modes may have.
_DROPPED = 1e-4


def build_gp(ensemble: Ensemble, config: EstimatorConfig) -> ReducedBasisEstimator:
    """Return the regression as an estimator; ``config.modes`` bounds its modes, ``config.length_horizontal`` fixes its length."""
    grid, slices = ensemble.grid, ensemble_slices(ensemble)
    depth_cov = second_moments(slices)
    length = config.length_horizontal or fit_length(ensemble, depth_cov)
    kernel = HorizontalKernel(length, length, 1.0)
    values, vectors = np.linalg.eigh(velocity_kernel(kernel, grid.nodes, grid.nodes))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    dropped = 1.0 - np.cumsum(values) / values.sum()
    n_modes = min(int(np.argmax(dropped < _DROPPED)) + 1, config.modes or values.size)
    n_levels = grid.levels.size
    no_members = np.empty((0, n_levels, n_modes))
    basis = Basis(
        grid=grid,
        horizontal=NodeKernel(kernel, grid.nodes),
        depth_functions=HATS,
        offset=np.zeros((values.size, n_levels)),
        modes=vectors[:, :n_modes] / np.sqrt(values[:n_modes]),
        singular_values=np.sqrt(values),
        member_weights=no_members,
        truncation_std=np.sqrt(max(dropped[n_modes - 1], 0.0) * np.diag(depth_cov)),
    )
    strength, functions = np.linalg.eigh(depth_cov)
    prior = HybridPrior(
        np.zeros(n_levels * n_modes),
        no_members,
        functions.T,
        strength[:, None, None] * np.eye(n_modes),
    )
    return ReducedBasisEstimator(
        basis, prior, None, basis.representation_std(config), ensemble.time_ns
    )


def second_moments(slices: Array) -> Array:
    """Return the covariance between levels about zero of a component, shape (Z, Z) [m^2/s^2].

    Args:
        slices: shape (E, Z, 2N) [m/s].
    """
    return np.asarray(
        np.einsum("ezn,eyn->zy", slices, slices) / (slices.shape[0] * slices.shape[2])
    )


def fit_length(ensemble: Ensemble, depth_cov: Array) -> float:
    """Return the kernel's length [m] that makes the members, as an instrument would measure them, most likely.

    Args:
        ensemble: The members.
        depth_cov: shape (Z, Z) [m^2/s^2], covariance between levels.
    """
    nodes = ensemble.grid.nodes
    chosen = np.unique(
        np.linspace(0, nodes.shape[0] - 1, min(_FIT_NODES, nodes.shape[0])).round().astype(np.intp)
    )
    slices = ensemble_slices(ensemble)[..., np.concatenate([chosen, chosen + nodes.shape[0]])]
    # the principal components of the levels are independent processes with the same kernel
    variances, rotation = np.linalg.eigh(depth_cov)
    components = np.einsum("ezn,zq->qen", slices, rotation)

    def cost(log_length: float) -> float:
        length = float(np.exp(log_length))
        kernel = velocity_kernel(
            HorizontalKernel(length, length, 1.0), nodes[chosen], nodes[chosen]
        )
        return -expected_log_likelihood(
            kernel, np.maximum(variances, 0.0), components, _FIT_ERROR_STD
        )

    cell = float(np.sqrt(np.prod(cell_size(ensemble.grid))))
    bounds = float(np.log(_SHORTEST * cell)), float(np.log(_LONGEST * cell))
    return float(
        np.exp(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 0.02}).x)
    )


def expected_log_likelihood(
    kernel: Array, variances: Array, fields: Array, error_std: float
) -> float:
    """Return the log likelihood of fields plus independent noise, in the mean over the noise and the fields.

    Args:
        kernel: shape (n, n), covariance of a field of unit variance.
        variances: shape (Q,) [m^2/s^2], of each kind of field.
        fields: shape (Q, E, n) [m/s].
        error_std: Of the noise [m/s].
    """
    values, vectors = np.linalg.eigh(kernel)
    noise = error_std**2
    total = 0.0
    for variance, of_kind in zip(variances, fields, strict=True):
        spectrum = variance * np.maximum(values, 0.0) + noise
        power = np.mean((of_kind @ vectors) ** 2, axis=0) + noise
        total -= 0.5 * float(np.sum(np.log(2.0 * np.pi * spectrum) + power / spectrum))
    return total
