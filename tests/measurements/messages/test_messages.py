"""Messages of any dialect, known, mapped or guessed: the one position, depth or profile that they hold, or why they are not used."""

import math
import re
import tomllib

import gsw
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import MeasurementConfig, load_config
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Flag, Observation, VehicleState
from replay_kit.measurements import suggestions
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml
from tests.measurements.foreign import BEAMS, ds_adcp, imc, pose, vectors
from tests.measurements.samples import (
    Skipped,
    Used,
    events_of,
    fix,
    logged,
    mapping,
    only,
    ping,
    reasons,
    run,
    the,
)
from tests.measurements.turned import stated

CONFIG, EARTH = MeasurementConfig(), MeasurementConfig(reference="earth")
LON, LAT, NAN = 152.25, -40.5, math.nan
RADIANS = {"lat": math.radians(LAT), "lon": math.radians(LON)}
DEGREES = {"latitude": LAT, "longitude": LON}
NAV_SAT = DEGREES | {"status": {"status": 0}}
ORIENTED = {"orientation": {"w": 1.0}, "orientation_covariance": [0.0] * 9}
PLACE = {"Lat": LAT, "Lng": LON}
FILTER = {"lat": -405_000_000, "lon": 1_522_500_000, "relative_alt": -2500}
TOPIC = '/vendor "x"'
PROFILE = {
    **{"topic": TOPIC, "kind": "profile", "reference": "earth", "frame": "enu"},
    **{"cell_size": 4.0, "first_cell": 6.0},
}
POSITION = {"topic": TOPIC, "kind": "position", "longitude": "lon", "latitude": "lat"}


def sent(schema, payload, second=0):
    """Return a message on a topic of its dialect."""
    known = re.fullmatch(r"(\d/)?([A-Z_]+|dataflash\.\w+)", schema)
    name = schema.rpartition("/")[2] if known else schema
    topic = f"mavlink/{(known[1] or '1/')}1/{name}" if known else TOPIC
    return logged(name, payload, second, topic)


def suggested(payload, **answers):
    """Return the configuration guessed of a payload, with a person's answers filled in, and its text."""
    text = suggestions({TOPIC: ("vendor.Thing", payload)})
    for key, value in answers.items():
        text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        assert count == 1
    return load_config(None, tomllib.loads(text)).measurements, text


def depth_of(dbar):
    return float(-gsw.z_from_p(dbar, LAT))


GUESSED = {"lat": LAT, "lon": LON}


@pytest.mark.parametrize(
    ("schema", "payload", "config", "depth", "reckoned"),
    [
        ("IMC.GpsFix", RADIANS | {"validity": 7, "type": "STANDALONE"}, CONFIG, NAN, False),
        ("IMC.GpsFix", RADIANS | {"type": 2}, CONFIG, NAN, True),
        ("IMC.EstimatedState", RADIANS | {"x": 0.0, "y": 0.0, "depth": 30.0}, CONFIG, 30.0, True),
        (
            "IMC.EstimatedState",
            RADIANS | {"lat": math.radians(LAT + 0.009004), "x": -1000.0, "depth": -1.0},
            *(CONFIG, NAN, True),
        ),
        ("sensor_msgs/msg/NavSatFix", NAV_SAT | {"altitude": NAN}, CONFIG, NAN, False),
        ("GLOBAL_POSITION_INT", FILTER, CONFIG, 2.5, False),
        ("dataflash.GPS", PLACE | {"Status": 3, "I": 0}, CONFIG, NAN, False),
        ("dataflash.POS", PLACE, CONFIG, NAN, True),
        *(
            (
                *("", {"lon": each * LON, "lat": each * LAT, "p": 10.0}),
                mapping(
                    POSITION
                    | {"angle_unit": unit, "dead_reckoned": True, "depth": "p", "depth_unit": "bar"}
                ),
                *(depth_of(100.0), True),
            )
            for unit, each in (("deg", 1.0), ("degE7", 1e7), ("rad", math.radians(1.0)))
        ),
        *(
            ("", payload, suggested(payload)[0], depth, False)
            for payload, depth in (
                ({"fix": GUESSED}, NAN),
                ({"gps_latitude_e7": -405_000_000, "gps_longitude_e7": 1_522_500_000}, NAN),
                ({"lat_rad": math.radians(LAT), "lng_rad": math.radians(LON)}, NAN),
                (GUESSED | {"depth": 12.5}, 12.5),
                (GUESSED | {"vehicle_depth_cm": 1250.0}, 12.5),
                (GUESSED | {"water_pressure_dbar": 100.0}, depth_of(100.0)),
                (GUESSED | {"press_bar": 10.0}, depth_of(100.0)),
                (GUESSED | {"fluid_pressure_mbar": 1000.0}, depth_of(10.0)),
            )
        ),
    ],
)
def test_a_position(schema, payload, config, depth, reckoned):
    state = the(VehicleState, [sent(schema, payload)], config)
    assert (state.longitude, state.latitude) == pytest.approx((LON, LAT), abs=2e-5)
    assert state.depth == pytest.approx(depth, abs=0.01, nan_ok=True)
    assert state.dead_reckoned == reckoned


