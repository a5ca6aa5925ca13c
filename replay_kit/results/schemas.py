"""The protobuf messages that replay-kit adds to the stock Foxglove ones, as one table each.

The table is the source: the descriptors are built from it on import, every file carries them, and ``README.md`` of this
folder lists the same fields with units and meanings. A change of a number, name, type or meaning raises CONTRACT_VERSION.
"""

from typing import Any, NamedTuple

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

CONTRACT_VERSION = 5

_PACKAGE = "replay_kit"
TIME = ".google.protobuf.Timestamp"
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


def _fields(type_name: str, *names: str) -> tuple[Field, ...]:
    """Return fields of one type; ``[]`` behind the type makes them lists."""
    kind = type_name.removesuffix("[]")
    return tuple(Field(name, kind, kind != type_name) for name in names)


MESSAGES: dict[str, tuple[Field, ...]] = {
    "FlowEstimate": (
        *_fields(TIME, "timestamp"),
        *_fields("uint32", "n_modes"),
        *_fields("double[]", "levels", "weights"),
        *_fields("uint32", "n_observations"),
    ),
    "Innovation": (
        *_fields(TIME, "timestamp"),
        *_fields("uint32", "source_input"),
        *_fields("string", "source_topic"),
        *_fields("uint64", "source_position"),
        *_fields(TIME, "source_time"),
        *_fields("uint32", "dive"),
        *_fields(
            "double[]",
            "depth",
            "innovation_east",
            "innovation_north",
            "innovation_std_east",
            "innovation_std_north",
        ),
        *_fields(
            "double[]",
            "residual_east",
            "residual_north",
            "prior_innovation_east",
            "prior_innovation_north",
        ),
        *_fields("double", "nis"),
        *_fields("uint32", "dof"),
        *_fields("bool", "accepted"),
        *_fields("double", "error_inflation"),
        *_fields("int32[]", "flags"),
        *_fields("uint32[]", "reasons"),
        *_fields("string", "decision"),
        *_fields("double", "gate_statistic", "gate_threshold", "signal_dof", "prior_inflation"),
        *_fields(".replay_kit.MeanCurrent", "mean_current"),
        *_fields("double[]", "replayed_residual_east", "replayed_residual_north"),
        *_fields("uint32", "profiles"),
    ),
    "MeanCurrent": (
        *_fields("string", "kind"),
        *_fields("double", "measured_east", "measured_north", "predicted_east", "predicted_north"),
        *_fields(
            "double", "corrected_east", "corrected_north", "estimated_east", "estimated_north"
        ),
        *_fields(
            "double",
            "measured_standard_error",
            "corrected_standard_error",
            "estimated_standard_error",
        ),
    ),
    "AtVehicle": (
        *_fields(TIME, "timestamp"),
        *_fields(
            "double",
            "longitude",
            "latitude",
            "depth",
            "east",
            "north",
            "east_standard_error",
            "north_standard_error",
        ),
    ),
    "Finding": _fields("string", "name", "since", "severity", "evidence", "likely_cause", "advice"),
    "Consistency": (*_fields(TIME, "timestamp"), *_fields(".replay_kit.Finding[]", "findings")),
    "Place": _fields("double", "longitude", "latitude", "depth"),
    "Statistic": _fields("string", "name", "value"),
    "Odds": (
        *_fields("uint32", "n_samples"),
        *_fields("double", "reached", "reached_held", "safe", "miss_median", "miss_90_percent"),
    ),
    "Plan": (
        *_fields(TIME, "timestamp"),
        *_fields("string", "status", "message"),
        *_fields(".replay_kit.Place", "start", "goal"),
        *_fields("double", "heading_deg", "glide_angle_deg", "speed"),
        *_fields("double[]", "velocity_through_water"),
        *_fields("double", "duration", "closest_approach"),
        *_fields("double[]", "track_time", "track_east", "track_north", "track_depth"),
        *_fields(".replay_kit.Statistic[]", "statistics"),
        *_fields("double", "energy", "battery"),
        *_fields(".replay_kit.Odds", "odds"),
        *_fields("double[]", "track_bottom"),
    ),
    "PlanOutcome": (
        *_fields(TIME, "timestamp", "planned_time", "predicted_time"),
        *_fields(".replay_kit.Place", "predicted", "actual"),
        *_fields("double", "distance", "direction_deg", "delay"),
        *_fields("bool", "inside_ellipse"),
        *_fields(
            "double",
            "ellipse_longitude",
            "ellipse_latitude",
            "ellipse_major",
            "ellipse_minor",
            "ellipse_bearing",
        ),
    ),
    "Surfacing": (
        *_fields(TIME, "timestamp", "dive_begin"),
        *_fields("uint32", "dive", "earlier_dives"),
        *_fields(".replay_kit.Place", "start", "expected", "actual"),
        *_fields("double", "distance", "direction_deg", "ellipse_bearing"),
        *_fields("double", "inner_major", "inner_minor", "outer_major", "outer_minor"),
        *_fields("bool", "inside_inner", "inside_outer"),
        *_fields(
            "double",
            "log_score",
            "persistent_log_score",
            "persistent_distance",
            "persistent_radius",
        ),
    ),
}


def _field(number: int, field: Field) -> FieldDescriptorProto:
    label = (
        FieldDescriptorProto.LABEL_REPEATED
        if field.repeated
        else FieldDescriptorProto.LABEL_OPTIONAL
    )
    if field.type.startswith("."):
        kind, type_name = FieldDescriptorProto.TYPE_MESSAGE, field.type
    else:
        kind, type_name = _SCALARS[field.type], None
    return FieldDescriptorProto(
        name=field.name, number=number, label=label, type=kind, type_name=type_name
    )


def _file() -> FileDescriptorProto:
    file = FileDescriptorProto(
        name="replay_kit/results.proto",
        package=_PACKAGE,
        syntax="proto3",
        dependency=[timestamp_pb2.DESCRIPTOR.name],
    )
    for name, fields in MESSAGES.items():
        file.message_type.add(
            name=name, field=[_field(number, field) for number, field in enumerate(fields, start=1)]
        )
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
    return {
        name: GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in MESSAGES
    }


_CLASSES = _classes()

DESCRIPTOR_SET: bytes = FileDescriptorSet(file=[_timestamp_file(), _file()]).SerializeToString(
    deterministic=True
)


def encode(name: str, values: dict[str, Any]) -> bytes:
    """Return a message's protobuf bytes; equal values give equal bytes.

    Args:
        name: Message of the table, without the package.
        values: Field name to value; nested messages as mappings, times as mappings of seconds and nanos.
    """
    return bytes(_CLASSES[name](**values).SerializeToString(deterministic=True))


def decode(name: str, data: bytes) -> Message:
    """Return a message of the table from its protobuf bytes, with the field names of this version of the contract."""
    return _CLASSES[name].FromString(data)
