"""Guessed mappings: what is found, that the file loads, and that with the right answers filled in the log can be used."""

import math

import pytest
from numpy.testing import assert_array_equal

from replay_kit.config.run import load_config
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.logs.tables.suggest import sample_key
from replay_kit.measurements import suggestions
from tests.measurements.samples import fix, logged, only, run, the

TOPIC = '/vendor "x"'


def suggested(tmp_path, payload, **replaced):
    """Return the entries guessed, loaded from the file, and the file's text."""
    text = suggestions({TOPIC: ("vendor.Thing", payload)})
    for key, value in replaced.items():
        (old,) = (line for line in text.splitlines() if line.startswith(f"{key} = "))
        text = text.replace(old, f"{key} = {value}")
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    config = load_config(tmp_path / "map.toml").measurements
    assert all(entry.topic == TOPIC for entry in config.map)
    return config, text


def events(config, payload):
    return run([logged("vendor.Thing", payload, topic=TOPIC)], config)


@pytest.mark.parametrize(
    ("payload", "longitude", "latitude"),
    [
        ({"fix": {"lat": -40.5, "lon": 152.25}}, 152.25, -40.5),
        ({"gps_latitude": -405_000_000, "gps_longitude": 1_522_500_000}, 152.25, -40.5),
        ({"lat": math.radians(-40.5), "lng_rad": math.radians(152.25)}, 152.25, -40.5),
        ({"lat": 90.0, "lon": 360.0}, 360.0, 90.0),
    ],
)
def test_positions(tmp_path, payload, longitude, latitude):
    config, _ = suggested(tmp_path, payload)
    (state,) = only(VehicleState, events(config, payload))
    assert (state.longitude, state.latitude) == pytest.approx((longitude, latitude), abs=1e-9)


@pytest.mark.parametrize(
    ("payload", "depth"),
    [
        ({"depth": 12.5}, 12.5),
        ({"vehicle_depth_cm": -1250.0}, 12.5),
        ({"water_pressure_dbar": 100.0}, 99.2),
        ({"pressure": 1_101_325.0}, 99.2),
        ({"press_bar": 11.01325}, 109.3),
        ({"pressure_mbar": 1013.25}, 0.0),
    ],
)
def test_depths(tmp_path, payload, depth):
    payload = {"lat": -40.0, "lon": 152.0, **payload}
    config, _ = suggested(tmp_path, payload)
    (state,) = only(VehicleState, events(config, payload))
    assert state.depth == pytest.approx(depth, abs=0.3)


def test_a_depth_alone_and_a_height_that_only_a_person_can_place(tmp_path):
    config, _ = suggested(tmp_path, {"ctd": {"depth_m": 3.0}})
    assert [entry.kind for entry in config.map] == ["depth"]
    config, text = suggested(tmp_path, {"z": -3.0})
    assert config.map == ()
    assert '# depth = "z"' in text
    config, text = suggested(tmp_path, {"lat": 1.0, "lon": 20.0, "altitude": 30.0})
    assert config.map[0].depth is None
    assert '# depth = "altitude"' in text


CELLS = [{"east": 120, "north": -50, "depth": 10.0}, {"east": -32768, "north": 7, "depth": 20.0}]


@pytest.mark.parametrize(
    ("payload", "velocity", "depth"),
    [
        ({"cells": CELLS}, [[0.12, -0.05], [math.nan, 0.007]], [10.0, 20.0]),
        (
            {"u_cm_s": [10, 20], "v_cm_s": [30.0, math.nan], "depths_cm": [-500.0, -900.0]},
            [[0.1, 0.3], [0.2, math.nan]],
            [5.0, 9.0],
        ),
        (
            {"currents": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]},
            [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6], [0.7, 0.8]],
            [1, 2, 3, 4],
        ),
    ],
)
def test_profiles_are_not_used_until_a_person_states_the_reference(
    tmp_path, payload, velocity, depth
):
    payload = {**payload, "position": {"lat": -40.0, "lon": 152.0}}
    config, text = suggested(tmp_path, payload)
    assert ("components = 2  # NOT KNOWN" in text) is ("currents" in payload)
    assert all(
        observation.reference == "platform"
        for observation in only(Observation, events(config, payload))
    )
    assert "NOT KNOWN" in text
    config, _ = suggested(tmp_path, payload, reference='"earth"')
    (observation,) = only(Observation, events(config, payload))
    assert_array_equal(observation.velocity, velocity)
    assert_array_equal(observation.depth, depth)