def depth_entry(**fields):
    return mapping({"topic": TOPIC, "kind": "depth", "depth": "d.0", **fields})


@pytest.mark.parametrize(
    ("schema", "payload", "config", "depth"),
    [
        ("sensor_msgs/msg/FluidPressure", {"fluid_pressure": 226_325.0}, CONFIG, depth_of(12.5)),
        ("dataflash.CTUN", {"Alt": -12.5, "BAlt": -9.0}, CONFIG, 12.5),
        ("", {"ctd": {"depth_m": 12.5}}, suggested({"ctd": {"depth_m": 12.5}})[0], 12.5),
        *(
            ("", {"d": [value]}, depth_entry(**fields), depth)
            for fields, value, depth in (
                ({}, 12.5, 12.5),
                ({"depth_positive": "up"}, -12.5, 12.5),
                ({"depth_unit": "cm"}, 1250, 12.5),
                ({"depth_unit": "dbar"}, 12.5, depth_of(12.5)),
                ({"depth_unit": "bar"}, 1.25, depth_of(12.5)),
                ({"depth_unit": "Pa"}, 125_000.0, depth_of(12.5)),
                ({"depth_unit": "Pa", "depth_absolute": True}, 226_325.0, depth_of(12.5)),
            )
        ),
        # a mapping goes before a known kind
        (
            *("GLOBAL_POSITION_INT", {"relative_alt": -12_500, "lat": 0, "lon": 0}),
            depth_entry(
                topic="mavlink/1/1/GLOBAL_POSITION_INT",
                **{"depth": "relative_alt", "depth_positive": "up", "depth_unit": "mm"},
            ),
            12.5,
        ),
    ],
)
def test_a_depth(schema, payload, config, depth):
    *_, state = only(
        VehicleState, run([fix(0, LON, LAT), sent(schema, payload), fix(1, LON, LAT)], config)
    )
    assert state.depth == pytest.approx(depth, abs=1e-9)


def test_a_position_is_computed_when_the_last_fix_is_old():
    gps = {"lat": FILTER["lat"], "lon": FILTER["lon"]}

    def reckoned(*messages, system=None):
        log = [sent(name, payload, at) for at, name, payload in messages]
        events = [event for each in events_of(log, CONFIG, system) for event in each]
        assert len(only(Used | Skipped, events)) == len(log)
        return [one.dead_reckoned for one in only(VehicleState, events)]

    def fixed(second, kind):
        return second, "GPS_RAW_INT", gps | {"fix_type": kind}

    def at(second, system="1"):
        return second, f"{system}/GLOBAL_POSITION_INT", FILTER

    # without a GPS in the log it is taken at its word; another system's fix says nothing of this one
    assert reckoned(at(0)) == reckoned(fixed(0, 3), at(8, "2")) == [False]
    assert reckoned(fixed(0, 3), at(5), at(6), fixed(7, 4), at(7)) == [False, True, False]
    assert reckoned(fixed(0, 2), at(1)) == [True]


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


def test_frames_that_are_not_east_north_up():
    found = stated(logged("geometry_msgs/PoseStamped", pose(20.0, 10.0, 40.0, "world_ned")))
    assert (found.east, found.north, found.depth) == (10.0, 20.0, 40.0)


CELLS = {"v": [[0.1, 0.2]] * 2}
STATED = [
    {"east_mm_s": 120, "north_mm_s": -50, "depth": 10.0},
    {"east_mm_s": None, "north_mm_s": 7, "depth": 20.0},
]
NO_CELLS = {"cell_size": None, "first_cell": None}


def profile_of(**fields):
    """Return a configuration that maps a profile; None takes a field away."""
    known = PROFILE | {"velocity": "v"} | fields
    return mapping({key: value for key, value in known.items() if value is not None})


