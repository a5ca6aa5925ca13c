"""Each baseline against its slow twin on a small ensemble."""

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.estimator import build_estimator
from replay_kit.estimator.baselines.builders import (
    BASELINES,
    average_over_depth,
    build_baseline,
    mean_depth_weights,
)
from replay_kit.estimator.baselines.columns import HATS
from replay_kit.estimator.baselines.etkf import build_letkf
from replay_kit.estimator.baselines.gp import (
    build_gp,
    expected_log_likelihood,
    fit_length,
    second_moments,
)
from replay_kit.estimator.basis.slices import cell_size, ensemble_slices
from replay_kit.estimator.prior.localised import gaspari_cohn
from tests import synthetic
from tests.estimator.baselines.small import (
    CONFIG,
    DEPTHS,
    GRID,
    MEMBERS,
    SMALL,
    STD,
    at_nodes,
    from_nodes,
    members_at,
    profiles,
    std_at_nodes,
)
from tests.estimator.runs import assert_alike, run
from tests.reference import baselines as slow


def test_nearest_is_the_member_of_least_squares():
    observations, places, values = profiles(4, seed=3)
    estimator = build_baseline("nearest", SMALL, CONFIG)
    state, said = run(estimator, observations)
    at_profiles = [members_at(place) for place in places]
    expected = slow.nearest(at_profiles, values, [STD] * 4)
    assert estimator.chosen(state) == expected
    np.testing.assert_allclose(
        said[-1].residual, values[-1] - at_profiles[-1][expected], atol=1e-10
    )
    np.testing.assert_allclose(
        estimator.innovation(state, observations[0]),
        values[0] - at_profiles[0][expected],
        atol=1e-10,
    )
    np.testing.assert_allclose(at_nodes(estimator.flow(state)), MEMBERS[expected], atol=2e-3)
    assert np.isnan(said[-1].nis)


def test_a_measured_member_is_found():
    estimator = build_baseline("nearest", SMALL, CONFIG)
    place = np.array([4_000.0, -3_000.0])
    observation = synthetic.profile(GRID, *place, DEPTHS, members_at(place)[3], STD)
    state, said = estimator.step(estimator.initial(), observation)
    assert estimator.chosen(state) == 3
    # 1.5e-10 is seen: rounding grows with the condition number of the fit, 1 / nugget
    np.testing.assert_allclose(said.residual, 0.0, atol=1e-9)


def test_naive_equals_a_textbook_filter_on_whole_member_modes():
    observations, places, values = profiles(5)
    estimator = build_baseline("naive3d", SMALL, CONFIG)
    state, said = run(estimator, observations)

    def seen_at(place):
        def design(modes):
            flows = modes.T.reshape(-1, *MEMBERS.shape[1:])
            seen = slow.design_of_members(flows, GRID.levels, from_nodes(place), DEPTHS)
            return seen.reshape(len(flows), -1).T

        return design

    modes, mean, cov = slow.naive(MEMBERS, [seen_at(place) for place in places], values, [STD] * 5)
    np.testing.assert_allclose(
        np.einsum("m,mzn->zn", state.mean, estimator.velocity).ravel(), modes @ mean, atol=1e-10
    )
    flow = estimator.flow(state)
    np.testing.assert_allclose(at_nodes(flow), (modes @ mean).reshape(3, -1), atol=2e-3)
    std = np.sqrt(np.diag(modes @ cov @ modes.T)).reshape(3, -1)
    np.testing.assert_allclose(std_at_nodes(flow), std, atol=1e-3)
    np.testing.assert_allclose(
        estimator.innovation(state, observations[-1]), said[-1].residual, atol=1e-12
    )


def test_etkf_equals_the_kalman_filter_with_the_sample_covariance():
    observations, _, _ = profiles(6)
    config = EstimatorConfig(modes=12, sample_share=1.0, shift_distance=0.0, mean_variance=0.0)
    textbook, estimator = build_estimator(SMALL, config), build_baseline("etkf", SMALL, config)
    expected, expected_said = run(textbook, observations)
    state, said = run(estimator, observations)
    flow, other = estimator.flow(state), textbook.flow(expected)
    np.testing.assert_allclose(flow.latent, other.latent, atol=1e-9 * np.abs(other.latent).max())
    np.testing.assert_allclose(
        flow.weight_cov, other.weight_cov, atol=1e-10 * np.abs(textbook.prior.covariance()).max()
    )
    assert_alike(said, expected_said, 1e-9, 1e-10)
    np.testing.assert_allclose(
        estimator.innovation(state, observations[2]),
        textbook.innovation(expected, observations[2]),
        atol=1e-10,
    )


def test_the_ensemble_s_mean_does_not_learn():
    estimator = build_baseline("ensemble_mean", SMALL, CONFIG)
    observations, _, _ = profiles(3)
    state, said = run(estimator, observations)
    assert state is not None
    np.testing.assert_allclose(at_nodes(estimator.flow(state)), MEMBERS.mean(axis=0), atol=2e-3)
    np.testing.assert_allclose(
        std_at_nodes(estimator.flow(state)), MEMBERS.std(axis=0, ddof=1), atol=2e-3
    )
    np.testing.assert_array_equal(said[2].innovation, said[2].prior_innovation)
    np.testing.assert_array_equal(said[2].innovation, said[2].residual)


