"""Pings made absolute: a current made into any instrument's axes comes back; what is refused, and that nothing is done twice."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation, Reason
from replay_kit.measurements.profiles import frames
from tests.measurements.foreign import pose
from tests.measurements.samples import fix, logged, only, ping, reasons, run, the
from tests.measurements.turned import CONFIG, NO_ATTITUDE, of_quaternion, quaternion, turned
from tests.reference import frames as slow

WATER, VESSEL = np.array([0.4, -0.2, 0.02]), np.array([1.1, 0.3, 0.0])
SHEAR = np.array([0.02, -0.013, 0.001])
LISTED = {"cell_size": None, "bin0_distance": None}
DISTANCE = 2.0 + np.arange(24.0)
# columns: the instrument's x, y, z in the body (x forward, y left, z up); looking up is half a turn about y (Teledyne) or x (Nortek)
MOUNTED = {
    ("teledyne", False): np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    ("teledyne", True): np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    ("nortek", False): np.diag([1.0, -1.0, -1.0]),
    ("nortek", True): np.eye(3),
}


def made(system, convention="teledyne", up=False, turn=None, beam_angle=20.0, shear=0.0, **changes):
    """Return a ping over a moving vessel in a current linear in depth, as its instrument would store it; a true heading unless changed."""
    angles = dict(zip(("heading", "pitch", "roll"), (35.0, 4.0, -3.0), strict=True))
    angles |= {key: changes.pop(key) for key in angles.keys() & changes}
    vectors = slow.janus_vectors(beam_angle)
    if turn is None:
        turn = getattr(slow, convention)(*angles.values(), up != (convention == "nortek"))
    along = vectors @ turn.T
    reached = shear * DISTANCE[:, None] * np.abs(along[:, 2]) / vectors[:, 2]
    water = WATER - VESSEL + reached[..., None] * SHEAR
    beams = np.einsum("kbi,bi->kb", water, along)
    ship = slow.about(2, angles["heading"] or 0.0)
    axes = {"beam": along, "instrument": turn.T, "ship": ship}.get(system, np.eye(3))
    cells = {
        "beam": beams,
        "instrument": np.array([slow.janus(row, beam_angle, True) for row in beams]),
    }.get(system, np.tile(axes @ (WATER - VESSEL), (len(DISTANCE), 1)))
    own = {
        **{
            "coordinate_system": system,
            "reference": "platform",
            "orientation": "up" if up else "down",
        },
        **{"attitude_convention": convention, "beam_unit_vectors": vectors.tolist()},
        **{"bin_mapped": False, "velocity_std": None, "declination_applied": True},
        **{"n_cells": len(DISTANCE), "cell_size": 1.0, "bin0_distance": 2.0},
        "velocity": cells.tolist(),
        "bottom_track": {
            "velocity": (axes @ -VESSEL).tolist(),
            **{"velocity_std": 0.4, "distance": [300.0] * 4},
        },
    }
    return ping(0).payload | own | angles | changes


def assert_water(found, shear=0.0):
    """Assert that cells have the water's velocity over the ground, and those in the middle have one."""
    expected = WATER + shear * DISTANCE[:, None] * SHEAR
    inside = np.isfinite(found.velocity).all(axis=1)
    assert inside[2:10].all()
    assert_allclose(found.velocity[inside, :2], expected[inside, :2], atol=1e-9)
    assert found.absolute
    assert_allclose(found.added, [*VESSEL[:2], 0.4], atol=1e-9)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    system=st.sampled_from(["beam", "instrument", "ship", "earth"]),
    convention=st.sampled_from(["teledyne", "nortek"]),
    up=st.booleans(),
    ypr=st.tuples(st.floats(-180.0, 360.0), *[st.floats(-20.0, 20.0)] * 2),
    beam_angle=st.floats(15.0, 30.0),
    declination=st.floats(-40.0, 40.0),
    lost=st.sampled_from([None, 0, 1, 2, 3]),
    by=st.sampled_from(["ping", "setting", "inertial unit"]),
    listed=st.booleans(),
)
def test_a_current_in_any_axes_comes_back(
    system, convention, up, ypr, beam_angle, declination, lost, by, listed
):
    """A magnetic heading is turned clockwise by the ping's declination, else by the setting's; an inertial unit's is the body's."""
    own_axes, attitudes = system in ("beam", "instrument"), NO_ATTITUDE
    shear = float(own_axes)
    changes = dict(zip(("heading", "pitch", "roll"), ypr, strict=True))
    if by == "inertial unit" and own_axes:
        rotation = Rotation.from_euler("ZYX", ypr, degrees=True)
        changes = {**dict.fromkeys(changes), "turn": rotation.as_matrix() @ MOUNTED[convention, up]}
        attitudes = of_quaternion(quaternion(rotation))
    raw = made(system, convention, up, beam_angle=beam_angle, shear=shear, **changes)
    if by != "inertial unit" and system != "earth":
        raw |= {"heading": ypr[0] - declination, "declination_applied": False}
        raw["magnetic_declination"] = declination if by == "ping" else None
    if lost is not None and system == "beam":
        raw["velocity"] = [[*row[:lost], None, *row[lost + 1 :]] for row in raw["velocity"]]
        raw["bottom_track"]["velocity"][lost] = None
    if listed:
        raw |= LISTED | {"cell_distances": DISTANCE.tolist()}
    config = MeasurementConfig(magnetic_declination=-90.0 if by == "ping" else declination)
    found = turned(raw, config, attitudes)
    assert_water(found, shear)
    assert np.isnan(found.error_std).all()