@pytest.mark.parametrize(
    ("schema", "payload", "config", "velocity", "depth"),
    [
        (
            *("ds_sensor_msgs/msg/Adcp", ds_adcp(), EARTH),
            *([[0.1, -0.2], [NAN, NAN], [0.3, 0.0]], [103.5, 105.5, 107.5]),
        ),
        (
            "replay_kit.AdcpPing",
            ping(
                0,
                velocity=[
                    {"value": [0.1, 0.2]},
                    {"east": 0.3, "north": 0.4, "up": 0.0},
                    {"east": None, "north": 0.4},
                ],
            ).payload,
            *(CONFIG, [[0.1, 0.2], [0.3, 0.4], [NAN, 0.4]], [16.0, 48.0, 80.0]),
        ),
        *(
            ("", payload, config, [[0.125, -0.25]] * 2, [106.0, 110.0])
            for unit, factor, frame in (
                ("m/s", 1, "enu"),
                ("dm/s", 10, "ned"),
                ("cm/s", 100, "enu"),
                ("mm/s", 1000, "ned"),
            )
            for cell in [
                [
                    factor * v
                    for v in ([0.125, -0.25, 0.5] if frame == "enu" else [-0.25, 0.125, -0.5])
                ]
            ]
            for payload, config in (
                ({"v": [cell] * 2}, profile_of(speed_unit=unit, frame=frame)),
                ({"v": cell * 2}, profile_of(speed_unit=unit, frame=frame, components=3)),
            )
        ),
        (
            *("", {"cells": [{"u": 100, "v": -32768}, {"u": 0, "v": 5}]}),
            profile_of(
                velocity=None,
                east="cells.*.u",
                north="cells.*.v",
                speed_unit="mm/s",
                missing=[-32768, 0],
            ),
            *([[0.1, NAN], [NAN, 0.005]], [106.0, 110.0]),
        ),
        *(
            ("", CELLS | payload, profile_of(**fields), CELLS["v"], depth)
            for fields, payload, depth in (
                ({"orientation": "up"}, {}, [94.0, 90.0]),
                (
                    {"cell_size": "size", "first_cell": "first", "distance_unit": "cm"},
                    *({"size": 50, "first": 75}, [100.75, 101.25]),
                ),
                (NO_CELLS | {"distances": "at"}, {"at": [3.0, 9.0]}, [103.0, 109.0]),
                (
                    NO_CELLS | {"depths": "at", "depth_positive": "up"},
                    {"at": [-3.0, -9.0]},
                    [3.0, 9.0],
                ),
                ({"depth": "p", "depth_unit": "dbar"}, {"p": 0.0}, [6.0, 10.0]),
            )
        ),
        *(
            ("", payload, suggested(payload, reference='"earth"')[0], velocity, depth)
            for payload, velocity, depth in (
                ({"cells": STATED}, [[0.12, -0.05], [NAN, 0.007]], [10.0, 20.0]),
                (
                    {"u_cm_s": [10, 20], "v_cm_s": [30.0, NAN], "depths_cm": [500.0, 900.0]},
                    *([[0.1, 0.3], [0.2, NAN]], [5.0, 9.0]),
                ),
                (
                    {"currents": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]},
                    *([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6], [0.7, 0.8]], [101, 102, 103, 104]),
                ),
                (
                    {
                        "velocities": [[0.1, 0.2], [0.3, 0.4]],
                        "cell_size_cm": 400,
                        "first_cell_cm": 600.0,
                    },
                    *([[0.1, 0.2], [0.3, 0.4]], [106.0, 110.0]),
                ),
            )
        ),
    ],
)
def test_a_profile(schema, payload, config, velocity, depth):
    found = the(Observation, [fix(0, depth=100.0), sent(schema, payload)], config)
    assert_array_equal(found.velocity, velocity)
    assert_array_equal(found.depth, depth)
    known = np.isfinite(velocity).all(axis=1)
    assert found.flags.tolist() == np.where(known, Flag.GOOD, Flag.MISSING).tolist()
    # what a guess does not know is left to a person
    if schema == "" and config.map[0].reference == "earth":
        unknown = {"map": [config.map[0].model_copy(update={"reference": "unknown"})]}
        events = run([fix(0), sent(schema, payload)], config.model_copy(update=unknown))
        assert {one.reference for one in only(Observation, events)} <= {"platform"}


