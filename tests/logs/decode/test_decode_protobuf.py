"""The dicts of protobuf payloads, whatever the fields are called."""

from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.descriptor_pool import DescriptorPool
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema

from replay_kit.logs.decode.protobuf import protobuf_decoder

#: Words of Python, and names that the converter itself uses.
NAMES = ("class", "from", "None", "m", "v", "k", "convert_0", "HasField", "__init__", "plain")
Field = descriptor_pb2.FieldDescriptorProto


@settings(max_examples=40, deadline=None, derandomize=True)
@given(names=st.lists(st.sampled_from(NAMES), unique=True, min_size=1), value=st.integers(-(2**31), 2**31 - 1), repeated=st.booleans())
def test_any_field_name(names: list[str], value: int, repeated: bool) -> None:
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="t", syntax="proto3")
    label = Field.LABEL_REPEATED if repeated else Field.LABEL_OPTIONAL
    fields = [Field(name=name, number=n, label=label, type=Field.TYPE_INT32) for n, name in enumerate(names, start=1)]
    file.message_type.add(name="M", field=fields)
    pool = DescriptorPool()
    pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("t.M"))(**{names[0]: [value] if repeated else value})
    schema = Schema(id=1, name="t.M", encoding="protobuf", data=descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString())
    empty = [] if repeated else 0
    expected = dict.fromkeys(names, empty) | {names[0]: [value] if repeated else value}
    assert protobuf_decoder(schema)(message.SerializeToString()) == expected
