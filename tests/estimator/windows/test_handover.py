"""What one window learnt is what the next one knows, no more and no less."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Flag
from replay_kit.estimator import build_estimator
from replay_kit.estimator.prior.conditioned import conditioned
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.representation import select_representation, to_full_covariance
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.estimator.windows.handover import hand_over, overlap
from tests import synthetic

CONFIG = EstimatorConfig(modes=20, sample_share=0.4, representation_error_std=0.0)
WHOLE = synthetic.ensemble(3, n_members=12, shape=(8, 12))


def columns(first, last) -> Ensemble:
    """Some columns of the ensemble, in its local frame."""
    part, grid = slice(first, last), WHOLE.grid
    cut = {
        name: getattr(grid, name)[..., part]
        for name in ("longitude", "latitude", "east", "north", "wet")
    }
    return replace(WHOLE, grid=replace(grid, **cut), velocity=WHOLE.velocity[..., part])


def after(estimator, n=12, seed=1):
    *_, (state, _) = estimator.steps(
        estimator.initial(), synthetic.random_profiles(estimator.basis.grid, n, seed)
    )
    return state


def at_common_points(one, other, *states):
    """Means and standard errors of some estimators' states where the windows of two overlap."""
    points = overlap(one.basis.grid, other.basis.grid)
    return [at_points(estimator, state, points) for estimator, state in states]


def at_points(estimator, state, points):
    east, north = np.repeat(points[None], 3, axis=0).reshape(-1, 2).T
    depth = np.repeat([20.0, 90.0, 200.0], len(points))
    flow = estimator.flow(state)
    return flow.velocity(east, north, depth), flow.standard_error(east, north, depth)


@pytest.fixture(scope="module")
def one():
    return build_estimator(columns(0, 8), CONFIG)


def test_a_window_handed_over_to_itself_is_the_same(one):
    state = after(one)
    again, loss = hand_over(one, state, one)
    (mean, error), (mean_again, error_again), (_, prior_error) = at_common_points(
        one, one, (one, state), (one, again), (one, one.initial())
    )
    assert loss < 0.01
    assert np.abs(mean_again - mean).max() < 0.2 * error.min()
    assert np.sqrt(np.mean((error_again / error - 1.0) ** 2)) < 0.03
    assert error.mean() < 0.5 * prior_error.mean()


def test_where_windows_overlap_the_next_knows_what_was_learnt_within_its_standard_error(one):
    state, other = after(one), build_estimator(columns(3, 12), CONFIG)
    begun, _ = hand_over(one, state, other)
    (mean, error), (begun_mean, begun_error), (prior_mean, prior_error) = at_common_points(
        one, other, (one, state), (other, begun), (other, other.initial())
    )
    change = np.sqrt(np.mean(((begun_mean - mean) / error) ** 2))
    assert change < 1.0
    assert np.sqrt(np.mean(((prior_mean - mean) / error) ** 2)) > 2.0
    assert 0.9 < np.sqrt(np.mean(begun_error**2)) / np.sqrt(np.mean(error**2)) < 1.5
    assert np.all(begun_error < 1.001 * prior_error)


def test_nothing_learnt_hands_over_the_next_prior(one):
    other = build_estimator(columns(3, 12), CONFIG)
    begun, loss = hand_over(one, one.initial(), other)
    assert loss == 0.0
    assert np.array_equal(begun.mean, other.initial().mean)
    assert np.allclose(begun.posterior.covariance(), other.prior.covariance(), atol=1e-9)


def test_windows_apart_hand_over_nothing_but_what_is_known_of_the_instrument(one):
    state, far = after(one), build_estimator(columns(8, 12), CONFIG)
    begun, _ = hand_over(one, state, far)
    assert np.array_equal(begun.mean, far.initial().mean)
    assert begun.monitor is state.monitor
    assert begun.last is state.last


