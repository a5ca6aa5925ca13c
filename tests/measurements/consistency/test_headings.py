"""Headings of pings beside the course between positions: which lags of a clock are found, and which cannot be."""

import math

import numpy as np
import pytest

from replay_kit.core.observation import Source, VehicleState
from replay_kit.measurements.consistency.causes import (
    found_of_headings,
    least_lag_of_headings,
    with_position,
)
from replay_kit.measurements.consistency.depths import DepthRecord
from replay_kit.measurements.consistency.sources import metres_per_degree

EAST, NORTH = metres_per_degree(0.0)
STEP = 600.0


def courses(kind, n=120):
    """Degrees, of each ten minutes."""
    rng = np.random.default_rng(0)
    return {"turns": rng.uniform(0.0, 360.0, n // 4).repeat(4), "straight": np.full(n, 70.0)}[kind]


def logged(kind, late, speed=2.0, turned=25.0):
    """Headings of pings and positions of a vehicle; the clock of the pings is late by some seconds."""
    degrees = courses(kind)
    way = speed * STEP * np.exp(1j * np.radians(90.0 - degrees))
    place = np.concatenate([[0.0], np.cumsum(way)])
    positions, own = (), DepthRecord()
    for k, at in enumerate(place):
        fix = VehicleState(
            int(1e9 * STEP * k),
            at.real / EAST,
            at.imag / NORTH,
            math.nan,
            False,
            Source(0, "", 0, 0),
        )
        positions = with_position(positions, fix)
    noise = np.random.default_rng(1).normal(0.0, 4.0, degrees.size)
    for k, heading in enumerate((degrees + turned + noise) % 360.0):
        own = own.after_ping(int(1e9 * (STEP * (k + 0.5) - late)), heading)
    return own, positions


@pytest.mark.parametrize(
    ("late", "speed"), [(7200.0, 2.0), (-7200.0, 2.0), (20_000.0, 2.0), (7200.0, 0.6)]
)
def test_a_late_clock_is_found_by_the_turns_to_within_a_leg(late, speed):
    found = found_of_headings(*logged("turns", late, speed), "/adcp")
    assert found.name == "clock of the instrument"
    assert ("late" if late > 0.0 else "ahead") in found.cause
    hours = float(found.evidence.split("vehicle ")[1].split(" h ")[0])
    assert hours == pytest.approx(abs(late) / 3600.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "late", "speed"),
    [("turns", 0.0, 2.0), ("straight", 3600.0, 2.0), ("turns", 3600.0, 0.1)],
)
def test_a_right_clock_a_straight_way_and_a_drifting_vehicle_show_none(kind, late, speed):
    own, positions = logged(kind, late, speed)
    assert found_of_headings(own, positions, "/adcp") is None
    assert math.isfinite(least_lag_of_headings(own, positions)) == (late == 0.0)


def test_the_least_lag_that_would_show_does():
    least = least_lag_of_headings(*logged("turns", 0.0))
    assert 60.0 < least < 7200.0
    assert found_of_headings(*logged("turns", 2.0 * least), "/adcp") is not None
    assert least_lag_of_headings(DepthRecord(), ()) == math.inf
