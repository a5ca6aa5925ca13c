"""Attitudes from quaternions against rotation matrices, and what a ping takes of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from replay_kit.measurements.observed import Stream, taken
from replay_kit.measurements.profiles.frames import attitude_of
from tests.measurements.foreign import pose
from tests.measurements.samples import CONFIG, fix, logged, ping
from tests.measurements.turned import turned

angles = st.tuples(st.floats(-179.0, 179.0), st.floats(-80.0, 80.0), st.floats(-170.0, 170.0))


def quaternion(rotation, factor=1.0):
    return dict(zip("xyzw", (factor * rotation.as_quat()).tolist(), strict=True))


def attitude(message, ned=False):
    """Return heading, pitch and roll [degrees] of a quaternion."""
    turn = np.array([[message.get(name, np.nan) for name in "xyzw"]])
    return attitude_of(turn, np.array([ned]))[0]


def attitudes(message, time_ns=0):
    """Return the attitude of a quaternion at a time."""
    values = attitude(message)[None]
    return {"time": np.array([time_ns]), "order": np.array([-1]), "values": values}


@settings(derandomize=True)
@given(st.floats(-179.0, 179.0), st.floats(-80.0, 80.0), st.floats(-170.0, 170.0))
def test_yaw_is_the_heading_north_east_down_and_counts_from_east_north_east_up(yaw, pitch, roll):
    turn = quaternion(Rotation.from_euler("ZYX", (yaw, pitch, roll), degrees=True), 1.03)
    for ned, expected in ((True, (yaw, pitch, roll)), (False, (90.0 - yaw, -pitch, roll))):
        found = attitude(turn, ned)
        off = (found - np.array(expected) + 180.0) % 360.0 - 180.0
        np.testing.assert_allclose(off, 0.0, atol=1e-6)
        assert 0.0 <= found[0] < 360.0
    for none in ({}, dict.fromkeys("xyzw", 0), {"w": 2.0}, turn | {"w": 2.0}):
        assert np.isnan(attitude(none)).all()


EAST = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
NORTH = {"x": 0.0, "y": 0.0, "z": math.sqrt(0.5), "w": math.sqrt(0.5)}


def test_a_ping_takes_a_recent_attitude_only_when_it_states_none():
    found = turned(ping(heading=None).payload, CONFIG, attitudes(EAST))
    assert (found.heading, found.pitch, found.roll, found.gimbal) == (90.0, 0.0, 0.0, True)
    own = turned(ping(heading=5.0).payload, CONFIG, attitudes(EAST))
    assert (own.heading, own.gimbal) == (5.0, False)
    for time_ns in (-2 * 10**9, 1):
        old = turned(ping(heading=None).payload, CONFIG, attitudes(EAST, time_ns))
        assert np.isnan(old.heading)


def test_poses_and_inertial_units_leave_their_orientation_for_pings_that_wait():
    stamped = pose(0.0, 0.0, 0.0) | {"pose": pose(0.0, 0.0, 0.0)["pose"] | {"orientation": EAST}}
    messages = [
        fix(0),
        logged("geometry_msgs/PoseStamped", stamped, 1, "/pose"),
        ping(1.5),
        logged("sensor_msgs/Imu", {"orientation": NORTH}, 2, "/imu"),
        ping(2.5),
    ]
    stream, _ = taken(Stream(), messages, CONFIG)
    headings = np.concatenate([part["heading"] for part in stream.memory.waiting])
    np.testing.assert_allclose(headings, [90.0, 0.0], atol=1e-9)


# columns: the instrument's x, y, z in the body (x forward, y left, z up); looking up is half a turn about y (Teledyne) or x (Nortek)
MOUNTED = {
    ("teledyne", "down"): np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    ("teledyne", "up"): np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    ("nortek", "down"): np.diag([1.0, -1.0, -1.0]),
    ("nortek", "up"): np.eye(3),
}


def turned_axes(message, convention, look):
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
    return turned(payload, CONFIG, attitudes(message)).velocity.T


@pytest.mark.parametrize(("convention", "look"), MOUNTED)
@settings(max_examples=50, deadline=None, derandomize=True)
@given(angles)
def test_an_inertial_unit_turns_every_instrument_as_its_rotation_does(convention, look, ypr):
    rotation = Rotation.from_euler("ZYX", ypr, degrees=True)
    axes = rotation.as_matrix() @ MOUNTED[convention, look]
    np.testing.assert_allclose(turned_axes(quaternion(rotation), convention, look), axes, atol=1e-9)
