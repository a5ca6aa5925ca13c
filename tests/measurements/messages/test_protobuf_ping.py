"""``AdcpPing.proto`` through a real MCAP: what it can say, and that what it does not say is not zero."""

import math
import re
from pathlib import Path

from google.protobuf import descriptor_pb2, message_factory, timestamp_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from numpy.testing import assert_allclose, assert_array_equal

import replay_kit.measurements
from replay_kit.config.run import LogConfig
from replay_kit.core.observation import Flag, Observation
from replay_kit.logs import open_log
from replay_kit.logs.decode.to_json import JSON_SCHEMAS
from tests.logs.log_samples import one_channel_mcap
from tests.measurements.samples import fix, only, ping, run, the

PROTO = (
    Path(replay_kit.measurements.__file__).with_name("AdcpPing.proto").read_text(encoding="utf-8")
)
FIELD = re.compile(r"^  (optional |repeated )?([\w.]+) (\w+) = (\d+);$", re.MULTILINE)
KIND = descriptor_pb2.FieldDescriptorProto
TYPES = {
    "double": KIND.TYPE_DOUBLE,
    "string": KIND.TYPE_STRING,
    "bool": KIND.TYPE_BOOL,
    "uint32": KIND.TYPE_UINT32,
    "uint64": KIND.TYPE_UINT64,
}


def descriptors() -> descriptor_pb2.FileDescriptorSet:
    """Return what a protobuf compiler makes of the file's fields, with the file it imports."""
    file = descriptor_pb2.FileDescriptorProto(
        name="AdcpPing.proto", package="replay_kit", syntax="proto3"
    )
    file.dependency.append("google/protobuf/timestamp.proto")
    message = file.message_type.add(name="AdcpPing")
    for label, kind, name, number in FIELD.findall(PROTO):
        field = message.field.add(
            name=name,
            number=int(number),
            label=KIND.LABEL_REPEATED if label == "repeated " else KIND.LABEL_OPTIONAL,
        )
        if kind in TYPES:
            field.type = TYPES[kind]
        else:
            field.type, field.type_name = KIND.TYPE_MESSAGE, f".{kind}"
        if label == "optional ":
            field.proto3_optional, field.oneof_index = True, len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{name}")
    timestamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(timestamp)
    return descriptor_pb2.FileDescriptorSet(file=[timestamp, file])


def through_mcap(folder: Path, **fields):
    """Return the ping, written with the fields given and read back."""
    files, pool = descriptors(), DescriptorPool()
    for file in files.file:
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("replay_kit.AdcpPing"))(
        **fields
    )
    schema = ("replay_kit.AdcpPing", "protobuf", files.SerializeToString())
    (folder / "pings.mcap").write_bytes(
        one_channel_mcap("protobuf", schema, [message.SerializeToString()])
    )
    reader = open_log(folder / "pings.mcap", 0, LogConfig())
    (read,) = reader.messages()
    assert reader.report().undecodable == {}
    return read


STATED = {
    **{
        key: ping().payload[key]
        for key in (
            "coordinate_system",
            "reference",
            "orientation",
            "n_cells",
            "cell_size",
            "bin0_distance",
        )
    },
    "velocity": [0.1, 0.2, math.nan, 0.3, math.nan, 0.0, 0.5, 0.6, 0.0],
    "velocity_std": [0.09, 0.08, 0.07],
}


def test_the_file_is_one_message_of_its_name():
    assert 'syntax = "proto3";' in PROTO
    assert "package replay_kit;" in PROTO
    body = PROTO[
        PROTO.index("message AdcpPing {") + len("message AdcpPing {\n") : PROTO.rindex("}")
    ]
    lines = [line for line in body.splitlines() if not line.strip().startswith("//")]
    assert len(lines) == len(FIELD.findall(PROTO))
    numbers = [int(number) for *_, number in FIELD.findall(PROTO)]
    assert numbers == list(range(1, len(numbers) + 1))


def test_the_fields_are_those_of_the_json_schema():
    names = [name for _, _, name, _ in FIELD.findall(PROTO)]
    # the motion of the bottom and of the platform are objects in JSON, which the file does not carry
    assert set(names) == set(JSON_SCHEMAS["replay_kit.AdcpPing"]["properties"]) - {
        "bottom_track",
        "platform_velocity",
    }
    assert {field.name for field in descriptors().file[1].message_type[0].field} == set(names)


def test_a_ping_of_two_components_says_in_protobuf_what_it_says_in_json(tmp_path):
    two = {**STATED, "velocity": [0.1, 0.2, 0.3, math.nan, 0.5, 0.6]}
    message = through_mcap(tmp_path, **two, pressure=0.0, dive=4, transducer_depth=1.0)
    ours = the(Observation, [fix(0), message])
    cells = [[0.1, 0.2, None], [0.3, None, 0.0], [0.5, 0.6, 0.0]]
    theirs = the(
        Observation,
        [
            fix(0),
            ping(0, velocity=cells, velocity_std=[0.09, 0.08, 0.07], transducer_depth=1.0, dive=4),
        ],
    )
    for name in ("depth", "velocity", "error_std", "flags", "reasons"):
        assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert ours.dive == theirs.dive == 4


def test_what_is_not_set_is_unknown_and_not_zero(tmp_path):
    message = through_mcap(
        tmp_path, **{key: value for key, value in STATED.items() if key != "velocity_std"}
    )
    assert message.payload["pressure"] is None
    observation = the(Observation, [fix(0, depth=200.0), message])
    assert_allclose(observation.depth, [216.0, 248.0, 280.0])
    assert_array_equal(observation.error_std, 0.09)
    assert observation.dive == 1
    assert observation.flags.tolist() == [Flag.GOOD, Flag.MISSING, Flag.GOOD]


def test_the_surface_can_be_stated(tmp_path):
    observation = the(
        Observation, [fix(0, depth=200.0), through_mcap(tmp_path, **STATED, pressure=0.0)]
    )
    assert observation.depth[0] == 16.0


def test_an_empty_ping_is_refused(tmp_path):
    assert not only(Observation, run([fix(0), through_mcap(tmp_path)]))
