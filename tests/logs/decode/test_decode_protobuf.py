"""The dicts of protobuf payloads, whatever the fields are called, and how large their types may be."""

import re
from functools import cache

import pytest
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.descriptor_pool import DescriptorPool
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema

from replay_kit.logs.decode.budget import BudgetError
from replay_kit.logs.decode.protobuf import protobuf_decoder

#: Words of Python, and names that the converter itself uses.
NAMES = ("class", "from", "None", "m", "v", "k", "convert_0", "HasField", "__init__", "plain")
Field = descriptor_pb2.FieldDescriptorProto


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    names=st.lists(st.sampled_from(NAMES), unique=True, min_size=1),
    value=st.integers(-(2**31), 2**31 - 1),
    repeated=st.booleans(),
)
def test_any_field_name(names, value, repeated):
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="t", syntax="proto3")
    label = Field.LABEL_REPEATED if repeated else Field.LABEL_OPTIONAL
    fields = [
        Field(name=name, number=n, label=label, type=Field.TYPE_INT32)
        for n, name in enumerate(names, start=1)
    ]
    file.message_type.add(name="M", field=fields)
    pool = DescriptorPool()
    pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("t.M"))(
        **{names[0]: [value] if repeated else value}
    )
    schema = Schema(
        id=1,
        name="t.M",
        encoding="protobuf",
        data=descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(),
    )
    empty = [] if repeated else 0
    expected = dict.fromkeys(names, empty) | {names[0]: [value] if repeated else value}
    assert protobuf_decoder(schema)(message.SerializeToString()) == expected


File = descriptor_pb2.FileDescriptorProto


def _schema(*files: File):
    return Schema(
        id=1,
        name="t.M",
        encoding="protobuf",
        data=descriptor_pb2.FileDescriptorSet(file=files).SerializeToString(),
    )


def _file(name="t.proto", **parts: object):
    return File(name=name, package="t", syntax="proto3", **parts)


def _kind(name, fields=0, of=""):
    """Return a type of so many numbers, or of lists of another type."""
    label, kind = (
        (Field.LABEL_REPEATED, Field.TYPE_MESSAGE)
        if of
        else (Field.LABEL_OPTIONAL, Field.TYPE_INT32)
    )
    many = [
        Field(name=f"a{n}", number=n, label=label, type=kind, type_name=of or None)
        for n in range(1, fields + 1)
    ]
    return descriptor_pb2.DescriptorProto(name=name, field=many)


def test_the_files_of_a_set_come_in_any_order():
    last = _file("a.proto", dependency=["b.proto", "c.proto"], message_type=[_kind("M", 1, ".t.B")])
    middle, first = (
        _file("b.proto", dependency=["c.proto"], message_type=[_kind("B", 1, ".t.C")]),
        _file("c.proto", message_type=[_kind("C", 1)]),
    )
    for files in ((last, middle, first), (first, middle, last), (middle, last, first)):
        assert protobuf_decoder(_schema(*files))(b"\x0a\x04\x0a\x02\x08\x07") == {
            "a1": [{"a1": [{"a1": 7}]}]
        }


@pytest.mark.parametrize(
    ("files", "error"),
    [
        (
            (_file(message_type=[_kind("M")]), _file(message_type=[_kind("M")])),
            "two files of the descriptor set have the same name",
        ),
        ((_file(message_type=[_kind("N")]),), "t.M"),
    ],
)
def test_a_set_that_does_not_hold_the_type_is_refused(files, error):
    with pytest.raises((ValueError, KeyError), match=re.escape(error)):
        protobuf_decoder(_schema(*files))


def _enumeration(name):
    return descriptor_pb2.EnumDescriptorProto(
        name=name, value=[descriptor_pb2.EnumValueDescriptorProto(name=name.lower(), number=0)]
    )


_Kind = descriptor_pb2.DescriptorProto
_NAMES = [f"B{k:x}" for k in range(20_000)]


@cache
def _types():
    return [_kind(name) for name in _NAMES]


@cache
def _enumerations():
    return list(map(_enumeration, _NAMES))


# each took hundreds of times its length in memory
@pytest.mark.parametrize(
    "made",
    [
        lambda: _file(message_type=[_kind("M"), *_types()]),
        lambda: _file(
            message_type=[
                descriptor_pb2.DescriptorProto(
                    name="M",
                    nested_type=[descriptor_pb2.DescriptorProto(name="N", nested_type=_types())],
                )
            ]
        ),
        lambda: _file(
            message_type=[_kind("M")],
            service=[descriptor_pb2.ServiceDescriptorProto(name=name) for name in _NAMES],
        ),
        lambda: _file(message_type=[_Kind(name="M", enum_type=_enumerations())]),
    ],
    ids=["types", "nested twice", "services", "nested enumerations"],
)
def test_a_set_of_types_that_hold_nothing_is_refused(made):
    with pytest.raises(
        BudgetError, match="more types than 2048, or than one in 16 bytes of the descriptor set"
    ):
        protobuf_decoder(_schema(made()))
