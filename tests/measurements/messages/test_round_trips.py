"""A ping through every carrier is the ping that it was, in JSON, protobuf and CDR to the bit, in a telemetry log to that of float32."""

import re

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, message_factory, timestamp_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.logs import open_log
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.schemas import tables_of
from tests.logs.log_samples import one_channel_mcap
from tests.logs.mavlink.telemetry_samples import MAX_CELLS, write_tlog
from tests.measurements.carriers import json_mcap, read_mcap, ros2_mcap
from tests.measurements.samples import CONFIG, fix, only, run
from tests.measurements.turned import row_of, stated
from tests.places import ROOT

PROTO = (ROOT / "replay_kit/measurements/AdcpPing.proto").read_text("utf-8")
PAGE = (ROOT / "replay_kit/logs/tables/ADCP_PING.md").read_text("utf-8")
FIELD = re.compile(r"^  (optional |repeated )?([\w.]+) (\w+) = (\d+);$", re.MULTILINE)
KIND = descriptor_pb2.FieldDescriptorProto
NUMBERS = ["heading", "pitch", "roll", "pressure", "transducer_depth", "magnetic_declination"]
SCHEMA = "replay_kit.AdcpPing"

# our own ping as a ROS 2 message: what may be unknown is NaN, velocity flat
ADCP_PING = """builtin_interfaces/Time stamp
string frame_id
uint64 ping
string coordinate_system
string reference
string orientation
bool bin_mapped
uint32 n_cells
float64 cell_size
float64 bin0_distance
float64 transducer_depth
float64[] velocity
float64[] velocity_std
float64 sound_speed
float64 temperature
float64 pressure
float64 heading
float64 pitch
float64 roll
float64 magnetic_declination
bool declination_applied"""

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


def descriptors():
    """Return what a protobuf compiler makes of the file's fields, with the file it imports."""
    file = descriptor_pb2.FileDescriptorProto(
        name="AdcpPing.proto", package="replay_kit", syntax="proto3"
    )
    file.dependency.append("google/protobuf/timestamp.proto")
    message = file.message_type.add(name="AdcpPing")
    for label, kind, name, number in FIELD.findall(PROTO):
        repeated = KIND.LABEL_REPEATED if label == "repeated " else KIND.LABEL_OPTIONAL
        field = message.field.add(name=name, number=int(number), label=repeated)
        if "." in kind:
            field.type, field.type_name = KIND.TYPE_MESSAGE, f".{kind}"
        else:
            field.type = getattr(KIND, f"TYPE_{kind.upper()}")
        if label == "optional ":
            field.proto3_optional, field.oneof_index = True, len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{name}")
    timestamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(timestamp)
    return descriptor_pb2.FileDescriptorSet(file=[timestamp, file])


def flat(ping):
    known = {name: value for name, value in ping.items() if value is not None}
    return known | {"velocity": np.array(ping["velocity"], np.float64).ravel().tolist()}


def through_protobuf(folder, ping):
    files, pool = descriptors(), DescriptorPool()
    for file in files.file:
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(SCHEMA))(**flat(ping))
    schema = (SCHEMA, "protobuf", files.SerializeToString())
    return read_mcap(folder, one_channel_mcap("protobuf", schema, [message.SerializeToString()]))


def through_json(folder, ping):
    return read_mcap(folder, json_mcap([(0, "/adcp", SCHEMA, ping)]))


def through_cdr(folder, ping):
    unknown = {name: np.nan for name in NUMBERS if ping[name] is None}
    values = [flat(ping) | unknown]
    return read_mcap(folder, ros2_mcap("replay_kit/msg/AdcpPing", ADCP_PING, values, "/adcp"))


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


@pytest.mark.parametrize(
    "carrier", [through_json, through_protobuf, through_cdr, through_a_telemetry_log]
)
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
    names = [name for _, _, name, _ in FIELD.findall(PROTO)]
    assert {*names} <= {*re.findall(r"[`\"](\w+)[`\"]", PAGE)}
    (message,) = descriptors().file[1].message_type
    assert [field.number for field in message.field] == list(range(1, len(names) + 1))


def test_what_protobuf_does_not_set_is_unknown_and_not_zero(tmp_path):
    cells = {"n_cells": 1, "cell_size": 32.0, "bin0_distance": 16.0, "velocity": [[0.1, 0.2]]}
    words = dict.fromkeys(("coordinate_system", "reference"), "earth") | {"orientation": "down"}
    for more, depth, dive in (({}, 216.0, 1), ({"pressure": 0.0, "dive": 4}, 16.0, 4)):
        message = through_protobuf(tmp_path, cells | words | more)
        (found,) = only(Observation, run([fix(0, depth=200.0), *message]))
        assert (found.depth, found.dive, found.error_std) == ([depth], dive, [0.09])
