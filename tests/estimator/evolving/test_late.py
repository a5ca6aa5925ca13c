"""Observations that come late: within twenty minutes they count at the state's time, in the filter and in the smoother alike."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.core.observation import Reason
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.evolving.smoother import smooth
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, profiles
from tests.estimator.evolving.test_smoother import FORGETFUL

MINUTE = 60 * 10**9


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
