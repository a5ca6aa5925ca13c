"""Profiles that count together: exactly what they say one after another, where nothing changes within the window."""

from dataclasses import replace
from itertools import groupby, islice, pairwise

import numpy as np
import pytest

from replay_kit.config.gating import GatingConfig
from replay_kit.config.time import TimeConfig
from replay_kit.estimator.evolving import build_evolving
from replay_kit.estimator.evolving import superobservation as module
from replay_kit.estimator.evolving.superobservation import compressed
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, profiles
from tests.estimator.update.test_path_mean import dive

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
    # a group counts at the time of its first profile, and each state knows all profiles so far
    assert [state.time_ns - DAY for state, _ in joint] == [11 * SECOND * (k // 11) for k in range(len(log))]
    assert all(np.abs(after.mean - before.mean).max() > 0.0 for (before, _), (after, _) in pairwise(joint))


def test_the_static_comparison_above_is_not_ruled_out():
    together = build_evolving(forecasts(), CONFIG, TimeConfig(scale="static", window=10.0))
    assert all(said.error_inflation == 1.0 for _, said in together.steps(together.initial(), quick_log()))


def test_an_outlier_in_a_group_is_rejected_alone():
    together = build_evolving(forecasts(), CONFIG, TimeConfig(window=10.0), GatingConfig())
    # one of a group is watched, so it takes five groups until the gate rejects
    log = quick_log(90)
    for k in range(80, 83):
        log[k] = replace(log[k], velocity=log[k].velocity + 3.0)
    said = [innovation.decision for _, innovation in together.steps(together.initial(), log)]
    # the seventh is of another place and of noise only
    assert [k for k, decision in enumerate(said) if decision == "rejected" and k != 7] == [80, 81, 82]


def first_of_groups(states):
    """How many states each group has, by the time of its first profile; one without a group is alone."""
    keys = [state.open_group.first_ns if state.open_group is not None else -k for k, state in enumerate(states, start=1)]
    return [len(list(alike)) for _, alike in groupby(keys)]


def test_groups_end_with_their_window_and_means_stay_alone():
    log, path = quick_log(12), replace(dive(), time_ns=DAY + 3 * SECOND)
    for window, given, expected in ((4.0, log, [5, 5, 2]), (0.0, log, [1] * 12), (100.0, [*log[:3], path, *log[4:]], [3, 1, 8])):
        together = build_evolving(forecasts(), CONFIG, TimeConfig(window=window))
        assert first_of_groups([state for state, _ in together.steps(together.initial(), given)]) == expected


def test_a_profile_older_than_the_first_of_the_group_begins_another():
    log = quick_log(8)[:6]
    log[4] = replace(log[4], time_ns=log[0].time_ns - SECOND)
    together = build_evolving(forecasts(), CONFIG, TimeConfig(window=100.0))
    assert first_of_groups([state for state, _ in together.steps(together.initial(), log)]) == [4, 2]


@pytest.mark.parametrize("block", [1, 3, 16])
def test_blocks_change_no_bit_of_a_group(block):
    """Whether profiles are given at once, in blocks or one by one."""
    together = build_evolving(forecasts(), CONFIG, TimeConfig(window=20.0, biases=("scale",)), GatingConfig())
    log = quick_log(45)
    whole = list(together.steps(together.initial(), log))
    state, parts, source = together.initial(), [], iter(log)
    while given := list(islice(source, block)):
        parts += list(together.steps(state, given))
        state = parts[-1][0]
    for (state, said), (other, expected) in zip(parts, whole, strict=True):
        for name in ("means", "cov"):
            assert getattr(state, name).tobytes() == getattr(other, name).tobytes()
        assert (state.time_ns, state.monitor) == (other.time_ns, other.monitor)
        assert state.bias_score.scores.tobytes() == other.bias_score.scores.tobytes()
        assert (said.nis, said.decision, said.error_inflation) == (expected.nis, expected.decision, expected.error_inflation)
    assert first_of_groups([state for state, _ in parts]) == [21, 21, 3]


def test_a_group_is_the_update_by_all_rows_at_once():
    """The textbook's update, and its whitened innovations as evidence of the instrument's errors."""
    together = build_evolving(forecasts(), CONFIG, TimeConfig(window=100.0, biases=("scale",)))
    log = [replace(each, platform_velocity=(0.2, -0.1), common_std=0.02) for each in quick_log(12)]
    state = together.initial()
    for observation in profiles(3):
        state, _ = together.step(state, replace(observation, time_ns=observation.time_ns // 10))
    first = together.candidate(state, log[0])
    offers = [first, *(together.candidate(state, each, first.before) for each in log[1:])]
    *_, (after, _) = together.steps(state, log)
    rows = np.vstack([each.rows.design / each.evaluated.error_scale for each in offers])
    told = np.vstack([each.augmented_innovation / each.evaluated.error_scale for each in offers])
    before = first.before
    innovation_cov = rows @ before.cov @ rows.T + np.eye(len(rows))
    gain = before.cov @ rows.T @ np.linalg.inv(innovation_cov)
    cov, means = before.cov - gain @ rows @ before.cov, before.means + gain @ told
    scale_jacobian = sum(each.scale_jacobian for each in offers)
    at = together.state_space.parts["biases"].start
    means[:, 0] -= cov[:, at] * together.operator.biases.std[0] * scale_jacobian
    np.testing.assert_allclose(after.means, means, atol=1e-9 * np.abs(means).max())
    np.testing.assert_allclose(after.cov, cov, atol=1e-10)
    evidence = before.bias_score.updated(told[:, 1:], told[:, 0], innovation_cov, scale_jacobian)
    np.testing.assert_allclose(after.bias_score.scores, evidence.scores, rtol=1e-8)
    np.testing.assert_allclose(after.bias_score.informations, evidence.informations, rtol=1e-8)
    assert scale_jacobian != 0.0


def test_a_long_group_takes_a_bounded_memory_and_says_what_its_profiles_say_alone():
    """150 profiles have 900 rows, in the directions that the state has at most."""
    together, one_by_one = (build_evolving(forecasts(), CONFIG, TimeConfig(scale="static", window=window)) for window in (600.0, 0.0))
    state, alone, sizes = together.initial(), one_by_one.initial(), []
    for observation in quick_log(150):
        state, _ = together.step(state, observation)
        alone, _ = one_by_one.step(alone, observation)
        sizes.append(len(state.open_group.gain))
    assert max(sizes) <= max(module._ROWS, 2 * together.state_space.size) < 900
    assert min(sizes[100:]) <= together.state_space.size + 6
    np.testing.assert_allclose(state.mean, alone.mean, atol=1e-9 * np.abs(alone.mean).max())
    np.testing.assert_allclose(state.cov, alone.cov, atol=1e-10)


def test_the_first_profile_of_a_group_is_watched_and_grows_the_covariance_of_the_whole_group():
    """Profiles far off, so that the watch fires at the first of some group: all of its states are grown, and none a second time."""
    gating = GatingConfig(gate="off", inflation_profiles=4)
    growing, steady = (
        build_evolving(forecasts(), CONFIG, TimeConfig(window=3.0), each) for each in (gating, gating.model_copy(update={"inflate": False}))
    )
    log = [replace(each, velocity=each.velocity + 1.5 * (-1.0) ** (k // 4)) for k, each in enumerate(quick_log(20))]
    state = without = growing.initial()
    grown_at: list[tuple[int, float]] = []
    for k, observation in enumerate(log):
        without = state if k % 4 == 0 else without
        state, said = growing.step(state, observation)
        without, _ = steady.step(without, observation)
        if said.prior_inflation > 1.0:
            grown_at.append((k, said.prior_inflation))
        factor = grown_at[-1][1] if grown_at and grown_at[-1][0] == k - k % 4 else 1.0
        np.testing.assert_allclose(state.cov, factor * without.cov, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(state.means, without.means, rtol=1e-12, atol=1e-15)
    assert grown_at
    assert all(k % 4 == 0 for k, _ in grown_at)


def test_a_group_whose_first_profile_is_rejected_counts_the_others_at_its_time():
    together = build_evolving(forecasts(), CONFIG, TimeConfig(window=10.0), GatingConfig())
    log = quick_log(80)
    log[77] = replace(log[77], velocity=log[77].velocity + 3.0)
    (before, _), (rejected, said), (joined, _) = list(together.steps(together.initial(), log[:79]))[-3:]
    assert said.decision == "rejected"
    np.testing.assert_array_equal(rejected.mean, before.mean)
    assert rejected.time_ns == before.time_ns
    assert joined.time_ns == log[77].time_ns
    assert np.abs(joined.mean - before.mean).max() > 0.0
