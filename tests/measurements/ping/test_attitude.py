"""Attitudes from quaternions against rotation matrices, and what a ping takes of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from replay_kit.core.message import Message
from replay_kit.measurements import initial_state, interpret
from replay_kit.measurements.messages.adcp_ping import parse_ping
from replay_kit.measurements.messages.vehicle import orientation_of
from replay_kit.measurements.ping.adcp_ping import Attitude, attitude_of, with_attitude
from replay_kit.measurements.ping.earth import earth_referenced
from tests.measurements.foreign import pose
from tests.measurements.samples import CONFIG, fix, logged, ping

angles = st.tuples(st.floats(-179.0, 179.0), st.floats(-80.0, 80.0), st.floats(-170.0, 170.0))


def quaternion(rotation, factor=1.0):
    return dict(zip("xyzw", (factor * rotation.as_quat()).tolist(), strict=True))


def axes(attitude):
    """Return where nose and starboard side point, east, north, up, from what the angles mean."""
    heading, pitch, roll = (
        math.radians(angle) for angle in (attitude.heading, attitude.pitch, attitude.roll)
    )
    level = np.array([math.sin(heading), math.cos(heading), 0.0])
    right = np.array([math.cos(heading), -math.sin(heading), 0.0])
    nose = math.cos(pitch) * level + math.sin(pitch) * np.array([0.0, 0.0, 1.0])
    top = np.cross(right, nose)
    return nose, math.cos(roll) * right - math.sin(roll) * top


TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@pytest.mark.parametrize(("ned", "starboard"), [(False, -1.0), (True, 1.0)])
@given(angles)
def test_nose_and_starboard_point_where_the_quaternion_turns_them(ned, starboard, ypr):
    rotation = Rotation.from_euler("ZYX", ypr, degrees=True)
    found = axes(attitude_of(orientation_of(quaternion(rotation, 1.03), ned)))
    expected = rotation.apply([[1.0, 0.0, 0.0], [0.0, starboard, 0.0]])
    np.testing.assert_allclose(found, expected @ TO_ENU if ned else expected, atol=1e-9)


@pytest.mark.parametrize(
    "bad",
    [
        None,
        [],
        {},
        {"x": 0, "y": 0, "z": 0, "w": 0},
        {"x": math.nan, "y": 0, "z": 0, "w": 1},
        {"w": 2.0},
    ],
)
def test_what_is_no_attitude(bad):
    assert attitude_of(orientation_of(bad)) is None
    stated = parse_ping(ping().payload)
    assert with_attitude(stated, (0, orientation_of(bad)), 0) is stated


EAST = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
NORTH = {"x": 0.0, "y": 0.0, "z": math.sqrt(0.5), "w": math.sqrt(0.5)}


def test_a_ping_takes_a_recent_attitude_only_when_it_states_none():
    unknown = parse_ping(ping(heading=None).payload)
    found = with_attitude(unknown, (0, orientation_of(EAST)), 10**9).attitude
    assert (found.heading, found.pitch, found.roll, found.euler_pitch) == (90.0, 0.0, 0.0, True)
    for stated, age in (
        (parse_ping(ping(heading=5.0).payload), 0),
        (unknown, 2 * 10**9),
        (unknown, -1),
    ):
        assert with_attitude(stated, (0, orientation_of(EAST)), age) is stated


def test_a_heading_is_below_360():
    assert 0.0 <= attitude_of(orientation_of(NORTH)).heading < 360.0
    assert attitude_of(orientation_of(NORTH)) == Attitude(
        pytest.approx(0.0, abs=1e-9), pytest.approx(0.0), pytest.approx(0.0)
    )


def test_poses_and_inertial_units_leave_their_orientation():
    state, _ = interpret(initial_state(), fix(0), CONFIG)
    stamped = pose(0.0, 0.0, 0.0) | {"pose": pose(0.0, 0.0, 0.0)["pose"] | {"orientation": EAST}}
    state, _ = interpret(
        state, Message(1, "/pose", "geometry_msgs/PoseStamped", stamped, 0, 0), CONFIG
    )
    assert state.orientation == (1, orientation_of(EAST))
    state, _ = interpret(
        state, Message(2, "/imu", "sensor_msgs/Imu", {"orientation": NORTH}, 0, 0), CONFIG
    )
    assert state.orientation == (2, orientation_of(NORTH))


def test_a_ping_that_waits_has_the_attitude():
    state, _ = interpret(
        initial_state(), logged("sensor_msgs/Imu", {"orientation": EAST}, topic="/imu"), CONFIG
    )
    state, _ = interpret(state, ping(0.5), CONFIG)
    assert state.waiting[0].ping.attitude.heading == 90.0


# columns: the instrument's x, y, z in the body (x forward, y left, z up); looking up is half a turn about y (Teledyne) or x (Nortek)
MOUNTED = {
    ("teledyne", "down"): np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    ("teledyne", "up"): np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    ("nortek", "down"): np.diag([1.0, -1.0, -1.0]),
    ("nortek", "up"): np.eye(3),
}


def turned(message, convention, look):
    """Return the instrument's axes in east, north, up as the columns of a matrix: what unit velocities along them become."""
    payload = ping().payload | {
        "coordinate_system": "instrument",
        "reference": "platform",
        "orientation": look,
        "attitude_convention": convention,
        "velocity": np.eye(3).tolist(),
        "bin_mapped": True,
        "declination_applied": True,
    }
    return earth_referenced(
        with_attitude(parse_ping(payload), (0, orientation_of(message)), 0), CONFIG
    ).velocity.T


@pytest.mark.parametrize(("convention", "look"), MOUNTED)
@settings(max_examples=50, deadline=None, derandomize=True)
@given(angles)
def test_an_inertial_unit_turns_every_instrument_as_its_rotation_does(convention, look, ypr):
    rotation = Rotation.from_euler("ZYX", ypr, degrees=True)
    axes = rotation.as_matrix() @ MOUNTED[convention, look]
    np.testing.assert_allclose(turned(quaternion(rotation), convention, look), axes, atol=1e-9)


def test_a_tilt_sensor_s_own_pitch_is_still_corrected():
    tilted = {
        "heading": 0.0,
        "pitch": 25.0,
        "roll": 20.0,
        "coordinate_system": "instrument",
        "attitude_convention": "teledyne",
    }
    payload = (
        ping().payload
        | tilted
        | {"reference": "platform", "velocity": np.eye(3).tolist(), "declination_applied": True}
    )
    # equation 18: tan(gimbal pitch) = tan(pitch) cos(roll); the third row of the second column is its sine
    expected = np.sin(np.arctan(np.tan(np.radians(25.0)) * np.cos(np.radians(20.0))))
    assert earth_referenced(parse_ping(payload), CONFIG).velocity[1, 2] == pytest.approx(
        expected, abs=1e-12
    )
