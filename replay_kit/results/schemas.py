"""The protobuf messages that replay-kit adds to the stock Foxglove ones, as one table each.

The table is the source: the descriptors are built from it on import, every file carries them, and ``README.md`` of this
folder lists the same fields with units and meanings. A change of a number, name, type or meaning raises CONTRACT_VERSION.
"""

from typing import Any, NamedTuple

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

CONTRACT_VERSION = 2

_PACKAGE = "replay_kit"
_TIME = ".google.protobuf.Timestamp"
_SCALARS = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "int32": FieldDescriptorProto.TYPE_INT32,
    "uint32": FieldDescriptorProto.TYPE_UINT32,
    "uint64": FieldDescriptorProto.TYPE_UINT64,
    "bool": FieldDescriptorProto.TYPE_BOOL,
    "string": FieldDescriptorProto.TYPE_STRING,
}


class Field(NamedTuple):
    """One field of a message; its number is its place in the table, counted from 1.

    Attributes:
        name: Field name.
        type: Protobuf scalar, or the full name of a message with a leading dot.
        repeated: True for a list.
    """

    name: str
    type: str
    repeated: bool = False


MESSAGES: dict[str, tuple[Field, ...]] = {
    "FlowEstimate": (
        Field("timestamp", _TIME),
        Field("n_modes", "uint32"),
        Field("levels", "double", repeated=True),
        Field("weights", "double", repeated=True),
        Field("n_observations", "uint32"),
    ),
    "Innovation": (
        Field("timestamp", _TIME),
        Field("source_input", "uint32"),
        Field("source_topic", "string"),
        Field("source_position", "uint64"),
        Field("source_time", _TIME),
        Field("dive", "uint32"),
        Field("depth", "double", repeated=True),
        Field("innovation_east", "double", repeated=True),
        Field("innovation_north", "double", repeated=True),
        Field("innovation_std_east", "double", repeated=True),
        Field("innovation_std_north", "double", repeated=True),
        Field("residual_east", "double", repeated=True),
        Field("residual_north", "double", repeated=True),
        Field("prior_innovation_east", "double", repeated=True),
        Field("prior_innovation_north", "double", repeated=True),
        Field("nis", "double"),
        Field("dof", "uint32"),
        Field("accepted", "bool"),
        Field("error_inflation", "double"),
        Field("flags", "int32", repeated=True),
        Field("reasons", "uint32", repeated=True),
        Field("decision", "string"),
        Field("gate_statistic", "double"),
        Field("gate", "double"),
        Field("signal_dof", "double"),
        Field("prior_inflation", "double"),
    ),
    "Place": (
        Field("longitude", "double"),
        Field("latitude", "double"),
        Field("depth", "double"),
    ),
    "Statistic": (
        Field("name", "string"),
        Field("value", "string"),
    ),
    "Plan": (
        Field("timestamp", _TIME),
        Field("status", "string"),
        Field("message", "string"),
        Field("start", ".replay_kit.Place"),
        Field("goal", ".replay_kit.Place"),
        Field("heading_deg", "double"),
        Field("glide_angle_deg", "double"),
        Field("speed", "double"),
        Field("velocity_through_water", "double", repeated=True),
        Field("duration", "double"),
        Field("closest_approach", "double"),
        Field("track_time", "double", repeated=True),
        Field("track_east", "double", repeated=True),
        Field("track_north", "double", repeated=True),
        Field("track_depth", "double", repeated=True),
        Field("statistics", ".replay_kit.Statistic", repeated=True),
    ),
    "PlanOutcome": (
        Field("timestamp", _TIME),
        Field("planned_time", _TIME),
        Field("predicted_time", _TIME),
        Field("predicted", ".replay_kit.Place"),
        Field("actual", ".replay_kit.Place"),
        Field("distance", "double"),
        Field("direction_deg", "double"),
        Field("late", "double"),
        Field("inside_ellipse", "bool"),
        Field("ellipse_longitude", "double"),
        Field("ellipse_latitude", "double"),
        Field("ellipse_major", "double"),
        Field("ellipse_minor", "double"),
        Field("ellipse_bearing", "double"),
    ),
}


def _field(number: int, field: Field) -> FieldDescriptorProto:
    label = FieldDescriptorProto.LABEL_REPEATED if field.repeated else FieldDescriptorProto.LABEL_OPTIONAL
    if field.type.startswith("."):
        kind, type_name = FieldDescriptorProto.TYPE_MESSAGE, field.type
    else:
        kind, type_name = _SCALARS[field.type], None
    return FieldDescriptorProto(name=field.name, number=number, label=label, type=kind, type_name=type_name)


def _file() -> FileDescriptorProto:
    file = FileDescriptorProto(
        name="replay_kit/results.proto", package=_PACKAGE, syntax="proto3", dependency=[timestamp_pb2.DESCRIPTOR.name]
    )
    for name, fields in MESSAGES.items():
        file.message_type.add(name=name, field=[_field(number, field) for number, field in enumerate(fields, start=1)])
    return file


def _timestamp_file() -> FileDescriptorProto:
    file = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(file)
    return file


def _classes() -> dict[str, type[Message]]:
    # A pool of our own: the names stay free for a reader that decodes a result in the same process.
    pool = DescriptorPool()
    pool.Add(_timestamp_file())
    pool.Add(_file())
    return {name: GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in MESSAGES}


_CLASSES = _classes()

DESCRIPTOR_SET: bytes = FileDescriptorSet(file=[_timestamp_file(), _file()]).SerializeToString(deterministic=True)


def encode(name: str, values: dict[str, Any]) -> bytes:
    """Return a message's protobuf bytes; equal values give equal bytes.

    Args:
        name: Message of the table, without the package.
        values: Field name to value; nested messages as mappings, times as mappings of seconds and nanos.
    """
    return bytes(_CLASSES[name](**values).SerializeToString(deterministic=True))
