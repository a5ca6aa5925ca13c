"""A ping through every carrier comes back exactly, to the carrier's quantisation, in the fields that the carrier has.

| carrier | quantisation | fields that it lacks |
|---|---|---|
| JSON, protobuf, our ping as a ROS 2 message | none | none of those compared |
| ds_sensor_msgs/Adcp in CDR | float32 for bin0_distance, whole metres for cell_size; zeros are none | all but geometry and velocity |
| DEBUG_FLOAT_ARRAY in a BlueOS recording | float32, written in its shortest form | none of those compared |
"""

import math

import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation
from replay_kit.logs.tables.columns import number
from replay_kit.logs.tables.frames import _assembled as assemble
from replay_kit.logs.tables.profiles import _ds_adcp
from tests.measurements import definitions as msg
from tests.measurements.carriers import json_mcap, read_mcap, ros2_mcap
from tests.measurements.messages.test_protobuf_ping import through_mcap
from tests.measurements.samples import fix, only, run

NUMBERS = (
    "transducer_depth",
    "sound_speed",
    "temperature",
    "pressure",
    "heading",
    "pitch",
    "roll",
    "magnetic_declination",
)
GEOMETRY = ("n_cells", "cell_size", "bin0_distance")
WORDS = ("coordinate_system", "reference", "orientation")
MAVLINK_CODES = {"earth": 3.0, "down": 0.0, "up": 1.0}

speed = st.one_of(st.none(), st.just(0.0), st.floats(-4.5, 4.5))
maybe = st.one_of(st.none(), st.floats(0.0, 360.0))


@st.composite
def pings(draw):
    n_cells = draw(st.integers(1, 6))
    return {
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": draw(st.sampled_from(["down", "up"])),
        "n_cells": n_cells,
        "cell_size": float(draw(st.integers(1, 60))),
        "bin0_distance": draw(st.floats(0.0, 100.0)),
        "velocity": [[draw(speed) for _ in range(3)] for _ in range(n_cells)],
        "velocity_std": [draw(st.floats(0.001, 1.0)) for _ in range(n_cells)],
        **{name: draw(maybe) for name in NUMBERS},
        # a ROS 2 message has no way to leave it open
        "declination_applied": True,
    }


def floats(value):
    """Return a payload's numbers as one row, unknown ones as NaN."""
    rows = value if isinstance(value, list) else [value]
    return np.array(
        [number(item) for row in rows for item in (row if isinstance(row, list) else [row])]
    )


def assert_same(ours, theirs, names, quantised=lambda values: values):
    for name in names:
        np.testing.assert_array_equal(
            quantised(floats(theirs[name])), quantised(floats(ours[name])), err_msg=name
        )


def profiles(*messages):
    config = MeasurementConfig(reference="earth")
    return [only(Observation, run([fix(0, depth=200.0), *given], config))[0] for given in messages]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("carriers")


def through_json(folder, ping):
    return read_mcap(folder, json_mcap([(0, "/adcp", "replay_kit.AdcpPing", ping)]))[0]


def flat(ping):
    known = {name: value for name, value in ping.items() if value is not None}
    return {**known, "velocity": floats(ping["velocity"]).tolist()}


@settings(max_examples=25, deadline=None)
@given(ping=pings())
def test_json(folder, ping):
    message = through_json(folder, ping)
    assert_same(ping, message.payload, [*NUMBERS, *GEOMETRY, "velocity", "velocity_std"])
    assert [message.payload[name] for name in WORDS] == [ping[name] for name in WORDS]


def assert_ours(folder, ping, message):
    """Assert that a message holds a ping, and gives the profile that the ping gives in JSON."""
    assert_same(ping, message.payload, [*NUMBERS, *GEOMETRY, "velocity", "velocity_std"])
    ours, theirs = profiles([through_json(folder, ping)], [message])
    assert_equal(ours, theirs)


@settings(max_examples=25, deadline=None)
@given(ping=pings())
def test_protobuf(folder, ping):
    message = through_mcap(folder, **flat(ping))
    assert_ours(folder, ping, message)