def test_letkf_without_a_taper_is_the_etkf():
    """A radius far beyond the region: every column has the same analysis, that of the sample covariance."""
    observations, _, values = profiles(4)
    local, everywhere = (
        build_letkf(SMALL, EstimatorConfig(), 1e10),
        build_baseline("etkf", SMALL, EstimatorConfig(modes=None, representation_error_std=0.0)),
    )
    state, said = run(local, observations)
    other, other_said = run(everywhere, observations)
    for ours, theirs in zip(said, other_said, strict=True):
        assert ours.nis == pytest.approx(theirs.nis, rel=1e-6)
        np.testing.assert_allclose(ours.innovation_std, theirs.innovation_std, rtol=1e-6)
    np.testing.assert_allclose(
        at_nodes(local.flow(state)), at_nodes(everywhere.flow(other)), atol=1e-5
    )
    expected = everywhere.innovation(other, observations[0])
    np.testing.assert_allclose(local.innovation(state, observations[0]), expected, atol=1e-6)
    assert values[0].shape == expected.shape


def test_letkf_knows_nothing_beyond_its_radius():
    estimator = build_letkf(SMALL, CONFIG, 8_000.0)
    corner = GRID.nodes[0]
    observation = synthetic.profile(GRID, *(corner + 500.0), DEPTHS, np.full((3, 2), 0.5), 0.01)
    state, _ = estimator.step(estimator.initial(), observation)
    before, after = at_nodes(estimator.flow(estimator.initial())), at_nodes(estimator.flow(state))
    far = len(GRID.nodes) - 1
    np.testing.assert_allclose(after[:, far], before[:, far], atol=2e-3)
    assert np.abs(after[:, 0] - before[:, 0]).max() > 0.02


def test_the_taper_is_gaspari_and_cohn_s():
    distance = np.linspace(0.0, 30.0, 61)
    np.testing.assert_allclose(
        gaspari_cohn(distance, 20.0), [slow.gaspari_cohn(d, 20.0) for d in distance], atol=1e-14
    )


def test_gp_equals_the_finite_model_written_out():
    observations, places, values = profiles(4)
    length = 9_000.0
    estimator = build_gp(SMALL, EstimatorConfig(length_horizontal=length, modes=None))
    state, _ = run(estimator, observations)
    depth_cov = second_moments(MEMBERS)
    mean, cov = slow.gp_at_nodes(
        GRID.nodes, GRID.levels, length, depth_cov, places, DEPTHS, values, [STD] * 4
    )
    flow = estimator.flow(state)
    # modes that carry less than 1e-4 of the variance are left out
    np.testing.assert_allclose(at_nodes(flow), mean.reshape(3, -1), atol=2e-3)
    np.testing.assert_allclose(std_at_nodes(flow), np.sqrt(np.diag(cov)).reshape(3, -1), rtol=1e-2)


def test_gp_prior_has_zero_mean_and_the_members_strength():
    estimator = build_baseline("gp", SMALL, EstimatorConfig(modes=None))
    flow = estimator.flow(estimator.initial())
    expected = np.sqrt(np.mean(MEMBERS**2, axis=(0, 2)))
    np.testing.assert_allclose(
        std_at_nodes(flow), np.broadcast_to(expected[:, None], (3, 2 * len(GRID.nodes))), rtol=1e-2
    )
    np.testing.assert_array_equal(flow.latent, 0.0)


def test_gp_finds_the_length_that_made_the_fields():
    grid = synthetic.ensemble(n_members=2, shape=(7, 8)).grid
    length = 17_000.0
    covariance = slow.kernel_matrix(grid.nodes, grid.nodes, length, length)
    values, vectors = np.linalg.eigh(covariance)
    draws = np.random.default_rng(0).standard_normal((60, 2, values.size)) * np.sqrt(
        np.maximum(values, 0.0)
    )
    fields = (0.4 * draws @ vectors.T).reshape(60, 2, 2, 7, 8).transpose(0, 2, 1, 3, 4)
    few = synthetic.ensemble(n_members=2, shape=(7, 8), levels=np.array([5.0, 90.0])).grid
    ensemble = type(SMALL)(few, fields, None, "drawn")
    assert fit_length(ensemble, second_moments(ensemble_slices(ensemble))) == pytest.approx(
        length, rel=0.06
    )


def test_gp_s_likelihood_is_that_of_the_fields_with_noise_in_the_mean():
    rng, error = np.random.default_rng(5), 0.3
    half, fields = rng.standard_normal((4, 4)), rng.standard_normal((2, 3, 4))
    expected = 0.0
    for variance, of_kind in zip((0.5, 0.0), fields, strict=True):
        covariance = variance * half @ half.T + error**2 * np.eye(4)
        inverse = np.linalg.inv(covariance)
        squares = np.mean(np.einsum("en,nm,em->e", of_kind, inverse, of_kind))
        # noise adds its own square in the mean
        squares += error**2 * np.trace(inverse)
        expected -= 0.5 * (np.linalg.slogdet(2.0 * np.pi * covariance)[1] + squares)
    found = expected_log_likelihood(half @ half.T, np.array([0.5, 0.0]), fields, error)
    assert found == pytest.approx(expected)