def test_a_stated_reference_of_the_platform_and_error_are_the_profile_s():
    relative = MeasurementConfig(reference="platform")
    found = the(Observation, [fix(0), sent("ds_sensor_msgs/msg/Adcp", ds_adcp())], relative)
    assert (found.reference, found.common_std) == ("platform", np.inf)
    found = the(Observation, [fix(0), sent("", CELLS)], profile_of(velocity_std=0.04))
    assert_array_equal(found.error_std, 0.04)


def test_ds_adcp_along_its_beams():
    water = np.array([0.2, -0.1, 0.05])
    along = [np.multiply(water @ beam, beam).tolist() for beam in BEAMS]
    payload = ds_adcp(0)
    payload["vel_bin_beams"] = [{"velocity_bin_beam": vectors([*along[:3], (0.0, 0.0, 0.0)])}]
    found = stated(logged("ds_sensor_msgs/Adcp", payload), EARTH)
    assert_allclose(found.velocity[0], [*(np.array(BEAMS[:3]) @ water), NAN], atol=1e-15)
    assert_array_equal(found.vectors, BEAMS)


FOUR = [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("payload", "schema", "config", "frame", "cell"),
    [
        (imc(8, [FOUR]), "imc.CurrentProfile", CONFIG, "earth", FOUR[:3]),
        (imc("ned", [FOUR]), "imc.CurrentProfile", CONFIG, "earth", [0.2, 0.1, -0.3]),
        (imc(1, [FOUR]), "imc.CurrentProfile", CONFIG, "instrument", FOUR),
        (imc(4, [FOUR]), "imc.CurrentProfile", CONFIG, "beam", FOUR),
        *(
            ({"v": [FOUR]}, "", profile_of(frame=of), of, FOUR)
            for of in ("beam", "instrument", "ship")
        ),
    ],
)
def test_components_in_other_frames_are_kept(payload, schema, config, frame, cell):
    message = sent(schema, payload)
    found = stated(message, config)
    assert (found.frame, found.velocity.tolist()) == (frame, [cell])
    if schema:
        assert (found.distance.tolist(), found.correlation.tolist()) == ([5.0], [[90] * 4])
        profiles = only(Observation, run([fix(0), message]))
        assert [one.reference for one in profiles] == ["platform"] * (frame == "earth")


@pytest.mark.parametrize(
    ("payload", "profiles", "positions"),
    [
        ({"v": [[0.1, 0.2]], "lon": 10.5, "lat": -30.0}, [10.5], [152.0, 10.5]),
        ({"v": [[0.1, 0.2]], "lon": 0.0, "lat": 0.0}, [152.0], [152.0]),
        # a position counts where the profile in its message does not
        ({"v": [[1.0]], "lon": 10.5, "lat": -30.0}, [], [152.0, 10.5]),
    ],
)
def test_a_profile_with_a_position_in_the_same_message(payload, profiles, positions):
    config = profile_of(longitude="lon", latitude="lat")
    events = run([fix(0, depth=0.0), sent("", payload)], config)
    assert [one.longitude for one in only(Observation, events)] == profiles
    assert [one.longitude for one in only(VehicleState, events)] == positions
    assert len(only(Used, events)) == 1 + len(profiles)


