"""The budget of a message: what claims much is refused before it is made, what is large and true is read."""

import struct

import orjson
import pytest
from google.protobuf import descriptor_pb2
from mcap.records import Schema

from replay_kit.logs.decode.budget import (
    FREE,
    MOST_BYTES,
    MOST_SCHEMA,
    MOST_VALUES,
    PER_BYTE,
    Budget,
    BudgetError,
)
from replay_kit.logs.decode.decoders import channel_decoder, decode_json
from replay_kit.logs.decode.protobuf import Cost, pay

SEPARATOR = "\n" + "=" * 80 + "\n"


def decoder(encoding, schema):
    found = channel_decoder(
        encoding, Schema(id=1, name=schema[0], encoding=schema[1], data=schema[2])
    )
    assert callable(found), found
    return found


def ros1(text):
    return decoder("ros1", ("p/A", "ros1msg", text.encode()))


def ros2(text):
    return decoder("cdr", ("p/msg/A", "ros2msg", text.encode()))


def test_a_budget_is_sixteen_values_a_byte_and_half_a_million_in_all():
    assert (PER_BYTE, MOST_VALUES, MOST_BYTES) == (16, 524_288, 16_777_216)
    for size, allowed in ((0, FREE), (10, FREE + 10 * PER_BYTE), (MOST_BYTES, MOST_VALUES)):
        Budget(size).spend(allowed)
        with pytest.raises(BudgetError, match="more values than a message may hold"):
            Budget(size).spend(allowed + 1)
    with pytest.raises(
        BudgetError, match="a message: 16777217 bytes, more than the 16777216 that are read"
    ):
        Budget(MOST_BYTES + 1)


# each claims from ten million to 10^16 values in a few bytes
@pytest.mark.parametrize(
    ("read", "payload"),
    [
        (ros1(f"E[] many{SEPARATOR}MSG: p/E\n"), struct.pack("<I", 2**31)),
        (ros1(f"B[99999] b{SEPARATOR}MSG: p/B\nE[99999] c{SEPARATOR}MSG: p/E\n"), b""),
        (ros1("string[] many"), struct.pack("<I", 10**7) + bytes(10**7)),
        (ros1("bool[] many"), struct.pack("<I", 10**7) + bytes(10**7)),
        (ros1("time[] many"), struct.pack("<I", 10**6) + bytes(8 * 10**5)),
        (ros2("float64[2000000000] many"), b"\0\1\0\0"),
        (
            ros2(f"E[] many{SEPARATOR}MSG: p/E\nbool flag"),
            b"\0\1\0\0" + struct.pack("<I", 10**7) + bytes(10**7),
        ),
        (
            ros2(f"E[] many{SEPARATOR}MSG: p/E\n"),
            b"\0\1\0\0" + struct.pack("<I", 10**7) + bytes(10**7),
        ),
        (decode_json, b'{"a":[' + b"[]," * 2**20 + b"[]]}"),
        (decode_json, b'{"a":[' + b"{}," * 2**18 + b"{}]}"),
        (decode_json, b'{"a":[' + b"1," * 2**20 + b"1]}"),
    ],
)
def test_a_message_that_claims_much_is_refused(read, payload):
    with pytest.raises(BudgetError, match="more values than a message may hold"):
        read(payload)


def test_large_messages_within_the_budget_are_read():
    numbers = struct.pack("<400000d", *range(400_000))
    assert len(ros1("float64[] many")(struct.pack("<I", 400_000) + numbers)["many"]) == 400_000
    assert ros1("uint8[] image")(struct.pack("<I", 10**7) + bytes(10**7))["image"] == bytes(10**7)
    assert len(decode_json(orjson.dumps({"a": list(range(400_000))}))["a"]) == 400_000
    assert len(decode_json(orjson.dumps({"a": "x" * 10**7}))["a"]) == 10**7


def tree():
    """The decoder of a type with a list of its own type, one of numbers and ten more fields."""
    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="p", syntax="proto3")
    node = file.message_type.add(name="A")
    node.field.add(
        name="many", number=1, type=kind.TYPE_MESSAGE, type_name=".p.A", label=kind.LABEL_REPEATED
    )
    node.field.add(name="flags", number=2, type=kind.TYPE_BOOL, label=kind.LABEL_REPEATED)
    node.field.add(name="sizes", number=3, type=kind.TYPE_DOUBLE, label=kind.LABEL_REPEATED)
    node.field.add(name="image", number=4, type=kind.TYPE_BYTES, label=kind.LABEL_OPTIONAL)
    for number in range(5, 12):
        node.field.add(
            name=f"x{number}", number=number, type=kind.TYPE_DOUBLE, label=kind.LABEL_OPTIONAL
        )
    return decoder(
        "protobuf",
        ("p.A", "protobuf", descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()),
    )


def varint(value):
    return (
        bytes([value & 0x7F]) if value < 0x80 else bytes([value & 0x7F | 0x80]) + varint(value >> 7)
    )


@pytest.mark.parametrize(
    "payload", [b"\x0a\x00" * 10**6, b"\x12" + varint(2 * 10**6) + bytes(2 * 10**6)]
)
def test_a_protobuf_message_that_claims_much_is_refused(payload):
    with pytest.raises(BudgetError, match="more values than a message may hold"):
        tree()(payload)


def test_large_protobuf_messages_within_the_budget_are_read():
    assert len(tree()(b"\x0a\x00" * 30_000)["many"]) == 30_000
    assert len(tree()(b"\x1a" + varint(3_200_000) + bytes(3_200_000))["sizes"]) == 400_000
    assert len(tree()(b"\x22" + varint(10**7) + bytes(10**7))["image"]) == 10**7


def test_protobuf_messages_that_contain_themselves_too_deeply_are_refused():
    node = Cost(7, {})
    node.parts[1] = node
    payload = b""
    for _ in range(100):
        payload = b"\x0a" + varint(len(payload)) + payload
    pay(node, payload, Budget(10**6))
    with pytest.raises(ValueError, match="more than 100 deep"):
        pay(node, b"\x0a" + varint(len(payload)) + payload, Budget(10**6))


@pytest.mark.parametrize(
    ("encoding", "schema"),
    [("cdr", "ros2msg"), ("ros1", "ros1msg"), ("protobuf", "protobuf")],
)
def test_a_schema_larger_than_any_in_use_is_not_parsed(encoding, schema):
    reason = channel_decoder(
        encoding, Schema(id=1, name="p/A", encoding=schema, data=b"\n" * (MOST_SCHEMA + 1))
    )
    assert isinstance(reason, str)
    assert f"{MOST_SCHEMA + 1} bytes, more than the {MOST_SCHEMA} that are read" in reason
    assert callable(
        channel_decoder(
            "ros1", Schema(id=1, name="p/A", encoding="ros1msg", data=b"\n" * MOST_SCHEMA)
        )
    )


def test_json_with_a_text_that_does_not_end_takes_time_in_proportion_to_its_length():
    with pytest.raises(ValueError, match="Unterminated"):
        decode_json(b'{"a":NaN,"b":' + b'"\\' * 10**6)
