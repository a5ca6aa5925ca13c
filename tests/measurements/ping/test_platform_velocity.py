"""The platform's motion from other messages: a DVL's bottom track, a vessel's fixes; and a DVL's water track as a current."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Observation
from replay_kit.measurements.profiles import earth
from tests.measurements.samples import CONFIG, fix, in_order, logged, only, ping, reasons, run, the
from tests.measurements.turned import stated, table_of

TRUE_HEADING = MeasurementConfig(magnetic_declination=0.0, water_track_distance=12.0)
HALF = np.sqrt(0.5)
AXES = ("starboard-down", "left-up")


def dvl_message(time_s, mode=1, velocity=(0.5, 0.1, 0.0), **changes):
    payload = {"velocity_mode": mode, "velocity_covar": [4e-4] * 9, **changes}
    payload["velocity"] = dict(zip("xyz", velocity, strict=True))
    return logged("marine_acoustic_msgs/msg/Dvl", payload, time_s, "/dvl")


def heading_east(time_s):
    """Level, the nose to the east: in ROS the body's axes are then the frame's."""
    level = {"orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return logged("sensor_msgs/msg/Imu", level, time_s, "/imu")


def relative(time_s, **changes):
    return ping(time_s, reference="platform", declination_applied=True, **changes)


def horizontal(velocity, angles, declination, left_up=False):
    """Return the velocity of one DVL along true east and north."""
    changes = {"magnetic_declination": declination, "dvl_axes": f"forward-{AXES[left_up]}"}
    config, zero = MeasurementConfig(**changes), np.zeros(1, int)
    attitudes = {"time": zero, "order": zero, "values": np.array([angles])}
    table = table_of(dvl_message(0, velocity=velocity), config)
    return earth.velocity_of(table, attitudes, config)[0][0, :2]


def test_a_dvl_s_velocity_turns_with_the_vehicle():
    forward, starboard, down = np.eye(3)
    level = (45.0, 0.0, 0.0)
    assert_allclose(horizontal(forward, level, 0.0), (HALF, HALF), atol=1e-12)
    assert_allclose(horizontal(starboard, level, 45.0), (0.0, -1.0), atol=1e-12)
    # nose up by 30 degrees: down through the vehicle's floor is forward in part
    assert_allclose(horizontal(down, (0.0, 30.0, 0.0), 0.0), (0.0, 0.5), atol=1e-12)
    # starboard down by 30 degrees: the floor looks to port
    assert_allclose(horizontal(down, (0.0, 0.0, 30.0), 0.0), (-0.5, 0.0), atol=1e-12)


@pytest.mark.parametrize(
    ("covariance", "error"),
    [
        (np.diag([9e-4, 1e-4, 1.0]) + 0.5 * (1.0 - np.eye(3)), np.sqrt(5e-4)),
        (np.full((3, 3), -1.0), 0.03),
    ],
)
def test_the_error_of_a_dvl_is_that_of_its_horizontal_velocity(covariance, error):
    found = stated(dvl_message(0, velocity_covar=covariance.ravel().tolist()))
    assert found.error_std == pytest.approx(error)


@pytest.mark.parametrize(
    ("seconds", "reference"),
    [(-3.0, "earth"), (-3.1, "platform"), (3.0, "earth"), (3.1, "platform")],
)
def test_bottom_track_makes_pings_absolute_within_three_seconds_before_and_after_it(
    seconds, reference
):
    """A ping that comes after the bottom track may have been made before it."""
    messages = [fix(0), heading_east(19.5), dvl_message(20), relative(20 + seconds), fix(60)]
    found = the(Observation, messages, TRUE_HEADING)
    assert found.reference == reference
    if reference == "earth":
        # 0.5 m/s forward is east, 0.1 m/s to starboard is south
        assert found.platform_velocity == pytest.approx((0.5, -0.1))
        assert found.common_std == pytest.approx(0.02)
        assert_allclose(found.velocity[0], (0.6, 0.1), atol=1e-12)


def test_a_motion_of_the_ping_s_own_goes_before_a_dvl_s():
    moved = {"platform_velocity": {"east": 0.1, "north": 0.0, "velocity_std": 0.05}}
    messages = [fix(0), heading_east(9.5), dvl_message(10), relative(11, **moved), fix(60)]
    assert the(Observation, messages, TRUE_HEADING).platform_velocity == (0.1, 0.0)


@pytest.mark.parametrize(
    ("messages", "config", "said"),
    [
        ([dvl_message(10, mode=0)], CONFIG, "neither 1"),
        ([dvl_message(10, coordinate_mode=3)], CONFIG, "coordinate_mode"),
        ([dvl_message(10, velocity=(1.0, np.nan, 0.0))], CONFIG, "no velocity"),
        ([heading_east(8), dvl_message(10)], TRUE_HEADING, "no attitude"),
        ([heading_east(10), dvl_message(10)], CONFIG, "true or magnetic"),
        (
            [heading_east(10), dvl_message(10, 2)],
            MeasurementConfig(magnetic_declination=0.0),
            "water_track_distance",
        ),
        ([heading_east(10), dvl_message(10, 2)], TRUE_HEADING, "without a bottom track"),
    ],
)
def test_a_dvl_without_what_it_needs_is_skipped_with_the_reason(messages, config, said):
    assert said in reasons(run([fix(0), *messages], config))[-1]


def sail(seconds, velocity=(1.5, -0.8), step=1):
    here = Projection(152.0, -40.0)
    for k in range(0, seconds, step):
        longitude, latitude = to_geographic(here, velocity[0] * k, velocity[1] * k)
        yield fix(k, float(longitude), float(latitude))


def test_a_vessel_s_fixes_give_its_motion():
    not_believed = {"platform_velocity": {"east": 9.0, "north": 9.0, "velocity_std": 1e3}}
    for changes in ({}, not_believed):
        events = run(in_order(*sail(120), relative(60.5, **changes), ping(61.5)))
        absolute, own = sorted(only(Observation, events), key=lambda one: -one.common_std)
        assert absolute.platform_velocity == pytest.approx((1.5, -0.8), abs=0.01)
        assert 0.0 < absolute.common_std < 0.05
        assert own.common_std == 0.0
        assert_allclose(absolute.velocity[0], (1.6, -0.6), atol=0.01)
        # its place is that of its own time, not of when it left
        east, _ = to_geographic(Projection(152.0, -40.0), 1.5 * 60.5, 0.0)
        assert absolute.longitude == pytest.approx(float(east), abs=1e-6)


@pytest.mark.parametrize(
    ("frame", "axes", "is_left_up"),
    [
        ("dvl_link", None, False),
        ("dvl_link", "forward-left-up", True),
        ("base_link", None, True),
        ("rov/base_link_flu", None, True),
        ("base_link_frd", None, False),
        ("base_link", "forward-starboard-down", False),
    ],
)
def test_a_water_track_is_a_current_along_the_axes_of_its_frame_or_as_stated(
    frame, axes, is_left_up
):
    """The current is the water track's opposite beside the bottom track's velocity."""
    turn = np.array([1.0, -1.0, -1.0]) if is_left_up else np.ones(3)
    tracks = [turn * [0.9, 0.25, 0.0], turn * [1.1, 0.05, 0.0]]
    messages = [
        dvl_message(1, mode, track.tolist(), header={"frame_id": frame})
        for mode, track in zip((1, 2), tracks, strict=True)
    ]
    config = TRUE_HEADING.model_copy(update={"dvl_axes": axes})
    found = the(Observation, [fix(0, depth=40.0), heading_east(1), *messages, fix(2)], config)
    # heading east: forward is east, starboard south
    assert_allclose(found.velocity[0], (0.9 - 1.1, 0.05 - 0.25), atol=1e-9)
    assert found.depth.tolist() == [52.0]
    assert (*found.error_std, found.common_std) == pytest.approx((0.02, 0.02))
