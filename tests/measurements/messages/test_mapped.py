"""Topics that the configuration maps: every unit, sign and shape, and a wrong path said once."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.logs.tables.mapped import look_up
from replay_kit.measurements.observed import begun
from replay_kit.workflows.replay.inputs.scan import open_readers
from tests.logs.dataflash.dataflash_samples import dataflash
from tests.logs.log_samples import tlog_entry
from tests.measurements.samples import (
    Skipped,
    Used,
    fix,
    interpret,
    logged,
    mapping,
    only,
    reasons,
    run,
    the,
)
from tests.measurements.turned import stated

PROFILE = {
    "topic": "/p",
    "kind": "profile",
    "reference": "earth",
    "frame": "enu",
    "cell_size": 4.0,
    "first_cell": 6.0,
}
POSITION = {"topic": "/p", "kind": "position", "longitude": "lon", "latitude": "lat"}


def entry(**fields):
    return mapping(fields)


def mapped(payload, config):
    return stated(logged("", payload, topic="/p"), config)


def profile(payload, vehicle_depth=0.0, **fields):
    config = mapping({**PROFILE, **fields})
    return run([fix(0, depth=vehicle_depth), logged("vendor.Thing", payload, topic="/p")], config)


def observed(payload, **fields):
    (observation,) = only(Observation, profile(payload, **fields))
    return observation


def test_paths():
    payload = {"a": {"b": [10, {"c": 3}]}, "cells": [{"v": 1}, {"v": 2}], "raw": b"\x05"}
    assert look_up(payload, "a.b.0") == 10
    assert look_up(payload, "a.b.-1.c") == 3
    assert look_up(payload, "cells.*.v") == [1, 2]
    assert look_up(payload, "raw.0") == 5


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("x", "the message holds a, cells"),
        ("a.b.7", "at 'a.b' holds a list"),
        ("a.b.c", "at 'a.b' holds a list"),
        ("a.b.0.c", "at 'a.b.0' holds one int"),
        ("cells.0.v.w", "at 'cells.0.v' holds nothing"),
        ("a.*", "at 'a' holds b"),
    ],
)
def test_a_path_that_leads_nowhere_says_what_stands_there(path, words):
    with pytest.raises(MeasurementError, match=words.replace(".", r"\.")):
        look_up({"a": {"b": [10]}, "cells": [{"v": None}]}, path)


def test_a_wrong_path_is_one_reason_for_all_messages():
    config = mapping({**POSITION, "longitude": "fix.lon"})
    messages = [
        Message(k, "/p", "vendor.Fix", {"latitude": k, "longitude": 0.1 * k}, 0, k)
        for k in range(5)
    ]
    events = run(messages, config)
    assert len(events) == 5
    (reason,) = {event.reason for event in only(Skipped, events)}
    assert "'fix.lon' leads nowhere: the message holds latitude, longitude" in reason


@pytest.mark.parametrize(
    ("unit", "longitude", "latitude"), [("deg", 152.5, -40.25), ("degE7", 1525000000, -402500000)]
)
def test_positions(unit, longitude, latitude):
    position = mapped(
        {"lon": longitude, "lat": latitude}, entry(**POSITION, angle_unit=unit, dead_reckoned=True)
    )
    assert (position.longitude, position.latitude, position.dead_reckoned) == (152.5, -40.25, True)
    assert math.isnan(position.depth)


def test_positions_in_radians():
    position = mapped(
        {"lon": math.radians(152.5), "lat": math.radians(-40.25)},
        entry(**POSITION, angle_unit="rad"),
    )
    assert (position.longitude, position.latitude) == pytest.approx((152.5, -40.25), abs=1e-12)
    with pytest.raises(ValueError, match="position is 0, 0"):
        mapped({"lon": 0, "lat": 0}, entry(**POSITION))


@pytest.mark.parametrize(
    ("fields", "value", "expected"),
    [
        ({}, 12.5, "depth"),
        ({"depth_positive": "up"}, -12.5, "depth"),
        ({"depth_unit": "cm"}, 1250, "depth"),
        ({"depth_unit": "dbar"}, 12.5, "pressure"),
        ({"depth_unit": "bar"}, 1.25, "pressure"),
        ({"depth_unit": "kPa"}, 125.0, "pressure"),
        ({"depth_unit": "hPa"}, 1250.0, "pressure"),
        ({"depth_unit": "Pa"}, 125_000.0, "pressure"),
        ({"depth_unit": "Pa", "depth_absolute": True}, 226_325.0, "pressure"),
    ],
)
def test_depths_and_pressures(fields, value, expected):
    found = mapped(
        {"d": {"value": value}}, entry(topic="/p", kind="depth", depth="d.value", **fields)
    )
    assert found.by == expected
    assert getattr(found, expected) == pytest.approx(12.5, abs=1e-12)


def test_a_position_with_a_pressure():
    config = entry(**POSITION, depth="p", depth_unit="bar")
    message = logged("", {"lon": 1.0, "lat": 2.0, "p": 10.0}, topic="/p")
    assert the(VehicleState, [message], config).depth == pytest.approx(99.4, abs=0.3)


@pytest.mark.parametrize(
    ("unit", "factor"), [("m/s", 1), ("dm/s", 10), ("cm/s", 100), ("mm/s", 1000)]
)
@pytest.mark.parametrize(
    ("frame", "cell"), [("enu", [0.125, -0.25, 0.5]), ("ned", [-0.25, 0.125, -0.5])]
)
def test_speeds_and_frames(unit, factor, frame, cell):
    payload = {"v": [[factor * value for value in cell]] * 2}
    assert_array_equal(
        observed(payload, velocity="v", speed_unit=unit, frame=frame).velocity, [[0.125, -0.25]] * 2
    )
    flat = {"v": payload["v"][0] * 2}
    assert_array_equal(
        observed(flat, velocity="v", components=3, speed_unit=unit, frame=frame).velocity,
        [[0.125, -0.25]] * 2,
    )


def test_columns_and_missing_numbers():
    cells = {"cells": [{"u": 100, "v": -32768}, {"u": 0, "v": 5}, {"u": None, "v": 1}]}
    columns = {
        "east": "cells.*.u",
        "north": "cells.*.v",
        "speed_unit": "mm/s",
        "missing": [-32768, 0],
    }
    found = observed(cells, **columns, velocity_std=0.04)
    assert_array_equal(found.velocity, [[0.1, np.nan], [np.nan, 0.005], [np.nan, 0.001]])
    assert_array_equal(found.error_std, 0.04)


@pytest.mark.parametrize(
    ("fields", "payload", "expected"),
    [
        ({}, {}, [106.0, 110.0]),
        ({"orientation": "up"}, {}, [94.0, 90.0]),
        (
            {"cell_size": "size", "first_cell": "first", "distance_unit": "cm"},
            {"size": 50, "first": 75},
            [100.75, 101.25],
        ),
        (
            {"cell_size": None, "first_cell": None, "distances": "at"},
            {"at": [3.0, 9.0]},
            [103.0, 109.0],
        ),
        ({"cell_size": None, "first_cell": None, "depths": "at"}, {"at": [3.0, 9.0]}, [3.0, 9.0]),
        (
            {"cell_size": None, "first_cell": None, "depths": "at", "depth_positive": "up"},
            {"at": [-3.0, -9.0]},
            [3.0, 9.0],
        ),
        ({"depth": "z", "depth_positive": "up"}, {"z": -20.0}, [26.0, 30.0]),
        ({"depth": "p", "depth_unit": "dbar"}, {"p": 0.0}, [6.0, 10.0]),
    ],
)
def test_where_the_cells_are(fields, payload, expected):
    fields = {key: value for key, value in {**PROFILE, **fields}.items() if value is not None}
    config = mapping({**fields, "velocity": "v"})
    message = logged("", {**payload, "v": [[0.1, 0.2]] * 2}, topic="/p")
    observation = the(Observation, [fix(0, depth=100.0), message], config)
    assert_array_equal(observation.depth, expected)


@pytest.mark.parametrize(
    ("payload", "fields", "words"),
    [
        ({"v": [0.1, 0.2]}, {"velocity": "v"}, "number of components"),
        ({"v": [0.1, 0.2, 0.3]}, {"velocity": "v", "components": 2}, "number of components"),
        ({"v": 0.1}, {"velocity": "v"}, "not a list"),
        ({"e": [1.0], "n": [1.0, 2.0]}, {"east": "e", "north": "n"}, "not lists of one length"),
        ({"v": []}, {"velocity": "v"}, "n_cells >= 1"),
        ({"v": [[0.1]]}, {"velocity": "v", "frame": "ned"}, "expected cells"),
    ],
)
def test_profiles_that_are_none(payload, fields, words):
    events = profile(payload, **fields)
    assert not only(Observation, events)
    assert words in reasons(events)[0]


@pytest.mark.parametrize("frame", ["beam", "instrument", "ship"])
def test_profiles_in_other_frames_keep_their_components(frame):
    found = mapped(
        {"v": [[1.0, 2.0, 3.0, 4.0]]}, entry(**PROFILE | {"frame": frame, "velocity": "v"})
    )
    assert found.frame == frame
    assert found.velocity.tolist() == [[1.0, 2.0, 3.0, 4.0]]
    assert not only(Observation, profile({"v": [[1.0, 2.0, 3.0, 4.0]]}, velocity="v", frame=frame))


@pytest.mark.parametrize(("longitude", "where"), [(10.5, 10.5), (0.0, 152.0)])
def test_a_profile_with_a_position_in_the_same_message(longitude, where):
    payload = {"v": [[0.1, 0.2]], "lon": longitude, "lat": longitude and -30.0}
    events = profile(payload, velocity="v", longitude="lon", latitude="lat")
    (observation,) = only(Observation, events)
    assert observation.longitude == where
    assert len(only(VehicleState, events)) == 1 + (longitude != 0.0)
    assert len(only(Used, events)) == 2


def test_a_position_counts_where_the_profile_in_its_message_does_not():
    events = profile(
        {"v": [[1.0]], "lon": 10.5, "lat": -30.0}, velocity="v", longitude="lon", latitude="lat"
    )
    assert not only(Observation, events)
    assert 10.5 in [state.longitude for state in only(VehicleState, events)]
    assert "expected cells of east, north" in reasons(events)[0]


def test_a_mapping_goes_before_a_known_kind():
    config = mapping({**POSITION, "topic": "/gps"})
    events = run(
        [logged("sensor_msgs/NavSatFix", {"lon": 1.0, "lat": 2.0, "status": -1}, topic="/gps")],
        config,
    )
    assert (len(only(VehicleState, events)), len(only(Used, events))) == (1, 1)


@pytest.mark.parametrize(
    "fields", [{}, {"depth_unit": "dbar"}, {"depth_unit": "Pa", "depth_absolute": True}]
)
def test_an_unknown_depth_of_the_instrument_is_that_of_the_vehicle(fields):
    payload = {"v": [[0.1, 0.2]], "d": None}
    (observation,) = only(Observation, profile(payload, 50.0, velocity="v", depth="d", **fields))
    assert observation.depth.tolist() == [56.0]
    entries = {"map": [{**PROFILE, "velocity": "v", "depth": "d", **fields}]}
    config = MeasurementConfig.model_validate(entries)
    events = run([fix(0), logged("vendor.Thing", payload, topic="/p")], config)
    assert only(Observation, events) == []
    assert reasons(events) == [
        "ping: instrument depth is not a number, and no earlier message gives the vehicle depth"
    ]


def test_a_mapping_goes_before_a_known_kind_of_mavlink(tmp_path):
    log = [
        tlog_entry(10**15 + k, dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, 0, -12.5, 0.0))
        for k in range(2)
    ]
    (tmp_path / "log.tlog").write_bytes(b"".join(log))
    (tmp_path / "log.BIN").write_bytes(b"".join(dataflash(2)))
    hud = {"topic": "mavlink/1/1/VFR_HUD", "kind": "depth", "depth": "alt", "depth_positive": "up"}
    ctun = {"topic": "dataflash/CTUN", "kind": "depth", "depth": "BAlt", "depth_positive": "up"}
    imu = {"topic": "dataflash/IMU", "kind": "depth", "depth": "AccZ", "depth_positive": "up"}
    config = RunConfig.model_validate({"measurements": {"map": [hud, ctun, imu]}})
    depths = {}
    for reader in open_readers([tmp_path / "log.tlog", tmp_path / "log.BIN"], config):
        for message in reader.messages():
            state, _ = interpret(begun(), message, config.measurements)
            depths[message.topic] = state.memory.depths["depth"][0]
    assert depths["mavlink/1/1/VFR_HUD"] == 12.5
    assert depths["dataflash/CTUN"] == pytest.approx(2.1, abs=1e-6)
    assert depths["dataflash/IMU"] == pytest.approx(9.8, abs=1e-6)


def test_one_velocity_at_one_depth():
    mooring = {
        "topic": "/m",
        "kind": "velocity",
        "reference": "earth",
        "east": "v.0",
        "north": "v.1",
        "speed_unit": "cm/s",
        "velocity_std": 0.02,
    }
    message = Message(
        5 * 10**9, "/m", "", {"v": [10.0, -20.0], "lon": 151.0, "lat": -39.0, "p": 101.0}, 0, 0
    )
    config = mapping({**mooring, "place": [150.5, -41.0], "at_depth": 80.0})
    # it says where it is itself, and nothing of the vehicle
    found = the(Observation, [message, fix(600, depth=100.0)], config)
    assert (found.longitude, found.latitude, found.depth.tolist(), found.dive) == (
        150.5,
        -41.0,
        [80.0],
        0,
    )
    assert_allclose(found.velocity, [[0.1, -0.2]])
    assert_allclose(found.error_std, [0.02])
    drifter = {**mooring, "longitude": "lon", "latitude": "lat", "depth": "p", "depth_unit": "dbar"}
    found = the(Observation, [message], mapping(drifter))
    assert (found.longitude, found.latitude, round(float(found.depth[0]))) == (151.0, -39.0, 100)
    found = the(Observation, [fix(0, depth=40.0), message, fix(10)], mapping(mooring))
    assert (found.longitude, found.depth.tolist()) == (152.0, [40.0])
    for wrong in (
        {"place": [150.5, -41.0]},
        {"place": [150.5, -91.0], "at_depth": 1.0},
        {"longitude": "lon"},
        {"depth": "p", "at_depth": 1.0},
    ):
        with pytest.raises(ValidationError):
            mapping({**mooring, **wrong})
