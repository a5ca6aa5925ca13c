"""The platform's motion from other messages: a DVL's bottom track, a vessel's fixes; and a DVL's water track as a current."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.measurements import dvl
from tests.measurements.samples import (
    CONFIG,
    SECOND,
    Used,
    fix,
    in_order,
    only,
    ping,
    reasons,
    run,
    the,
)
from tests.measurements.turned import stated, table_of

TRUE_HEADING = MeasurementConfig(magnetic_declination=0.0, water_track_distance=12.0)
HALF = np.sqrt(0.5)
AXES = ("starboard-down", "left-up")


def dvl_message(time_s, mode=1, velocity=(0.5, 0.1, 0.0), **changes):
    payload = {
        "velocity_mode": mode,
        "velocity": dict(zip("xyz", velocity, strict=True)),
        "velocity_covar": [4e-4] * 9,
    } | changes
    return Message(
        int(time_s * SECOND), "/dvl", "marine_acoustic_msgs/msg/Dvl", payload, 0, int(time_s)
    )


def heading_east(time_s):
    """Level, the nose to the east: in ROS the body's axes are then the frame's."""
    return Message(
        int(time_s * SECOND),
        "/imu",
        "sensor_msgs/msg/Imu",
        {"orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
        0,
        0,
    )


def relative(time_s, **changes):
    return ping(time_s, reference="platform", declination_applied=True, **changes)


def horizontal(velocity, angles, declination, left_up=False):
    """Return the velocity of one DVL along true east and north."""
    changes = {"magnetic_declination": declination, "dvl_axes": f"forward-{AXES[left_up]}"}
    config, zero = MeasurementConfig(**changes), np.zeros(1, int)
    attitudes = {"time": zero, "order": zero, "values": np.array([angles])}
    table = table_of(dvl_message(0, velocity=velocity), config)
    return dvl.velocity_of(table, attitudes, config)[0][0, :2]


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
    ("changes", "said"),
    [
        ({"mode": 0}, "neither 1"),
        ({"coordinate_mode": 3}, "coordinate_mode"),
        ({"velocity": (0.0, 0.0, 0.0)}, "no velocity"),
        ({"velocity": (1.0, float("nan"), 0.0)}, "no velocity"),
    ],
)
def test_a_dvl_that_says_nothing(changes, said):
    with pytest.raises(ValueError, match=said):
        stated(dvl_message(0, **changes))
    assert stated(dvl_message(0, velocity_covar=[-1.0] * 9)).error_std == 0.03


def test_the_error_of_a_dvl_is_that_of_its_horizontal_velocity():
    variances = np.diag([9e-4, 1e-4, 1.0]) + 0.5 * (1.0 - np.eye(3))
    found = stated(dvl_message(0, velocity_covar=variances.ravel().tolist()))
    assert found.error_std == pytest.approx(np.sqrt(5e-4))


def test_bottom_track_makes_pings_absolute_that_state_no_motion():
    messages = [fix(0), heading_east(9.5), dvl_message(10), relative(11), relative(20), fix(60)]
    near, far = only(Observation, run(messages, TRUE_HEADING))
    # 0.5 m/s forward is east, 0.1 m/s to starboard is south
    assert near.platform_velocity == pytest.approx((0.5, -0.1))
    assert (near.common_std, near.reference) == (pytest.approx(0.02), "earth")
    assert_allclose(near.velocity[0], (0.6, 0.1), atol=1e-12)
    # nine seconds later it may go anywhere
    assert far.reference == "platform"
    moved = {"platform_velocity": {"east": 0.1, "north": 0.0, "velocity_std": 0.05}}
    own = the(
        Observation,
        [fix(0), heading_east(9.5), dvl_message(10), relative(11, **moved), fix(60)],
        TRUE_HEADING,
    )
    assert own.platform_velocity == (0.1, 0.0)


@pytest.mark.parametrize(
    ("seconds", "reference"),
    [(-3.0, "earth"), (-3.1, "platform"), (3.0, "earth"), (3.1, "platform")],
)
def test_bottom_track_counts_for_pings_within_three_seconds_before_and_after_it(seconds, reference):
    """A ping that comes after the bottom track may have been made before it."""
    messages = [fix(0), heading_east(19.5), dvl_message(20), relative(20 + seconds), fix(60)]
    observation = the(Observation, messages, TRUE_HEADING)
    assert observation.reference == reference


def test_water_track_beside_bottom_track_is_the_current_at_one_depth():
    messages = [
        fix(0, depth=40.0),
        heading_east(9.5),
        dvl_message(10),
        dvl_message(10.2, 2, (0.3, 0.3, 0.0)),
        fix(60, depth=40.0),
    ]
    current = the(Observation, messages, TRUE_HEADING)
    # over the ground less through the water
    assert_allclose(current.velocity, [(0.5 - 0.3, -0.1 + 0.3)], atol=1e-12)
    assert (current.depth.tolist(), current.error_std[0], current.common_std) == (
        [52.0],
        pytest.approx(0.02),
        pytest.approx(0.02),
    )


@pytest.mark.parametrize(
    ("messages", "config", "said"),
    [
        ([dvl_message(10)], TRUE_HEADING, "no attitude"),
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
    messages = in_order(*sail(120), relative(60.5), ping(61.5))
    events = run(messages)
    absolute, own = sorted(
        only(Observation, events),
        key=lambda each: each.reference != "earth" or each.common_std == 0.0,
    )
    assert absolute.platform_velocity == pytest.approx((1.5, -0.8), abs=0.01)
    assert 0.0 < absolute.common_std < 0.05
    assert_allclose(absolute.velocity[0], (1.6, -0.6), atol=0.01)
    # its place is that of its own time, not of when it left
    assert absolute.longitude == pytest.approx(
        float(to_geographic(Projection(152.0, -40.0), 1.5 * 60.5, 0.0)[0]), abs=1e-6
    )
    assert own.common_std == 0.0
    assert len([event for event in only(Used, events) if event.topic == "/adcp"]) == 2


@pytest.mark.parametrize(
    "messages",
    [
        [*sail(61), relative(60.5)],
        [*sail(120, step=15), relative(118)],
        [*sail(120, step=30), relative(60)],
    ],
)
def test_fixes_that_are_few_or_on_one_side_give_none(messages):
    messages = in_order(*messages)
    observation = the(Observation, messages)
    assert observation.reference == "platform"
    assert (
        "relative to the platform"
        in reasons(run(messages, MeasurementConfig(use_relative=False)))[0]
    )


def test_a_ping_that_waited_in_vain_is_between_the_positions_around_it():
    observation = the(Observation, [fix(0, 152.0), relative(5), fix(100, 152.1)])
    assert observation.reference == "platform"
    assert observation.longitude == pytest.approx(152.005, abs=1e-6)


def test_a_stated_velocity_that_is_not_believed_leaves_the_vessel_to_its_fixes():
    stated = {"platform_velocity": {"east": 9.0, "north": 9.0, "velocity_std": 1e3}}
    observation = the(
        Observation,
        in_order(*sail(60), relative(30.5, **stated)),
    )
    assert observation.platform_velocity == pytest.approx((1.5, -0.8), abs=0.01)


def test_fixes_that_come_seldom_count_from_both_sides_alike():
    """Fixes 9 s apart on a curve: those within 20 s on either side of the ping give its tangent's slope, wherever the next fix is."""
    here = Projection(152.0, -40.0)
    places = [to_geographic(here, 0.01 * (k - 45) ** 2, 0.0) for k in range(0, 100, 9)]
    fixes = [
        fix(9 * k, float(longitude), float(latitude))
        for k, (longitude, latitude) in enumerate(places)
    ]
    observation = the(Observation, in_order(*fixes, relative(45)))
    assert observation.platform_velocity == pytest.approx((0.0, 0.0), abs=1e-5)


