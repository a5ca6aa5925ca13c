"""Other packages' messages, from logs in their own encodings: a profile, a position, a depth, or why not."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag, Observation, VehicleState
from tests.measurements import definitions as msg
from tests.measurements.carriers import json_mcap, read_mcap, ros2_mcap
from tests.measurements.foreign import BEAMS, ds_adcp, imc, pose, vectors
from tests.measurements.samples import (
    Skipped,
    fix,
    logged,
    only,
    ping,
    run,
    the,
)
from tests.measurements.turned import stated

EARTH = MeasurementConfig(reference="earth")
PLACE = {"lat": math.radians(-40.0), "lon": math.radians(152.0)}
NAV_SAT = {"latitude": -40.0, "longitude": 152.0, "status": {"status": 0}}
ORIENTED = {"orientation": {"w": 1.0}, "orientation_covariance": [0.0] * 9}


def through_ros2(folder, schema, definition, payload):
    (message,) = read_mcap(folder, ros2_mcap(schema, definition, [payload]))
    return message


def test_ds_adcp_in_earth_coordinates(tmp_path):
    name = "ds_sensor_msgs/msg/Adcp"
    message = through_ros2(tmp_path, name, msg.DS_ADCP_2, ds_adcp())
    profile = the(Observation, [fix(0, depth=10.0), message], EARTH)
    assert_array_equal(profile.velocity, [[0.1, -0.2], [np.nan, np.nan], [0.3, 0.0]])
    assert profile.flags.tolist() == [Flag.GOOD, Flag.MISSING, Flag.GOOD]
    assert_array_equal(profile.depth, [13.5, 15.5, 17.5])
    relative = MeasurementConfig(reference="platform")
    found = the(Observation, [fix(0, depth=10.0), message], relative)
    assert (found.reference, found.common_std) == ("platform", np.inf)


def test_ds_adcp_along_its_beams():
    water = np.array([0.2, -0.1, 0.05])
    along = [np.multiply(water @ beam, beam).tolist() for beam in BEAMS]
    payload = ds_adcp(0)
    payload["vel_bin_beams"] = [{"velocity_bin_beam": vectors([*along[:3], (0.0, 0.0, 0.0)])}]
    found = stated(logged("ds_sensor_msgs/Adcp", payload), EARTH)
    assert_allclose(found.velocity[0], [*(np.array(BEAMS[:3]) @ water), np.nan], atol=1e-15)
    assert_array_equal(found.vectors, BEAMS)


@pytest.mark.parametrize(
    ("coord_sys", "system", "cell"),
    [
        (8, "earth", [0.1, 0.2, 0.3]),
        ("ned", "earth", [0.2, 0.1, -0.3]),
        (1, "instrument", [0.1, 0.2, 0.3, 0.4]),
        (4, "beam", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_imc_profile(tmp_path, coord_sys, system, cell):
    payload = imc(coord_sys, [[0.1, 0.2, 0.3, 0.4]])
    (message,) = read_mcap(tmp_path, json_mcap([(0, "/imc", "", payload)]))
    found = stated(message)
    assert (found.frame, found.distance) == (system, [5.0])
    assert_array_equal(found.velocity, [cell])
    assert_array_equal(found.correlation, [[90] * 4])
    profiles = only(Observation, run([fix(0), message]))
    assert [one.reference for one in profiles] == ["platform"] * (system == "earth")


@pytest.mark.parametrize(
    ("schema", "payload", "words"),
    [
        ("ds_sensor_msgs.Adcp", ds_adcp(), "measurements.reference"),
        ("ds_sensor_msgs.Adcp", ds_adcp(9), "none of 0"),
        ("ds_sensor_msgs.Adcp", ds_adcp(cell_depth=0), "cells below 1 m"),
        ("interfaces.CurrentProfile", {"velocity_data": [120, -50, 3]}, "does not state"),
        ("imc.CurrentProfile", imc(3, [[0.1] * 3]), "none of XYZ"),
        ("imc.CurrentProfile", imc(8, [[0.1] * 2]), "three components"),
        ("imc.CurrentProfile", {}, "neither velocity_data"),
        ("imc.GpsFix", PLACE | {"validity": 3}, "VALID_POS"),
        ("imc.EstimatedState", {"lat": 0.0, "lon": 0.0}, "0, 0"),
        ("imc.EstimatedState", PLACE | {"x": None}, "not a number"),
        ("replay_kit.AdcpPing", ping(0, cell_distances=[4.0]).payload, "cell_distances"),
        ("sensor_msgs.Imu", ORIENTED | {"orientation_covariance": [-1.0]}, "no orientation stated"),
        ("sensor_msgs.Imu", ORIENTED, "without their own"),
        ("sensor_msgs.NavSatFix", NAV_SAT | {"status": {"status": -1}}, "no fix (status < 0)"),
        ("geometry_msgs.PoseStamped", pose(1e6, 1e6, 1e6, "/earth"), "frame 'earth'"),
        ("geometry_msgs.PoseStamped", {}, "no pose.position in it"),
    ],
)
def test_what_is_not_used_says_why(schema, payload, words):
    message = logged(schema, payload)
    event = the(Skipped, [fix(0), message])
    assert event.topic == message.topic
    assert words in event.reason


def test_fixes_and_pressures_in_pascal_of_ros(tmp_path):
    place = {**NAV_SAT, "altitude": math.nan, "position_covariance": [0.0] * 9}
    place["status"] |= {"service": 1}
    fluid = {"fluid_pressure": 101_325.0 + 1e6, "variance": 0.0}
    messages = [
        through_ros2(tmp_path, "sensor_msgs/msg/FluidPressure", msg.FLUID_PRESSURE, fluid),
        through_ros2(tmp_path, "sensor_msgs/msg/NavSatFix", msg.NAV_SAT_FIX, place),
    ]
    (state,) = only(VehicleState, run(messages))
    assert (state.longitude, state.latitude, state.dead_reckoned) == (152.0, -40.0, False)
    assert state.depth == pytest.approx(99.2, abs=0.2)


def test_poses_move_the_last_position_each_topic_in_its_own_frame():
    def at(second, topic, *place):
        stamped = pose(*place)
        odometry = {"schema": "nav_msgs/msg/Odometry", "payload": {"pose": stamped}}
        plain = {"schema": "geometry_msgs/msg/PoseStamped", "payload": stamped}
        return logged(**(odometry if topic == "/odom" else plain), time_s=second, topic=topic)

    messages = [at(0, "/odom", 5.0, 5.0, 0.0), fix(1), at(2, "/map", 1e5, 1e5, 0.0)]
    messages += [at(3, "/map", 1e5 + 1000.0, 1e5, -40.0), at(4, "/odom", 0.0, 0.0, 0.0)]
    states = only(VehicleState, run([*messages, at(5, "/odom", 0.0, 500.0, -30.0)]))
    assert [state.dead_reckoned for state in states] == [False] + [True] * 4
    assert [state.depth for state in states[1:]] == [0.0, 40.0, 0.0, 30.0]
    # the second topic begins where the first had got to, in a frame of its own
    expected = 1000.0 / 85_400.0 * np.array([0, 0, 1, 1, 1])
    assert_allclose([state.longitude - 152.0 for state in states], expected, rtol=1e-3, atol=1e-9)
    assert states[4].latitude + 40.0 == pytest.approx(500.0 / 111_000.0, rel=1e-2)


@pytest.mark.parametrize(
    ("schema", "fields", "expected"),
    [
        ("IMC.GpsFix", {"validity": 0x0007, "type": "STANDALONE"}, (-40.0, math.nan, False)),
        ("IMC.GpsFix", {"type": 2}, (-40.0, math.nan, True)),
        ("IMC.EstimatedState", {"x": 0.0, "y": 0.0, "depth": 30.0}, (-40.0, 30.0, True)),
        ("IMC.EstimatedState", {"x": -1000.0, "depth": -1.0}, (-40.009, math.nan, True)),
    ],
)
def test_imc_positions(schema, fields, expected):
    found = stated(logged(schema, PLACE | fields))
    assert found.longitude == pytest.approx(152.0, abs=2e-5)
    values = (found.latitude, found.depth, found.dead_reckoned)
    assert values == pytest.approx(expected, abs=2e-5, nan_ok=True)


def test_frames_that_are_not_east_north_up():
    ned = logged("geometry_msgs/PoseStamped", pose(20.0, 10.0, 40.0, "world_ned"), topic="/pose")
    found = stated(ned)
    assert (found.east, found.north, found.depth) == (10.0, 20.0, 40.0)
    goal = ned._replace(topic="/move_base/Goal")
    assert "suggests a goal" in the(Skipped, [fix(0), goal]).reason
