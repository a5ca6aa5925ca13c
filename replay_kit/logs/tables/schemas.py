"""What reads the messages of a schema: one table from the schema's name to a function that returns tables.

ROS 1, ROS 2 and other spellings of a name count as one: ``sensor_msgs/NavSatFix``, ``sensor_msgs/msg/NavSatFix``,
``sensor_msgs::msg::dds_::NavSatFix_``, ``sensor_msgs.NavSatFix``. A ``CurrentProfile`` is known in any package, since each driver has
its own. Messages of IMC written as JSON (LSTS/imc, IMC.xml) have angles in radians and offsets north, east, down.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.extensions import additions
from replay_kit.core.table import Kind, Raw, Table
from replay_kit.logs.tables import profiles, vehicle, water
from replay_kit.logs.tables.columns import NOT_A_KIND as NOT_A_KIND
from replay_kit.logs.tables.columns import Payload, field, malformed, read_each, some, unused
from replay_kit.logs.tables.frames import SCHEMA, Open, joined
from replay_kit.logs.tables.mapped import mapped

_ALSO_INVERTED = (
    "already in the dive's inverted profile; measurements.use_inverted = false uses this instead"
)
_INVERTED = "inverted from the dive's pings and mean current, which are used instead (measurements.use_inverted)"
#: Returns the tables of a topic's messages.
Reader = Callable[[Raw, MeasurementConfig], list[Table]]


def tables_of(
    raws: Sequence[Raw], config: MeasurementConfig, pending: Open = MappingProxyType({})
) -> tuple[list[Table], Open]:
    """Return the tables of a block of messages, and the frames of MAVLink's pings that are not complete.

    Each message is in one table. A mapping of the settings goes before a known schema.

    Args:
        raws: The messages, by topic.
        config: The mappings, and what holds for payloads that do not say it.
        pending: Frames of the blocks before.
    """
    found: list[Table] = []
    framed: list[Raw] = []
    for raw in raws:
        raw, odd = _with_fields(raw)
        found += odd
        mapped_tables, rest = _mapped(raw, config)
        found += mapped_tables
        if rest is None:
            continue
        if rest.schema == SCHEMA:
            framed.append(rest)
            continue
        sender, known = sender_of(rest), _known(rest, config)
        if sender is not None:
            known = [replace(one, fixed={**one.fixed, "sender": sender}) for one in known]
        found += known
    if framed:
        pending, pings = joined(pending, framed, config)
        found += pings
    return found, pending


def _with_fields(raw: Raw) -> tuple[Raw, list[Table]]:
    """Return the messages that have fields, and the table of those that have none."""
    if {*map(type, raw.payloads)} <= {dict}:
        return raw, []
    known = [isinstance(payload, Mapping) for payload in raw.payloads]
    reason = malformed(AttributeError())
    rest = some(raw, [k for k, has_fields in enumerate(known) if has_fields])
    return rest, unused(raw, ["" if has_fields else reason for has_fields in known])


def _mapped(raw: Raw, config: MeasurementConfig) -> tuple[list[Table], Raw | None]:
    """Return the tables of messages with a mapping, and the other messages."""
    found: list[Table] = []
    left = [*range(len(raw.time))]
    for entry in config.map:
        if entry.topic != raw.topic:
            continue
        name = entry.name
        own = [k for k in left if name is None or raw.payloads[k].get("name") == name]
        if own:
            taken = set(own)
            left = [k for k in left if k not in taken]
            found += mapped(some(raw, own), entry, config)
    return found, some(raw, left) if left else None


def _known(raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of messages without a mapping."""
    mark, reason = (
        ("also_in", _ALSO_INVERTED) if config.use_inverted else ("computed_from", _INVERTED)
    )
    marked = field(raw.payloads, mark)
    if any(marked):
        found = unused(raw, [reason if mark else "" for mark in marked])
        left = [k for k, mark in enumerate(marked) if not mark]
        return found + _known(some(raw, left), config) if left else found
    if raw.schema:
        return _by(reader_of(raw.schema, raw.topic), raw, config)
    # IMC in JSON names its messages inside, when nothing outside does
    kinds: dict[Reader | str | None, list[int]] = {}
    outside = reader_of(raw.schema, raw.topic)
    for k, name in enumerate(field(raw.payloads, "abbrev")):
        kinds.setdefault(outside or _IMC.get(str(name)), []).append(k)
    return [table for read, at in kinds.items() for table in _by(read, some(raw, at), config)]


