"""However measurements are cut into blocks, the estimate is the same; and what leaves it as it was."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.core.observation import Reason
from replay_kit.estimator import build, smooth
from tests.estimator.seas import CONFIG, DAY, HOUR, SEA, dive, forecasts, profiles

MINUTE = 60 * 10**9
FIELDS = ("innovation", "innovation_std", "residual", "prior_innovation", "nis", "log_likelihood")


def cut(estimator, log, size):
    state, steps = estimator.initial(), []
    for begin in range(0, len(log), size):
        state, some = estimator.assimilate(state, log[begin : begin + size])
        steps += some
    return state, steps


def eventful():
    """Two days with faults, repetitions, what comes late and far too late, and means along paths."""
    log = profiles(66, days=2.0)
    for k in (5, 20, 21):
        log[k] = replace(log[k], velocity=log[k].velocity + 3.0)
    log[30] = replace(log[30], time_ns=log[29].time_ns - 10 * MINUTE)
    log[40] = replace(log[40], time_ns=log[39].time_ns - 10 * HOUR)
    return [*log[:12], dive(log[11].time_ns), *log[12:50], log[49], *log[50:]]


@pytest.mark.parametrize("spread", [None, "fit", "as_given"])
@pytest.mark.parametrize("size", [7, 64])
def test_blocks_are_measurements_one_by_one(spread, size):
    config = CONFIG.model_copy(update={"spread": spread, "mean_variance": None})
    estimator, log = build([SEA], config, GatingConfig()), eventful()
    (state, one_by_one), (other, blocks) = (cut(estimator, log, each) for each in (1, size))
    np.testing.assert_allclose(other.x, state.x, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(other.covariance, state.covariance, rtol=0.0, atol=1e-12)
    names = ("time_ns", "profiles", "scale")
    for name in names:
        assert getattr(other, name) == pytest.approx(getattr(state, name), rel=1e-12)
    assert (other.centre is None) == (state.centre is None)
    decisions = [step.innovation.decision for step in one_by_one]
    assert decisions.count("rejected") >= 5
    assert [step.innovation.decision for step in blocks] == decisions
    for ours, theirs in zip(blocks, one_by_one, strict=True):
        assert ours.event.source == theirs.event.source
        assert ours.after.time_ns == theirs.after.time_ns
        for name in FIELDS:
            one, same = (getattr(each.innovation, name) for each in (ours, theirs))
            np.testing.assert_allclose(one, same, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(
            estimator.flow(ours.after).latent, estimator.flow(theirs.after).latent, atol=1e-7
        )


@pytest.mark.parametrize("minutes", [1, 30])
def test_blocks_through_time_differ_by_far_less_than_the_errors(minutes):
    estimator = build(forecasts(), CONFIG, GatingConfig(), TimeConfig(scale=20 * 86_400.0))
    log = [replace(p, time_ns=DAY + k * minutes * MINUTE) for k, p in enumerate(profiles(48))]
    (state, _), (other, _) = (cut(estimator, log, each) for each in (1, 16))
    other = estimator.predict(other, state.time_ns)
    at = SEA.grid.east, SEA.grid.north, np.full(SEA.grid.east.shape, 60.0)
    one, same = (estimator.flow(each) for each in (state, other))
    off = one.velocity(*at) - same.velocity(*at)
    assert np.sqrt(np.mean(off**2)) < 1e-3
    assert np.abs(off).max() < 0.1 * one.standard_error(*at).min()


@pytest.mark.parametrize("time", [None, TimeConfig(scale=2 * 86_400.0)])
def test_what_is_twice_too_old_or_rejected_leaves_the_estimate_as_it_was(time):
    estimator, log = build(forecasts(), CONFIG, GatingConfig(), time), profiles(12)
    state, _ = cut(estimator, log, 1)
    old = replace(log[3], time_ns=state.time_ns - 20 * MINUTE - 1)
    wrong = replace(log[3], time_ns=state.time_ns + HOUR, velocity=log[3].velocity + 3.0)
    late = [(old, Reason.OUT_OF_ORDER)] if time else []
    for given, reason in ((log[-1], Reason.DUPLICATE), *late, (wrong, None)):
        after, (step,) = estimator.assimilate(state, [given])
        assert (step.innovation.decision, step.innovation.accepted) == ("rejected", False)
        assert reason is None or np.all(step.innovation.reasons & reason)
        assert (after.time_ns, after.profiles) == (state.time_ns, state.profiles)
        np.testing.assert_array_equal(after.x, state.x)
        np.testing.assert_array_equal(after.covariance, state.covariance)
    # of a constant current nothing is too old
    used = replace(old, time_ns=old.time_ns + 1) if time else old
    after, (step,) = estimator.assimilate(state, [used])
    assert step.innovation.accepted
    assert after.time_ns == state.time_ns


def test_a_late_measurement_after_a_rejected_one_counts_for_the_times_between():
    estimator = build(forecasts(), CONFIG, GatingConfig(), TimeConfig(scale=3 * 3600.0))
    good = [replace(each, time_ns=DAY + 30 * k * MINUTE) for k, each in enumerate(profiles(8))]
    end = good[6].time_ns
    wrong = replace(good[7], time_ns=end + 20 * MINUTE, velocity=good[7].velocity + 5.0)
    late = replace(good[7], time_ns=end + 10 * MINUTE)
    wanted = [end + minutes * MINUTE for minutes in (5, 10, 15, 25)]
    logs = [*good[:7], wrong, late], [*good[:7], late]
    for one, other in zip(*(smooth(estimator, log, wanted) for log in logs), strict=True):
        np.testing.assert_allclose(one.x, other.x, atol=1e-12)
        np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-12)
