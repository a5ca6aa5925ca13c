"""Messages to observations: pings, positions, dives, and everything a message can get wrong."""

import math

import gsw
import numpy as np
import pytest
from numpy.testing import assert_allclose

from replay_kit.core.observation import Flag, Observation, PathMean, Reason, VehicleState
from tests.measurements.samples import (
    CONFIG,
    dac,
    fix,
    logged,
    mavlink_frames,
    only,
    ping,
    position_int,
    reasons,
    run,
    the,
)


@pytest.mark.parametrize(
    ("vehicle", "changes", "depth"),
    [
        (0.0, {"pressure": 100.0, "transducer_depth": 1.0}, 116.2),
        (0.0, {"orientation": "up", "pressure": None, "transducer_depth": 60.0}, 44.0),
        (200.0, {"pressure": math.nan}, 216.0),
    ],
)
def test_depths_of_cells_are_those_of_the_pressure_or_of_the_vehicle(vehicle, changes, depth):
    found = the(Observation, [fix(0, depth=vehicle), ping(0, **changes)])
    up = "orientation" in changes
    assert_allclose(found.depth - found.depth[0], np.array([0.0, 32.0, 64.0]) * (-1.0) ** up)
    assert found.depth[0] == pytest.approx(depth, abs=0.1)
    assert (found.flags[2] == Flag.FAIL) == bool(found.reasons[2] & Reason.ABOVE_SURFACE) == up


def test_an_incomplete_mavlink_ping_is_said():
    events = run([position_int(5), *mavlink_frames(skip=("ADCP_N",))])
    assert reasons(events) == ["part of an incomplete ping"] * 4
    two = mavlink_frames(n_components=2.0, skip=("ADCP_U",))
    assert len(only(Observation, [*events, *run([position_int(5), *two])])) == 1


def test_a_dive_known_by_the_ping_s_pressure_is_in_metres():
    pings = [ping(100 * k, pressure=20.0 * min(k, 100 - k)) for k in range(1, 100)]
    stated = dac(10_001, end_s=10_000)
    mean = the(PathMean, [fix(0), *pings, fix(10_000), stated])
    # a dive of 1000 dbar goes down to 990 m; its two middle pieces of 128 each end at the apogee
    deepest = -gsw.z_from_p(1000.0, -40.0)
    assert mean.depth.max() == pytest.approx(deepest * 127.0 / 128.0, rel=1e-12)


@pytest.mark.parametrize(("more", "dive"), [(-0.001, 0), (0.001, 1)])
def test_a_dive_begins_at_a_depth_and_not_at_its_number_of_decibars(more, dive):
    pressure = float(gsw.p_from_z(-(2.0 * CONFIG.surface_depth + more), -40.0))
    assert the(Observation, [fix(0), ping(60, pressure=pressure)]).dive == dive


@pytest.mark.parametrize(("first", "latitude"), [([], 45.0), ([fix(0)], -40.0)])
def test_a_pressure_before_the_first_position_is_taken_at_45_degrees(first, latitude):
    pressure = logged("sensor_msgs/FluidPressure", {"fluid_pressure": 101_325.0 + 1e7})
    *_, state = only(VehicleState, run([*first, pressure, fix(1)]))
    assert state.depth == pytest.approx(-gsw.z_from_p(1000.0, latitude), rel=1e-12)