@pytest.mark.parametrize(("rough", "cells"), [(1.0, 0.7), (0.0, 12.0)])
def test_gp_takes_noise_for_the_shortest_length_tried_and_a_uniform_current_for_the_longest(
    rough, cells
):
    grid = synthetic.ensemble(n_members=2, shape=(7, 8), levels=np.array([5.0])).grid
    rng = np.random.default_rng(3)
    fields = rough * rng.standard_normal((60, 2, 1, 7, 8)) + (1.0 - rough) * rng.standard_normal(
        (60, 2, 1, 1, 1)
    )
    ensemble = type(SMALL)(grid, fields, None, "drawn")
    cell = np.sqrt(np.prod(cell_size(grid)))
    assert fit_length(ensemble, second_moments(ensemble_slices(ensemble))) == pytest.approx(
        cells * cell, rel=0.03
    )


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_depth_average_is_the_thickness_weighted_mean(preset):
    config = EstimatorConfig(preset=preset, modes=8)
    estimator, full = (
        build_baseline("depth_average", SMALL, config, depth=150.0),
        build_estimator(SMALL, config),
    )
    observations, _, _ = profiles(3)
    state, said = run(estimator, observations)
    _, full_said = run(full, observations)
    assert [s.nis for s in said] == [s.nis for s in full_said]
    averaged, flow = estimator.flow(state), full.flow(state)
    depths = np.linspace(0.0, 150.0, 3001)
    fine = flow.velocity(2_000.0, -1_000.0, depths)
    expected = np.trapezoid(fine, depths, axis=0) / 150.0
    for depth in (0.0, 60.0, 400.0):
        np.testing.assert_allclose(averaged.velocity(2_000.0, -1_000.0, depth), expected, atol=1e-5)
    drawn = np.array(
        [
            np.trapezoid(s.velocity(0.0, 0.0, depths[::30]), depths[::30], axis=0) / 150.0
            for s in flow.sample(400, seed=0)
        ]
    )
    np.testing.assert_allclose(
        averaged.standard_error(0.0, 0.0, 30.0), drawn.std(axis=0), rtol=0.12
    )


def test_the_mean_over_depth_of_hats_is_exact_between_any_levels():
    levels, depth = np.array([0.0, 7.3, 31.9, 96.4]), 60.0
    values = np.array([0.4, -0.3, 0.2, -0.1])
    bends = np.array([0.0, 7.3, 31.9, depth])
    exact = np.trapezoid(np.interp(bends, levels, values), bends) / depth
    assert mean_depth_weights(HATS, levels, depth) @ values == pytest.approx(exact, abs=1e-12)


def test_depth_average_needs_no_uncertainty():
    flow = build_baseline("nearest", SMALL, CONFIG)
    averaged = average_over_depth(flow.flow(flow.initial()), 220.0)
    assert averaged.n_modes == 0
    assert np.ptp(averaged.velocity(0.0, 0.0, np.array([0.0, 100.0, 220.0])), axis=0).max() < 1e-12


@pytest.mark.parametrize("name", BASELINES)
def test_a_profile_partly_below_the_grid_is_used_in_part(name):
    estimator = build_baseline(name, SMALL, CONFIG, depth=100.0)
    depth = np.array([50.0, 150.0, 250.0])
    _, said = estimator.step(
        estimator.initial(), synthetic.profile(GRID, 0.0, 0.0, depth, np.full((3, 2), 0.1))
    )
    assert said.dof == 4
    assert np.isfinite(said.innovation[:2]).all()
    assert np.isnan(said.innovation[2]).all()


@pytest.mark.parametrize(
    ("name", "depth", "text"),
    [("kriging", None, "or one of"), ("depth_average", None, "depth > 0")],
)
def test_what_cannot_be_built_is_said(name, depth, text):
    with pytest.raises(ConfigError, match=text):
        build_baseline(name, SMALL, CONFIG, depth)


def test_the_paper_s_error_model_holds_for_the_paper_s_baseline():
    config = EstimatorConfig(preset="paper", modes=5)
    observation = profiles(1)[0][0]
    estimator = build_baseline("naive3d", SMALL, config)
    _, said = estimator.step(estimator.initial(), observation)
    assert said.innovation_std.min() >= 0.12


def test_local_values_are_rotated_like_the_estimator_s():
    observation = profiles(1)[0][0]
    place = to_local(GRID.projection, observation.longitude, observation.latitude)
    local = np.column_stack(
        rotate_to_local(
            GRID.projection, observation.longitude, observation.latitude, *observation.velocity.T
        )
    )
    estimator = build_baseline("nearest", SMALL, CONFIG)
    _, said = estimator.step(estimator.initial(), observation)
    np.testing.assert_allclose(
        local - said.prior_innovation,
        members_at(np.array(place))[estimator.chosen(estimator.initial())],
        atol=1e-9,
    )
