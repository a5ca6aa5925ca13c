"""What no message may do: end a replay, or pass for a good measurement when it is none."""

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag, Observation, PathMean, Reason, VehicleState
from replay_kit.measurements import observations
from tests.measurements.foreign import BEAMS, ds_adcp, imc, pose
from tests.measurements.samples import (
    ODD,
    Skipped,
    Used,
    dac,
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

STATED = MeasurementConfig(reference="earth", dead_reckoning="through_water")
NUMBERS = [[1.0] * 4] * 3
RAW = {
    **ping(1).payload,
    "coordinate_system": "beam",
    "reference": "platform",
    "attitude_convention": "teledyne",
    "beam_unit_vectors": BEAMS,
    "velocity": NUMBERS,
    "bottom_track": {"velocity": [0.1] * 4, "velocity_std": 0.4, "distance": [300.0] * 4},
    "declination_applied": True,
    "tilt_applied": True,
    "bin_mapped": False,
    **dict.fromkeys(("heading", "pitch", "roll"), 3.0),
    **dict.fromkeys(("correlation", "amplitude", "snr", "percent_good"), NUMBERS),
}
SCHEMAS = {
    "foxglove.LocationFix": fix(1, depth=3.0).payload,
    "sensor_msgs/msg/NavSatFix": {"longitude": 152.0, "latitude": -40.0, "status": {"status": 0}},
    "GLOBAL_POSITION_INT": position_int(1).payload,
    "nav_msgs/msg/Odometry": {"pose": pose(1.0, 1.0, -1.0)},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": 2e5},
    "replay_kit.AdcpPing": RAW,
    "replay_kit.DepthAveragedCurrent": dac(2).payload,
    "DEBUG_FLOAT_ARRAY": next(mavlink_frames(1)).payload,
    "ds_sensor_msgs/msg/Adcp": ds_adcp(),
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
# Damaged messages of one stream.
_TOGETHER = 40
BROKEN = [[1e308] * 4] * 3, {"velocity": [1e308] * 4}, {"distance": ["b"]}, [[[1.0]]] * 3
PLACES = {"time": {"sec": 1e308, "nsec": 0}, "lon": 1e308, "lat": 0.0}, {"time": 3}


def damaged(payload):
    """A message with every field replaced by every odd value, or taken away."""
    yield {}
    for key in payload:
        yield {k: v for k, v in payload.items() if k != key}
        yield from ({**payload, key: odd} for odd in (*ODD, *BROKEN, *PLACES))
    if "pose" in payload:
        yield from ({"pose": inner} for inner in damaged(payload["pose"]))
    elif "position" in payload:
        yield from ({"position": inner} for inner in damaged(payload["position"]))


@pytest.mark.parametrize("schema", SCHEMAS)
def test_no_damaged_message_ends_a_replay_or_gives_a_good_bin_without_numbers(schema):
    ends = [fix(0, depth=0.0), fix(1, depth=9.0), fix(2, depth=0.0)]
    all_of = list(damaged(SCHEMAS[schema]))
    for begin in range(0, len(all_of), _TOGETHER):
        payloads = all_of[begin : begin + _TOGETHER]
        bad = [logged(schema, payload, 2, "/bad") for payload in payloads]
        events = run([*ends, *bad, ping(2), fix(3)], STATED)
        counted = [event.topic for event in only(Used | Skipped, events)]
        assert sorted(counted) == ["/adcp", *["/bad"] * len(bad), *["/vehicle/fix"] * 4], payloads
        numbers = []
        for one in only(Observation, events):
            good = one.flags == Flag.GOOD
            numbers += [one.depth[good], one.velocity[good], one.error_std[good], one.longitude]
        for one in only(PathMean, events):
            numbers += [one.longitude, one.depth, one.weight, one.velocity, 1.0 / one.error_std]
        numbers += [(one.longitude, one.latitude) for one in only(VehicleState, events)]
        assert all(np.isfinite(each).all() for each in numbers), payloads


@pytest.mark.parametrize("bad", [None, "NaN", math.nan, math.inf, "-inf", "words"])
@pytest.mark.parametrize("whole", [False, True])
def test_every_way_to_write_a_missing_number(bad, whole):
    velocity = [bad if whole else [bad, 0.1], bad if whole else [0.1, bad], [0.1, 0.1]]
    found = the(Observation, [fix(0), ping(0, velocity=velocity, pressure=bad, velocity_std=bad)])
    assert found.flags.tolist() == [Flag.MISSING, Flag.MISSING, Flag.GOOD]
    assert_array_equal(found.error_std, STATED.velocity_std)


@pytest.mark.parametrize(
    ("metadata", "depth", "dead_reckoned"),
    [
        ("depth", math.nan, False),
        ({"depth": 3.0, "dead_reckoned": True}, 3.0, True),
        ([{"key": "depth", "value": None}], math.nan, False),
        *(
            ([{"key": "dead_reckoned", "value": word}], math.nan, meaning)
            for word, meaning in (("1", True), ("0", False), ("maybe", False), ("TRUE ", True))
        ),
    ],
)
def test_metadata_of_any_shape_leave_the_position(metadata, depth, dead_reckoned):
    state = the(VehicleState, [fix(0, metadata=metadata)])
    assert (state.longitude, state.dead_reckoned) == (152.0, dead_reckoned)
    assert_array_equal(state.depth, depth)


@pytest.mark.parametrize("pressure", [-1e9, 1e300])
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
    ("dive", "used"), [(7, 7), (0, 0), (2**32, 1), (-1, 1), (True, 1), (2.0, 1), ("3", 1)]
)
def test_a_dive_that_can_be_none_is_ignored(dive, used):
    assert the(Observation, [fix(0, depth=50.0), ping(0, dive=dive)]).dive == used


def test_a_current_that_cannot_be_fails():
    messages = [fix(0), ping(0, velocity=[[5.1, 0.0], [0.0, -5.1], [5.0, -5.0]])]
    observation = the(Observation, messages)
    assert observation.flags.tolist() == [Flag.FAIL, Flag.FAIL, Flag.SUSPECT]
    high = Reason.HIGH_SPEED
    assert observation.reasons.tolist() == [Reason.GROSS_RANGE | high] * 2 + [high]
    (slow,) = observations(messages, MeasurementConfig(max_speed=1.0))
    assert slow.flags.tolist() == [Flag.FAIL] * 3


def test_mavlink_frames_with_odd_fields_are_each_counted_once():
    for part, key in itertools.product(range(5), ("array_id", "time_usec", "data")):
        messages = [position_int(5)]
        for k, odd in enumerate(ODD):
            frames = list(mavlink_frames(5.0 + k, k))
            frames[part] = frames[part]._replace(payload={**frames[part].payload, key: odd})
            messages += frames
        events = run(messages)
        assert len(only(Used | Skipped, events)) == len(messages), (part, key)
        for one in only(Observation, events):
            assert np.isfinite(one.depth[one.flags == Flag.GOOD]).all()


@pytest.mark.parametrize(
    ("messages", "config", "said"),
    [
        (
            [position_int(5), *mavlink_frames(reference=1.0)],
            MeasurementConfig(use_relative=False),
            ["velocity relative to the platform, whose motion is unknown"] * 5,
        ),
        (mavlink_frames(), STATED, ["no position within 600 s"] * 5),
        (
            [position_int(5), next(mavlink_frames()), *mavlink_frames()],
            STATED,
            ["repeated frame of a ping"],
        ),
    ],
)
def test_the_frames_of_a_mavlink_ping_share_one_fate(messages, config, said):
    assert reasons(run(messages, config)) == said


def test_alike_damage_has_one_short_reason():
    bad = ping(1, velocity=[list(range(k)) for k in (0, 500, 900)])
    broken = [logged("sensor_msgs/msg/FluidPressure", None, k) for k in range(3)]
    long, *alike = reasons(run([fix(0), bad, *broken]))
    assert len(long) < 200
    assert len(set(alike)) == 1
    assert alike[0].startswith("malformed: ")
