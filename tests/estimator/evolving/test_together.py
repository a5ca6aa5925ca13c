"""Profiles that count together: exactly what they say one after another, where nothing changes within the window."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config_time import TimeConfig
from replay_kit.config_trust import TrustConfig
from replay_kit.estimator.evolving import build_evolving
from replay_kit.estimator.evolving.together import compressed, grouped
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, profiles
from tests.estimator.test_paths import dive

SECOND = 10**9


def quick_log(n=40):
    """Profiles at 1 Hz along a short way, and one of another place among them."""
    start = profiles(1)[0]
    rng, log = np.random.default_rng(4), []
    for k in range(n):
        velocity = start.velocity + 0.05 * rng.standard_normal(start.velocity.shape)
        log.append(
            replace(start, time_ns=DAY + k * SECOND, longitude=start.longitude + 1e-5 * k, velocity=velocity, depth=start.depth + 0.1 * k)
        )
    log[7] = replace(profiles(3)[2], time_ns=log[7].time_ns)
    return log


def test_rows_that_say_the_same_are_few():
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((60, 5)) @ rng.standard_normal((5, 30))
    innovation = rng.standard_normal(60)
    few, told = compressed(rows, innovation)
    assert len(few) == 5
    np.testing.assert_allclose(few.T @ few, rows.T @ rows, atol=1e-10)
    np.testing.assert_allclose(few.T @ told, rows.T @ innovation, atol=1e-10)


@pytest.mark.parametrize("scale", ["static", 5 * 86_400.0])
def test_one_update_is_as_good_as_many(scale):
    one_by_one = build_evolving(forecasts(), CONFIG, TimeConfig(scale=scale))
    together = build_evolving(forecasts(), CONFIG, TimeConfig(scale=scale, window=10.0))
    log = quick_log()
    single, joint = ([*each.steps(each.initial(), log)] for each in (one_by_one, together))
    # a profile is held against the state before its group, so errors adapt a little differently: rule that out
    if all(a[1].error_inflation == b[1].error_inflation == 1.0 for a, b in zip(single, joint, strict=True)):
        tolerance = 1e-9 if scale == "static" else 2e-3
        np.testing.assert_allclose(joint[-1][0].mean, single[-1][0].mean, atol=tolerance * np.abs(single[-1][0].mean).max())
        np.testing.assert_allclose(joint[-1][0].cov, single[-1][0].cov, atol=tolerance)
    assert len(joint) == len(log)
    assert joint[-1][0].time_ns == log[-1].time_ns
    # within a group the state waits for the last of it
    assert joint[0][0].time_ns is None
    assert joint[10][0].time_ns == log[10].time_ns


def test_the_static_comparison_above_is_not_ruled_out():
    together = build_evolving(forecasts(), CONFIG, TimeConfig(scale="static", window=10.0))
    assert all(said.error_inflation == 1.0 for _, said in together.steps(together.initial(), quick_log()))


def test_an_outlier_in_a_group_is_rejected_alone():
    together = build_evolving(forecasts(), CONFIG, TimeConfig(window=10.0), TrustConfig())
    # one of a group is watched, so it takes five groups until the gate rejects
    log = quick_log(90)
    for k in range(80, 83):
        log[k] = replace(log[k], velocity=log[k].velocity + 3.0)
    said = [innovation.decision for _, innovation in together.steps(together.initial(), log)]
    # the seventh is of another place and of noise only
    assert [k for k, decision in enumerate(said) if decision == "rejected" and k != 7] == [80, 81, 82]


def test_groups_end_with_their_window_and_means_stay_alone():
    log = quick_log(12)
    assert [len(group) for group in grouped(log, 4.0)] == [5, 5, 2]
    assert [len(group) for group in grouped(log, 0.0)] == [1] * 12
    path = replace(dive(), time_ns=log[3].time_ns)
    assert [len(group) for group in grouped([*log[:3], path, *log[4:]], 100.0)] == [3, 1, 8]
