"""The budget of a message: what claims much is refused before it is made, what is large and true is read."""

import struct

import orjson
import pytest
from google.protobuf import descriptor_pb2
from mcap.records import Schema

from replay_kit.logs.decode.decoders import channel_decoder, decode_json
from replay_kit.logs.decode.protobuf import Budget, BudgetError, Cost, pay

MOST_SCHEMA = 1 << 18
SEPARATOR = "\n" + "=" * 80 + "\n"


def decoder(encoding, schema_encoding, data, name="p/A"):
    schema = Schema(id=1, name=name, encoding=schema_encoding, data=data)
    return channel_decoder(encoding, schema)


def ros1(text):
    return decoder("ros1", "ros1msg", text.encode())


def ros2(text):
    return decoder("cdr", "ros2msg", text.encode(), "p/msg/A")


def tree():
    """The decoder of a type with a list of its own type, of flags and of numbers, with bytes and more numbers."""
    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="p", syntax="proto3")
    many = [kind.TYPE_MESSAGE, kind.TYPE_BOOL, kind.TYPE_DOUBLE]
    once = [kind.TYPE_BYTES] + 7 * [kind.TYPE_DOUBLE]
    node = file.message_type.add(name="A")
    for number, of in enumerate(many + once, 1):
        label = kind.LABEL_REPEATED if number <= len(many) else kind.LABEL_OPTIONAL
        own = ".p.A" if of == kind.TYPE_MESSAGE else None
        node.field.add(name=f"x{number}", number=number, type=of, type_name=own, label=label)
    data = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    return decoder("protobuf", "protobuf", data, "p.A")


def varint(value):
    return (
        bytes([value & 0x7F]) if value < 0x80 else bytes([value & 0x7F | 0x80]) + varint(value >> 7)
    )


def counted(count, size=1):
    """A count, and as many zeros."""
    return struct.pack("<I", count) + bytes(count * size)


def test_a_budget_is_sixteen_values_a_byte_and_half_a_million_in_all():
    for size, allowed in ((0, 1024), (10, 1184), (1 << 24, 524_288)):
        Budget(size).spend(allowed)
        with pytest.raises(BudgetError, match="more values than a message may hold"):
            Budget(size).spend(allowed + 1)
    with pytest.raises(BudgetError, match="16777217 bytes, more than the 16777216 that are read"):
        Budget((1 << 24) + 1)


NOTHING = f"E[] many{SEPARATOR}MSG: p/E\n"
ORDER = b"\0\1\0\0"


# each claims from ten million to 10^16 values in a few bytes
@pytest.mark.parametrize(
    ("read", "payload"),
    [
        (ros1(NOTHING), struct.pack("<I", 2**31)),
        (ros1(f"B[99999] b{SEPARATOR}MSG: p/B\nE[99999] c{SEPARATOR}MSG: p/E\n"), b""),
        (ros1("string[] many"), counted(10**7)),
        (ros1("bool[] many"), counted(10**7)),
        (ros1("time[] many"), struct.pack("<I", 10**6) + bytes(8 * 10**5)),
        (ros2("float64[2000000000] many"), ORDER),
        (ros2(f"{NOTHING}bool flag"), ORDER + counted(10**7)),
        (ros2(NOTHING), ORDER + counted(10**7)),
        (decode_json, b'{"a":[' + b"[]," * 2**20 + b"[]]}"),
        (decode_json, b'{"a":[' + b"{}," * 2**18 + b"{}]}"),
        (decode_json, b'{"a":[' + b"1," * 2**20 + b"1]}"),
        (tree(), b"\x0a\x00" * 10**6),
        (tree(), b"\x12" + varint(2 * 10**6) + bytes(2 * 10**6)),
    ],
)
def test_a_message_that_claims_much_is_refused(read, payload):
    with pytest.raises(BudgetError, match="more values than a message may hold"):
        read(payload)


@pytest.mark.parametrize(
    ("read", "payload", "name", "count"),
    [
        (ros1("float64[] many"), counted(400_000, 8), "many", 400_000),
        (ros1("uint8[] image"), counted(10**7), "image", 10**7),
        (decode_json, orjson.dumps({"a": list(range(400_000))}), "a", 400_000),
        (decode_json, orjson.dumps({"a": "x" * 10**7}), "a", 10**7),
        (tree(), b"\x0a\x00" * 30_000, "x1", 30_000),
        (tree(), b"\x1a" + varint(3_200_000) + bytes(3_200_000), "x3", 400_000),
        (tree(), b"\x22" + varint(10**7) + bytes(10**7), "x4", 10**7),
    ],
)
def test_large_messages_within_the_budget_are_read(read, payload, name, count):
    assert len(read(payload)[name]) == count


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
    ("encoding", "schema"), [("cdr", "ros2msg"), ("ros1", "ros1msg"), ("protobuf", "protobuf")]
)
def test_a_schema_larger_than_any_in_use_is_not_parsed(encoding, schema):
    reason = decoder(encoding, schema, b"\n" * (MOST_SCHEMA + 1))
    assert f"{MOST_SCHEMA + 1} bytes, more than the {MOST_SCHEMA} that are read" in reason
    assert callable(ros1("\n" * MOST_SCHEMA))


def test_json_with_a_text_that_does_not_end_takes_time_in_proportion_to_its_length():
    with pytest.raises(ValueError, match="Unterminated"):
        decode_json(b'{"a":NaN,"b":' + b'"\\' * 10**6)
