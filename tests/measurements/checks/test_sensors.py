"""The instrument's depth and heading against the vehicle's: unit, stuck sensor and lag are named, and sound sensors are not."""

import math

import numpy as np
import pytest

from replay_kit.measurements.checks.check import unknowable
from replay_kit.measurements.checks.sensors import CLOCK, DEPTHS
from tests.measurements.checks.made import EAST, NORTH, STEP, fix, judged, ping

DIVE, CELLS = 10_080.0, 3


def depth_at(seconds):
    """Of dives to 500 m, each of another length than the one before."""
    phase = np.mod(seconds / DIVE + 0.02 * np.sin(seconds / 40_000.0), 1.0)
    return 500.0 * (1.0 - np.abs(2.0 * phase - 1.0))


def dives(own, lag=0.0, number=100, of_vehicle=lambda depth: depth, noise=0.2):
    """Positions and pings, of which ``own`` and ``of_vehicle`` make the logged depths."""
    rng, events = np.random.default_rng(0), []
    for k in range(number):
        seconds = STEP * k
        for at in (seconds, seconds + 300.0):
            east = 150.0 + 1e-6 * at
            events.append(fix(at, east, 0.0, float(of_vehicle(depth_at(at))), reckoned=True))
        measured = float(own(depth_at(seconds - lag))) + noise * rng.standard_normal()
        events.append(pressed(seconds + 300.0, measured, rng, at=seconds))
    return events


def pressed(seconds, measured, rng, at=None, **changes):
    velocity = 0.1 + 0.05 * rng.standard_normal((CELLS, 2))
    time = seconds if at is None else at
    return ping(time, velocity, pressure_depth=measured, dive=0, **changes)


@pytest.mark.parametrize(
    ("scale", "cause"), [(0.1, "in bar"), (3.28084, "in feet"), (0.3048, "vehicle")]
)
def test_a_unit_is_named_with_its_cause(scale, cause):
    ((_, finding),) = judged(dives(lambda depth: scale * depth))[1]
    assert finding.name == DEPTHS
    assert cause in finding.cause


@pytest.mark.parametrize("lag", [-120.0, 18.0, 120.0, 3600.0])
def test_a_late_clock_is_named_to_some_seconds(lag):
    ((_, finding),) = judged(dives(lambda depth: depth, lag))[1]
    assert finding.name == CLOCK
    number, unit = finding.cause.split(" is ")[1].split()[:2]
    stated = float(number) * (3600.0 if unit == "h" else 1.0)
    assert stated == pytest.approx(abs(lag), abs=8.0)
    assert ("ahead" in finding.cause) == (lag > 0.0)


@pytest.mark.parametrize(
    "stuck", [{"own": lambda depth: 120.0}, {"of_vehicle": lambda depth: 120.0}]
)
def test_stuck_depths_are_named_on_either_side(stuck):
    ((_, finding),) = judged(dives(**{"own": lambda depth: depth, "noise": 0.01} | stuck))[1]
    assert (finding.name, "stays at 120.0 m" in finding.evidence) == (DEPTHS, True)


@pytest.mark.parametrize(
    ("own", "noise"), [(lambda d: d, 0.2), (lambda d: d + 3.0, 0.2), (lambda d: 1.005 * d, 1.0)]
)
def test_sound_sensors_are_not_accused(own, noise):
    state, found, _ = judged(dives(own, noise=noise))
    assert found == []
    (lag,) = (text for text in unknowable(state) if "a lag of the instrument's clock" in text)
    assert float(lag.split(" below ")[1].split()[0]) <= 60.0


def courses(kind, late=0.0, speed=2.0):
    """Pings with headings and positions of a vehicle; the clock of the pings is late by some seconds."""
    rng = np.random.default_rng(0)
    degrees = rng.uniform(0.0, 360.0, 30).repeat(4) if kind == "turns" else np.full(120, 70.0)
    steps = speed * STEP * np.exp(1j * np.radians(90.0 - degrees))
    place = np.concatenate([[0.0], np.cumsum(steps)]) / complex(EAST)
    events = [fix(STEP * k, at.real, at.imag * EAST / NORTH) for k, at in enumerate(place)]
    headings = (degrees + 25.0 + np.random.default_rng(1).normal(0.0, 4.0, 120)) % 360.0
    for k, (heading, at) in enumerate(zip(headings, place, strict=False)):
        own = {"heading": heading, "place": (at.real, at.imag)}
        events.append(pressed(STEP * (k + 0.5) - late, math.nan, rng, **own))
    return sorted(events, key=lambda event: event[1]["time"])


@pytest.mark.parametrize(("late", "speed"), [(-7200.0, 2.0), (20_000.0, 2.0), (7200.0, 0.6)])
def test_a_late_clock_is_found_by_the_turns_to_within_a_leg(late, speed):
    found = [one for _, one in judged(courses("turns", late, speed))[1] if one.name == CLOCK]
    assert ("late" if late > 0.0 else "ahead") in found[0].cause
    hours = float(found[0].evidence.split("vehicle ")[1].split(" h ")[0])
    assert hours == pytest.approx(abs(late) / 3600.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "late", "speed"),
    [("turns", 0.0, 2.0), ("straight", 3600.0, 2.0), ("turns", 3600.0, 0.1)],
)
def test_a_right_clock_a_straight_way_and_a_drifting_vehicle_show_none(kind, late, speed):
    state, found, _ = judged(courses(kind, late, speed))
    assert CLOCK not in [one.name for _, one in found]
    said = any("a lag of the instrument's clock below" in text for text in unknowable(state))
    assert said == (late == 0.0)


def test_without_a_pressure_or_a_heading_nothing_can_be_known_and_that_is_said():
    rng = np.random.default_rng(0)
    assert unknowable(judged([])[0]) == ()
    pairs = ((fix(t, 150.0 + 2e-6 * t), pressed(t, math.nan, rng)) for t in 600.0 * np.arange(20))
    state, found, _ = judged(event for pair in pairs for event in pair)
    assert found == []
    assert [text.split(" (")[0] for text in unknowable(state)] == [
        "cannot be known here: an offset, a drift or a scale of the profiles",
        "cannot be known here: the clock and the depth of the instrument",
    ]
