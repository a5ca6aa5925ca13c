"""Other packages' messages, from logs in their own encodings: a profile, a position, a depth, or why not."""

import math
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag, Observation, VehicleState
from replay_kit.logs.tables.instruments import STD_BELIEVED
from replay_kit.logs.tables.schemas import canonical, reader_of
from tests.logs.log_samples import one_channel_mcap
from tests.measurements import definitions as msg
from tests.measurements.carriers import json_mcap, read_mcap, ros2_mcap
from tests.measurements.foreign import BEAMS, NUCLEUS, ds_adcp, imc, pose, vectors
from tests.measurements.samples import (
    CONFIG,
    SECOND,
    Skipped,
    fix,
    logged,
    only,
    ping,
    reasons,
    run,
    the,
)
from tests.measurements.turned import stated

EARTH = MeasurementConfig(reference="earth")


def through_ros2(folder, schema, definition, payload):
    (message,) = read_mcap(folder, ros2_mcap(schema, definition, [payload]))
    return message


def skipped(message, config=CONFIG):
    event = the(Skipped, [fix(0), message], config)
    assert event.topic == message.topic
    return event.reason


@pytest.mark.parametrize("schema", ["ds_sensor_msgs/msg/Adcp", "ds_sensor_msgs/Adcp"])
def test_ds_adcp_in_earth_coordinates(tmp_path, schema):
    message = through_ros2(tmp_path, schema, msg.DS_ADCP_2, ds_adcp())
    profile = the(Observation, [fix(0, depth=10.0), message], EARTH)
    assert_array_equal(profile.velocity, [[0.1, -0.2], [np.nan, np.nan], [0.3, 0.0]])
    assert profile.flags.tolist() == [Flag.GOOD, Flag.MISSING, Flag.GOOD]
    assert_array_equal(profile.depth, [13.5, 15.5, 17.5])
    assert "measurements.reference" in skipped(message)
    relative = the(
        Observation, [fix(0, depth=10.0), message], MeasurementConfig(reference="platform")
    )
    assert (relative.reference, relative.common_std) == ("platform", np.inf)


@pytest.mark.parametrize(("mode", "system"), [(0, "beam"), (1, "instrument"), (2, "ship")])
def test_ds_adcp_in_other_coordinates_is_said(tmp_path, mode, system):
    message = through_ros2(tmp_path, "ds_sensor_msgs/msg/Adcp", msg.DS_ADCP_2, ds_adcp(mode))
    assert stated(message, EARTH).frame == system
    assert not only(Observation, run([fix(0), message], EARTH))
    assert skipped(message, EARTH)


def test_ds_adcp_in_no_coordinates():
    assert "none of 0" in skipped(logged("ds_sensor_msgs/Adcp", ds_adcp(9)))


def test_ds_adcp_along_its_beams():
    water = np.array([0.2, -0.1, 0.05])
    along = [np.multiply(water @ beam, beam).tolist() for beam in BEAMS]
    payload = ds_adcp(0)
    payload["vel_bin_beams"] = [{"velocity_bin_beam": vectors([*along[:3], (0.0, 0.0, 0.0)])}]
    found = stated(logged("ds_sensor_msgs/Adcp", payload), EARTH)
    assert_allclose(found.velocity[0, :3], np.array(BEAMS[:3]) @ water, atol=1e-15)
    assert np.isnan(found.velocity[0, 3])
    assert_array_equal(found.vectors, BEAMS)
    assert found.frame == "beam"


def test_ds_adcp_whose_cells_are_cut_to_whole_metres_is_said():
    assert "cells below 1 m" in skipped(logged("ds_sensor_msgs/Adcp", ds_adcp(cell_depth=0)))


