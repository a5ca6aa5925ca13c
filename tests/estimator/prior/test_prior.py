"""The prior's parts against one dense matrix, and against a slow twin that builds it entry by entry."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build_estimator
from replay_kit.estimator.basis.shifts import shifted_copies
from replay_kit.estimator.basis.slices import cell_size, correlation_length, ensemble_slices
from replay_kit.estimator.prior.conditioned import full_covariance_prior
from tests import synthetic
from tests.reference import estimator as slow
from tests.reference.baselines import gaspari_cohn as slow_taper
from tests.reference.lattice import matrix as functions_at

SMALL = synthetic.ensemble(n_members=5, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
CONFIGS = {
    "hybrid": EstimatorConfig(),
    "sample": EstimatorConfig(sample_share=1.0, shift_distance=0.0, mean_variance=0.0),
    "localised": EstimatorConfig(sample_share=0.0),
    "paper": EstimatorConfig(preset="paper", length_vertical=60.0),
}


def test_the_prior_is_the_twin_s_projected_on_the_modes():
    share, shift, radius, of_mean = 0.3, 1.2e4, 4e4, 0.2
    config = EstimatorConfig(
        sample_share=share, shift_distance=shift, localisation_radius=radius, mean_variance=of_mean
    )
    estimator = build_estimator(SMALL, config)
    basis, nodes = estimator.basis, SMALL.grid.nodes
    velocity_modes = functions_at(basis.horizontal, nodes) @ basis.modes
    fields = basis.member_weights @ velocity_modes.T
    twin = slow.hybrid_covariance(fields, velocity_modes, nodes, share, shift, radius, slow_taper)
    projector = np.kron(np.eye(basis.member_weights.shape[1]), np.linalg.pinv(velocity_modes))
    mean = basis.mean_weights @ velocity_modes.T
    # but for the nugget, and what no flow without divergence has
    np.testing.assert_allclose(
        mean, ensemble_slices(SMALL).mean(axis=0), atol=5e-3 * np.abs(mean).max()
    )
    twin += of_mean * np.outer(mean, mean)
    np.testing.assert_allclose(
        estimator.prior.covariance(), projector @ twin @ projector.T, atol=1e-12
    )


def prior_named(name):
    if name != "dense":
        return build_estimator(SMALL, CONFIGS[name]).prior
    hybrid = build_estimator(SMALL, CONFIGS["hybrid"]).prior
    return full_covariance_prior(hybrid.mean, hybrid.covariance(), 3)


@pytest.mark.parametrize("name", [*CONFIGS, "dense"])
def test_products_with_the_parts_are_products_with_the_matrix(name):
    prior = prior_named(name)
    dense = prior.covariance()
    assert np.linalg.eigvalsh(dense).min() > -1e-12 * np.abs(dense).max()
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((4, 3, dense.shape[0] // 3))
    scale = np.abs(dense).max()
    np.testing.assert_allclose(
        prior.matvec(weights).reshape(4, -1), weights.reshape(4, -1) @ dense, atol=1e-12 * scale
    )
    basis = weights[0, :2]
    columns = np.einsum("zy,cr->zcyr", np.eye(3), basis).reshape(6, -1)
    np.testing.assert_allclose(
        prior.matvec_modes(basis).reshape(6, -1), columns @ dense, atol=1e-12 * scale
    )


def test_a_dense_prior_is_the_matrix_it_was_made_of_and_less_takes_rows_away():
    hybrid = build_estimator(SMALL, CONFIGS["hybrid"]).prior
    matrix = hybrid.covariance()
    prior = full_covariance_prior(hybrid.mean, matrix, 3)
    np.testing.assert_allclose(
        prior.covariance(), matrix, atol=1e-16
    )  # the upper half is the lower one mirrored
    np.testing.assert_allclose(prior.mode_std(), hybrid.mode_std(), rtol=1e-12)
    rows = 0.1 * np.random.default_rng(1).standard_normal((7, len(matrix)))
    less = prior.downdate(hybrid.mean + 1.0, rows)
    np.testing.assert_allclose(less.covariance(), matrix - rows.T @ rows, atol=1e-14)
    np.testing.assert_array_equal(less.mean, hybrid.mean + 1.0)


def test_without_shift_or_localisation_it_is_the_sample_covariance():
    estimator = build_estimator(SMALL, CONFIGS["sample"])
    np.testing.assert_allclose(
        estimator.prior.covariance(),
        np.cov(estimator.basis.member_weights.reshape(5, -1).T),
        atol=1e-14,
    )


def test_copies_shift_the_interior_and_repeat_the_edge():
    nodes = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    copies = (
        shifted_copies(np.arange(6.0).reshape(1, 1, 6), nodes, 1.0)
        * np.sqrt(6.0 / np.array([2, 1, 1, 1, 1]))[:, None, None]
    )
    np.testing.assert_allclose(
        copies[:3, 0], [[0, 1, 2, 3, 4, 5], [1, 2, 2, 4, 5, 5], [0, 0, 1, 3, 3, 4]]
    )
    np.testing.assert_allclose(copies[3:, 0], [[0, 1, 2, 3, 4, 5]] * 2)


def test_the_correlation_length_equals_a_pair_by_pair_twin_with_land_and_is_at_least_a_cell():
    wet = np.ones(SMALL.grid.wet.shape, dtype=bool)
    wet[:, 1:3, 2], wet[2, 0, 0] = False, False
    smooth = synthetic.ensemble(n_members=5, shape=(4, 5), levels=SMALL.grid.levels, step=0.02)
    with_land = replace(smooth, grid=replace(smooth.grid, wet=wet))
    expected = slow.correlation_length(
        with_land.velocity, with_land.grid.east, with_land.grid.north, wet
    )
    cell = np.sqrt(np.prod(cell_size(with_land.grid)))
    assert expected > 1.1 * cell
    assert correlation_length(with_land) == pytest.approx(expected, rel=1e-12)
    rough = replace(
        smooth, velocity=np.random.default_rng(0).standard_normal(smooth.velocity.shape)
    )
    assert correlation_length(rough) == pytest.approx(cell)
    assert correlation_length(
        replace(smooth, velocity=np.ones_like(smooth.velocity))
    ) == pytest.approx(cell)
