"""Velocities of which each message carries one component: joined by their stamps, suggested by their names."""

import io
import tomllib

import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.measurements import Used, initial_state, interpret, suggestions
from replay_kit.measurements.messages.suggest import sample_key, suggested_entries
from replay_kit.workflows.replay.store.pickling import dump, load
from tests.command import invoke
from tests.logs.log_samples import tlog_entry
from tests.measurements.samples import fix, mapping, only, reasons, run, the

FLOAT, ARRAY = "mavlink/1/1/NAMED_VALUE_FLOAT", "mavlink/1/1/DEBUG_FLOAT_ARRAY"
VELOCITY = {
    "topic": FLOAT,
    "kind": "velocity",
    "reference": "earth",
    "east": "VE",
    "north": "VN",
    "join_within": 0.05,
    "distance": 3.0,
}
ALONE = "one velocity component without the other within join_within"


def part(name, value, ms, seconds=1, topic=FLOAT):
    held = {"value": value} if topic == FLOAT else {"data": value}
    return Message(
        seconds * 10**9,
        topic,
        "X",
        {"name": name, **held, **({} if ms is None else {"time_boot_ms": ms})},
        0,
        0,
    )


def around(messages):
    return [fix(0, depth=5.0), *messages, fix(9, depth=5.0)]


def events(messages, **changes):
    config = mapping(VELOCITY | changes)
    return [
        event
        for event in run(around(messages), config)
        if getattr(event, "topic", FLOAT) != "/vehicle/fix"
    ]


@pytest.mark.parametrize("order", [1, -1])
def test_two_components_are_one_velocity(order):
    found = events([part("VE", 0.25, 100), part("Volt", 12.0, 100), part("VN", -0.5, 150)][::order])
    (observation,) = only(Observation, found)
    assert_array_equal(observation.velocity, [[0.25, -0.5]])
    assert observation.depth.tolist() == [8.0]
    assert [type(event) for event in found if isinstance(event, Used)] == [Used, Used]


@pytest.mark.parametrize(("first", "second"), [((100, 1), (151, 1)), ((None, 1), (None, 2))])
def test_components_of_other_times_are_not_joined(first, second):
    found = events([part("VE", 0.25, *first), part("VN", -0.5, *second)])
    assert only(Observation, found) == []
    assert reasons(found) == [ALONE, ALONE]


def test_a_lost_component_costs_its_own_velocity_alone():
    found = events(
        [part("VE", 9.0, 100), part("VE", 0.25, 200), part("VN", -0.5, 200), part("VN", 9.0, 300)]
    )
    (observation,) = only(Observation, found)
    assert_array_equal(observation.velocity, [[0.25, -0.5]])
    assert reasons(found) == [ALONE, ALONE]


def test_a_component_that_waits_is_a_value_that_a_checkpoint_holds():
    config = mapping(VELOCITY)
    state, _ = interpret(initial_state(), part("VE", 0.25, 100), config)
    file = io.BytesIO()
    dump(state, file)
    file.seek(0)
    assert load(file).components == state.components
    assert [waiting.value for waiting in state.components.values()] == [0.25]


def test_arrays_of_one_component_are_a_profile():
    changes = {
        "topic": ARRAY,
        "kind": "profile",
        "frame": "enu",
        "cell_size": 2.0,
        "first_cell": 3.0,
        "speed_unit": "cm/s",
    }
    config = mapping({k: v for k, v in (VELOCITY | changes).items() if k != "distance"})
    parts = [
        part("VE", [10.0, 20.0], None, topic=ARRAY),
        part("VN", [-5.0, 0.0], None, topic=ARRAY),
    ]
    observation = the(Observation, around(parts), config)
    assert_allclose(observation.velocity, [[0.1, -0.05], [0.2, 0.0]])
    assert observation.depth.tolist() == [8.0, 10.0]
    parts[1] = part("VN", [-5.0], None, topic=ARRAY)
    unequal = run(around(parts), config)
    assert reasons(unequal) == ["measurements.map: east and north are not lists of one length"] * 2


@pytest.mark.parametrize(
    "wrong",
    [
        {"name": "VE"},
        {"longitude": "lon", "latitude": "lat"},
        {"depth": "d"},
        {"join_within": -1.0},
    ],
)
def test_what_a_message_of_one_component_cannot_hold_is_refused(wrong):
    with pytest.raises(ValidationError):
        mapping(VELOCITY | wrong)


def samples(topic, **values):
    key = "data" if topic == ARRAY else "value"
    payloads = [{"name": name, key: value} for name, value in values.items()]
    return {sample_key(topic, payload): ("X", payload) for payload in payloads}


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (("VE", "VN"), ["VE and VN"]),
        (("U", "V", "Volt"), ["U and V"]),
        (("cur_e2", "cur_n2", "cur_e1"), ["cur_e2 and cur_n2"]),
        (("VelEast", "VelNorth"), ["VelEast and VelNorth"]),
        (("VE1", "VN2"), []),
        (("Vx", "Vy"), []),
    ],
)
def test_pairs_are_found_by_their_names(names, pairs):
    found = suggested_entries(samples(FLOAT, **dict.fromkeys(names, 0.1)))
    assert list(found) == [f"{FLOAT}\n{pair}" for pair in pairs]


def test_the_entry_of_a_pair_says_what_it_does_not_know(tmp_path):
    text = suggestions(
        samples(FLOAT, VE=120.0, VN=-50.0) | samples(ARRAY, E=[0.1] * 3, N=[0.2] * 3, odd=[0.1] * 6)
    )
    assert text.count("[[measurements.map]]") == 3
    assert 'east = "VE"' in text
    assert 'speed_unit = "mm/s"' in text
    # an array that is no ping of ours is a profile under any name
    assert 'name = "odd"\nkind = "profile"' in text
    path = tmp_path / "map.toml"
    path.write_text(text)
    assert [entry.reference for entry in MeasurementConfig.model_validate(_toml(path)).map] == [
        "unknown"
    ] * 3


def _toml(path):
    return tomllib.loads(path.read_text())["measurements"]


def test_a_telemetry_log_with_named_components_is_used_by_the_mapping_suggested(tmp_path):
    log, mapping = tmp_path / "a.tlog", tmp_path / "map.toml"
    entries = []
    for k in range(4):
        stamp = 10**15 + k * 10**6
        position = dialect.MAVLink_global_position_int_message(
            1000 * k, -400000000, 1520000000, 0, -5000, 0, 0, 0, 0
        )
        named = [
            dialect.MAVLink_named_value_float_message(1000 * k + i, name, value)
            for i, (name, value) in enumerate(((b"VE", 0.25), (b"VN", -0.5)))
        ]
        entries += [tlog_entry(stamp + i, message) for i, message in enumerate((position, *named))]
    log.write_bytes(b"".join(entries))
    said = invoke(f"info {log} --suggest {mapping}").stdout
    assert f"Unknown type: {FLOAT}, name VE and VN looks like a velocity" in said
    assert f"Next: replay-kit info {log} --suggest map.toml" in said
    mapping.write_text(mapping.read_text().replace('"unknown"', '"earth"'))
    said = invoke(f"info {log} --config {mapping}").stdout
    assert "4 profiles with 4 usable bins" in said
    assert said.rstrip().endswith(
        f"Next: replay-kit replay {log} --ensemble FORECAST.nc --config {mapping} -o RESULT.mcap"
    )
