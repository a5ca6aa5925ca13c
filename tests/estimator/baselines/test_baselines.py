"""Each baseline against its slow twin on a small ensemble."""

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.estimator.baselines.builders import (
    BASELINES,
    average_over_depth,
    build_baseline,
    mean_depth_weights,
)
from replay_kit.estimator.baselines.columns import HATS
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
from tests.estimator.runs import run
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


def test_the_mean_over_depth_of_hats_is_exact_between_any_levels():
    levels, depth = np.array([0.0, 7.3, 31.9, 96.4]), 60.0
    values = np.array([0.4, -0.3, 0.2, -0.1])
    bends = np.array([0.0, 7.3, 31.9, depth])
    exact = np.trapezoid(np.interp(bends, levels, values), bends) / depth
    assert mean_depth_weights(HATS, levels, depth) @ values == pytest.approx(exact, abs=1e-12)


def test_a_mean_over_depth_needs_no_uncertainty():
    flow = build_baseline("nearest", SMALL, CONFIG)
    averaged = average_over_depth(flow.flow(flow.initial()), 220.0)
    assert averaged.n_modes == 0
    assert np.ptp(averaged.velocity(0.0, 0.0, np.array([0.0, 100.0, 220.0])), axis=0).max() < 1e-12


@pytest.mark.parametrize("name", BASELINES)
def test_a_profile_partly_below_the_grid_is_used_in_part(name):
    estimator = build_baseline(name, SMALL, CONFIG)
    depth = np.array([50.0, 150.0, 250.0])
    _, said = estimator.step(
        estimator.initial(), synthetic.profile(GRID, 0.0, 0.0, depth, np.full((3, 2), 0.1))
    )
    assert said.dof == 4
    assert np.isfinite(said.innovation[:2]).all()
    assert np.isnan(said.innovation[2]).all()


@pytest.mark.parametrize(
    ("name", "text"),
    [("kriging", "or one of"), ("etkf", "--estimator has no etkf any more: leave it out")],
)
def test_what_cannot_be_built_is_said(name, text):
    with pytest.raises(ConfigError, match=text):
        build_baseline(name, SMALL, CONFIG)


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
