"""The dicts of protobuf payloads, whatever the fields are called, and how large their types may be."""

import pytest
from google.protobuf import descriptor_pb2, message_factory, timestamp_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema

from replay_kit.logs.decode.protobuf import BudgetError, protobuf_decoder

#: Words of Python, and names that the converter itself uses.
NAMES = ("class", "from", "None", "m", "v", "k", "convert_0", "HasField", "__init__", "plain")
Field = descriptor_pb2.FieldDescriptorProto
Kind = descriptor_pb2.DescriptorProto


def _file(*kinds, name="t.proto", **parts):
    return descriptor_pb2.FileDescriptorProto(
        name=name, package="t", syntax="proto3", message_type=kinds, **parts
    )


def _decoder(*files):
    data = descriptor_pb2.FileDescriptorSet(file=files).SerializeToString()
    return protobuf_decoder(Schema(id=1, name="t.M", encoding="protobuf", data=data))


def _kind(name, *fields, of="", repeated=False):
    """Return a type of some numbers, or of lists of another type."""
    label = Field.LABEL_REPEATED if of or repeated else Field.LABEL_OPTIONAL
    about = {"label": label, "type_name": of or None}
    about["type"] = Field.TYPE_MESSAGE if of else Field.TYPE_INT32
    held = [Field(name=each, number=n, **about) for n, each in enumerate(fields, 1)]
    return Kind(name=name, field=held)


#: Of a kind: what is not set, and what may be.
VALUES = {
    Field.TYPE_DOUBLE: (0.0, st.floats(allow_nan=False)),
    Field.TYPE_INT32: (0, st.integers(-(2**31), 2**31 - 1)),
    Field.TYPE_STRING: ("", st.text(max_size=5)),
    Field.TYPE_BYTES: (b"", st.binary(max_size=5)),
    Field.TYPE_BOOL: (False, st.booleans()),
}


@st.composite
def messages(draw):
    """Draw a type with fields of any kind, of itself and of maps to itself, a message of it, and what it holds."""
    times = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(times)
    file, pool = _file(_kind("M"), dependency=[times.name]), DescriptorPool()
    (kind,) = file.message_type
    entry = kind.nested_type.add(name="NamedEntry", options={"map_entry": True})
    # once, many, maybe
    part = Field.TYPE_MESSAGE
    labels = [Field.LABEL_OPTIONAL, Field.LABEL_REPEATED, Field.LABEL_OPTIONAL]
    for name in draw(st.lists(st.sampled_from(NAMES), unique=True, min_size=1)):
        of, how = draw(st.sampled_from([*VALUES, part, part])), draw(st.integers(0, 2))
        field = kind.field.add(name=name, number=len(kind.field) + 1, type=of, label=labels[how])
        if of == part:
            field.type_name = draw(st.sampled_from([".t.M", ".google.protobuf.Timestamp"]))
        elif how == 2:
            field.proto3_optional, field.oneof_index = True, len(kind.oneof_decl)
            kind.oneof_decl.add(name=f"_{name}")
    kind.field.add(name="named", number=99, label=labels[1], type=part, type_name=".t.M.NamedEntry")
    entry.field.add(name="key", number=1, label=labels[0], type=Field.TYPE_STRING)
    entry.field.add(name="value", number=2, label=labels[0], type=part, type_name=".t.M")
    pool.Add(times)
    pool.Add(file)
    make = message_factory.GetMessageClass(pool.FindMessageTypeByName("t.M"))

    def one(field, depth):
        if field.type != part:
            return [draw(VALUES[field.type][1])] * 2
        if field.type_name == ".t.M":
            return made(depth + 1)
        seconds, nanos = draw(st.integers(0, 2**40)), draw(st.integers(0, 10**9))
        return {"seconds": seconds, "nanos": nanos}, {"sec": seconds, "nsec": nanos}

    def made(depth):
        held, plain = {}, {"named": {}}
        for field in kind.field[:-1]:
            own, many = field.type == part, field.label == Field.LABEL_REPEATED
            some = range(2 if draw(st.booleans()) and not (own and depth > 1) else 0)
            values = [one(field, depth) for _ in some]
            none = None if own or field.proto3_optional else VALUES[field.type][0]
            plain[field.name] = [each[1] for each in values] if many else none
            if values:
                held[field.name] = [each[0] for each in values] if many else values[0][0]
                plain[field.name] = plain[field.name] if many else values[0][1]
        message = make(**held)
        for key in "ab" if depth == 0 and draw(st.booleans()) else "":
            other, plain["named"][key] = made(1)
            message.named[key].CopyFrom(other)
        return message, plain

    return (times, file), *made(0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(messages())
def test_any_message_is_what_it_holds(drawn):
    files, message, plain = drawn
    decode = _decoder(*files)
    assert decode(message.SerializeToString()) == plain
    with pytest.raises(DecodeError):
        decode(b"\xff")


def test_the_files_of_a_set_come_in_any_order():
    last = _file(_kind("M", "b", of=".t.B"), name="a.proto", dependency=["b.proto", "c.proto"])
    middle = _file(_kind("B", "c", of=".t.C"), name="b.proto", dependency=["c.proto"])
    first = _file(_kind("C", "x"), name="c.proto")
    for files in ((last, middle, first), (first, middle, last), (middle, last, first)):
        found = _decoder(*files)(b"\x0a\x04\x0a\x02\x08\x07")
        assert found == {"b": [{"c": [{"x": 7}]}]}


@pytest.mark.parametrize(
    ("files", "error"),
    [
        ([_file(_kind("M"))] * 2, "two files of the descriptor set have the same name"),
        ([_file(_kind("N"))], r"t\.M"),
    ],
)
def test_a_set_that_does_not_hold_the_type_is_refused(files, error):
    with pytest.raises((ValueError, KeyError), match=error):
        _decoder(*files)


def _many(make):
    return [make(name=f"B{k:x}") for k in range(20_000)]


def _enumeration(name):
    value = descriptor_pb2.EnumValueDescriptorProto(name=name.lower(), number=0)
    return descriptor_pb2.EnumDescriptorProto(name=name, value=[value])


# each took hundreds of times its length in memory
@pytest.mark.parametrize(
    "made",
    [
        lambda: _file(_kind("M"), *_many(Kind)),
        lambda: _file(Kind(name="M", nested_type=[Kind(name="N", nested_type=_many(Kind))])),
        lambda: _file(_kind("M"), service=_many(descriptor_pb2.ServiceDescriptorProto)),
        lambda: _file(Kind(name="M", enum_type=_many(_enumeration))),
    ],
    ids=["types", "nested twice", "services", "nested enumerations"],
)
def test_a_set_of_types_that_hold_nothing_is_refused(made):
    with pytest.raises(BudgetError, match="more types than 2048, or than one in 16 bytes of the"):
        _decoder(made())