@pytest.mark.parametrize(
    "payload",
    [
        {},
        {"velocity": [0.1, 0.2, 0.3]},
        {"lat": 1.0, "far": {"lon": 2.0}},
        {"field": {"z": 1.0}},
    ],
)
def test_nothing_that_looks_usable(tmp_path, payload):
    config, text = suggested(tmp_path, payload)
    assert config.map == ()
    assert "Nothing in the log" in text


def test_a_payload_that_holds_itself_ends():
    payload = {"lat": 1.0, "lon": 20.0}
    payload["again"] = payload
    assert 'latitude = "lat"' in suggestions({"/x": ("", payload)})


@pytest.mark.parametrize(
    "payload",
    [
        {"end_lat": 1.0, "end_lon": 20.0},
        {"homePosition": {"lat": 1.0, "lon": 20.0}},
    ],
)
def test_a_position_where_the_vehicle_is_not_now_is_commented_out(tmp_path, payload):
    config, text = suggested(tmp_path, payload)
    assert config.map == ()
    assert "# # longitude = " not in text
    assert "# longitude = " in text


def test_the_vehicles_own_position_goes_before_a_goal(tmp_path):
    payload = {"goal": {"lat": 1.0, "lon": 20.0}, "legend": {"lat": 2.0, "lon": 30.0}}
    assert suggested(tmp_path, payload)[0].map[0].latitude == "legend.lat"


@pytest.mark.parametrize(("looks", "depth"), [("down", 19.0), ("up", 2.0)])
def test_a_twist_on_a_topic_of_one_cell_is_a_velocity_at_a_distance(tmp_path, looks, depth):
    payload = {"twist": {"linear": {"x": 0.12, "y": -0.05, "z": 0.0}, "angular": {"x": 0.0}}}
    messages = [fix(0, depth=7.0), logged("geometry_msgs/TwistStamped", payload, topic=TOPIC)]
    config, text = suggested(tmp_path, payload)
    assert "NOT KNOWN" in text
    assert not only(Observation, run(messages, config))
    config, _ = suggested(tmp_path, payload, reference='"earth"', distance=str(abs(depth - 7.0)))
    (entry,) = config.map
    looking = {"map": (entry.model_copy(update={"orientation": looks}),)}
    observation = the(Observation, messages, config.model_copy(update=looking))
    assert_array_equal(observation.velocity, [[0.12, -0.05]])
    assert observation.depth.tolist() == [depth]


def mavlink(kind, **fields):
    return f"mavlink/1/1/{kind}", kind, {"time_boot_ms": 5, **fields}


@pytest.mark.parametrize(
    ("message", "kind", "line"),
    [
        (mavlink("NAMED_VALUE_FLOAT", name="Depth", value=12.5), "depth", 'depth = "value"'),
        (
            mavlink(
                "DEBUG_FLOAT_ARRAY", name="CURPROF", array_id=1, data=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
            ),
            "profile",
            'velocity = "data"',
        ),
        (mavlink("DEBUG_VECT", name="current", x=0.1, y=0.2, z=0.0), "velocity", 'east = "x"'),
    ],
)
def test_numbers_under_names_of_the_senders_own(message, kind, line):
    topic, schema, payload = message
    text = suggestions({sample_key(topic, payload): (schema, payload)})
    assert f'topic = "{topic}"\nname = "{payload["name"]}"\nkind = "{kind}"' in text
    assert f"{line}  #" in text
    assert sample_key("/x", payload) == "/x"


def test_a_mapping_of_a_name_leaves_other_names_alone(tmp_path):
    topic, schema, payload = mavlink("NAMED_VALUE_FLOAT", name="Depth", value=12.5)
    text = suggestions({sample_key(topic, payload): (schema, payload)})
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    config = load_config(tmp_path / "map.toml").measurements
    other = logged(schema, payload | {"name": "Volt", "value": 24.0}, 1, topic)
    messages = [logged(schema, payload, topic=topic), other, fix(2)]
    assert the(VehicleState, messages, config).depth == 12.5