MOORING = {
    **{"topic": TOPIC, "kind": "velocity", "reference": "earth", "east": "v.0", "north": "v.1"},
    **{"speed_unit": "cm/s", "velocity_std": 0.02},
}
LOGGED = {"longitude": "lon", "latitude": "lat", "depth": "p", "depth_unit": "dbar"}


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"place": [150.5, -41.0], "at_depth": 80.0}, (150.5, -41.0, 80)),
        (LOGGED, (151.0, -39.0, 100)),
        ({}, (152.0, -40.0, 40)),
    ],
)
def test_one_velocity_at_one_depth(fields, where):
    payload = {"v": [10.0, -20.0], "lon": 151.0, "lat": -39.0, "p": 101.0}
    messages = [fix(0, depth=40.0), sent("", payload, 5), fix(10)]
    found = the(Observation, messages, mapping(MOORING | fields))
    assert (found.longitude, found.latitude, round(float(found.depth[0]))) == where
    assert_allclose([*found.velocity[0], *found.error_std], [0.1, -0.2, 0.02])


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
        ("imc.GpsFix", RADIANS | {"validity": 3}, "VALID_POS"),
        ("imc.EstimatedState", {"lat": 0.0, "lon": 0.0}, "0, 0"),
        ("imc.EstimatedState", RADIANS | {"x": None}, "not a number"),
        ("sensor_msgs.Imu", ORIENTED | {"orientation_covariance": [-1.0]}, "no orientation stated"),
        ("sensor_msgs.Imu", ORIENTED, "without their own"),
        ("sensor_msgs.NavSatFix", NAV_SAT | {"status": {"status": -1}}, "no fix (status < 0)"),
        ("geometry_msgs.PoseStamped", pose(1e6, 1e6, 1e6, "/earth"), "frame 'earth'"),
        ("geometry_msgs.PoseStamped", {}, "no pose.position in it"),
        ("dataflash.GPS", PLACE | {"Status": 2}, "no fix (Status < 3)"),
        ("dataflash.GPS", PLACE | {"Status": 4, "I": 1}, "not the first GPS receiver"),
        ("dataflash.POS", {"Lat": "x"}, "position is not a number"),
        ("dataflash.CTUN", {"Alt": NAN}, "depth is not a number"),
        ("dataflash.BARO", {"Alt": -9.2, "I": 0}, "message type not used by the estimator"),
        ("GPS_RAW_INT", FILTER | {"fix_type": 2}, "no fix (fix_type < 3)"),
        ("GLOBAL_POSITION_INT", FILTER | {"lat": 0, "lon": 0}, "position is 0, 0 (no fix)"),
        *(
            ("replay_kit.AdcpPing", ping(0, **changes).payload, words)
            for changes, words in (
                ({"cell_distances": [4.0]}, "cell_distances"),
                ({"reference": None}, "expected reference"),
                ({"coordinate_system": "beam"}, "heading is magnetic"),
                ({"coordinate_system": "sideways"}, "expected coordinate_system"),
                ({"velocity": [[0.1, 0.2]]}, "expected 3 cells"),
                ({"velocity": [{"x": 1.0, "y": 1.0}] * 3}, "expected cells"),
                ({"velocity": None}, "list of velocities"),
                ({"cell_size": 0.0}, "cell_size > 0"),
                ({"velocity_std": [0.1, 0.1]}, "3 numbers"),
            )
        ),
        *(
            (config, payload, words)
            for payload, config, words in (
                ({"v": [0.1, 0.2, 0.3]}, profile_of(components=2), "number of components"),
                ({"v": 0.1}, profile_of(), "not a list"),
                (
                    {"e": [1.0], "n": [1.0, 2.0]},
                    profile_of(velocity=None, east="e", north="n"),
                    "not lists of one length",
                ),
                ({"v": []}, profile_of(), "n_cells >= 1"),
                ({"v": [[0.1]]}, profile_of(frame="ned"), "expected cells"),
                ({"lon": 0, "lat": 0}, mapping(POSITION), "position is 0, 0"),
            )
        ),
    ],
)
def test_what_is_not_used_says_why(schema, payload, words):
    config, schema = (CONFIG, schema) if isinstance(schema, str) else (schema, "")
    message = sent(schema, payload)
    event = the(Skipped, [fix(0), message], config)
    assert event.topic == message.topic
    assert words in event.reason


def test_a_goal_is_no_position():
    goal = logged("geometry_msgs/PoseStamped", pose(2.0, 1.0, 4.0), topic="/move_base/Goal")
    assert "suggests a goal" in the(Skipped, [fix(0), goal]).reason


@pytest.mark.parametrize(
    "payload",
    [
        {},
        {"velocity": [0.1, 0.2, 0.3]},
        {"lat": 1.0, "far": {"lon": 2.0}},
        {"field": {"z": 1.0}},
        # where the vehicle is not now
        {"end_lat": 1.0, "end_lon": 20.0},
        {"homePosition": {"lat": 1.0, "lon": 20.0}},
        # a height that only a person can place
        {"z": -3.0},
    ],
)
def test_nothing_that_looks_usable_is_guessed(payload):
    config, text = suggested(payload)
    assert (config.map, "Nothing in the log" in text) == ((), True)


def test_what_is_guessed_says_what_it_does_not_know_and_takes_the_vehicle_s_own_position():
    assert "components = 2  # NOT KNOWN" in suggested({"currents": [0.1] * 8})[1]
    payload = {"goal": {"lat": 1.0, "lon": 20.0}, "legend": {"lat": 2.0, "lon": 30.0}}
    # a payload that holds itself ends
    payload["again"] = payload
    assert suggested(payload)[0].map[0].latitude == "legend.lat"


