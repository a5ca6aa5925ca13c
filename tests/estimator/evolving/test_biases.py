"""Errors of the instrument as parts of the state: filter and smoother against one joint Gaussian of all bins."""

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.evolving.smoother import smoothed_states
from tests.estimator.evolving.test_evolving import CONFIG, DAY, LEVELS, forecasts, profiles
from tests.estimator.evolving.test_extras import faulty
from tests.estimator.evolving.test_smoother import pooled_static
from tests.reference import evolving as slow

TIME = TimeConfig(scale=2 * 86_400.0, dropped_std=0.0, biases=("heading", "scale", "shear"))
STDS = np.array([np.deg2rad(TIME.heading_bias_std), TIME.scale_bias_std, TIME.shear_bias_std])


def turning(n):
    """Profiles of an instrument with faults, on a vehicle that goes round."""
    angles = 0.7 * np.arange(n)
    through_water = 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    return [
        faulty(profile, 4.0, 0.05, motion)
        for profile, motion in zip(profiles(n), through_water, strict=True)
    ]


@pytest.fixture(scope="module")
def estimator():
    return build_evolving(forecasts(), CONFIG, TIME)


@pytest.fixture(scope="module")
def observations():
    return turning(9)


def dense_rows(observation, static):
    """Whitened bins: rows of the weights, then of one prior standard deviation of each bias, and their values; by the definitions."""
    used = np.flatnonzero(observation.depth <= LEVELS[-1])
    rows, depth, projection = (
        static.rows(observation, used),
        observation.depth[used],
        static.basis.grid.projection,
    )
    whiten = rows.stack.layouts[0].whiten[: used.size, used]
    relative = (observation.velocity[used] - observation.platform_velocity).mean(axis=0)
    east, north = (
        float(part)
        for part in rotate_to_local(
            projection, observation.longitude, observation.latitude, *relative
        )
    )
    constant, linear = (
        whiten @ np.ones(depth.size),
        whiten @ np.abs(depth - depth[0]),
    )
    of_weights = whiten @ depth_weights(static.basis.depth_functions, depth, LEVELS)
    parts = []
    for component, (along, across) in enumerate(((east, north), (north, -east))):
        biases = (
            np.column_stack(
                [across * constant, along * constant, -along / np.hypot(east, north) * linear]
            )
            * STDS
        )
        parts.append(np.hstack([np.kron(of_weights, rows.basis[component]), biases]))
    return np.vstack(parts), (whiten @ rows.stack.values[0, used]).T.ravel()


@pytest.fixture(scope="module")
def joint(estimator, observations):
    """A function of a time and a number of observations: means of weights and biases at that time, from so many of them at once.

    The Jacobian of an observation is the factor exp(-slope scale) on its density: it moves a Gaussian's mean by slope covariances.
    """
    static, state, rows, slopes = pooled_static(forecasts()), estimator.initial(), [], []
    for observation in observations:
        screened = estimator.screened(state, (observation,))
        column = estimator.group_column(state, screened)
        update = estimator.evaluated(state, column)
        rows.append(
            [
                part / np.sqrt(update.gate.error_factor[0])
                for part in dense_rows(observation, static)
            ]
        )
        slopes.append(update.scale_jacobian)
        state = estimator.assimilated(screened, column, (state, update))[-1].after
    designs, values = zip(*rows, strict=True)
    times, prior = (
        [observation.time_ns for observation in observations],
        slow.WithConstants(estimator.operator.process, STDS.size),
    )

    def of(at, count):
        mean, cov = slow.joint(prior, designs[:count], times[:count], values[:count], at)
        mean = mean - cov[:, -2] * STDS[1] * sum(slopes[:count])
        return mean[: -STDS.size], STDS * mean[-STDS.size :]

    return of


def assert_equal(estimator, state, expected):
    weights, biases = expected
    np.testing.assert_allclose(
        estimator.weights([state])[0], weights, rtol=0.0, atol=1e-9 * np.abs(weights).max()
    )
    np.testing.assert_allclose(
        [mean for mean, _ in estimator.biases(state).values()], biases, rtol=1e-9
    )


def test_the_filter_is_the_joint_gaussian_times_the_jacobian_of_the_scale(
    estimator, observations, joint
):
    state = estimator.initial()
    for count, observation in enumerate(observations, 1):
        state, _ = estimator.step(state, observation)
        assert_equal(estimator, state, joint(observation.time_ns, count))


@pytest.mark.parametrize("lag_days", [None, 1.0])
def test_the_smoother_is_the_same_of_all_that_it_may_use(estimator, observations, joint, lag_days):
    times = [observation.time_ns for observation in observations]
    wanted = [times[4], 0, times[2] + DAY // 7, times[-1]]
    found = smoothed_states(
        estimator, observations, wanted, None if lag_days is None else lag_days * 86_400.0
    )
    for at, state in zip(wanted, found, strict=True):
        last = times[-1] if lag_days is None else at + int(lag_days * DAY)
        assert_equal(estimator, state, joint(at, sum(time <= last for time in times)))


def test_constant_unknowns_have_at_all_times_the_filter_s_last_values():
    config, given = TIME.model_copy(update={"oscillators": ("inertial",)}), turning(12)
    estimator = build_evolving(forecasts(), CONFIG, config, GatingConfig())
    state = estimator.initial()
    for observation in given:
        state, said = estimator.step(state, observation)
        # one that grows the covariance lets what is constant change
        assert said.prior_inflation == 1.0
    part = estimator.state_space.parts["biases"]
    for smoothed in smoothed_states(
        estimator, given, [0, *(observation.time_ns for observation in given), 5 * DAY]
    ):
        np.testing.assert_allclose(smoothed.mean[part], state.mean[part], rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(
            smoothed.cov[part, part], state.cov[part, part], rtol=0.0, atol=1e-10
        )