def test_magnetic_axes_are_turned_by_the_declination():
    magnetic = (slow.about(2, 20.0) @ WATER).tolist()
    raw = made("earth", velocity=[magnetic] * len(DISTANCE), reference="earth")
    raw |= {"declination_applied": False, "magnetic_declination": 20.0}
    assert_allclose(turned(raw).velocity, np.tile(WATER, (len(DISTANCE), 1)), atol=1e-12)


SPEED = st.floats(-5.0, 5.0)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(SPEED, min_size=4, max_size=4), st.floats(10.0, 45.0), st.booleans())
def test_four_beams_are_solved_as_teledyne_does(beams, angle, convex):
    vectors = slow.janus_vectors(angle, convex)
    found = frames.solve_beams(np.array([[beams]]), vectors)
    assert_allclose(found[0, 0], slow.janus(beams, angle, convex), rtol=1e-10, atol=1e-10)
    assert_allclose(frames.beams_of(found, vectors)[0, 0], beams, rtol=1e-10, atol=1e-10)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.lists(st.one_of(SPEED, st.just(np.nan)), min_size=6, max_size=12),
    # off the factors at which two cells are as near
    st.integers(30, 105).map(lambda share: 0.01 * share + 0.0012),
)
def test_bins_among_missing_ones_are_mapped_as_the_twin_maps_them(column, stretch):
    one = np.ones(1)
    found = frames.map_bins(np.array(column)[None, :, None], one[None] * stretch, 2.0 * one, one)
    assert_allclose(found[0, :, 0], slow.mapped(np.array(column), stretch, 2.0, 1.0), atol=1e-12)


def test_two_lost_beams_are_a_missing_cell():
    raw = made("beam", bin_mapped=True)
    raw["velocity"][1] = [None, None, 0.1, 0.2]
    missing = np.isnan(turned(raw).velocity[:, :2]).all(axis=1)
    assert np.flatnonzero(missing).tolist() == [1]


def test_gps_stands_in_for_a_lost_bottom():
    own = {"east": VESSEL[0], "north": VESSEL[1], "velocity_std": 0.4, "source": "gps"}
    for track in (None, {"velocity": [None] * 4}, {"velocity": "deep"}, "lost"):
        assert_water(turned(made("beam", bottom_track=track, platform_velocity=own)))


def test_a_beams_stated_error_grows_in_the_solution():
    stated = np.linspace(0.1, 0.3, 24)
    # two beams at 20 degrees from the vertical give a component: 1 / (sqrt(2) sin 20)
    expected = stated / (np.sqrt(2.0) * np.sin(np.deg2rad(20.0)))
    assert_allclose(turned(made("beam", velocity_std=stated.tolist())).error_std, expected)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"heading": None}, "heading, pitch or roll is not known"),
        ({"roll": float("nan")}, "heading, pitch or roll is not known"),
        ({"attitude_convention": None}, "to be one of teledyne, nortek"),
        ({"beam_unit_vectors": [[0.1, 0.2]]}, "three numbers a beam"),
        ({"beam_unit_vectors": None}, "three numbers a beam"),
        ({"beam_unit_vectors": [[0.0, 0.0, 2.0]] * 4}, "vectors of length 1"),
        ({"orientation": "left"}, "expected orientation"),
        ({"declination_applied": False}, "declination unknown"),
        *(
            (LISTED | {"cell_distances": [*distances, *DISTANCE[3:]]}, "evenly spaced")
            for distances in ([2.0, 3.0, 4.02], [4.0, 3.0, 2.0], [2.0, None, 4.0])
        ),
    ],
)
def test_a_rotation_that_lacks_something_is_refused_with_the_reason(changes, reason):
    raw = made("beam") | changes
    with pytest.raises(ValueError, match=reason):
        turned(raw)