@pytest.mark.parametrize(("looks", "depth"), [("down", 19.0), ("up", 2.0)])
def test_a_twist_on_a_topic_of_one_cell_is_a_velocity_at_a_distance(looks, depth):
    payload = {"twist": {"linear": {"x": 0.12, "y": -0.05, "z": 0.0}, "angular": {"x": 0.0}}}
    messages = [fix(0, depth=7.0), sent("geometry_msgs/TwistStamped", payload)]
    # not used until a person states the reference
    assert not only(Observation, run(messages, suggested(payload)[0]))
    config, _ = suggested(payload, reference='"earth"', distance=str(abs(depth - 7.0)))
    looking = {"map": (config.map[0].model_copy(update={"orientation": looks}),)}
    observation = the(Observation, messages, config.model_copy(update=looking))
    assert_array_equal(observation.velocity, [[0.12, -0.05]])
    assert observation.depth.tolist() == [depth]


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("x", "the message holds a, cells, raw"),
        ("a.b.c", "at 'a.b' holds a list"),
        ("a.b.0.c", "at 'a.b.0' holds one int"),
        ("cells.1.v.w", "at 'cells.1.v' holds nothing"),
        ("a.*", "at 'a' holds b"),
    ],
)
def test_a_path_that_leads_nowhere_says_what_stands_there_once(path, said):
    payload = {"a": {"b": [10, {"c": 3}]}, "cells": [{"v": 1}, {"v": None}], "raw": b"\x05"}
    config = mapping(POSITION | {"longitude": path})
    (reason,) = set(reasons(run([sent("", payload, k) for k in range(3)], config)))
    assert f"{path!r} leads nowhere" in reason
    assert said in reason


@pytest.mark.parametrize("path", ["a.b.0", "a.b.-1.c", "raw.0"])
def test_a_path_leads_to_a_value(path):
    payload = {"a": {"b": [5, {"c": 5}]}, "raw": b"\x05", "lat": LAT}
    state = the(VehicleState, [sent("", payload)], mapping(POSITION | {"longitude": path}))
    assert state.longitude == 5.0


TOML = """
[[measurements.map]]
topic = "/nav"
kind = "position"
longitude = "x.0"
latitude = "x.1"
angle_unit = "rad"

[[measurements.map]]
topic = "/\\u2248 \\"adcp\\""
kind = "profile"
reference = "earth"
frame = "ned"
velocity = "cells.*.v"
missing = [-32768.0]
cell_size = "size"
first_cell = 2.5
"""


def test_mappings_in_toml(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(TOML)
    config = load_config(path)
    assert [kind.kind for kind in config.measurements.map] == ["position", "profile"]
    assert config.measurements.map[1].topic == '/\u2248 "adcp"'
    path.write_text(run_settings_toml(config), encoding="utf-8")
    assert load_config(path) == config


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({**POSITION, "lattitude": "y"}, r"unknown key '.*lattitude'; known here: .*latitude"),
        (
            {"topic": "/p", "kind": "depth", "depth": "d", "unit": "m"},
            r"unknown key '.*unit'; known here: .*depth_unit",
        ),
        ({**POSITION, "kind": "place"}, "'position', 'depth', 'profile'"),
        ({**POSITION, "latitude": "a..b"}, "latitude"),
        ({**POSITION, "angle_unit": "grad"}, "'deg', 'rad'"),
        (PROFILE, "give velocity, or east and north"),
        (
            {**PROFILE, "velocity": "v", "east": "e", "north": "n"},
            "give velocity, or east and north",
        ),
        ({**PROFILE, "east": "e", "north": "n", "frame": "beam"}, "not in a frame 'beam'"),
        ({**PROFILE, "velocity": "v", "latitude": "y"}, "longitude and latitude, or neither"),
        ({**PROFILE, "velocity": "v", "distances": "d"}, "give one of depths"),
        *(
            ({**MOORING, **half}, words)
            for half, words in (
                ({"place": [150.5, -41.0]}, "at_depth"),
                ({"longitude": "lon"}, "latitude"),
            )
        ),
        ({**PROFILE, "velocity": "v", "reference": ""}, "reference"),
    ],
)
def test_a_wrong_mapping_is_an_error(fields, words):
    with pytest.raises(ConfigError, match=words):
        load_config(None, {"measurements": {"map": [fields]}})
