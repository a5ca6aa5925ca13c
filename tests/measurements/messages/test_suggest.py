"""Guessed mappings: what is found, that the file loads, and that with the right answers filled in the log can be used."""

import math

import pytest
from numpy.testing import assert_array_equal

from replay_kit.config.run import load_config
from replay_kit.core.observation import Observation, VehicleState
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


AT = {"lat": -40.5, "lon": 152.25}


@pytest.mark.parametrize(
    ("payload", "depth"),
    [
        ({"fix": AT}, math.nan),
        ({"gps_latitude_e7": -405_000_000, "gps_longitude_e7": 1_522_500_000}, math.nan),
        ({"lat_rad": math.radians(-40.5), "lng_rad": math.radians(152.25)}, math.nan),
        (AT | {"depth": 12.5}, 12.5),
        (AT | {"vehicle_depth_cm": 1250.0}, 12.5),
        (AT | {"water_pressure_dbar": 100.0}, 99.2),
        (AT | {"press_bar": 10.0}, 99.2),
        (AT | {"fluid_pressure_mbar": 1000.0}, 9.9),
    ],
)
def test_positions_and_depths(tmp_path, payload, depth):
    config, _ = suggested(tmp_path, payload)
    (state,) = only(VehicleState, events(config, payload))
    assert (state.longitude, state.latitude) == pytest.approx((152.25, -40.5), abs=1e-9)
    assert state.depth == pytest.approx(depth, abs=0.3, nan_ok=True)


def test_a_depth_alone(tmp_path):
    config, _ = suggested(tmp_path, {"ctd": {"depth_m": 3.0}})
    assert [entry.kind for entry in config.map] == ["depth"]


CELLS = [
    {"east_mm_s": 120, "north_mm_s": -50, "depth": 10.0},
    {"east_mm_s": None, "north_mm_s": 7, "depth": 20.0},
]


@pytest.mark.parametrize(
    ("payload", "velocity", "depth"),
    [
        ({"cells": CELLS}, [[0.12, -0.05], [math.nan, 0.007]], [10.0, 20.0]),
        (
            {"u_cm_s": [10, 20], "v_cm_s": [30.0, math.nan], "depths_cm": [500.0, 900.0]},
            [[0.1, 0.3], [0.2, math.nan]],
            [5.0, 9.0],
        ),
        (
            {"currents": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]},
            [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6], [0.7, 0.8]],
            [1, 2, 3, 4],
        ),
        (
            {"velocities": [[0.1, 0.2], [0.3, 0.4]], "cell_size_cm": 400, "first_cell_cm": 600.0},
            [[0.1, 0.2], [0.3, 0.4]],
            [6.0, 10.0],
        ),
    ],
)
def test_profiles_are_not_used_until_a_person_states_the_reference(
    tmp_path, payload, velocity, depth
):
    payload = {**payload, "position": {"lat": -40.0, "lon": 152.0}}
    config, text = suggested(tmp_path, payload)
    assert ("components = 2  # NOT KNOWN" in text) is ("currents" in payload)
    assert {one.reference for one in only(Observation, events(config, payload))} <= {"platform"}
    config, _ = suggested(tmp_path, payload, reference='"earth"')
    (observation,) = only(Observation, events(config, payload))
    assert_array_equal(observation.velocity, velocity)
    assert_array_equal(observation.depth, depth)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        ({}, "Nothing in the log"),
        ({"velocity": [0.1, 0.2, 0.3]}, "Nothing in the log"),
        ({"lat": 1.0, "far": {"lon": 2.0}}, "Nothing in the log"),
        ({"field": {"z": 1.0}}, "Nothing in the log"),
        # where the vehicle is not now
        ({"end_lat": 1.0, "end_lon": 20.0}, "Nothing in the log"),
        ({"homePosition": {"lat": 1.0, "lon": 20.0}}, "Nothing in the log"),
        # a height that only a person can place
        ({"z": -3.0}, "Nothing in the log"),
    ],
)
def test_nothing_that_looks_usable(tmp_path, payload, said):
    config, text = suggested(tmp_path, payload)
    assert (config.map, said in text) == ((), True)


def test_a_payload_that_holds_itself_ends():
    payload = {"lat": 1.0, "lon": 20.0}
    payload["again"] = payload
    assert 'latitude = "lat"' in suggestions({"/x": ("", payload)})


def test_the_vehicles_own_position_goes_before_a_goal(tmp_path):
    payload = {"goal": {"lat": 1.0, "lon": 20.0}, "legend": {"lat": 2.0, "lon": 30.0}}
    assert suggested(tmp_path, payload)[0].map[0].latitude == "legend.lat"


@pytest.mark.parametrize(("looks", "depth"), [("down", 19.0), ("up", 2.0)])
def test_a_twist_on_a_topic_of_one_cell_is_a_velocity_at_a_distance(tmp_path, looks, depth):
    payload = {"twist": {"linear": {"x": 0.12, "y": -0.05, "z": 0.0}, "angular": {"x": 0.0}}}
    messages = [fix(0, depth=7.0), logged("geometry_msgs/TwistStamped", payload, topic=TOPIC)]
    # not used until a person states the reference
    assert not only(Observation, run(messages, suggested(tmp_path, payload)[0]))
    config, _ = suggested(tmp_path, payload, reference='"earth"', distance=str(abs(depth - 7.0)))
    looking = {"map": (config.map[0].model_copy(update={"orientation": looks}),)}
    observation = the(Observation, messages, config.model_copy(update=looking))
    assert_array_equal(observation.velocity, [[0.12, -0.05]])
    assert observation.depth.tolist() == [depth]
