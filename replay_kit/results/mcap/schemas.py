"""Protobuf messages of replay-kit in addition to the stock Foxglove ones, one table each.

Descriptors are built from the table on import and stored in every file; ``README.md`` of this folder lists the fields with units and
meanings. A change of a number, name, type or meaning raises CONTRACT_VERSION.
"""

import re
from collections.abc import Iterator, Mapping
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


# Each message with its fields, a line for each type: ``name`` or ``name=path.to.attribute``; ``[]`` after the type makes lists.
_TABLE = """
Estimate
    time timestamp
    fixed32 basis
    float[] x
Innovations
    sfixed64[] timestamp=time_ns
    fixed32[] source_input=source.input
    string[] source_topic=source.topic
    fixed64[] source_position=source.position
    sfixed64[] source_time=source.time_ns
    fixed32[] dive
    double[] nis
    fixed32[] dof
    bool[] accepted
    double[] error_inflation
    string[] decision
    double[] gate_statistic gate_threshold=gate signal_dof
    string[] mean_current_kind=mean_kind
    double[] mean_current_measured_east=mean_current mean_current_measured_north=mean_current
    double[] mean_current_corrected_east=corrected_current mean_current_corrected_north=corrected_current
    double[] mean_current_measured_standard_error=mean_std mean_current_corrected_standard_error=corrected_std
    double[] mean_current_estimated_standard_error=estimated_std
    fixed32[] profiles bins=depth.size
    float[] depth measured_east=measured measured_north=measured innovation_east=innovation
    float[] innovation_north=innovation innovation_std_east=innovation_std innovation_std_north=innovation_std
    float[] residual_east=residual residual_north=residual prior_innovation_east=prior_innovation
    float[] prior_innovation_north=prior_innovation replayed_residual_east=replayed_residual
    float[] replayed_residual_north=replayed_residual
    sfixed32[] flags
    fixed32[] reasons
Finding
    string name since severity evidence likely_cause advice
Consistency
    time timestamp
    Finding[] findings
Place
    double longitude latitude depth
Statistic
    string name value
Odds
    uint32 n_samples
    double reached safe radius deadline arrival_median arrival_90_percent
Plan
    time timestamp=start_time_ns
    string status message
    Place start goal
    double heading_deg glide_angle_deg speed
    double[] velocity_through_water
    double duration closest_approach
    double[] track_time track_east track_north track_depth
    Statistic[] statistics
    double energy battery
    Odds odds
    double[] track_bottom
    Place[] via
PlanOutcome
    time timestamp=time_ns planned_time=planned_ns predicted_time=predicted.time_ns
    Place predicted actual
    double distance direction_deg delay=late
    bool inside_ellipse
    double ellipse_longitude ellipse_latitude ellipse_major ellipse_minor ellipse_bearing
Surfacing
    time timestamp=fix.time_ns dive_begin=forecast.start.time_ns
    uint32 dive=forecast.dive earlier_dives=forecast.earlier
    Place start=forecast.start expected=forecast actual=fix
    double distance direction_deg ellipse_bearing=forecast.outer.bearing_deg inner_major=forecast.inner.major
    double inner_minor=forecast.inner.minor outer_major=forecast.outer.major outer_minor=forecast.outer.minor
    bool inside_inner=in_inner inside_outer=in_outer
    double log_score persistence_log_score persistence_distance persistence_radius=forecast.persistence_radius
"""


def _messages(table: str) -> Iterator[tuple[str, tuple[Field, ...]]]:
    """Yield the messages of the table with their fields."""
    for text in re.split(r"\n(?=\w)", table.strip()):
        name, *lines = text.split("\n")
        fields = list[Field]()
        for kind, *names in map(str.split, lines):
            scalar, _, repeated = kind.partition("[")
            field_type = (
                f".{_PACKAGE}.{scalar}" if scalar.istitle() else scalar.replace("time", TIME)
            )
            pairs = (one.partition("=") for one in names)
            fields += (
                Field(one, field_type, bool(repeated), path or one) for one, _, path in pairs
            )
        yield name, tuple(fields)


MESSAGES = dict(_messages(_TABLE))


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
    times = FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)
    file = FileDescriptorProto(
        name="replay_kit/results.proto",
        package=_PACKAGE,
        syntax="proto3",
        dependency=[timestamp_pb2.DESCRIPTOR.name],
    )
    for name, fields in MESSAGES.items():
        numbered = [_field(number, field, as_bytes) for number, field in enumerate(fields, start=1)]
        file.message_type.add(name=name, field=numbered)
    return times, file


# A pool of our own: the names stay free for a reader that decodes a result in the same process.
_POOL = DescriptorPool()
for _own in _files(as_bytes=True):
    _POOL.Add(_own)
_CLASSES: dict[str, type[Message]] = {
    name: GetMessageClass(_POOL.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in MESSAGES
}

DESCRIPTOR_SET: bytes = FileDescriptorSet(file=_files(as_bytes=False)).SerializeToString(
    deterministic=True
)


def attributes(value: Any, names: str) -> dict[str, Any]:
    """Return attributes of a value, or items of a mapping, by name, each ``name`` or ``name=path.to.attribute``; None for missing items."""
    pairs = (each.partition("=") for each in names.split())
    held = {name: path or name for name, _, path in pairs}
    if isinstance(value, Mapping):
        return {name: value.get(path) for name, path in held.items()}
    return {name: attrgetter(path)(value) for name, path in held.items()}


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