def test_ds_adcp_in_ros1(tmp_path):
    header = struct.pack("<IIII", 1, 2, 3, 4) + b"adcp" + struct.pack("<II", 2, 3) + bytes(16)
    fixed = header + struct.pack("<BBBHf", 3, 0, 2, 4, 6.0) + struct.pack("<12d", *np.ravel(BEAMS))
    cells = (
        struct.pack("<I", 2)
        + struct.pack("<I3d", 1, 0.1, 0.2, 0.0)
        + struct.pack("<I3d", 1, 0.3, 0.4, 0.0)
    )
    schema = ("ds_sensor_msgs/Adcp", "ros1msg", msg.DS_ADCP_1.encode())
    (message,) = read_mcap(tmp_path, one_channel_mcap("ros1", schema, [fixed + cells]))
    profile = the(Observation, [fix(0), message], EARTH)
    assert_array_equal(profile.velocity, [[0.1, 0.2], [0.3, 0.4]])
    assert_array_equal(profile.depth, [6.0, 10.0])


@pytest.mark.parametrize(
    "schema", ["interfaces/msg/CurrentProfile", "nortek_nucleus_dvl/CurrentProfile"]
)
def test_nucleus_profile(tmp_path, schema):
    message = through_ros2(tmp_path, schema, msg.NUCLEUS, NUCLEUS)
    found = stated(message)
    assert_array_equal(found.velocity, [[0.12, -0.05, 0.003], [np.nan, 0.007, 0.008]])
    assert_array_equal(found.amplitude, [[70, 71, 72], [73, 74, 75]])
    assert_array_equal(found.correlation, [[90, 91, 92], [93, 94, 95]])
    assert found.distance[0] == 0.5
    assert "declination unknown" in skipped(message)
    assert "three beams" in skipped(message._replace(payload={**NUCLEUS, "number_of_cells": 3}))


