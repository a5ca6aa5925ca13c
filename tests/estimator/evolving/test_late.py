"""Observations that come late: within twenty minutes they count at the state's time, in the filter and in the smoother alike."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.gating import GatingConfig
from replay_kit.config.time import TimeConfig
from replay_kit.core.observation import Reason
from replay_kit.estimator.evolving import build_evolving
from replay_kit.estimator.evolving.smoother import smooth
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, inflated_rows, profiles
from tests.estimator.evolving.test_smoother import FORGETFUL, pooled_static
from tests.reference import evolving as slow

MINUTE = 60 * 10**9
LATE = 15 * MINUTE


def test_twenty_minutes_late_counts_at_the_state_s_time_and_a_nanosecond_more_does_not():
    estimator = build_evolving(forecasts(), CONFIG, FORGETFUL)
    first, second = (replace(each, time_ns=2 * DAY) for each in profiles(2))
    before, _ = estimator.step(estimator.initial(), first)
    late = replace(second, time_ns=2 * DAY - 20 * MINUTE)
    after, said = estimator.step(before, late)
    assert said.accepted
    assert after.time_ns == 2 * DAY
    assert np.abs(after.mean - before.mean).max() > 1e-3
    same, said = estimator.step(before, replace(late, time_ns=late.time_ns - 1))
    assert same is before
    assert not said.accepted
    assert np.all(said.reasons & Reason.OUT_OF_ORDER)


@pytest.mark.parametrize("lag_days", [None, 1.0])
def test_the_smoother_is_the_joint_gaussian_with_a_late_observation_where_the_filter_counted_it(
    lag_days,
):
    members = forecasts()
    estimator, static = build_evolving(members, CONFIG, FORGETFUL), pooled_static(members)
    observations = profiles(9)
    observations[5] = replace(observations[5], time_ns=observations[4].time_ns - LATE)
    designs, values = inflated_rows(estimator, observations, static)
    times = [o.time_ns for o in observations]
    counted = [*times[:5], times[4], *times[6:]]
    wanted = [
        times[4] - LATE // 3,
        times[4],
        times[5],
        times[3],
        times[4] - DAY // 4,
        times[4] + DAY // 4,
        times[-1],
    ]
    flows = smooth(
        estimator, observations, wanted, None if lag_days is None else lag_days * 86_400.0
    )
    for at, flow in zip(wanted, flows, strict=True):
        last = times[-1] if lag_days is None else at + int(lag_days * DAY)
        used = [k for k, time in enumerate(counted) if time <= max(last, at)]
        of_used = ([each[k] for k in used] for each in (designs, times, values))
        mean, cov = slow.joint(estimator.operator.process, *of_used, at, [counted[k] for k in used])
        latent = estimator.basis.offset + estimator.basis.modes @ mean.reshape(3, -1).T
        np.testing.assert_allclose(flow.latent, latent, atol=1e-8 * np.abs(latent).max())
        np.testing.assert_allclose(flow.weight_cov, cov, atol=1e-8 * np.abs(cov).max())


@pytest.mark.parametrize("lag_seconds", [None, 7200.0])
def test_a_late_observation_after_a_rejected_one_counts_for_the_times_between(lag_seconds):
    """The state stays where it was at a rejected profile; what comes late then counts before that profile's time."""
    estimator = build_evolving(forecasts(), CONFIG, TimeConfig(scale=3 * 3600.0), GatingConfig())
    good = [replace(each, time_ns=DAY + 30 * k * MINUTE) for k, each in enumerate(profiles(8))]
    wrong = replace(good[7], time_ns=good[6].time_ns + 20 * MINUTE, velocity=good[7].velocity + 5.0)
    late = replace(good[7], time_ns=good[6].time_ns + 10 * MINUTE)
    state = estimator.initial()
    for observation in good[:7]:
        state, _ = estimator.step(state, observation)
    assert estimator.step(state, wrong)[1].decision == "rejected"
    wanted = [good[6].time_ns + minutes * MINUTE for minutes in (5, 10, 15, 25)]
    disordered = smooth(estimator, [*good[:7], wrong, late], wanted, lag_seconds)
    ordered = smooth(estimator, [*good[:7], late], wanted, lag_seconds)
    for one, other in zip(disordered, ordered, strict=True):
        np.testing.assert_allclose(one.latent, other.latent, atol=1e-12)
        np.testing.assert_allclose(one.weight_cov, other.weight_cov, atol=1e-12)