def _by(reader: Reader | str | None, raw: Raw, config: MeasurementConfig) -> list[Table]:
    if callable(reader):
        return reader(raw, config)
    return unused(raw, [reader or NOT_A_KIND] * len(raw.time))


def _each(kind: Kind, names: str, read: Callable[[Payload], Any], **fixed: Any) -> Reader:
    """Return the reader of a schema whose messages are read one by one."""

    def reader(raw: Raw, config: MeasurementConfig) -> list[Table]:
        del config
        return read_each(raw, kind, names.split(), read, fixed)

    return reader


def _of_system(kind: Kind, names: str, read: Callable[[Payload], Any], **fixed: Any) -> Reader:
    """Return the reader of a MAVLink message, whose topic says of which system it is."""

    def reader(raw: Raw, config: MeasurementConfig) -> list[Table]:
        del config
        system = "/".join(raw.topic.split("/")[:2])
        return read_each(raw, kind, names.split(), read, {**fixed, "system": system})

    return reader


_PLACE, _POSE = "longitude latitude depth dead_reckoned", "east north depth quaternion ned"
_CTD = "depth temperature salinity conductivity pressure"
_MEAN = "velocity error_std start_time start end_time end dive deepest inverted"
_RADAR = "longitude latitude value error_std direction suspect depth averaged error_length kind"
_SCHEMAS: Mapping[str, Reader | str] = MappingProxyType(
    {
        "replay_kit.AdcpPing": profiles.adcp_pings,
        "replay_kit.DepthAveragedCurrent": _each("mean", _MEAN, water.depth_averaged_current),
        "replay_kit.Ctd": water.ctd,
        "replay_kit.DrifterFix": _each(
            "drifter", "name longitude latitude depth error", water.drifter_fix
        ),
        "replay_kit.RadarCurrents": _each("radar", _RADAR, water.radar_currents),
        "replay_kit.Altimeter": "height above the bottom, not used",
        "replay_kit.Battery": "state of the battery, not used",
        "replay_kit.Waypoint": "where the glider steers for, not where it is",
        "ds_sensor_msgs.Adcp": profiles.ds_adcps,
        "foxglove.LocationFix": vehicle.location_fixes,
        "foxglove_msgs.LocationFix": vehicle.location_fixes,
        "sensor_msgs.NavSatFix": _each("position", _PLACE, vehicle.nav_sat_fix),
        "sensor_msgs.FluidPressure": _each(
            "depth", "pressure", vehicle.fluid_pressure, by="pressure"
        ),
        "sensor_msgs.Imu": _each("attitude", "quaternion ned", vehicle.imu),
        "nav_msgs.Odometry": _each("pose", _POSE, vehicle.odometry, system="", oriented=True),
        "geometry_msgs.PoseStamped": _each(
            "pose", _POSE, vehicle.pose_stamped, system="", oriented=True
        ),
        "geometry_msgs.PoseWithCovarianceStamped": _each(
            "pose", _POSE, vehicle.odometry, system="", oriented=True
        ),
        "marine_acoustic_msgs.Dvl": _each("dvl", "velocity error_std bottom axes", vehicle.dvl),
        "ds_sensor_msgs.Dvl": _each("dvl", "velocity error_std bottom axes", vehicle.dvl),
        "dataflash.GPS": _each("position", _PLACE, vehicle.dataflash_gps),
        "dataflash.POS": _each("position", _PLACE, vehicle.dataflash_position),
        "dataflash.CTUN": _each("depth", "depth", vehicle.dataflash_depth, by="depth"),
        "GLOBAL_POSITION_INT": _of_system("position", _PLACE, vehicle.global_position_int),
        "GPS_RAW_INT": _of_system("gps", "no_fix", vehicle.gps_raw_int),
        "LOCAL_POSITION_NED": _of_system("pose", _POSE, vehicle.local_position_ned, oriented=False),
        "GPS_GLOBAL_ORIGIN": _of_system("origin", "longitude latitude", vehicle.gps_global_origin),
    }
)
_ANY_PACKAGE: Mapping[str, Reader] = MappingProxyType({"CurrentProfile": profiles.current_profiles})
_IMC: Mapping[str, Reader] = MappingProxyType(
    {
        **_ANY_PACKAGE,
        "GpsFix": _each("position", _PLACE, vehicle.imc_gps_fix),
        "EstimatedState": _each("position", _PLACE, vehicle.imc_estimated_state),
    }
)
_SEPARATORS = re.compile(r"::|[/.]")
# a pose on such a topic is where something should go, not where the vehicle is
_WISH = re.compile(r"goal|target|setpoint|waypoint|command|cmd|desired", re.IGNORECASE)
_POSES = ("geometry_msgs.PoseStamped", "geometry_msgs.PoseWithCovarianceStamped")
_BLUEOS_COPY = "mavlink/out"
_BLUEOS_FIELD = re.compile(r"mavlink/\d+/\d+/[A-Z][A-Z0-9_]*/\w+", re.ASCII)


