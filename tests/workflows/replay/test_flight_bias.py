"""The flight model's error in mean currents: found from the dives before, and taken from those that follow."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, Flag, Observation
from replay_kit.workflows.replay.flight_bias import (
    FlightState,
    as_used,
    corrected,
    with_dive_profile,
)
from tests.workflows.replay.test_dive_forecasts import mean

CURRENT, BIAS = complex(0.05, -0.02), 0.5


def dive(k, bias=BIAS):
    """Dive k of a turning course, whose flight model states the way through water too small."""
    way = 0.25 * np.exp(2.1j * k)
    stated = CURRENT + bias * way
    start = mean(k).fixes[0]
    end = to_geographic(
        Projection(start.longitude, start.latitude),
        *(7200.0 * np.array([(way + stated).real, (way + stated).imag])),
    )
    fixes = (start, Fix(start.time_ns + 7200 * 10**9, *map(float, end)))
    return replace(mean(k, (stated.real, stated.imag)), fixes=fixes)


def profile(k):
    """An absolute profile of the true current."""
    depth = np.array([50.0, 150.0])
    flags, reasons = np.full(2, Flag.GOOD, np.int8), np.zeros(2, np.int32)
    velocity = np.tile([CURRENT.real, CURRENT.imag], (2, 1))
    return Observation(
        mean(k).time_ns - 1,
        5.0,
        62.0,
        depth,
        velocity,
        np.full(2, 0.05),
        "earth",
        flags,
        reasons,
        k + 1,
        mean(k).source,
    )


@pytest.mark.parametrize("with_profiles", [False, True])
def test_a_biased_flight_model_is_found_and_taken_from_the_mean_currents(with_profiles):
    state, errors, stds = FlightState(), [], []
    for k in range(8):
        if with_profiles:
            state = with_dive_profile(state, profile(k))
        state, used = corrected(state, replace(dive(k), beside_profiles=with_profiles))
        errors.append(abs(complex(*used.velocity) - CURRENT))
        stds.append(used.error_std)
        assert used.stated == dive(k).velocity
    assert errors[0] == pytest.approx(0.125, abs=1e-3)
    assert errors[-1] < 0.02
    assert all(error < 3.0 * std for error, std in zip(errors, stds, strict=True))
    assert stds[-1] < 0.3 * stds[0]


def test_a_dives_own_mean_current_does_not_correct_itself():
    state = FlightState()
    for k in range(4):
        state, _ = corrected(state, dive(k))
    plain, other = (corrected(state, replace(dive(4), time_ns=shift))[1] for shift in (1, 2))
    assert plain.velocity == other.velocity
    begun = with_dive_profile(state, profile(4))
    assert corrected(begun, dive(4))[1].velocity == corrected(state, dive(4))[1].velocity


def test_a_sound_flight_model_stays_as_it_is():
    state = FlightState()
    for k in range(10):
        state, used = corrected(state, dive(k, bias=0.0))
    assert abs(complex(*used.velocity) - CURRENT) < 0.015
    assert used.error_std < 0.03


def test_what_has_no_way_through_water_is_used_as_stated():
    config, off = MeasurementConfig(), MeasurementConfig(flight_bias=False)
    drift = replace(dive(0), kind="drift")
    assert as_used(FlightState(), drift, config)[1] is drift
    without = replace(dive(0), fixes=None)
    assert as_used(FlightState(), without, config)[1] is without
    assert as_used(FlightState(), dive(0), off)[1].stated is None
    assert as_used(FlightState(), dive(0), config)[1].error_std > dive(0).error_std
