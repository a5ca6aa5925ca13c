"""Protobuf messages of replay-kit in addition to the stock Foxglove ones, one table each.

Descriptors are built from the table on import and stored in every file; ``README.md`` of this folder lists the fields with units and
meanings. A change of a number, name, type or meaning raises CONTRACT_VERSION.
"""

from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from numpy.typing import NDArray

CONTRACT_VERSION = 6

_PACKAGE = "replay_kit"
TIME = ".google.protobuf.Timestamp"
#: How a list of numbers lies in a message, one behind the other: it is read and written as bytes.
ARRAYS = {
    "double": "<f8",
    "float": "<f4",
    "fixed32": "<u4",
    "sfixed32": "<i4",
    "fixed64": "<u8",
    "sfixed64": "<i8",
    "bool": "?",
}


class Field(NamedTuple):
    """Field of a message; its number is its position in the table, from 1.

    Attributes:
        name: Field name.
        type: Protobuf scalar, or the full name of a message with a leading dot.
        repeated: True for a list.
        path: Path of its attribute in the value of the message; for a list in columns in each value, and for a name with suffix ``_east``
            or ``_north`` of the pair.
    """

    name: str
    type: str
    repeated: bool
    path: str


def _fields(type_name: str, *names: str) -> tuple[Field, ...]:
    """Return fields of one type, each ``name`` or ``name=path.to.attribute``; ``[]`` after the type makes lists."""
    kind, pairs = type_name.removesuffix("[]"), [each.partition("=") for each in names]
    return tuple(Field(name, kind, kind != type_name, path or name) for name, _, path in pairs)


MESSAGES: dict[str, tuple[Field, ...]] = {
    "Estimate": (
        *_fields(TIME, "timestamp"),
        *_fields("fixed32", "basis"),
        *_fields("float[]", "x"),
    ),
    "Innovations": (
        *_fields("sfixed64[]", "timestamp=time_ns"),
        *_fields("fixed32[]", "source_input=source.input"),
        *_fields("string[]", "source_topic=source.topic"),
        *_fields("fixed64[]", "source_position=source.position"),
        *_fields("sfixed64[]", "source_time=source.time_ns"),
        *_fields("fixed32[]", "dive"),
        *_fields("double[]", "nis"),
        *_fields("fixed32[]", "dof"),
        *_fields("bool[]", "accepted"),
        *_fields("double[]", "error_inflation"),
        *_fields("string[]", "decision"),
        *_fields("double[]", "gate_statistic", "gate_threshold=gate", "signal_dof"),
        *_fields("string[]", "mean_current_kind=mean_kind"),
        *_fields(
            "double[]",
            "mean_current_measured_east=mean_current",
            "mean_current_measured_north=mean_current",
            "mean_current_corrected_east=corrected_current",
            "mean_current_corrected_north=corrected_current",
            "mean_current_measured_standard_error=mean_std",
            "mean_current_corrected_standard_error=corrected_std",
            "mean_current_estimated_standard_error=estimated_std",
        ),
        *_fields("fixed32[]", "profiles", "bins=depth.size"),
        *_fields("float[]", "depth", "measured_east=measured", "measured_north=measured"),
        *_fields("float[]", "innovation_east=innovation", "innovation_north=innovation"),
        *_fields("float[]", "innovation_std_east=innovation_std"),
        *_fields("float[]", "innovation_std_north=innovation_std"),
        *_fields("float[]", "residual_east=residual", "residual_north=residual"),
        *_fields("float[]", "prior_innovation_east=prior_innovation"),
        *_fields("float[]", "prior_innovation_north=prior_innovation"),
        *_fields("float[]", "replayed_residual_east=replayed_residual"),
        *_fields("float[]", "replayed_residual_north=replayed_residual"),
        *_fields("sfixed32[]", "flags"),
        *_fields("fixed32[]", "reasons"),
    ),
    "Finding": _fields("string", "name", "since", "severity", "evidence", "likely_cause", "advice"),
    "Consistency": (*_fields(TIME, "timestamp"), *_fields(".replay_kit.Finding[]", "findings")),
    "Place": _fields("double", "longitude", "latitude", "depth"),
    "Statistic": _fields("string", "name", "value"),
    "Odds": (
        *_fields("uint32", "n_samples"),
        *_fields(
            "double",
            "reached",
            "safe",
            "radius",
            "deadline",
            "arrival_median",
            "arrival_90_percent",
        ),
    ),
    "Plan": (
        *_fields(TIME, "timestamp=start_time_ns"),
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
        *_fields(TIME, "timestamp=time_ns", "planned_time=planned_ns"),
        *_fields(TIME, "predicted_time=predicted.time_ns"),
        *_fields(".replay_kit.Place", "predicted", "actual"),
        *_fields("double", "distance", "direction_deg", "delay=late"),
        *_fields("bool", "inside_ellipse"),
        *_fields("double", "ellipse_longitude", "ellipse_latitude"),
        *_fields("double", "ellipse_major", "ellipse_minor", "ellipse_bearing"),
    ),
    "Surfacing": (
        *_fields(TIME, "timestamp=fix.time_ns", "dive_begin=forecast.start.time_ns"),
        *_fields("uint32", "dive=forecast.dive", "earlier_dives=forecast.earlier"),
        *_fields(".replay_kit.Place", "start=forecast.start", "expected=forecast", "actual=fix"),
        *_fields("double", "distance", "direction_deg"),
        *_fields("double", "ellipse_bearing=forecast.outer.bearing_deg"),
        *_fields("double", "inner_major=forecast.inner.major", "inner_minor=forecast.inner.minor"),
        *_fields("double", "outer_major=forecast.outer.major", "outer_minor=forecast.outer.minor"),
        *_fields("bool", "inside_inner=in_inner", "inside_outer=in_outer"),
        *_fields("double", "log_score", "persistence_log_score", "persistence_distance"),
        *_fields("double", "persistence_radius=forecast.persistence_radius"),
    ),
}


