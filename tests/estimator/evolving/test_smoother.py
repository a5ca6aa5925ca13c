"""The smoother against one joint Gaussian of all observations, and against the filter."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.evolving.smoother import smooth
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, inflated_rows, profiles
from tests.reference import evolving as slow

LATE = 15 * 60 * 10**9
FORGETFUL = TimeConfig(scale=2 * 86_400.0, dropped_std=0.0)


def pooled_static(members):
    return build_estimator(
        replace(members[0], velocity=np.concatenate([m.velocity for m in members])), CONFIG
    )


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("lag_days", [None, 1.0])
def test_the_smoother_is_the_joint_gaussian_of_what_it_may_use(lag_days, late):
    """A late observation is in it where the filter counted it: at the time of the one before."""
    members = forecasts()
    estimator, static = build_evolving(members, CONFIG, FORGETFUL), pooled_static(members)
    observations = profiles(9)
    if late:
        observations[5] = replace(observations[5], time_ns=observations[4].time_ns - LATE)
    designs, values = inflated_rows(estimator, observations, static)
    times = [o.time_ns for o in observations]
    counted = [*times[:5], max(times[4:6]), *times[6:]]
    wanted = [times[4], 0, times[2] + DAY // 7, times[-1], times[-1] + DAY]
    if late:
        around = (-LATE // 3, -DAY // 4, DAY // 4)
        wanted += [times[5], times[3], *(times[4] + off for off in around)]
    lag = None if lag_days is None else lag_days * 86_400.0
    for at, flow in zip(wanted, smooth(estimator, observations, wanted, lag), strict=True):
        last = times[-1] if lag_days is None else at + int(lag_days * DAY)
        used = [k for k, time in enumerate(counted) if time <= max(last, at)]
        of_used = ([each[k] for k in used] for each in (designs, times, values))
        mean, cov = slow.joint(estimator.operator.process, *of_used, at, [counted[k] for k in used])
        latent = estimator.basis.offset + estimator.basis.modes @ mean.reshape(3, -1).T
        np.testing.assert_allclose(flow.latent, latent, atol=1e-8 * np.abs(latent).max())
        np.testing.assert_allclose(flow.weight_cov, cov, atol=1e-8 * np.abs(cov).max())
        assert flow.time_ns == at


def test_with_oscillations_and_biases_it_never_knows_less_than_the_filter_and_the_same_at_the_end():
    members = forecasts()
    config = TimeConfig(scale=86_400.0, oscillators=("inertial", "M2"), biases=("shear",))
    estimator = build_evolving(members, EstimatorConfig(modes=8, sample_share=0.6), config)
    observations = profiles(8)
    state, states = estimator.initial(), []
    for observation in observations:
        state, _ = estimator.step(state, observation)
        states.append(state)
    flows = smooth(estimator, observations, [o.time_ns for o in observations])
    for filtered, flow in zip(states, flows, strict=True):
        less = estimator.flow(filtered).weight_cov - flow.weight_cov
        assert np.linalg.eigvalsh(less).min() > -1e-10 * np.trace(less + np.eye(len(less)))
    np.testing.assert_allclose(flows[-1].latent, estimator.flow(states[-1]).latent, atol=1e-12)
    np.testing.assert_allclose(
        flows[-1].weight_cov, estimator.flow(states[-1]).weight_cov, atol=1e-12
    )


def test_an_observation_at_the_very_end_of_the_lag_counts():
    estimator, observations = build_evolving(forecasts(), CONFIG, FORGETFUL), profiles(4)
    at = observations[2].time_ns - 7_200 * 10**9
    given = ((observations, 7200.0), (observations[:3], None), (observations, 7199.0))
    (counted,), (expected,), (too_late,) = (
        smooth(estimator, some, [at], lag) for some, lag in given
    )
    np.testing.assert_allclose(
        counted.latent, expected.latent, rtol=0.0, atol=1e-12 * np.abs(expected.latent).max()
    )
    assert np.abs(counted.latent - too_late.latent).max() > 1e-3 * np.abs(expected.latent).max()
