"""Messages to observations: pings, positions, dives, and everything a message can get wrong."""

import math

import gsw
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, Observation, PathMean, Reason, VehicleState
from replay_kit.measurements.observed import begun
from tests.measurements.samples import (
    CONFIG,
    SECOND,
    Skipped,
    Used,
    fix,
    interpret,
    logged,
    mavlink_frames,
    only,
    ping,
    position_int,
    reasons,
    run,
    the,
)


def test_a_ping_becomes_a_profile_at_the_interpolated_position():
    events = run([fix(0, 152.0), ping(30), fix(60, 152.01)])
    (observation,) = only(Observation, events)
    assert observation.longitude == pytest.approx(152.005, abs=1e-6)
    assert_allclose(observation.depth, [16.0, 48.0, 80.0])
    assert_allclose(observation.velocity[0], [0.1, 0.2])
    assert observation.flags.tolist() == [Flag.GOOD, Flag.MISSING, Flag.GOOD]
    assert observation.reasons.tolist() == [0, Reason.MISSING, 0]
    assert_array_equal(observation.error_std, 0.09)
    assert len(only(Used, events)) == 3


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_fix_of_the_same_time_is_the_position_whichever_comes_first(order):
    messages = [ping(10), fix(10, 152.3)]
    observation = the(Observation, [fix(0), *(messages[i] for i in order), fix(99, 153.0)])
    assert observation.longitude == 152.3


def test_without_a_near_position_a_ping_is_skipped():
    skipped = the(Skipped, [fix(0), ping(2000), fix(5000)])
    assert skipped.reason == "no position within 600 s"
    assert reasons(run([ping(0)]))[0] == "no position within 600 s"
    assert len(only(Observation, run([fix(0), ping(500)]))) == 1


def test_pings_do_not_pile_up_without_positions():
    state = begun()
    for k in range(200):
        state, _ = interpret(state, ping(100.0 * k), CONFIG)
    assert sum(map(len, state.memory.waiting)) <= 8


def test_across_the_antimeridian():
    observation = the(Observation, [fix(0, 179.99), ping(5), fix(10, -179.99)])
    assert abs(observation.longitude) == pytest.approx(180.0, abs=1e-6)


def test_depths_up_and_down_and_from_a_submerged_transducer():
    deep = only(Observation, run([fix(0), ping(0, pressure=100.0, transducer_depth=1.0)]))[0].depth
    assert deep[0] == pytest.approx(99.2 + 1.0 + 16.0, abs=0.2)
    up = only(
        Observation, run([fix(0), ping(0, orientation="up", pressure=None, transducer_depth=60.0)])
    )[0]
    assert_allclose(up.depth, [44.0, 12.0, -20.0])
    assert up.flags[2] == Flag.FAIL
    assert up.reasons[2] & Reason.ABOVE_SURFACE
    known = only(Observation, run([fix(0, depth=200.0), ping(0, pressure=float("nan"))]))[0]
    assert known.depth[0] == pytest.approx(216.0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"reference": None}, "expected reference"),
        ({"coordinate_system": "beam"}, "heading is magnetic"),
        ({"coordinate_system": "sideways"}, "expected coordinate_system"),
        ({"velocity": [[0.1, 0.2]]}, "expected 3 cells"),
        ({"velocity": None}, "list of velocities"),
        ({"cell_size": 0.0}, "cell_size > 0"),
        ({"velocity_std": [0.1, 0.1]}, "3 numbers"),
        ({"orientation": "left"}, "expected orientation"),
    ],
)
def test_bad_pings_are_skipped_with_a_reason(changes, reason):
    events = run([fix(0), ping(0, **changes)])
    assert not only(Observation, events)
    assert reason in reasons(events)[0]


@pytest.mark.parametrize("bad", [None, "NaN", float("nan"), float("inf"), "-inf", "words"])
def test_every_way_to_write_a_missing_number(bad):
    events = run(
        [
            fix(0),
            ping(0, velocity=[[bad, 0.1], [0.1, bad], [0.1, 0.1]], pressure=bad, velocity_std=bad),
        ]
    )
    (observation,) = only(Observation, events)
    assert observation.flags.tolist() == [9, 9, 1]
    assert_array_equal(observation.error_std, CONFIG.velocity_std)