@pytest.mark.parametrize("schema", ["IMC.CurrentProfile", "imc/CurrentProfile", ""])
@pytest.mark.parametrize(
    ("coord_sys", "system", "cell"),
    [
        (8, "earth", [0.1, 0.2, 0.3]),
        ("ENU", "earth", [0.1, 0.2, 0.3]),
        (2, "earth", [0.2, 0.1, -0.3]),
        ("ned", "earth", [0.2, 0.1, -0.3]),
        (1, "instrument", [0.1, 0.2, 0.3, 0.4]),
        (4, "beam", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_imc_profile(tmp_path, schema, coord_sys, system, cell):
    (message,) = read_mcap(
        tmp_path, json_mcap([(0, "/imc", schema, imc(coord_sys, [[0.1, 0.2, 0.3, 0.4]]))])
    )
    found = stated(message)
    assert found.frame == system
    assert_array_equal(found.velocity, [cell])
    assert_array_equal(found.distance, [5.0])
    assert_array_equal(found.correlation, [[90] * 4])
    events = run([fix(0), message])
    assert [o.reference for o in only(Observation, events)] == ["platform"] * (system == "earth")


def test_imc_profiles_that_are_none():
    assert "none of XYZ" in skipped(logged("imc.CurrentProfile", imc(3, [[0.1] * 3]), topic="/imc"))
    assert "three components" in skipped(
        logged("imc.CurrentProfile", imc(8, [[0.1] * 2]), topic="/imc")
    )
    assert "neither velocity_data" in skipped(logged("imc.CurrentProfile", {}, topic="/imc"))


def test_cells_at_listed_distances():
    payload = {
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "n_cells": 3,
        "velocity": [[0.1, 0.2]] * 3,
    }
    ping = logged(
        "replay_kit.AdcpPing", {**payload, "cell_distances": [4.0, 9.0, None]}, topic="/adcp"
    )
    profile = the(Observation, [fix(0, depth=100.0), ping])
    assert_array_equal(profile.depth, [104.0, 109.0, np.nan])
    assert profile.flags.tolist() == [Flag.GOOD, Flag.GOOD, Flag.MISSING]
    assert "cell_distances" in skipped(ping._replace(payload={**payload, "cell_distances": [4.0]}))


def test_a_dvl_is_read(tmp_path):
    payload = {
        "velocity_mode": 2,
        "velocity": {"x": 0.5, "y": 0.1, "z": -0.2},
        "velocity_covar": [4e-4] * 9,
    }
    payload |= {
        "range": [9.0] * 4,
        "range_covar": [-1.0] * 4,
        "beam_quality": [1.0] * 4,
        "beam_velocity": [0.1] * 4,
    }
    payload |= {"beam_velocity_covar": [-1.0] * 4, "beam_unit_vec": vectors(BEAMS)}
    message = through_ros2(tmp_path, "marine_acoustic_msgs/msg/Dvl", msg.DVL, payload)
    found = stated(message)
    assert (found.velocity.tolist(), found.error_std) == ([0.5, 0.1, -0.2], 0.02)
    assert not found.bottom


@pytest.mark.parametrize(
    ("covariance", "words"),
    [([-1.0] + [0.0] * 8, "no orientation stated"), ([0.0] * 9, "without their own")],
)
def test_an_attitude_is_said_to_be_one(tmp_path, covariance, words):
    payload = {"orientation": {"w": 1.0}, "orientation_covariance": covariance}
    payload |= {
        "angular_velocity_covariance": [0.0] * 9,
        "linear_acceleration_covariance": [0.0] * 9,
    }
    message = through_ros2(tmp_path, "sensor_msgs/msg/Imu", msg.IMU, payload)
    assert words in skipped(message)


def test_a_navsatfix(tmp_path):
    place = {
        "latitude": -40.0,
        "longitude": 152.0,
        "altitude": math.nan,
        "position_covariance": [0.0] * 9,
    }
    payloads = [{**place, "status": {"status": status, "service": 1}} for status in (-1, 0, 2)]
    messages = read_mcap(
        tmp_path, ros2_mcap("sensor_msgs/msg/NavSatFix", msg.NAV_SAT_FIX, payloads, "/gps")
    )
    events = run(messages)
    assert [(state.longitude, state.latitude) for state in only(VehicleState, events)] == [
        (152.0, -40.0)
    ] * 2
    assert reasons(events)[0] == "no fix (status < 0)"


def test_a_fluid_pressure_is_absolute_pascal(tmp_path):
    data = ros2_mcap(
        "sensor_msgs/msg/FluidPressure",
        msg.FLUID_PRESSURE,
        [{"fluid_pressure": 101_325.0 + 1e6, "variance": 0.0}],
        "/p",
    )
    states = only(VehicleState, run([fix(0), *read_mcap(tmp_path, data), fix(1)]))
    assert states[1].depth == pytest.approx(99.2, abs=0.2)


def test_poses_move_the_last_position_each_topic_in_its_own_frame(tmp_path):
    poses = [pose(1e5, 1e5, 0.0), pose(1e5 + 1000.0, 1e5, -40.0)]
    stamped = read_mcap(
        tmp_path, ros2_mcap("geometry_msgs/msg/PoseStamped", msg.POSE_STAMPED, poses, "/map_pose")
    )
    inner = {"covariance": [0.0] * 36}
    odometry = [
        {"header": p["header"], "pose": {**inner, "pose": p["pose"]}, "twist": inner}
        for p in (pose(0, 0, 0), pose(0, 500.0, -30.0))
    ]
    odometry = read_mcap(
        tmp_path, ros2_mcap("nav_msgs/msg/Odometry", msg.ODOMETRY, odometry, "/odom")
    )
    later = [message._replace(time_ns=message.time_ns + 5 * SECOND) for message in odometry]
    states = only(
        VehicleState,
        run([fix(0), *(m._replace(time_ns=m.time_ns + SECOND) for m in stamped), *later]),
    )
    assert [state.depth for state in states[1:]] == [0.0, 40.0, 0.0, 30.0]
    assert states[2].longitude - 152.0 == pytest.approx(1000.0 / 85_400.0, rel=1e-3)
    # the second topic begins where the first had got to, in a frame of its own
    assert states[3].longitude == pytest.approx(states[2].longitude, abs=1e-9)
    assert states[4].latitude + 40.0 == pytest.approx(500.0 / 111_000.0, rel=1e-2)


def test_frames_that_are_not_east_north_up():
    ned = logged("geometry_msgs/PoseStamped", pose(20.0, 10.0, 40.0, "world_ned"), topic="/pose")
    found = stated(ned)
    assert (found.east, found.north, found.depth) == (10.0, 20.0, 40.0)
    assert "frame 'earth'" in skipped(ned._replace(payload=pose(1e6, 1e6, 1e6, "/earth")))
    assert "suggests a goal" in skipped(ned._replace(topic="/move_base/Goal"))
    assert skipped(ned._replace(payload={})) == "no pose.position in it"


@pytest.mark.parametrize(
    "schema",
    [
        "sensor_msgs/NavSatFix",
        "sensor_msgs/msg/NavSatFix",
        "sensor_msgs::msg::dds_::NavSatFix_",
        "sensor_msgs.NavSatFix",
    ],
)
def test_every_spelling_of_a_name(schema):
    assert canonical(schema) == "sensor_msgs.NavSatFix"


def test_names_that_are_no_package_and_type():
    assert [canonical(name) for name in ("GLOBAL_POSITION_INT", "", "msg", "/")] == [
        "GLOBAL_POSITION_INT",
        "",
        "msg",
        "/",
    ]
    assert reader_of("", "/x") is None


PLACE = {"lat": math.radians(-40.0), "lon": math.radians(152.0)}


@pytest.mark.parametrize(
    ("kind", "fields", "expected"),
    [
        ("GpsFix", {"validity": 0x0007, "type": "STANDALONE"}, (152.0, -40.0, math.nan, False)),
        ("GpsFix", {"type": 2}, (152.0, -40.0, math.nan, True)),
        ("EstimatedState", {"x": 0.0, "y": 0.0, "depth": 30.0}, (152.0, -40.0, 30.0, True)),
        ("EstimatedState", {"x": -1000.0, "depth": -1.0}, (152.0, -40.009, math.nan, True)),
    ],
)
@pytest.mark.parametrize("named", [True, False])
def test_imc_positions(kind, fields, expected, named):
    message = logged(
        f"IMC.{kind}" if named else "", {"abbrev": kind, **PLACE, **fields}, topic="/imc"
    )
    found = stated(message)
    values = (found.longitude, found.latitude, found.depth, found.dead_reckoned)
    assert values == pytest.approx(expected, abs=2e-5, nan_ok=True)


def test_imc_positions_that_are_none():
    assert "VALID_POS" in skipped(logged("imc/GpsFix", {**PLACE, "validity": 3}, topic="/imc"))
    assert "0, 0" in skipped(logged("imc/EstimatedState", {"lat": 0.0, "lon": 0.0}, topic="/imc"))
    assert "not a number" in skipped(
        logged("imc/EstimatedState", {**PLACE, "x": None}, topic="/imc")
    )
    assert reader_of("vendor.GpsFix", "/x") is None


def test_the_bounds_of_an_error_that_is_believed_belong_to_it_for_one_number_and_for_many():
    def believed(value, n=3):
        cells = {"n_cells": n, "velocity": [[0.1, 0.2]] * n, "velocity_std": value}
        return stated(ping(0, **cells)).error_std

    low, high = STD_BELIEVED
    outside = [0.5 * low, 2.0 * high, np.nan]
    assert_array_equal(believed([low, high, *outside], 5), [low, high, np.nan, np.nan, np.nan])
    for value in (low, high, *outside):
        assert_array_equal(believed(value), believed([value] * 3))
        assert_array_equal(believed(value), believed([value]))
