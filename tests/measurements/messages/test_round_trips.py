"""A ping as every carrier's decoder gives it is the ping that it was, to the bit, in a telemetry log to that of float32."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.logs import open_log
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.schemas import tables_of
from tests.logs.mavlink.telemetry_samples import MAX_CELLS, write_tlog
from tests.measurements.samples import CONFIG, fix, ping, the
from tests.measurements.turned import row_of, stated
from tests.places import ROOT

PROTO = (ROOT / "replay_kit/measurements/AdcpPing.proto").read_text("utf-8")
PAGE = (ROOT / "replay_kit/logs/tables/ADCP_PING.md").read_text("utf-8")
FIELD = re.compile(r"^  (optional |repeated )?([\w.]+) (\w+) = (\d+);$", re.MULTILINE)
NUMBERS = ["heading", "pitch", "roll", "pressure", "transducer_depth", "magnetic_declination"]
SCHEMA = "replay_kit.AdcpPing"

# NaN is "unknown", as null is; infinities are no velocities
maybe = st.one_of(st.none(), st.just(0.0), st.floats(-1e6, 1e6))
positive = st.floats(1e-3, 1e4)


@st.composite
def pings(draw):
    cells = draw(st.integers(1, MAX_CELLS))
    column = st.lists(maybe, min_size=cells, max_size=cells)
    columns = [draw(column) for _ in range(draw(st.integers(2, 3)))]
    return {
        "ping": draw(st.integers(0, 2**32)),
        "coordinate_system": draw(st.sampled_from(["beam", "instrument", "ship", "earth"])),
        "reference": draw(st.sampled_from(["earth", "platform"])),
        "orientation": draw(st.sampled_from(["down", "up"])),
        "n_cells": cells,
        "cell_size": draw(positive),
        "bin0_distance": draw(positive),
        "velocity": list(map(list, zip(*columns, strict=True))),
        "velocity_std": draw(st.lists(positive, min_size=cells, max_size=cells)),
        **{name: draw(maybe) for name in NUMBERS},
        # a ROS 2 message has no way to leave it open
        "declination_applied": True,
    }


def flat(ping):
    known = {name: value for name, value in ping.items() if value is not None}
    return known | {"velocity": np.array(ping["velocity"], np.float64).ravel().tolist()}


def unset():
    """Return what a decoder gives of a protobuf message in which nothing is set."""
    none = {"optional ": None, "repeated ": []}
    plain = {"string": "", "google.protobuf.Timestamp": None}
    return {name: none.get(of, plain.get(kind, 0)) for of, kind, name, _ in FIELD.findall(PROTO)}


def as_json(folder, ping):
    return [Message(0, "/adcp", SCHEMA, ping, 0, 0)]


def as_protobuf(folder, ping):
    return as_json(folder, unset() | flat(ping))


def as_ros2(folder, ping):
    """What may be unknown is NaN, velocity flat."""
    held = dict.fromkeys(NUMBERS, np.nan) | flat(ping)
    return [Message(0, "/adcp", "replay_kit/msg/AdcpPing", held, 0, 0)]


def through_a_telemetry_log(folder, ping):
    """Return the frames in a log, last first, which share the ping's number and its time in microseconds."""
    time_us = 1_700_000_000_000_001
    write_tlog(folder / "log", [Message(time_us * 1000, "/adcp", SCHEMA, ping, 0, 0)])
    framed = [one for one in open_log(folder / "log").messages() if "data" in one.payload]
    keys = {(one.payload["array_id"], one.payload["time_usec"], one.time_ns) for one in framed}
    assert keys == {(ping["ping"] % 65536, time_us, time_us * 1000)}
    return framed[::-1]


def float32(value):
    if isinstance(value, list):
        return list(map(float32, value))
    return float(np.float32(value)) if isinstance(value, float) else value


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("carriers")


@pytest.mark.parametrize("carrier", [as_protobuf, as_ros2, through_a_telemetry_log])
@settings(max_examples=25, deadline=None, derandomize=True)
@given(ping=pings())
def test_a_ping_is_the_same_whatever_carried_it(folder, carrier, ping):
    carried = carrier(folder, ping)
    tables, pending = tables_of(raws_of(carried), CONFIG)
    (table,) = (one for one in tables if one.kind == "ping")
    assert (pending, table["messages"].tolist()) == ({}, [len(carried)])
    kept = float32 if len(carried) > 1 else lambda value: value
    sent = {name: kept(value) for name, value in ping.items()}
    found, expected = vars(row_of(table)), vars(stated(Message(0, "/adcp", SCHEMA, sent, 0, 0)))
    assert found.keys() == expected.keys()
    for name in found.keys() - {"time", "order", "messages", "layout"}:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


def test_the_fields_of_the_protobuf_file_are_those_of_the_page():
    fields = FIELD.findall(PROTO)
    assert {name for _, _, name, _ in fields} <= {*re.findall(r"[`\"](\w+)[`\"]", PAGE)}
    assert [int(number) for *_, number in fields] == list(range(1, len(fields) + 1))
    kinds = {"bool", "double", "string", "uint32", "uint64", "google.protobuf.Timestamp"}
    assert {kind for _, kind, *_ in fields} == kinds


def test_what_protobuf_does_not_set_is_unknown_and_not_zero():
    cells = {"n_cells": 1, "cell_size": 32.0, "bin0_distance": 16.0, "velocity": [0.1, 0.2]}
    words = dict.fromkeys(("coordinate_system", "reference"), "earth") | {"orientation": "down"}
    for more, depth, dive in (({}, 216.0, 1), ({"pressure": 0.0, "dive": 4}, 16.0, 4)):
        found = the(Observation, [fix(0, depth=200.0), ping(0, **(unset() | cells | words | more))])
        assert (found.depth, found.dive, found.error_std) == ([depth], dive, [0.09])