@settings(max_examples=25, deadline=None)
@given(ping=pings())
def test_our_ping_in_cdr(folder, ping):
    value = {**flat(ping), **{name: number(ping[name]) for name in NUMBERS}}
    (message,) = read_mcap(
        folder, ros2_mcap("replay_kit/msg/AdcpPing", msg.ADCP_PING, [value], "/adcp")
    )
    assert_ours(folder, ping, message)


@settings(max_examples=25, deadline=None)
@given(ping=pings())
def test_ds_adcp_in_cdr(folder, ping):
    cells = [
        {"velocity_bin_beam": [dict(zip("xyz", map(number, cell), strict=True))]}
        for cell in ping["velocity"]
    ]
    unit = {"x": 0.0, "y": 0.0, "z": 1.0}
    value = {
        "coordinate_mode": 3,
        "cells": ping["n_cells"],
        "cell_depth": int(ping["cell_size"]),
        "bin0_distance": ping["bin0_distance"],
    }
    data = ros2_mcap(
        "ds_sensor_msgs/msg/Adcp",
        msg.DS_ADCP_2,
        [{**value, "beam_unit_vec": [unit] * 4, "vel_bin_beams": cells}],
        "/adcp",
    )
    stated = _ds_adcp(read_mcap(folder, data)[0].payload)
    assert_same(ping, stated, ["n_cells", "cell_size"])
    assert_same(ping, stated, ["bin0_distance"], lambda values: values.astype(np.float32))
    expected = [
        cell if any(number(v) != 0.0 for v in cell) else [None] * 3 for cell in ping["velocity"]
    ]
    assert_same({"velocity": expected}, stated, ["velocity"])


@settings(max_examples=25, deadline=None)
@given(ping=pings())
def test_blueos_json(folder, ping):
    messages = read_mcap(
        folder,
        json_mcap([(0, TOPIC, TOPIC.replace("/", "."), frame) for frame in blueos_frames(ping)]),
    )
    frames = [message.payload for message in messages]
    assert None not in frames
    payload = assemble({frame["name"]: frame["data"] for frame in frames})
    assert_same(
        ping,
        payload,
        [*NUMBERS, *GEOMETRY, "velocity", "velocity_std"],
        lambda values: values.astype(np.float32),
    )
    ours, theirs = profiles(
        [through_json(folder, {**ping, **payload, "orientation": ping["orientation"]})], messages
    )
    assert_equal(ours, theirs)


def assert_equal(ours, theirs):
    for name in ("depth", "velocity", "error_std", "flags", "reasons"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)


TOPIC = "mavlink/1/1/DEBUG_FLOAT_ARRAY"


def blueos_frames(ping):
    """Yield a ping's five frames as the recorder writes them: float32 in their shortest form, NaN bare."""
    cell = np.array([[number(v) for v in cell] for cell in ping["velocity"]])
    code = {name: MAVLINK_CODES.get(ping[name], 0.0) for name in WORDS}
    configuration = [
        ping["n_cells"],
        ping["cell_size"],
        ping["bin0_distance"],
        code["coordinate_system"],
        0.0,
        code["orientation"],
        1.0,
    ]
    configuration += [
        ping[name]
        for name in (
            "heading",
            "pitch",
            "roll",
            "pressure",
            "sound_speed",
            "temperature",
            "magnetic_declination",
        )
    ]
    configuration += [1.0, 3.0, ping["transducer_depth"]]
    parts = {
        "ADCP_CFG": configuration,
        **dict(zip(("ADCP_E", "ADCP_N", "ADCP_U"), cell.T, strict=True)),
        "ADCP_STD": ping["velocity_std"],
    }
    for name, values in parts.items():
        data = [*(np.float32(number(v)) for v in values), *[np.float32(0.0)] * (58 - len(values))]
        numbers = ",".join("NaN" if math.isnan(v) else str(v) for v in data)
        message = {
            "type": "DEBUG_FLOAT_ARRAY",
            "time_usec": 0,
            "name": name,
            "array_id": 7,
            "data": "?",
        }
        text = orjson.dumps(
            {"header": {"system_id": 1, "component_id": 1, "sequence": 0}, "message": message}
        ).decode()
        yield text.replace('"?"', f"[{numbers}]").encode()
