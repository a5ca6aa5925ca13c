"""The flight model's error in mean currents: found from the dives before, and taken from those that follow; what was measured stays."""

from dataclasses import replace

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.workflows.replay.surfacings import FlightState
from tests.workflows.replay.given import block_of
from tests.workflows.replay.test_dive_forecasts import mean

CURRENT, BIAS = complex(0.05, -0.02), 0.5


def dive(k, bias=BIAS):
    """Dive k of a turning course, whose flight model states the way through water too small."""
    way = 0.25 * np.exp(2.1j * k)
    stated = CURRENT + bias * way
    return mean(k, (stated.real, stated.imag), way=(way.real, way.imag))


def with_wrong(means, k, error=0.3):
    """The same with one mean current that was delivered wrong; the fixes are right."""
    east, north = means[k].velocity
    return [*means[:k], replace(means[k], velocity=(east + error, north)), *means[k + 1 :]]


def profile(k):
    """An absolute profile of the true current."""
    velocity = np.full(2, CURRENT.real), np.full(2, CURRENT.imag)
    time_ns = mean(k).time_ns - 1
    made = rk.Observation.profile(time_ns, 5.0, 62.0, [50.0, 150.0], *velocity, 0.05)
    return replace(made, dive=k + 1)


def used(means, state=None):
    """The mean currents as an estimate is given them, and the state after them."""
    state, out = state or FlightState(), []
    for each in means:
        state, after = state.with_mean(each, True)
        out.append(after)
    return out, state


def test_a_biased_flight_model_is_found_and_taken_from_the_mean_currents():
    """Beside profiles; without any a replay shows the same."""
    state, found = FlightState(), []
    for k in range(8):
        state = state.with_profiles(block_of([profile(k)]), np.zeros(1, np.intp))
        (after,), state = used([replace(dive(k), beside_profiles=True)], state)
        assert (after.velocity, after.error_std) == (dive(k).velocity, dive(k).error_std)
        found.append(after)
    assert [after.corrected for after in found[:2]] == [None, None]
    assert abs(complex(*found[0].used) - CURRENT) == pytest.approx(0.125, abs=1e-3)
    # without a correction it has the flight model's uncertainty
    assert found[0].used_std > 3.0 * found[0].error_std
    last = found[-1]
    assert abs(complex(*last.corrected) - CURRENT) < min(0.02, 3.0 * last.used_std)
    assert last.used == last.corrected
    assert last.error_std < last.used_std < 0.025
    correction = state.correction(
        [abs(complex(*after.used) - complex(*after.velocity)) for after in found if after.corrected]
    )
    assert correction.sizes[-1] == pytest.approx(0.125, abs=0.02)


def test_a_dives_own_mean_current_does_not_correct_itself():
    means, state = used(map(dive, range(8)))
    assert means[-1].corrected is not None
    plain, other = (
        state.with_mean(replace(dive(8), velocity=velocity), True)[1]
        for velocity in (dive(8).velocity, (1.0, 1.0))
    )
    way = complex(*other.velocity) - complex(*dive(8).velocity)
    error = complex(*plain.velocity) - complex(*plain.corrected)
    share = error / (0.25 * np.exp(2.1j * 8))
    assert complex(*other.velocity) - complex(*other.corrected) == pytest.approx(
        error - share * way, abs=1e-4
    )
    begun = state.with_profiles(block_of([profile(8)]), np.zeros(1, np.intp))
    assert begun.with_mean(dive(8), True)[1].corrected == plain.corrected


def test_a_sound_flight_model_corrects_nothing():
    means, state = used(dive(k, bias=0.0) for k in range(10))
    assert all(after.corrected is None for after in means)
    assert [after.used_std for after in means] == [dive(k).error_std for k in range(10)]
    assert state.correction(()) is None


@pytest.mark.parametrize("k", [0, 1, 5])
def test_one_wrong_mean_current_corrects_no_other_one(k):
    means = [dive(k, bias=0.0) for k in range(9)]
    found, _ = used(with_wrong(means, k))
    for number, (after, given) in enumerate(zip(found, means, strict=True)):
        assert after.corrected is None
        assert number == k or (after.used, after.used_std) == (given.velocity, given.error_std)


def test_what_has_no_way_through_water_is_used_as_stated():
    _, state = used(map(dive, range(8)))
    stated = replace(dive(8), fixes=None)
    assert state.with_mean(stated, True)[1] is stated
    assert state.with_mean(dive(8), True)[1].corrected is not None