@lru_cache(maxsize=4096)
def reader_of(schema: str, topic: str) -> Reader | str | None:
    """Return what reads a topic's messages, or why they cannot be used; None for a kind that is not known."""
    name = canonical(schema)
    package, _, kind = name.rpartition(".")
    reader = (
        _SCHEMAS.get(name)
        or _ANY_PACKAGE.get(kind)
        or (_IMC.get(kind) if package.lower() == "imc" else None)
    )
    if reader is None and (added := additions("sensors", callable, "a function").get(name)):
        reader = partial(_sensor, added)
    if name in _POSES and _WISH.search(topic):
        return "topic name suggests a goal, not the vehicle position"
    if reader is None and topic == _BLUEOS_COPY:
        return "repeats messages of other topics"
    if reader is None and _BLUEOS_FIELD.fullmatch(topic):
        return "one field of a message on another topic"
    return reader


def may_state(schema: str, topic: str) -> bool:
    """Return whether messages of a schema and topic may state something; where not, the same becomes of each of them."""
    # without a schema a message may say inside what it is
    return not schema or schema == SCHEMA or callable(reader_of(schema, topic))


def _sensor(added: Callable[[Payload], Any], raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the measurements that the function of another package reads."""
    del config

    def read(payload: Payload) -> tuple[Any] | str:
        stated = added(payload)
        return stated if isinstance(stated, str) else (stated,)

    return read_each(raw, "sensor", ["measurement"], read)


def canonical(schema: str) -> str:
    """Return a schema's name as ``package.Type``, whatever the spelling."""
    parts = [part for part in _SEPARATORS.split(schema) if part]
    if len(parts) < 2:
        return schema
    # DDS writes package::msg::dds_::Type_
    return ".".join(part.rstrip("_") for part in parts if part not in ("msg", "dds_"))


def sender_of(raw: Raw) -> tuple[str, str] | None:
    """Return the numbers of the MAVLink system and component whose position or depth messages state; None for any others."""
    parts = raw.topic.split("/")
    known = raw.schema in SENDERS and parts[0] == "mavlink" and len(parts) > 3
    return (parts[1], parts[2]) if known else None


#: Messages of which one sender counts.
SENDERS = frozenset(
    {"GPS_RAW_INT", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "GPS_GLOBAL_ORIGIN"}
    | {"dataflash.GPS", "dataflash.POS", "dataflash.CTUN"}
)