@pytest.mark.parametrize("reverse", [False, True])
def test_mavlink_frames_make_the_same_profile_as_json_in_any_order(reverse):
    frames = list(mavlink_frames())
    events = run([position_int(5), *(frames[::-1] if reverse else frames)])
    (ours,), (theirs,) = only(Observation, events), only(Observation, run([fix(5), ping(5)]))
    assert_array_equal(ours.velocity, theirs.velocity)
    assert_array_equal(ours.depth, theirs.depth)
    assert len(only(Used, events)) == 6


def test_an_incomplete_mavlink_ping_is_said():
    events = run([position_int(5), *mavlink_frames(skip=("ADCP_N",))])
    assert not only(Observation, events)
    assert reasons(events) == ["part of an incomplete ping"] * 4
    assert (
        len(
            only(
                Observation,
                run([position_int(5), *mavlink_frames(n_components=2.0, skip=("ADCP_U",))]),
            )
        )
        == 1
    )


def test_null_island_and_no_fix_are_no_positions():
    events = run([position_int(0, lon=0, lat=0), fix(1, latitude=math.nan), fix(2, latitude=99.0)])
    assert not only(VehicleState, events)
    assert "no fix" in reasons(events)[0]


def test_odometry_moves_the_last_measured_fix():
    def odometry(time_s, x, y, z):
        payload = {"pose": {"pose": {"position": {"x": x, "y": y, "z": z}}}}
        return Message(time_s * SECOND, "/odom", "nav_msgs/msg/Odometry", payload, 0, time_s)

    states = only(
        VehicleState,
        run(
            [
                odometry(0, 0, 0, 0),
                fix(1),
                odometry(2, 10.0, 20.0, -3.0),
                odometry(3, 1010.0, 20.0, -40.0),
            ]
        ),
    )
    assert [s.dead_reckoned for s in states] == [False, True, True]
    assert states[2].depth == 40.0
    assert states[2].longitude - 152.0 == pytest.approx(1000.0 / 85_400.0, rel=1e-3)
    assert states[2].latitude == pytest.approx(-40.0, abs=1e-4)


def mean_current(time_s):
    start, end = (
        {"time": {"sec": at, "nsec": 0}, "lon": lon, "lat": -40.0}
        for at, lon in ((0, 152.0), (10_000, 152.1))
    )
    payload = {"dac_eastward": 0.1, "dac_northward": 0.1, "start_fix": start, "end_fix": end}
    return Message(time_s * SECOND, "/dac", "replay_kit.DepthAveragedCurrent", payload, 0, time_s)


def test_a_dive_known_by_the_ping_s_pressure_is_in_metres():
    pressures = {100 * k: 20.0 * min(k, 100 - k) for k in range(1, 100)}
    pings = [ping(at, pressure=pressure) for at, pressure in pressures.items()]
    events = run([fix(0), *pings, fix(10_000, longitude=152.1), mean_current(10_001)])
    (mean,) = only(PathMean, events)
    # a dive of 1000 dbar goes down to 990 m; its two middle pieces of 128 each end at the apogee
    deepest = -gsw.z_from_p(1000.0, -40.0)
    assert mean.depth.max() == pytest.approx(deepest * 127.0 / 128.0, rel=1e-12)


def test_a_dive_begins_at_a_depth_and_not_at_its_number_of_decibars():
    limit = 2.0 * CONFIG.surface_depth
    for depth, dive in ((limit - 0.001, 0), (limit + 0.001, 1)):
        deep = ping(60, pressure=float(gsw.p_from_z(-depth, -40.0)))
        assert only(Observation, run([fix(0), deep]))[0].dive == dive


def test_a_pressure_before_the_first_position_is_taken_at_45_degrees():
    pressure = logged("sensor_msgs/FluidPressure", {"fluid_pressure": 101_325.0 + 1e7}, topic="/p")
    first = the(VehicleState, [pressure, fix(1)])
    assert first.depth == pytest.approx(-gsw.z_from_p(1000.0, 45.0), rel=1e-12)
    (_, second) = only(VehicleState, run([fix(0), pressure, fix(1)]))
    assert second.depth == pytest.approx(-gsw.z_from_p(1000.0, -40.0), rel=1e-12)
