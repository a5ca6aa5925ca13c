"""The kinds of message that say something: one table from the schema's name to the function that reads the payload.

ROS 1, ROS 2 and other spellings of a name count as one: ``sensor_msgs/NavSatFix``, ``sensor_msgs/msg/NavSatFix``,
``sensor_msgs::msg::dds_::NavSatFix_``, ``sensor_msgs.NavSatFix``. A ``CurrentProfile`` is known in any package, since each driver has
its own.
"""

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from replay_kit.core.message import Message
from replay_kit.measurements.current.mean import MeanCurrent
from replay_kit.measurements.messages import (
    mavlink_ping,
    mavlink_vehicle,
    motion,
    position,
    profiles,
)
from replay_kit.measurements.messages.mean_current import depth_averaged_current
from replay_kit.measurements.messages.position import Depth, Pose, Position, Pressure
from replay_kit.measurements.messages.profiles import StatedPing
from replay_kit.measurements.ping.attitude import Orientation

#: What a message states, or in words why it cannot be used.
Statement = (
    Position
    | Depth
    | Pressure
    | Pose
    | Orientation
    | StatedPing
    | mavlink_ping.PingFrame
    | mavlink_vehicle.GpsStatus
    | mavlink_vehicle.NavigationPosition
    | MeanCurrent
    | motion.Dvl
    | str
)
Reader = Callable[[Mapping[str, Any]], Statement]

_READERS: Mapping[str, Reader | str] = MappingProxyType(
    {
        "replay_kit.AdcpPing": profiles.adcp_ping,
        "replay_kit.DepthAveragedCurrent": depth_averaged_current,
        "ds_sensor_msgs.Adcp": profiles.ds_adcp,
        "foxglove.LocationFix": position.location_fix,
        "foxglove_msgs.LocationFix": position.location_fix,
        "sensor_msgs.NavSatFix": position.nav_sat_fix,
        "sensor_msgs.FluidPressure": position.fluid_pressure,
        "sensor_msgs.Imu": motion.imu,
        "nav_msgs.Odometry": position.odometry,
        "geometry_msgs.PoseStamped": position.pose_stamped,
        "geometry_msgs.PoseWithCovarianceStamped": position.odometry,
        "marine_acoustic_msgs.Dvl": motion.dvl,
        "ds_sensor_msgs.Dvl": motion.dvl,
        "dataflash.GPS": mavlink_vehicle.dataflash_gps,
        "dataflash.POS": mavlink_vehicle.dataflash_position,
        "dataflash.CTUN": mavlink_vehicle.dataflash_depth,
    }
)
# of messages whose topic says of which system they are
_MAVLINK: Mapping[str, Callable[[Message], Statement | None]] = MappingProxyType(
    {
        "DEBUG_FLOAT_ARRAY": mavlink_ping.ping_frame,
        "GLOBAL_POSITION_INT": mavlink_vehicle.global_position_int,
        "GPS_RAW_INT": mavlink_vehicle.gps_raw_int,
    }
)
_ANY_PACKAGE: Mapping[str, Reader] = MappingProxyType({"CurrentProfile": profiles.current_profile})
_IMC: Mapping[str, Reader] = MappingProxyType(
    {**_ANY_PACKAGE, "GpsFix": position.imc_gps_fix, "EstimatedState": position.imc_estimated_state}
)
_SEPARATORS = re.compile(r"::|[/.]")
# a pose on such a topic is where something should go, not where the vehicle is
_WISH = re.compile(r"goal|target|setpoint|waypoint|command|cmd|desired", re.IGNORECASE)
_POSES = ("geometry_msgs.PoseStamped", "geometry_msgs.PoseWithCovarianceStamped")
_BLUEOS_COPY = "mavlink/out"
_BLUEOS_FIELD = re.compile(r"mavlink/\d+/\d+/[A-Z][A-Z0-9_]*/\w+", re.ASCII)


def statement(message: Message) -> Statement | None:
    """Return what a message states, or why it cannot be used; None for a kind that is not known.

    Raises:
        MeasurementError: A frame of a ping does not say of which ping it is.
        ValueError, TypeError, LookupError, AttributeError, OverflowError: The payload is not what the schema's name promises.
    """
    if message.schema in _MAVLINK:
        return _MAVLINK[message.schema](message)
    reader = _reader(message.schema, message.topic)
    if reader is None and not message.schema:
        # IMC in JSON names its messages inside, when nothing outside does
        reader = _IMC.get(str(message.payload.get("abbrev")))
    return reader(message.payload) if callable(reader) else reader


def may_state(schema: str, topic: str) -> bool:
    """Return whether messages of a schema and topic may state something; where not, ``statement`` gives the same for each of them."""
    # without a schema a message may say inside what it is
    return not schema or schema in _MAVLINK or callable(_reader(schema, topic))


@lru_cache(maxsize=4096)
def _reader(schema: str, topic: str) -> Reader | str | None:
    """Return what reads a topic's messages, or why they cannot be used; None for a kind that is not known."""
    name = canonical(schema)
    package, _, kind = name.rpartition(".")
    reader = (
        _READERS.get(name)
        or _ANY_PACKAGE.get(kind)
        or (_IMC.get(kind) if package.lower() == "imc" else None)
    )
    if name in _POSES and _WISH.search(topic):
        return "by its topic's name a place to go to, not where the vehicle is"
    if reader is None and topic == _BLUEOS_COPY:
        return "repeats the messages that have topics of their own"
    if reader is None and _BLUEOS_FIELD.fullmatch(topic):
        return "one field of a message that has a topic of its own"
    return reader


def canonical(schema: str) -> str:
    """Return a schema's name as ``package.Type``, whatever the spelling."""
    parts = [part for part in _SEPARATORS.split(schema) if part]
    if len(parts) < 2:
        return schema
    # DDS writes package::msg::dds_::Type_
    return ".".join(part.rstrip("_") for part in parts if part not in ("msg", "dds_"))