def _field(number: int, field: Field, as_bytes: bool) -> FieldDescriptorProto:
    kind, repeated = "message" if field.type.startswith(".") else field.type, field.repeated
    if as_bytes and repeated and kind in ARRAYS:
        # of numbers of one length a packed list lies in a message as bytes do
        kind, repeated = "bytes", False
    return FieldDescriptorProto(
        name=field.name,
        number=number,
        label=FieldDescriptorProto.Label.Value("LABEL_REPEATED" if repeated else "LABEL_OPTIONAL"),
        type=FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}"),
        type_name=field.type if kind == "message" else None,
    )


def _files(as_bytes: bool) -> tuple[FileDescriptorProto, FileDescriptorProto]:
    """Return the descriptor files of the messages: times, and our own."""
    times, file = (
        FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb),
        FileDescriptorProto(
            name="replay_kit/results.proto",
            package=_PACKAGE,
            syntax="proto3",
            dependency=[timestamp_pb2.DESCRIPTOR.name],
        ),
    )
    for name, fields in MESSAGES.items():
        numbered = [_field(number, field, as_bytes) for number, field in enumerate(fields, start=1)]
        file.message_type.add(name=name, field=numbered)
    return times, file


def _classes() -> dict[str, type[Message]]:
    # A pool of our own: the names stay free for a reader that decodes a result in the same process.
    pool = DescriptorPool()
    for file in _files(as_bytes=True):
        pool.Add(file)
    return {
        name: GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in MESSAGES
    }


_CLASSES = _classes()

DESCRIPTOR_SET: bytes = FileDescriptorSet(file=_files(as_bytes=False)).SerializeToString(
    deterministic=True
)


def attributes(value: Any, names: str) -> dict[str, Any]:
    """Return attributes of a value by name, each ``name`` or ``name=path.to.attribute``."""
    pairs = (each.partition("=") for each in names.split())
    return {name: attrgetter(path or name)(value) for name, _, path in pairs}


def encode(name: str, values: dict[str, Any]) -> bytes:
    """Return a message's protobuf bytes; equal values give equal bytes.

    Args:
        name: Name of the message without the package.
        values: Values by field; nested messages as mappings, times as mappings of seconds and nanos, lists of numbers as arrays.
    """
    packed = {
        field.name: np.asarray(values[field.name], ARRAYS[field.type]).tobytes()
        for field in MESSAGES[name]
        if field.repeated and field.type in ARRAYS and field.name in values
    }
    return bytes(_CLASSES[name](**values | packed).SerializeToString(deterministic=True))


def decode(name: str, data: bytes) -> Message:
    """Return a message of the table from protobuf bytes; ``numbers`` returns its lists of numbers."""
    return _CLASSES[name].FromString(data)


def numbers(name: str, message: Any, field: str) -> NDArray[Any]:
    """Return a list of numbers of a decoded message of the table, shape (n,)."""
    (kind,) = (one.type for one in MESSAGES[name] if one.name == field)
    return np.frombuffer(getattr(message, field), ARRAYS[kind])