@pytest.mark.parametrize(
    ("frame", "axes", "is_left_up"),
    [
        ("dvl_link", None, False),
        ("dvl_link", "forward-left-up", True),
        ("base_link", None, True),
        ("rov/base_link", None, True),
        ("base_link_flu", None, True),
        ("base_link_frd", None, False),
        ("base_link", "forward-starboard-down", False),
    ],
)
def test_the_axes_of_a_dvl_are_those_of_its_frame_or_as_stated(frame, axes, is_left_up):
    """The current is the water track's opposite beside the bottom track's velocity."""
    forward, starboard = 0.9, 0.25
    config = TRUE_HEADING.model_copy(update={"dvl_axes": axes})
    water = (1.1, 0.05, 0.0)
    water = (water[0], -water[1], 0.0) if is_left_up else water
    level = (forward, -starboard, 0.0) if is_left_up else (forward, starboard, 0.0)
    about = {"header": {"frame_id": frame}}
    messages = [
        *(fix(0), heading_east(1), dvl_message(1, velocity=level, **about)),
        *(dvl_message(1, mode=2, velocity=water, **about), fix(2)),
    ]
    found = the(Observation, messages, config)
    # heading east: forward is east, starboard south
    assert_allclose(found.velocity[0], (forward - 1.1, 0.05 - starboard), atol=1e-9)
