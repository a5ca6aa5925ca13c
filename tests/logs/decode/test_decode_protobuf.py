"""The dicts of protobuf payloads, whatever the fields are called, and how large their types may be."""

import pytest
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.descriptor_pool import DescriptorPool
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


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    names=st.lists(st.sampled_from(NAMES), unique=True, min_size=1),
    value=st.integers(-(2**31), 2**31 - 1),
    repeated=st.booleans(),
)
def test_any_field_name(names, value, repeated):
    file, pool = _file(_kind("M", *names, repeated=repeated)), DescriptorPool()
    pool.Add(file)
    held = {names[0]: [value] if repeated else value}
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("t.M"))(**held)
    expected = dict.fromkeys(names, [] if repeated else 0) | held
    assert _decoder(file)(message.SerializeToString()) == expected


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
