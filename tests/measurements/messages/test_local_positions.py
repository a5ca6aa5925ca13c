"""Positions in a local frame, of one component of one system: with an origin they are dead-reckoned, without one the message says so."""

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Observation, VehicleState
from tests.measurements.foreign import pose
from tests.measurements.messages.test_messages import sent
from tests.measurements.samples import (
    CONFIG,
    events_of,
    in_order,
    logged,
    mavlink_frames,
    only,
    position_int,
    reasons,
    run,
)

ORIGIN = (152.0, -40.0)
STATED = MeasurementConfig(origin=ORIGIN)


def _local(time_s):
    payload = {"x": 0.3 * time_s, "y": 0.8 * time_s, "z": 5.0}
    return sent("LOCAL_POSITION_NED", payload, time_s)


def _origin(longitude, latitude):
    stated = {"longitude": round(longitude * 1e7), "latitude": round(latitude * 1e7)}
    return sent("GPS_GLOBAL_ORIGIN", stated)


def _track(events):
    return np.array([(p.longitude, p.latitude) for p in only(VehicleState, events)])


@pytest.mark.parametrize("stated", ["log", "setting", "both"])
def test_local_positions_are_dead_reckoned_from_an_origin(stated):
    logs = {"log": [_origin(*ORIGIN)], "setting": [], "both": [_origin(10.0, 50.0)]}
    no_fix = [position_int(k, lon=0, lat=0) for k in range(0, 20, 2)]
    messages = [*logs[stated], *in_order(*map(_local, range(1, 20)), *no_fix, *mavlink_frames(5.0))]
    events = run(messages, MeasurementConfig() if stated == "log" else STATED)
    seconds = np.arange(1.0, 20.0)
    expected = np.column_stack(to_geographic(Projection(*ORIGIN), 0.8 * seconds, 0.3 * seconds))
    np.testing.assert_allclose(_track(events), expected, atol=1e-9)
    assert all(p.dead_reckoned and p.depth == 5.0 for p in only(VehicleState, events))
    (ping,) = only(Observation, events)
    assert (ping.longitude, ping.latitude) == pytest.approx(tuple(expected[4]), abs=1e-9)


def test_without_an_origin_and_beside_a_position_on_the_earth_they_are_named():
    alone = run([*map(_local, range(1, 20))])
    assert not only(VehicleState, alone)
    assert (
        reasons(alone) == ["local position without an origin: state it with --origin LON,LAT"] * 19
    )
    both = run(in_order(_origin(*ORIGIN), position_int(0), *map(_local, range(1, 20))), STATED)
    assert len(only(VehicleState, both)) == 1
    assert set(reasons(both)) == {
        "local position beside the system's position on the Earth, which is used"
    }


def test_odometry_without_a_fix_begins_at_a_stated_origin():
    odometry = [
        logged("nav_msgs/msg/Odometry", {"pose": pose(10.0 * k, -5.0 * k, -2.0)}, k, "/odom")
        for k in range(1, 5)
    ]
    k = np.arange(1.0, 5.0)
    expected = np.column_stack(to_geographic(Projection(*ORIGIN), 10.0 * k, -5.0 * k))
    np.testing.assert_allclose(_track(run(odometry, STATED)), expected, atol=1e-9)
    assert not only(VehicleState, run(odometry))


@pytest.mark.parametrize(
    ("other", "asked", "left"),
    [
        ("1/191", {}, "component 191, but component 1 is used; choose with component in [logs]"),
        ("1/191", {"component": 1}, "component 191, but component 1"),
        ("1/191", {"component": 191}, "component 1, but component 191"),
        ("2/1", {}, "choose with system in [logs]"),
        ("2/1", {"system": 2}, "choose with system in [logs]"),
    ],
)
def test_one_component_of_one_system_counts(other, asked, left):
    own, others = map(position_int, range(6)), (position_int(k + 0.5) for k in range(6))
    others = [one._replace(topic=one.topic.replace("1/1", other)) for one in others]
    messages = in_order(*own, *others)
    events = [event for each in events_of(messages, CONFIG, **asked) for event in each]
    said, used = reasons(events), only(VehicleState, events)
    assert (len(said), len(used), all(left in reason for reason in said)) == (6, 6, True)
    asked_other = any(f"/{value}/" in f"/{other}/" for value in asked.values() if value > 1)
    assert {other in one.source.topic for one in used} == {asked_other}
