"""The instrument's depth against the vehicle's: unit, stuck sensor and lag are named, and sound sensors are not."""

import math

import numpy as np
import pytest

from replay_kit.core.observation import RawValues
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.depths import (
    Depth,
    DepthRecord,
    can_compare,
    found_of_depths,
    least_lag,
)
from replay_kit.measurements.consistency.monitor import ConsistencyState, check, unknowable
from tests.measurements.samples import profile, vehicle

STEP, DIVE = 600.0, 10_080.0


def depth_at(seconds):
    """Of dives to 500 m, each of another length than the one before."""
    phase = np.mod(seconds / DIVE + 0.02 * np.sin(seconds / 40_000.0), 1.0)
    return 500.0 * (1.0 - np.abs(2.0 * phase - 1.0))


def records(own, lag=0.0, number=100, of_vehicle=lambda depth: depth, noise=0.2):
    """Return the records of an instrument and its vehicle, of which ``own`` and ``of_vehicle`` make the logged depths."""
    rng, pings, positions = np.random.default_rng(0), DepthRecord(), DepthRecord()
    for k in range(number):
        seconds = STEP * k
        fine = seconds + 300.0 * np.arange(2)
        for at in fine.tolist():
            positions = positions.after(Depth(int(at * 1e9), float(of_vehicle(depth_at(at)))))
        measured = float(own(depth_at(seconds - lag))) + noise * rng.standard_normal()
        pings = pings.after_ping(int(seconds * 1e9), measured)
    return pings, positions


@pytest.mark.parametrize(
    ("scale", "cause"),
    [(0.1, "in bar"), (10.0, "in kPa"), (3.28084, "in feet"), (0.3048, "vehicle")],
)
def test_a_unit_is_named_with_its_cause(scale, cause):
    found = found_of_depths(*records(lambda depth: scale * depth), "/adcp")
    assert found is not None
    assert found.name == findings.DEPTHS
    assert cause in found.cause


@pytest.mark.parametrize("lag", [-120.0, 18.0, 120.0, 3600.0])
def test_a_late_clock_is_named_to_some_seconds(lag):
    found = found_of_depths(*records(lambda depth: depth, lag), "/adcp")
    assert found is not None
    assert found.name == findings.CLOCK
    number, unit = found.cause.split(" is ")[1].split()[:2]
    stated = float(number) * (3600.0 if unit == "h" else 1.0)
    assert stated == pytest.approx(abs(lag), abs=8.0)
    assert ("ahead" in found.cause) == (lag > 0.0)


def test_stuck_depths_are_named_on_either_side():
    for stuck in (
        records(lambda depth: 120.0, noise=0.01),
        records(lambda depth: depth, of_vehicle=lambda depth: 120.0),
    ):
        found = found_of_depths(*stuck, "/adcp")
        assert found is not None
        assert (found.name, "stays at 120.0 m" in found.evidence) == (findings.DEPTHS, True)


@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_sound_sensors_are_not_accused(offset):
    assert found_of_depths(*records(lambda depth: depth + offset), "/adcp") is None
    # nor ones that disagree by half a percent and a metre of noise
    assert found_of_depths(*records(lambda depth: 1.005 * depth, noise=1.0), "/adcp") is None


@pytest.mark.parametrize(("noise", "least", "most"), [(0.01, 10.0, 10.0), (20.0, 30.0, 600.0)])
def test_the_least_lag_that_would_be_found_grows_with_the_noise(noise, least, most):
    assert least <= least_lag(*records(lambda depth: depth, noise=noise)) <= most
    assert least_lag(*records(lambda depth: 0.0, of_vehicle=lambda depth: 0.0)) == math.inf


def test_without_dives_or_without_a_pressure_nothing_can_be_known_and_that_is_said():
    assert not can_compare(*records(lambda depth: 0.0, of_vehicle=lambda depth: 0.0, noise=0.0))
    state = ConsistencyState()
    assert unknowable(state) == ()
    for k in range(20):
        state, _ = check(state, vehicle(600.0 * k, 150.0 + 1e-3 * k))
        each = profile([[0.1, 0.0]], [10.0], time_ns=int(600e9 * k), raw=RawValues())
        state, _ = check(state, each)
    assert [text.split(" (")[0] for text in unknowable(state)] == [
        "cannot be known here: an offset, a drift or a scale of the profiles",
        "cannot be known here: the clock and the depth of the instrument",
    ]
