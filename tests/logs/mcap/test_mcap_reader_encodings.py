"""MCAP encodings: JSON and protobuf payloads as plain dicts; what fits no decoder is counted with a reason."""

import math

import pytest
from foxglove import messages as foxglove_messages
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.descriptor_pool import DescriptorPool

from replay_kit.config.run import LogConfig
from replay_kit.logs.decode.decoders import decode_json
from tests.logs.log_samples import one_channel_mcap
from tests.logs.log_samples import read_log as read


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"a": NaN, "b": inf, "c": -inf}', {"a": math.nan, "b": math.inf, "c": -math.inf}),
        (
            '{"a": nan, "b": Infinity, "c": -Infinity}',
            {"a": math.nan, "b": math.inf, "c": -math.inf},
        ),
        (
            '{"a": NaN, "b": "say \\" inf NaN", "c": [inf]}',
            {"a": math.nan, "b": 'say " inf NaN', "c": [math.inf]},
        ),
    ],
)
def test_bare_numbers_of_json(text, expected):
    assert repr(decode_json(text.encode())) == repr(expected)


@pytest.mark.parametrize(
    "data", [b"", b"[1]", b"7", b"{", b'{"a": infinite}', b"\xff\xfe", b"[" * 100_000]
)
def test_no_json_object(tmp_path, data):
    messages, report = read(
        tmp_path, one_channel_mcap("json", None, [b'{"ok": 1}', data, b'{"ok": 2}'])
    )
    assert [m.payload["ok"] for m in messages] == [1, 2]
    assert report.read == {"/x": 3}
    assert report.undecodable["/x"][0] == 1


def test_foxglove_protobuf(tmp_path):
    fix = foxglove_messages.LocationFix(
        timestamp=foxglove_messages.Timestamp(1_700_000_000, 5),
        latitude=47.5,
        longitude=-23.25,
        altitude=-1.0,
        position_covariance=[1.0] * 9,
        position_covariance_type=foxglove_messages.LocationFixPositionCovarianceType.Known,
    )
    schema = foxglove_messages.LocationFix.get_schema()
    empty = foxglove_messages.LocationFix().encode()
    messages, report = read(
        tmp_path,
        one_channel_mcap(
            "protobuf", (schema.name, schema.encoding, schema.data), [fix.encode(), empty]
        ),
    )
    assert report.undecodable == {}
    full, unset = (m.payload for m in messages)
    assert messages[0].schema == "foxglove.LocationFix"
    assert full["timestamp"] == {"sec": 1_700_000_000, "nsec": 5}
    assert (full["latitude"], full["longitude"], full["altitude"]) == (47.5, -23.25, -1.0)
    assert full["position_covariance"] == [1.0] * 9
    assert full["position_covariance_type"] == 3
    assert unset["latitude"] == 0.0
    assert unset["frame_id"] == ""
    assert unset["timestamp"] is None
    assert list(unset) == list(full)


def test_protobuf_nested_maps_oneofs_and_recursion(tmp_path):
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="t", syntax="proto3")
    node = file.message_type.add(name="Node")
    kind = descriptor_pb2.FieldDescriptorProto
    entry = node.nested_type.add(name="NamedEntry")
    entry.options.map_entry = True

    def field(
        message, name, number, of="", label=kind.LABEL_OPTIONAL, type=kind.TYPE_DOUBLE, **more
    ):
        if of:
            type = kind.TYPE_MESSAGE
        message.field.add(
            name=name, number=number, type=type, type_name=of or None, label=label, **more
        )

    field(entry, "key", 1, type=kind.TYPE_STRING)
    field(entry, "value", 2, ".t.Node")
    field(node, "named", 1, ".t.Node.NamedEntry", kind.LABEL_REPEATED)
    field(node, "children", 2, ".t.Node", kind.LABEL_REPEATED)
    field(node, "value", 3)
    node.oneof_decl.add(name="_depth")
    field(node, "depth", 4, proto3_optional=True, oneof_index=0)
    pool = DescriptorPool()
    pool.Add(file)
    tree = message_factory.GetMessageClass(pool.FindMessageTypeByName("t.Node"))()
    tree.children.add(value=2.0).children.add(depth=0.0)
    tree.named["a"].value = math.inf
    data = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    messages, report = read(
        tmp_path,
        one_channel_mcap(
            "protobuf", ("t.Node", "protobuf", data), [tree.SerializeToString(), b"\xff"]
        ),
    )
    leaf = {"named": {}, "children": [], "value": 0.0, "depth": None}
    child = {**leaf, "value": 2.0, "children": [{**leaf, "depth": 0.0}]}
    assert [m.payload for m in messages] == [
        {**leaf, "children": [child], "named": {"a": {**leaf, "value": math.inf}}}
    ]
    assert report.undecodable["/x"][0] == 1


@pytest.mark.parametrize(
    ("encoding", "schema", "reason"),
    [
        ("cbor", None, "has none"),
        ("wrong_format", ("a/msg/B", "ros2msg", b"float64 x"), "not known"),
        ("cdr", ("a/msg/B", "ros2msg", b"float64 x\n---\nfloat64 y"), "cannot be parsed"),
        ("cdr", ("a/msg/B", "ros2msg", b"missing_msgs/Thing x"), "definition not found"),
        ("cdr", ("a/msg/B", "ros2msg", b"\xff"), "cannot be parsed"),
        ("protobuf", ("a.B", "protobuf", b"not a descriptor"), "cannot be parsed"),
        ("cdr", ("a/msg/B", "ros2idl", b"module a { };"), "record in ros2msg"),
        ("protobuf", ("a.B", "protobuf", b""), "cannot be parsed"),
    ],
)
def test_the_reason_is_kept_and_nothing_printed(
    tmp_path,
    capsys,
    encoding,
    schema,
    reason,
):
    data = one_channel_mcap(encoding, schema, [b"\0\1\0\0" + bytes(8)] * 2)
    messages, report = read(tmp_path, data, LogConfig(remap={"/x": "/y"}))
    assert messages == []
    ((topic, (count, why)),) = report.undecodable.items()
    assert (topic, count) == ("/y", 2)
    assert reason in why
    assert capsys.readouterr() == ("", "")
