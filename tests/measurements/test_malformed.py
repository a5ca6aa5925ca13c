"""What no message may do: end a replay, or pass for a good measurement when it is none."""

import itertools
import math

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, Observation, Reason, VehicleState
from replay_kit.measurements import observations
from replay_kit.workflows.replay.inputs.scan import MAVLINK_NAMES
from tests.measurements.foreign import NUCLEUS, ds_adcp, imc, pose
from tests.measurements.samples import (
    ODD,
    Skipped,
    Used,
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

STATED = MeasurementConfig(reference="earth")
SCHEMAS = {
    "foxglove.LocationFix": fix(1, depth=3.0).payload,
    "sensor_msgs/msg/NavSatFix": {"longitude": 152.0, "latitude": -40.0, "status": {"status": 0}},
    "GLOBAL_POSITION_INT": position_int(1).payload,
    "nav_msgs/msg/Odometry": {"pose": {"pose": {"position": {"x": 1.0, "y": 1.0, "z": -1.0}}}},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": 2e5},
    "replay_kit.AdcpPing": ping(1).payload,
    "DEBUG_FLOAT_ARRAY": next(mavlink_frames(1)).payload,
    "ds_sensor_msgs/msg/Adcp": ds_adcp(),
    "interfaces/msg/CurrentProfile": NUCLEUS,
    "imc.CurrentProfile": imc(8, [[0.1, 0.2, 0.3]]),
    "imc.GpsFix": {"lat": -0.7, "lon": 2.6, "validity": 4, "type": 0},
    "imc.EstimatedState": {"lat": -0.7, "lon": 2.6, "x": 1.0, "y": 2.0, "depth": 3.0},
    "geometry_msgs/msg/PoseStamped": pose(1.0, 1.0, -1.0),
    "marine_acoustic_msgs/msg/Dvl": {
        "velocity_mode": 1,
        "velocity": {"x": 1.0, "y": 0.0, "z": 0.0},
        "velocity_covar": [0.1] * 9,
    },
    "sensor_msgs/msg/Imu": {"orientation_covariance": [0.0] * 9},
}


def damaged():
    """Every message with every field replaced by every odd value, or taken away."""
    for schema, payload in SCHEMAS.items():
        yield schema, {}
        for key in payload:
            yield schema, {k: v for k, v in payload.items() if k != key}
            yield from ((schema, {**payload, key: odd}) for odd in ODD)
    yield from (
        ("nav_msgs/msg/Odometry", {"pose": {"pose": {"position": {"x": odd, "y": 0, "z": 0}}}})
        for odd in ODD
    )
    yield from (("nav_msgs/msg/Odometry", {"pose": odd}) for odd in ODD)


@pytest.mark.parametrize("schema", SCHEMAS)
def test_no_damaged_message_ends_a_replay_or_gives_a_good_bin_without_numbers(schema):
    for k, (_, payload) in enumerate(item for item in damaged() if item[0] == schema):
        bad = Message(10**9, "/bad", schema, payload, 0, k)
        events = run([fix(0), bad, ping(2), fix(3)], STATED)
        counted = only(Used, events) + only(Skipped, events)
        assert sorted(event.topic for event in counted) == [
            "/adcp",
            "/bad",
            "/vehicle/fix",
            "/vehicle/fix",
        ], payload
        for observation in only(Observation, events):
            good = observation.flags == Flag.GOOD
            numbers = np.column_stack(
                [observation.depth, observation.velocity, observation.error_std]
            )[good]
            assert np.isfinite(numbers).all(), payload
            assert math.isfinite(observation.longitude)
        assert all(
            math.isfinite(state.longitude) and math.isfinite(state.latitude)
            for state in only(VehicleState, events)
        ), payload


def test_alike_damage_has_one_short_reason():
    bad = [
        ping(0, velocity=[[0.1]] * 3, n_cells=3),
        ping(1, velocity=[list(range(k)) for k in (0, 500, 900)]),
    ]
    assert all(len(event.reason) < 200 for event in only(Skipped, run([fix(0), *bad])))
    broken = [Message(0, "/odom", "sensor_msgs/msg/FluidPressure", None, 0, k) for k in range(3)]
    (reason,) = {event.reason for event in only(Skipped, run(broken))}
    assert reason.startswith("malformed: ")


@pytest.mark.parametrize("null", [None, "NaN", math.nan])
@pytest.mark.parametrize("at", [0, 1, 2])
def test_a_null_cell_is_a_missing_bin(null, at):
    cells = [[0.1, 0.2, 0.0], [0.3, 0.4, 0.0], [0.5, 0.6, 0.0]]
    cells[at] = null
    observation = the(Observation, [fix(0), ping(0, velocity=cells)])
    assert [int(flag) for flag in observation.flags] == [
        Flag.MISSING if k == at else Flag.GOOD for k in range(3)
    ]
    assert np.isnan(observation.velocity[at]).all()


def test_only_null_cells():
    observation = the(Observation, [fix(0), ping(0, velocity=[None] * 3)])
    assert observation.flags.tolist() == [Flag.MISSING] * 3


def test_cells_as_messages_of_their_own():
    nested = [
        {"value": [0.1, 0.2]},
        {"east": 0.3, "north": 0.4, "up": 0.0},
        {"east": None, "north": 0.4},
    ]
    observation = the(Observation, [fix(0), ping(0, velocity=nested)])
    np.testing.assert_array_equal(observation.velocity, [[0.1, 0.2], [0.3, 0.4], [np.nan, 0.4]])
    skipped = the(Skipped, [fix(0), ping(0, velocity=[{"x": 1.0, "y": 1.0}] * 3)])
    assert "expected cells" in skipped.reason


@pytest.mark.parametrize(
    "metadata",
    [
        ["depth", "3"],
        "depth",
        7,
        {"depth": 3.0, "dead_reckoned": True},
        [{"key": "depth", "value": None}],
    ],
)
def test_metadata_of_any_shape_leave_the_position(metadata):
    state = the(VehicleState, [fix(0, metadata=metadata)])
    assert state.longitude == 152.0
    assert state.dead_reckoned == isinstance(metadata, dict)
    assert state.depth == 3.0 if isinstance(metadata, dict) else math.isnan(state.depth)


@pytest.mark.parametrize(
    ("word", "meaning"),
    [
        ("1", True),
        ("0", False),
        ("true", True),
        ("False", False),
        ("maybe", False),
        ("TRUE ", True),
    ],
)
def test_dead_reckoned_in_words(word, meaning):
    state = the(VehicleState, [fix(0, metadata=[{"key": "dead_reckoned", "value": word}])])
    assert state.dead_reckoned is meaning


def test_a_position_without_a_status_is_one_and_a_status_below_zero_is_none():
    def nav(**status):
        return logged(
            "sensor_msgs/msg/NavSatFix", {"longitude": 1.0, "latitude": 2.0, **status}, topic="/gps"
        )

    assert len(only(VehicleState, run([nav()]))) == 1
    assert len(only(VehicleState, run([nav(status={"status": 0})]))) == 1
    assert not only(VehicleState, run([nav(status=-1)]))


@pytest.mark.parametrize("pressure", [-1e9, 1e300, -1e300])
def test_a_pressure_without_a_depth_is_no_good_bin_and_no_dive(pressure):
    events = run([fix(0), ping(0, pressure=pressure), ping(1, pressure=None), fix(2)])
    assert "no depth" in reasons(events)[0]
    (sound,) = only(Observation, events)
    assert sound.dive == 0


def test_bins_whose_depth_overflows_are_missing():
    observation = the(Observation, [fix(0), ping(0, cell_size=1e308, velocity=[[0.1, 0.2]] * 3)])
    assert observation.flags.tolist() == [Flag.GOOD, Flag.GOOD, Flag.MISSING]
    assert observation.reasons.tolist() == [0, 0, Reason.MALFORMED]


@pytest.mark.parametrize(
    ("dive", "used"),
    [
        (7, 7),
        (0, 0),
        (2**32 - 1, 2**32 - 1),
        (2**32, 1),
        (-1, 1),
        (True, 1),
        (2.0, 1),
        ("3", 1),
        ([], 1),
    ],
)
def test_a_dive_that_can_be_none_is_ignored(dive, used):
    events = run([fix(0, depth=50.0), ping(0, dive=dive)])
    assert only(Observation, events)[0].dive == used


def test_a_current_that_cannot_be_fails():
    speeds = [[5.1, 0.0], [0.0, -5.1], [5.0, -5.0]]
    observation = the(Observation, [fix(0), ping(0, velocity=speeds)])
    assert observation.flags.tolist() == [Flag.FAIL, Flag.FAIL, Flag.SUSPECT]
    assert observation.reasons.tolist() == [Reason.GROSS_RANGE | Reason.HIGH_SPEED] * 2 + [
        Reason.HIGH_SPEED
    ]
    (slow,) = observations([fix(0), ping(0, velocity=speeds)], MeasurementConfig(max_speed=1.0))
    assert slow.flags.tolist() == [Flag.FAIL] * 3


@pytest.mark.parametrize("n_cells", [3, 3.0])
def test_a_count_may_be_written_as_a_float(n_cells):
    assert len(only(Observation, run([fix(0), ping(0, n_cells=n_cells)]))) == 1


@pytest.mark.parametrize("n_cells", [True, 3.5, "3", math.inf, 10**400, -3, 10**12])
def test_a_count_that_is_none(n_cells):
    assert len(only(Skipped, run([fix(0), ping(0, n_cells=n_cells)]))) == 1


@pytest.mark.parametrize("std", [0.0, -1.0, 1e-300, 1e308])
def test_an_error_that_cannot_be_is_not_stated(std):
    observation = the(Observation, [fix(0), ping(0, velocity_std=[std, 0.05, std])])
    np.testing.assert_array_equal(observation.error_std, [0.09, 0.05, 0.09])


def test_mavlink_frames_with_odd_fields_are_each_counted_once():
    assert "DEBUG_FLOAT_ARRAY" in MAVLINK_NAMES
    for part, key, odd in itertools.product(range(5), ("array_id", "time_usec", "data"), ODD):
        frames = list(mavlink_frames())
        frames[part] = frames[part]._replace(payload={**frames[part].payload, key: odd})
        events = run([position_int(5), *frames])
        assert len(only(Used, events) + only(Skipped, events)) == 6, (part, key, odd)
        assert all(
            np.isfinite(o.depth[o.flags == Flag.GOOD]).all() for o in only(Observation, events)
        )


def test_the_frames_of_a_mavlink_ping_share_one_fate():
    refused = run(
        [position_int(5), *mavlink_frames(reference=1.0)], MeasurementConfig(use_relative=False)
    )
    assert len(only(Used, refused)) == 1
    assert reasons(refused) == ["velocity relative to the platform, whose motion is unknown"] * 5
    alone = run(list(mavlink_frames()))
    assert reasons(alone) == ["no position within 600 s"] * 5
    frames = list(mavlink_frames())
    twice = run([position_int(5), frames[0], *frames])
    assert len(only(Observation, twice)) == 1
    assert reasons(twice) == ["repeated frame of a ping"]