def test_a_raw_ping_becomes_an_observation():
    message = ping(0)._replace(payload=made("beam", correlation_depth=16.0))
    observation = the(Observation, [fix(0), message], MeasurementConfig(velocity_std=0.3))
    # the reference's error is one for all bins, not each bin's own
    assert_allclose(observation.error_std, 0.3)
    assert (observation.common_std, observation.correlation_depth) == (0.4, 16.0)
    assert_allclose(observation.platform_velocity, VESSEL[:2], atol=1e-12)
    # a ping that came absolute says nothing of a platform
    plain = the(Observation, [fix(0), ping(0)])
    assert (plain.reference, plain.common_std, plain.platform_velocity) == ("earth", 0.0, None)


OF_UNKNOWN_ERROR = {"east": 1.0, "north": 0.0, "velocity_std": 90.0}


@pytest.mark.parametrize("own", [None, {"east": 1.0, "velocity_std": 0.1}, OF_UNKNOWN_ERROR, 3])
def test_a_ping_of_a_platform_of_unknown_motion_is_a_relative_observation(own):
    raw = made("ship", bottom_track=None, platform_velocity=own)
    messages = [fix(0), ping(0)._replace(payload=raw)]
    observation = the(Observation, messages, MeasurementConfig(correlation_depth=8.0))
    assert_allclose(observation.velocity, np.tile((WATER - VESSEL)[:2], (24, 1)), atol=1e-12)
    found = observation.reference, observation.common_std, observation.platform_velocity
    assert (*found, observation.correlation_depth) == ("platform", np.inf, None, 8.0)
    refused = run(messages, MeasurementConfig(use_relative=False))
    assert "relative to the platform" in reasons(refused)[0]


@pytest.mark.parametrize(
    ("cells", "depths", "flagged"),
    [
        ({}, [100.0, None, 90.0, 95.0], [2]),
        (LISTED | {"cell_distances": [16.0, 48.0, 80.0]}, [60.0, None, 70.0, 65.0], [1, 2]),
    ],
)
def test_bins_below_the_bottom_are_flagged(cells, depths, flagged):
    spoiled = ping(0, **cells, bottom_track={"distance": depths})
    below = the(Observation, [fix(0), spoiled]).reasons & Reason.BELOW_BOTTOM
    assert np.flatnonzero(below).tolist() == flagged


def attitude(message, ned=False):
    """Return heading, pitch and roll [degrees] of a quaternion."""
    turn = np.array([[message.get(name, np.nan) for name in "xyzw"]])
    return frames.attitude_of(turn, np.array([ned]))[0]


@settings(derandomize=True)
@given(st.floats(-179.0, 179.0), st.floats(-80.0, 80.0), st.floats(-170.0, 170.0))
def test_yaw_is_the_heading_north_east_down_and_counts_from_east_north_east_up(yaw, pitch, roll):
    turn = quaternion(Rotation.from_euler("ZYX", (yaw, pitch, roll), degrees=True), 1.03)
    for ned, expected in ((True, (yaw, pitch, roll)), (False, (90.0 - yaw, -pitch, roll))):
        found = attitude(turn, ned)
        off = (found - np.array(expected) + 180.0) % 360.0 - 180.0
        assert_allclose(off, 0.0, atol=1e-6)
        assert 0.0 <= found[0] < 360.0
    for none in ({}, dict.fromkeys("xyzw", 0), {"w": 2.0}, turn | {"w": 2.0}):
        assert np.isnan(attitude(none)).all()


@pytest.mark.parametrize(
    ("own", "time_ns", "heading"),
    [(5.0, 0, 5.0), (None, 0, 90.0), (None, -2 * 10**9, np.nan), (None, 1, np.nan)],
)
def test_a_ping_takes_a_recent_attitude_only_when_it_states_none(own, time_ns, heading):
    attitudes = of_quaternion(quaternion(Rotation.identity()), time_ns)
    found = turned(ping(heading=own).payload, CONFIG, attitudes)
    np.testing.assert_equal((found.heading, found.gimbal), (heading, heading == 90.0))


def test_poses_and_inertial_units_leave_their_orientation_for_pings():
    east, north = (quaternion(Rotation.from_euler("Z", yaw, degrees=True)) for yaw in (0, 90))
    forward = {"coordinate_system": "ship", "velocity": [[0.0, 0.5, 0.0]] * 3}
    messages = [
        fix(0),
        logged("geometry_msgs/PoseStamped", pose(0.0, 0.0, 0.0, turn=east), 1, "/pose"),
        ping(1.5, declination_applied=True, **forward),
        logged("sensor_msgs/Imu", {"orientation": north}, 2, "/imu"),
        ping(2.5, declination_applied=True, **forward),
    ]
    found = [one.velocity[0] for one in only(Observation, run(messages))]
    assert_allclose(found, [[0.5, 0.0], [0.0, 0.5]], atol=1e-12)
