"""What reads the messages of a schema: one table from the schema's name to a function that returns tables.

ROS 1, ROS 2 and other spellings of a name count as one: ``sensor_msgs/NavSatFix``, ``sensor_msgs/msg/NavSatFix``,
``sensor_msgs::msg::dds_::NavSatFix_``, ``sensor_msgs.NavSatFix``. A ``CurrentProfile`` is known in any package, since each driver has
its own. Messages of IMC written as JSON (LSTS/imc, IMC.xml) have angles in radians and offsets north, east, down.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Mask, replace
from replay_kit.core.extensions import additions
from replay_kit.core.table import Raw
from replay_kit.logs.tables import profiles, vehicle, water
from replay_kit.logs.tables.columns import Payload, Tables, field, read_each, some, unused
from replay_kit.logs.tables.frames import PARTS, SCHEMA, Open, joined
from replay_kit.logs.tables.mapped import mapped

#: The reason of a message of a kind that is not known.
NOT_A_KIND = "message type not used by the estimator"
_ALSO_INVERTED = (
    "already in the dive's inverted profile; measurements.use_inverted = false uses this instead"
)
_INVERTED = "inverted from the dive's pings and mean current, which are used instead (measurements.use_inverted)"
_NO_FIELDS = "malformed: a field is missing or of the wrong kind (AttributeError)"
#: Returns the tables of a topic's messages.
Reader = Callable[[Raw, MeasurementConfig], Tables]


def tables_of(
    raws: Sequence[Raw], config: MeasurementConfig, pending: Open = MappingProxyType({})
) -> tuple[Tables, Open]:
    """Return the tables of a block of messages, and the frames of MAVLink's pings that are not complete.

    Each message is in one table. A mapping of the settings goes before a known schema.

    Args:
        raws: The messages, by topic.
        config: The mappings, and what holds for payloads that do not say it.
        pending: Frames of the blocks before.
    """
    found, framed = Tables(), list[Raw]()
    # an overflow is no number
    with np.errstate(all="ignore"):
        for raw in raws:
            left = np.full(len(raw.time), True)
            for read, chosen in _readers(raw, config):
                part, left = left & chosen, left & ~np.array(chosen)
                if not part.any():
                    continue
                own = some(raw, part)
                if read == SCHEMA:
                    framed.append(own)
                else:
                    found += (
                        read(own, config) if callable(read) else unused(own, read or NOT_A_KIND)
                    )
        pending, pings = joined(pending, framed, config)
    return found + pings, pending


def _readers(
    raw: Raw, config: MeasurementConfig
) -> Iterator[tuple[Reader | str | None, Sequence[bool] | Mask]]:
    """Yield what reads messages, or why they cannot be used, and which of those they are that were not yielded before."""
    payloads, names = raw.payloads, field(raw.payloads, "name")
    yield _NO_FIELDS, [type(one) is not dict and not isinstance(one, Mapping) for one in payloads]
    for entry in config.map:
        if entry.topic == raw.topic:
            yield partial(mapped, entry), [entry.name in (None, name) for name in names]
    if raw.schema == SCHEMA:
        yield SCHEMA, [name in PARTS for name in names]
    mark, reason = (
        ("also_in", _ALSO_INVERTED) if config.use_inverted else ("computed_from", _INVERTED)
    )
    yield reason, [*map(bool, field(payloads, mark))]
    read, everyone = reader_of(raw.schema, raw.topic), np.full(len(payloads), True)
    if not (raw.schema or read):
        # IMC in JSON names its messages inside, when nothing outside does
        kinds = field(payloads, "abbrev")
        for kind, own in _IMC.items():
            yield own, [one == kind for one in kinds]
    yield read, everyone


def _plain(read: Callable[[Raw], Tables]) -> Reader:
    """Return the reader of a schema whose messages say all themselves; of one of which one sender counts, it says which this is."""

    def reader(raw: Raw, config: MeasurementConfig) -> Tables:
        parts, tables = raw.topic.split("/"), read(raw)
        if raw.schema not in SENDERS or parts[0] != "mavlink" or len(parts) < 4:
            return tables
        return [replace(one, fixed={**one.fixed, "sender": (parts[1], parts[2])}) for one in tables]

    return reader


_SENDING: Mapping[str, Callable[[Raw], Tables]] = {
    "dataflash.GPS": vehicle.dataflash_gps,
    "dataflash.POS": vehicle.dataflash_positions,
    "dataflash.CTUN": vehicle.dataflash_depths,
    "GLOBAL_POSITION_INT": vehicle.global_positions_int,
    "GPS_RAW_INT": vehicle.gps_raw_ints,
    "LOCAL_POSITION_NED": vehicle.local_positions_ned,
    "GPS_GLOBAL_ORIGIN": vehicle.gps_global_origins,
}
#: Messages of which one sender counts.
SENDERS = frozenset(_SENDING)
_PLAIN: Mapping[str, Callable[[Raw], Tables]] = {
    **_SENDING,
    "replay_kit.DepthAveragedCurrent": water.mean_currents,
    "replay_kit.Ctd": water.ctds,
    "replay_kit.DrifterFix": water.drifter_fixes,
    "replay_kit.RadarCurrents": water.radar_currents,
    "foxglove.LocationFix": vehicle.location_fixes,
    "foxglove_msgs.LocationFix": vehicle.location_fixes,
    "sensor_msgs.NavSatFix": vehicle.nav_sat_fixes,
    "sensor_msgs.FluidPressure": vehicle.fluid_pressures,
    "sensor_msgs.Imu": vehicle.imus,
    "nav_msgs.Odometry": vehicle.poses_within,
    "geometry_msgs.PoseStamped": vehicle.poses,
    "geometry_msgs.PoseWithCovarianceStamped": vehicle.poses_within,
    "marine_acoustic_msgs.Dvl": vehicle.dvls,
    "ds_sensor_msgs.Dvl": vehicle.dvls,
}
_SCHEMAS: Mapping[str, Reader | str] = {
    **{name: _plain(read) for name, read in _PLAIN.items()},
    "replay_kit.AdcpPing": profiles.adcp_pings,
    "ds_sensor_msgs.Adcp": profiles.ds_adcps,
    "replay_kit.Altimeter": "height above the bottom, not used",
    "replay_kit.Battery": "state of the battery, not used",
    "replay_kit.Waypoint": "where the glider steers for, not where it is",
}
_ANY_PACKAGE: Mapping[str, Reader] = {"CurrentProfile": profiles.current_profiles}
_IMC: Mapping[str, Reader] = {
    **_ANY_PACKAGE,
    "GpsFix": _plain(vehicle.imc_gps_fixes),
    "EstimatedState": _plain(vehicle.imc_estimated_states),
}
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
        reader = _sensor(added)
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


def _sensor(added: Callable[[Payload], Any]) -> Reader:
    """Return the reader of the measurements that a function of another package reads."""

    def read(payload: Payload) -> tuple[Any] | str:
        measured = added(payload)
        return measured if isinstance(measured, str) else (measured,)

    return _plain(lambda raw: read_each(raw, "sensor", "measurement", read))


def canonical(schema: str) -> str:
    """Return a schema's name as ``package.Type``, whatever the spelling."""
    parts = [part for part in _SEPARATORS.split(schema) if part]
    if len(parts) < 2:
        return schema
    # DDS writes package::msg::dds_::Type_
    return ".".join(part.rstrip("_") for part in parts if part not in ("msg", "dds_"))
