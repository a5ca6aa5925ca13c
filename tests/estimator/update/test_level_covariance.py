"""The covariance of some levels' weights is that part of the whole one, in every form of the estimate; depth slices ask for no more.

The parts are differences of matrices as large as the prior's, so the tolerance is 1e-12 of the prior's scale.
"""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.covariance import quadratic_form, sums_for
from replay_kit.core.flow.factors import covariance_of_sum
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import FilterState, build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.prior.amplitude import ScaledPrior
from replay_kit.estimator.prior.conditioned import FullCovariancePrior
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.posterior import directions, nonzero_mode_std
from replay_kit.estimator.update.reduced_subspace import (
    ReducedSubspacePosterior,
    to_reduced_subspace,
)
from replay_kit.estimator.update.representation import PosteriorCovariance, to_full_covariance
from replay_kit.results.slices import depth_slice
from tests import synthetic
from tests.estimator.runs import after
from tests.estimator.update.test_representation import observed

LEVELS = np.array([5.0, 90.0, 220.0, 300.0])
WORLD = synthetic.ensemble(n_members=9, shape=(5, 7), levels=LEVELS)
CHOSEN = (2, 0)


def last_state(estimator, seed=0, state=None):
    places = np.random.default_rng(seed + 100).uniform(-1.5e4, 1.5e4, (6, 2))
    return after(estimator, observed(places, seed, world=WORLD), state)


def static(preset):
    return build_estimator(WORLD, EstimatorConfig(preset=preset, length_vertical=60.0, modes=20))


def evolving():
    series = tuple(
        Ensemble(WORLD.grid, WORLD.velocity, day * 86_400 * 10**9, "made") for day in (0, 1)
    )
    return build_evolving(
        series,
        EstimatorConfig(modes=12, sample_share=0.5),
        TimeConfig(scale=432_000.0),
        GatingConfig(),
    )


def posteriors():
    for preset in ("default", "paper"):
        estimator = static(preset)
        first = last_state(estimator).posterior
        assert isinstance(first, ObservationSpacePosterior)
        yield first
        std = nonzero_mode_std(first.prior)
        yield to_reduced_subspace(first, directions(first.profile_basis * std), std)
        whole = to_full_covariance(first)
        yield whole
        yield last_state(estimator, 1, FilterState(whole)).posterior


@pytest.mark.parametrize("index", range(8))
def test_the_covariance_of_some_levels_is_that_part_of_the_whole(index):
    posterior = list(posteriors())[index]
    kinds = [
        ObservationSpacePosterior,
        ReducedSubspacePosterior,
        ObservationSpacePosterior,
        ObservationSpacePosterior,
    ]
    assert isinstance(posterior, kinds[index % 4])
    assert isinstance(posterior.prior, FullCovariancePrior) == (index % 4 > 1)
    r = posterior.covariance().shape[0] // LEVELS.size
    at = np.concatenate([np.arange(level * r, (level + 1) * r) for level in CHOSEN])
    expected = posterior.covariance()[np.ix_(at, at)]
    scale = np.abs(posterior.prior.covariance()).max()
    np.testing.assert_allclose(posterior.covariance(CHOSEN), expected, rtol=0.0, atol=1e-12 * scale)


@pytest.mark.parametrize("index", range(8))
@pytest.mark.parametrize("levels", [(2,), (3, 1), (0, 1, 2, 3)])
def test_the_covariance_of_a_sum_of_levels_is_the_sum_of_its_blocks(index, levels):
    posterior = list(posteriors())[index]
    for scaled in (posterior, replace(posterior, prior=ScaledPrior(posterior.prior, 1.7))):
        blocks = scaled.covariance(levels).reshape(
            len(levels), -1, len(levels), scaled.covariance((0,)).shape[0]
        )
        scale = np.abs(scaled.prior.covariance()).max()
        np.testing.assert_allclose(
            PosteriorCovariance(scaled).of_sum(levels),
            blocks.sum(axis=(0, 2)),
            rtol=0.0,
            atol=1e-11 * scale,
        )


def test_covariances_of_one_and_two_levels_give_that_at_every_depth():
    rng = np.random.default_rng(0)
    factor = rng.standard_normal((12, 12))
    cov, rows = factor @ factor.T, rng.standard_normal((7, 3))
    weights = depth_weights(
        DepthFunctions("hat", 0.0), np.array([0.0, 5.0, 40.0, 90.0, 250.0, 400.0]), LEVELS
    )
    sums, shares = sums_for(weights)
    assert len(sums) == 6  # three levels, two pairs of neighbours, one of them used twice
    parts = [covariance_of_sum(cov, levels, 3) for levels in sums]
    for row, of_depth in zip(weights, shares, strict=True):
        design = np.kron(row, np.eye(3))
        mixed = sum(share * part for share, part in zip(of_depth, parts, strict=True))
        np.testing.assert_allclose(mixed, design @ cov @ design.T, atol=1e-12)
        np.testing.assert_allclose(
            quadratic_form(rows, mixed), np.diag(rows @ mixed @ rows.T), atol=1e-11
        )


def test_a_quadratic_form_of_a_matrix_of_several_blocks():
    rng = np.random.default_rng(1)
    factor, rows = rng.standard_normal((150, 150)), rng.standard_normal((4, 150))
    cov = factor @ factor.T
    np.testing.assert_allclose(quadratic_form(rows, cov), np.diag(rows @ cov @ rows.T), rtol=1e-12)


ESTIMATORS = {
    "static": lambda: static("default"),
    "evolving": evolving,
}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_depth_slice_needs_the_covariance_of_its_levels_alone(name):
    estimator = ESTIMATORS[name]()
    state = last_state(estimator)
    for depth in (90.0, 150.0):
        flow, whole = estimator.flow(state), estimator.flow(state)
        assert whole.weight_cov.shape == (LEVELS.size * flow.n_modes, LEVELS.size * flow.n_modes)
        errors = depth_slice(flow, depth).standard_error
        assert "weight_cov" not in vars(flow)
        np.testing.assert_allclose(errors, depth_slice(whole, depth).standard_error, rtol=1e-10)
        assert np.isfinite(errors).any()


def test_no_points_need_no_covariance():
    estimator = ESTIMATORS["static"]()
    flow = estimator.flow(estimator.initial())
    assert flow.standard_error(np.empty(0), 0.0, 10.0).shape == (0, 2)
    assert "weight_cov" not in vars(flow)
