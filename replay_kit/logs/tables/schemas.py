"""Readers of schemas: a table from schema name to a function that returns tables.

Spellings of ROS 1, ROS 2 and others are equivalent: ``sensor_msgs/NavSatFix``, ``sensor_msgs/msg/NavSatFix``,
``sensor_msgs::msg::dds_::NavSatFix_``, ``sensor_msgs.NavSatFix``. ``CurrentProfile`` is accepted in any package, as each driver has its
own. IMC messages in JSON (LSTS/imc, IMC.xml) have angles in radians and offsets north, east, down.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.extensions import additions
from replay_kit.core.observation.table import Raw
from replay_kit.logs.tables import vehicle, water
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    Tables,
    field,
    read_each,
    some_messages,
    unused_table,
    used_and_unused,
)
from replay_kit.logs.tables.instruments import PARTS, SCHEMA, Open, joined_frames
from replay_kit.logs.tables.mapped import mapped_tables

#: The reason of a message of a kind that is not known.
NOT_A_KIND = "message type not used by the estimator"
# by whether inverted profiles are used: the field that marks what is then left out, and why it is
_INVERTED = {
    True: (
        "also_in",
        "already in the dive's inverted profile; measurements.use_inverted = false uses this instead",
    ),
    False: (
        "computed_from",
        "inverted from the dive's pings and mean current, which are used instead (measurements.use_inverted)",
    ),
}
_NO_FIELDS = "malformed: a field is missing or of the wrong kind (AttributeError)"
#: Returns the tables of a topic's messages.
Reader = Callable[[Raw, MeasurementConfig], Tables]


def tables_of(
    raws: Sequence[Raw], config: MeasurementConfig, pending: Open = MappingProxyType({})
) -> tuple[Tables, Open]:
    """Return the tables of a block of messages, and the frames of incomplete MAVLink pings.

    Each message is in one table. Mappings take precedence over known schemas.

    Args:
        raws: Messages by topic.
        config: Mappings, and defaults for values that payloads do not state.
        pending: Frames of earlier blocks.
    """
    found, framed = Tables(), list[Raw]()
    # an overflow is no number
    with np.errstate(all="ignore"):
        for raw in raws:
            left = np.full(len(raw.time), True)
            for read, chosen in _readers(raw, config):
                of_reader = some_messages(raw, left & chosen)
                left &= ~np.array(chosen)
                if of_reader.payloads and read == SCHEMA:
                    framed.append(of_reader)
                elif of_reader.payloads:
                    found += (
                        read(of_reader, config)
                        if callable(read)
                        else unused_table(of_reader, read or NOT_A_KIND)
                    )
        pending, pings = joined_frames(pending, framed, config)
    return found + pings, pending


def _readers(raw: Raw, config: MeasurementConfig) -> Iterator[tuple[Reader | str | None, Any]]:
    """Yield the reader of messages, or the reason for exclusion, with a mask of the messages not yielded before."""
    payloads, names = raw.payloads, field(raw.payloads, "name")
    if {*map(type, payloads)} != {dict}:
        yield _NO_FIELDS, [not isinstance(one, Mapping) for one in payloads]
    for entry in config.map:
        if entry.topic == raw.topic:
            yield partial(mapped_tables, entry), [entry.name in (None, name) for name in names]
    if raw.schema == SCHEMA:
        yield SCHEMA, [name in PARTS for name in names]
    mark, reason = _INVERTED[config.use_inverted]
    yield reason, [*map(bool, field(payloads, mark))]
    read = reader_of(raw.schema, raw.topic)
    if not (raw.schema or read):
        # IMC in JSON names its messages inside, when nothing outside does
        kinds = field(payloads, "abbrev")
        for kind, reader in _IMC.items():
            yield reader, [one == kind for one in kinds]
    yield read, True


def _plain(read: Callable[[Sequence[Payload]], Rows]) -> Reader:
    """Return the reader of a schema with self-contained messages; the MAVLink system is in the topic."""

    def reader(raw: Raw, config: MeasurementConfig) -> Tables:
        rows, parts = read(raw.payloads), raw.topic.split("/")
        fixed = dict(rows.fixed)
        if raw.schema in SENDERS and not raw.schema.startswith("dataflash"):
            fixed["system"] = "/".join(parts[:2])
            if parts[0] == "mavlink" and len(parts) > 3:
                fixed["sender"] = parts[1], parts[2]
        return used_and_unused(raw, rows._replace(fixed=fixed))

    return reader


#: Messages of which one sender counts.
SENDERS = frozenset(vehicle.SENDING)
_PLAIN = {**vehicle.SENDING, **vehicle.READERS, **water.READERS}
_SCHEMAS: Mapping[str, Reader | str] = {
    **{name: _plain(read) for name, read in _PLAIN.items()},
    "replay_kit.AdcpPing": water.adcp_pings,
    "ds_sensor_msgs.Adcp": partial(water.profiles, read=water.ds_adcp),
    "replay_kit.Altimeter": "height above the bottom, not used",
    "replay_kit.Battery": "state of the battery, not used",
    "replay_kit.Waypoint": "where the glider steers for, not where it is",
}
_IMC: Mapping[str, Reader] = {
    "CurrentProfile": partial(water.profiles, read=water.current_profile),
    **{name: _plain(read) for name, read in vehicle.IMC.items()},
}
_SEPARATORS = re.compile(r"::|[/.]")
# a pose on such a topic is where something should go, not where the vehicle is
_WISH = re.compile(r"goal|target|setpoint|waypoint|command|cmd|desired", re.IGNORECASE)
_POSES = ("geometry_msgs.PoseStamped", "geometry_msgs.PoseWithCovarianceStamped")


@lru_cache(maxsize=4096)
def reader_of(schema: str, topic: str) -> Reader | str | None:
    """Return the reader of a topic, or the reason for exclusion; None for an unknown kind."""
    name = canonical(schema)
    package, _, kind = name.rpartition(".")
    reader = _SCHEMAS.get(name)
    if kind == "CurrentProfile" or package.lower() == "imc":
        reader = _IMC.get(kind)
    if reader is None and (added := additions("sensors", callable, "a function").get(name)):
        reader = _plain(lambda payloads: read_each("sensor", "measurement", payloads, added))
    if name in _POSES and _WISH.search(topic):
        return "topic name suggests a goal, not the vehicle position"
    return reader


def may_state(schema: str, topic: str) -> bool:
    """Return whether messages of a schema and topic may be usable; otherwise all are treated alike."""
    # without a schema a message may say inside what it is
    return not schema or schema == SCHEMA or callable(reader_of(schema, topic))


def canonical(schema: str) -> str:
    """Return a schema name as ``package.Type`` for any spelling."""
    parts = [part for part in _SEPARATORS.split(schema) if part]
    if len(parts) < 2:
        return schema
    # DDS writes package::msg::dds_::Type_
    return ".".join(part.rstrip("_") for part in parts if part not in ("msg", "dds_"))