def test_rows_of_any_form_condition_a_prior_as_the_textbook_says(one):
    rng = np.random.default_rng(5)
    prior = one.prior
    design = rng.standard_normal((7, *one.prior_weights.shape))
    innovation = rng.standard_normal((7, 3))
    found, sensitivity = conditioned(prior, design, innovation)
    dense, rows = prior.covariance(), design.reshape(7, -1)
    gain = dense @ rows.T @ np.linalg.inv(rows @ dense @ rows.T + np.eye(7))
    covariance = dense - gain @ rows @ dense
    scale = np.abs(dense).max()
    assert np.allclose(found.mean, prior.mean + gain @ innovation[:, 0], atol=1e-9)
    assert np.allclose(sensitivity.reshape(2, -1), (gain @ innovation[:, 1:]).T, atol=1e-9)
    assert np.allclose(found.covariance(), covariance, atol=1e-9 * scale)
    r = design.shape[2]
    assert np.allclose(
        found.covariance((1, 2)), covariance[r : 3 * r, r : 3 * r], atol=1e-9 * scale
    )
    weights = rng.standard_normal((2, *design.shape[1:]))
    assert np.allclose(
        found.matvec(weights).reshape(2, -1), weights.reshape(2, -1) @ covariance, atol=1e-8 * scale
    )
    basis, by_level = (
        rng.standard_normal((3, r)),
        covariance.reshape(len(design[0]), r, len(design[0]), r),
    )
    assert np.allclose(
        found.matvec_modes(basis), np.einsum("cr,zryq->zcyq", basis, by_level), atol=1e-8 * scale
    )
    assert np.allclose(
        found.matvec_modes(basis, (2,)),
        np.einsum("cr,zryq->zcyq", basis, by_level[:, :, 2:3]),
        atol=1e-8 * scale,
    )
    assert np.allclose(
        found.mode_std() ** 2, np.einsum("zrzr->r", by_level) / len(design[0]), atol=1e-9 * scale
    )


@pytest.mark.parametrize("n", [5, 40])
def test_the_covariance_of_combinations_is_that_of_the_weights(one, n):
    posterior = after(one, n).posterior
    design = np.random.default_rng(2).standard_normal((4, *one.prior_weights.shape))
    rows = design.reshape(4, -1)
    for form in (posterior, select_representation(posterior), to_full_covariance(posterior)):
        expected = rows @ form.covariance() @ rows.T
        assert np.allclose(
            form.covariance_of(design),
            expected,
            atol=1e-9 * np.abs(rows @ one.prior.covariance() @ rows.T).max(),
        )


def test_windows_say_of_measurements_what_the_estimator_of_the_window_says(one):
    grid = one.basis.grid
    west, south, east, north = (
        f(values) for f in (np.min, np.max) for values in (grid.longitude, grid.latitude)
    )
    windows = WindowedEstimator(
        (west, south, east, north), 1.0, (west, south, east + 1.0, north), lambda _: one
    )
    first, *others = log = synthetic.random_profiles(grid, 5, 3)
    state, inner = windows.initial(), one.initial()
    for profile in log:
        np.testing.assert_array_equal(
            windows.innovation(state, profile), one.innovation(inner, profile)
        )
    group = ProfileGroup(tuple(others))
    np.testing.assert_array_equal(
        windows.group_innovation(state, group), one.group_innovation(inner, group)
    )
    nothing = replace(
        first,
        velocity=np.full_like(first.velocity, np.nan),
        flags=np.full_like(first.flags, Flag.FAIL),
    )
    deep = replace(first, depth=first.depth + grid.levels[-1])
    east_only = replace(first, velocity=first.velocity * [1.0, np.nan], flags=nothing.flags)
    at_bottom = replace(first, depth=first.depth - first.depth[0] + grid.levels[-1])
    for away in (0.0, 0.5):  # in the first window, and where there is none yet
        moved = [
            replace(each, longitude=each.longitude + away)
            for each in (first, at_bottom, nothing, deep, east_only)
        ]
        moved = [replace(each, longitude=east + away) if away else each for each in moved]
        assert [windows.usable(each) for each in moved] == [True, True, False, False, False]
    assert not windows.usable(replace(first, longitude=east + 1.5))


def test_a_window_that_represents_half_is_no_surer_of_what_both_know(one):
    """What it cannot take over is an error of as many unknowns as there are, not of as many as points."""
    other = build_estimator(columns(3, 12), CONFIG.model_copy(update={"modes": 10}))
    ratios = []
    for seed in range(4):
        state = after(one, seed=seed)
        begun, _ = hand_over(one, state, other)
        (_, error), (_, begun_error) = at_common_points(one, other, (one, state), (other, begun))
        ratios.append(np.sqrt(np.mean(begun_error**2) / np.mean(error**2)))
    assert np.mean(ratios) > 0.78
