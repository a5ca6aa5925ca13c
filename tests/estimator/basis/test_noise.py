"""The errors of bins against the textbook: whitening, shared errors, a platform of unknown velocity."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.observation import Flag, Reason
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.update.noise import bin_noise
from tests import synthetic
from tests.reference import estimator as slow
from tests.reference.representation import error_at

SMALL = synthetic.ensemble(n_members=6, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
DEPTH = 10.0 + 20.0 * np.arange(9)


def covariance(depth, own, extra, common, length):
    """N written out bin by bin."""
    n = depth.size
    cov = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            alike = float(i == j) if length == 0.0 else np.exp(-abs(depth[i] - depth[j]) / length)
            cov[i, j] = own[i] * own[j] * alike + (extra[i] ** 2 if i == j else 0.0) + common**2
    return cov


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 12),
    st.floats(0.0, 0.3),
    st.sampled_from([0.0, 15.0, 200.0]),
    st.integers(0, 2**16),
)
def test_whitening_makes_the_covariance_one(n, common, length, seed):
    rng = np.random.default_rng(seed)
    depth, own, extra = (
        np.sort(rng.uniform(0, 300, n)),
        rng.uniform(0.02, 0.2, n),
        rng.uniform(0.001, 0.1, n),
    )
    cov = covariance(depth, own, extra, common, length)
    noise = bin_noise(cov, relative=False)
    np.testing.assert_allclose(noise.whiten @ cov @ noise.whiten.T, np.eye(n), atol=1e-9)
    np.testing.assert_allclose(noise.unwhiten @ noise.unwhiten.T, cov, atol=1e-12)
    np.testing.assert_allclose(noise.std, np.sqrt(np.diag(cov)), rtol=1e-9)


def seen(estimator, observation, common):
    """Mean and covariance of the weights after one profile, by the textbook."""
    used = np.arange(observation.depth.size)
    rows = estimator.rows(observation, used)
    values, layout = rows.stack.values[0], rows.stack.layouts[0]
    depth_factor = layout.unwhiten @ layout.q @ rows.r
    representation = np.interp(
        observation.depth,
        SMALL.grid.levels,
        error_at(estimator, observation.longitude, observation.latitude),
    )
    noise = covariance(
        observation.depth,
        observation.error_std,
        representation,
        common,
        observation.correlation_depth,
    )
    design = np.vstack([np.kron(depth_factor, rows.basis[c]) for c in range(2)])
    return slow.kalman_update(
        estimator.prior.mean,
        estimator.prior.covariance(),
        design,
        values.T.ravel(),
        np.kron(np.eye(2), noise),
    )


@pytest.mark.parametrize(("common", "length"), [(0.05, 0.0), (0.0, 40.0), (0.02, 40.0)])
def test_a_profile_with_shared_errors_equals_the_textbook(common, length):
    estimator = build_estimator(SMALL, EstimatorConfig(modes=8, mean_variance=0.1))
    (observation,) = synthetic.random_profiles(SMALL.grid, 1, seed=3, speed=0.05)
    observation = replace(observation, common_std=common, correlation_depth=length)
    shallow = replace(
        observation,
        depth=DEPTH,
        velocity=observation.velocity[:9],
        error_std=observation.error_std[:9],
    )
    shallow = replace(shallow, flags=observation.flags[:9], reasons=observation.reasons[:9])
    mean, cov, nis, _ = seen(estimator, shallow, common)
    state, said = estimator.step(estimator.initial(), shallow)
    if said.error_inflation == 1.0:
        np.testing.assert_allclose(state.mean, mean, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(state.posterior.covariance(), cov, rtol=1e-7, atol=1e-12)
    assert said.nis == pytest.approx(nis, rel=1e-8)


def relative_to_a_moving_platform(observation, drift):
    return replace(
        observation, velocity=observation.velocity + drift, common_std=np.inf, reference="platform"
    )


def test_an_unknown_platform_is_the_limit_of_a_badly_known_one_and_its_speed_does_not_matter():
    estimator = build_estimator(SMALL, EstimatorConfig(modes=8))
    (observation,) = synthetic.random_profiles(SMALL.grid, 1, seed=3, speed=0.05)
    relative, faster = (
        relative_to_a_moving_platform(observation, np.array(drift))
        for drift in ((0.3, -0.1), (-2.0, 1.4))
    )
    said = {}
    for name, profile in (
        ("one", relative),
        ("other", faster),
        ("limit", replace(relative, common_std=300.0)),
    ):
        state, innovation = estimator.step(estimator.initial(), profile)
        said[name] = (state.mean, state.posterior.covariance(), innovation)
    np.testing.assert_allclose(said["one"][0], said["other"][0], atol=1e-9)
    np.testing.assert_allclose(said["one"][0], said["limit"][0], atol=1e-6)
    np.testing.assert_allclose(said["one"][1], said["limit"][1], atol=1e-6)
    assert said["one"][2].dof == said["limit"][2].dof - 2
    # what is left is about the profile's own mean: it sums to nothing when errors are alike
    assert np.abs(np.nansum(said["one"][2].innovation, axis=0)).max() < 0.5


def test_the_gate_of_a_profile_relative_to_its_platform_does_not_depend_on_rounding():
    """More bins than levels: their differences leave one function of depth undetermined, and no row may be made of its rounding."""
    estimator = build_estimator(SMALL, EstimatorConfig(modes=8), GatingConfig())
    (observation,) = synthetic.random_profiles(SMALL.grid, 1, seed=3, speed=0.05)
    relative = relative_to_a_moving_platform(observation, np.zeros(2))
    assert relative.depth.size > SMALL.grid.levels.size
    statistics = [
        estimator.step(estimator.initial(), replace(relative, error_std=error))[1].gate_statistic
        for error in relative.error_std * (1.0 + 1e-15 * np.arange(6)[:, None])
    ]
    np.testing.assert_allclose(statistics, statistics[0], rtol=1e-9)


@pytest.mark.parametrize("wrong", ["nan", "inf", "no error", "error without end"])
def test_bins_that_are_no_measurement_are_left_out(wrong):
    estimator = build_estimator(SMALL, EstimatorConfig(modes=8), GatingConfig())
    (observation,) = synthetic.random_profiles(SMALL.grid, 1, speed=0.05)
    velocity, error = observation.velocity.copy(), observation.error_std.copy()
    if wrong in ("nan", "inf"):
        velocity[2] = float(wrong)
    else:
        error[2] = 0.0 if wrong == "no error" else np.inf
    state, said = estimator.step(
        estimator.initial(), replace(observation, velocity=velocity, error_std=error)
    )
    assert said.accepted
    assert said.reasons[2] & Reason.MALFORMED
    assert np.isfinite(state.mean).all()
    # the same as if the bin had not been there
    flags = observation.flags.copy()
    flags[2] = Flag.MISSING
    expected, _ = estimator.step(estimator.initial(), replace(observation, flags=flags))
    np.testing.assert_array_equal(state.mean, expected.mean)


@pytest.mark.parametrize("evolving", [False, True])
@pytest.mark.parametrize("n", [2, 3, 9])
def test_a_platform_of_unknown_velocity_takes_one_degree_of_freedom_of_each_component(n, evolving):
    config = EstimatorConfig(modes=8)
    estimator = (
        build_evolving([SMALL], config, TimeConfig(scale="static"), GatingConfig())
        if evolving
        else build_estimator(SMALL, config)
    )
    (observation,) = synthetic.random_profiles(SMALL.grid, 1, seed=3, speed=0.05)
    flags = np.where(np.arange(11) < n, Flag.GOOD, Flag.MISSING).astype(np.int8)
    absolute = replace(observation, flags=flags)
    for profile, dof in (
        (absolute, 2 * n),
        (replace(absolute, common_std=0.3), 2 * n),
        (relative_to_a_moving_platform(absolute, 0.0), 2 * n - 2),
    ):
        _, said = estimator.step(estimator.initial(), profile)
        assert said.dof == dof


@pytest.mark.full
def test_the_innovation_of_relative_profiles_is_chi_square_with_those_degrees_of_freedom():
    """Drawn from the estimate's own Gaussian, with a platform as fast as it likes, NIS has the mean and the variance of its dof."""
    estimator = build_estimator(SMALL, EstimatorConfig(modes=8))
    observation = synthetic.profile(SMALL.grid, 0.0, 0.0, DEPTH, np.zeros((9, 2)))
    used = np.arange(9)
    rows = estimator.rows(observation, used)
    zero, layout = rows.stack.values[0], rows.stack.layouts[0]
    rng, n = np.random.default_rng(11), 300
    representation = np.interp(
        observation.depth,
        SMALL.grid.levels,
        error_at(estimator, observation.longitude, observation.latitude),
    )
    std = np.hypot(observation.error_std, representation)
    bins = layout.unwhiten @ layout.q @ rows.r
    factor = np.linalg.cholesky(
        estimator.prior.covariance() + 1e-14 * np.eye(estimator.prior.mean.size)
    )
    found = []
    for _ in range(n):
        weights = (
            estimator.prior.mean + factor @ rng.standard_normal(estimator.prior.mean.size)
        ).reshape(bins.shape[1], -1)
        local = (
            bins @ weights @ rows.basis.T
            - zero
            + std[:, None] * rng.standard_normal((used.size, 2))
            + rng.normal(0.0, 3.0, 2)
        )
        turned = np.column_stack(
            rotate_to_geographic(
                SMALL.grid.projection, observation.longitude, observation.latitude, *local.T
            )
        )
        drawn = replace(observation, velocity=turned, common_std=np.inf, reference="platform")
        _, said = estimator.step(estimator.initial(), drawn)
        found.append(said.nis)
    dof = 2 * (used.size - 1)
    # four standard errors of the mean; two degrees of freedom more or less are six off
    assert np.mean(found) == pytest.approx(dof, abs=4.0 * np.sqrt(2.0 * dof / n))
    assert np.var(found) == pytest.approx(2.0 * dof, rel=0.4)
