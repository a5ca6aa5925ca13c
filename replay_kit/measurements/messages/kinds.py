"""The kinds of message that say something: one table from the schema's name to the function that reads the payload.

ROS 1, ROS 2 and other spellings of a name count as one: ``sensor_msgs/NavSatFix``, ``sensor_msgs/msg/NavSatFix``,
``sensor_msgs::msg::dds_::NavSatFix_``, ``sensor_msgs.NavSatFix``. A ``CurrentProfile`` is known in any package, since each driver has
its own.
"""

import math
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from replay_kit.core.extensions import additions
from replay_kit.core.message import Message
from replay_kit.core.observation import Fix, LinearMeasurement
from replay_kit.measurements.messages import mavlink, profiles, vehicle, water
from replay_kit.measurements.messages.fields import STD_BELIEVED, dive_number, number
from replay_kit.measurements.messages.profiles import StatedPing
from replay_kit.measurements.messages.vehicle import Depth, Pose, Position, Pressure
from replay_kit.measurements.ping.adcp_ping import Orientation
from replay_kit.measurements.vehicle.mean_current import MeanCurrent

_NS = 1_000_000_000


def depth_averaged_current(payload: Mapping[str, Any]) -> MeanCurrent | str:
    """Return the mean current of a ``replay_kit.DepthAveragedCurrent``, or why there is none."""
    velocity = number(payload.get("dac_eastward")), number(payload.get("dac_northward"))
    if not math.isfinite(sum(velocity)):
        return "depth-averaged current: not a number"
    std = number(payload.get("error"))
    start, end = (_fix(payload.get(name)) for name in ("start_fix", "end_fix"))
    believed = std if STD_BELIEVED[0] <= std <= STD_BELIEVED[1] else math.nan
    dive, inverted = dive_number(payload.get("dive")), bool(payload.get("inverted_in"))
    return MeanCurrent(
        velocity, believed, start, end, dive, number(payload.get("max_depth")), inverted
    )


def _fix(stated: Any) -> Fix | None:
    """Return a fix of a payload; None when it does not hold one whole."""
    if not isinstance(stated, Mapping) or not isinstance(stated.get("time"), Mapping):
        return None
    seconds, rest = (number(stated["time"].get(name)) for name in ("sec", "nsec"))
    longitude, latitude = number(stated.get("lon")), number(stated.get("lat"))
    if not (
        0.0 <= seconds < 2**33
        and 0.0 <= rest < 2 * _NS
        and math.isfinite(longitude)
        and abs(latitude) <= 90.0
    ):
        return None
    return Fix(int(seconds) * _NS + int(rest), longitude, latitude)


#: What a message states, or in words why it cannot be used.
Statement = (
    Position
    | Depth
    | Pressure
    | Pose
    | Orientation
    | StatedPing
    | mavlink.PingFrame
    | mavlink.GpsStatus
    | mavlink.NavigationPosition
    | mavlink.LocalOrigin
    | MeanCurrent
    | vehicle.Dvl
    | water.Ctd
    | water.RadarCurrents
    | water.DrifterFix
    | LinearMeasurement
    | str
)
Reader = Callable[[Mapping[str, Any]], Statement]

_READERS: Mapping[str, Reader | str] = MappingProxyType(
    {
        "replay_kit.AdcpPing": profiles.adcp_ping,
        "replay_kit.DepthAveragedCurrent": depth_averaged_current,
        "replay_kit.Ctd": water.ctd,
        "replay_kit.DrifterFix": water.drifter_fix,
        "replay_kit.RadarCurrents": water.radar_currents,
        "replay_kit.Altimeter": "height above the bottom, not used",
        "replay_kit.Battery": "state of the battery, not used",
        "replay_kit.Waypoint": "where the glider steers for, not where it is",
        "ds_sensor_msgs.Adcp": profiles.ds_adcp,
        "foxglove.LocationFix": vehicle.location_fix,
        "foxglove_msgs.LocationFix": vehicle.location_fix,
        "sensor_msgs.NavSatFix": vehicle.nav_sat_fix,
        "sensor_msgs.FluidPressure": vehicle.fluid_pressure,
        "sensor_msgs.Imu": vehicle.imu,
        "nav_msgs.Odometry": vehicle.odometry,
        "geometry_msgs.PoseStamped": vehicle.pose_stamped,
        "geometry_msgs.PoseWithCovarianceStamped": vehicle.odometry,
        "marine_acoustic_msgs.Dvl": vehicle.dvl,
        "ds_sensor_msgs.Dvl": vehicle.dvl,
        "dataflash.GPS": mavlink.dataflash_gps,
        "dataflash.POS": mavlink.dataflash_position,
        "dataflash.CTUN": mavlink.dataflash_depth,
    }
)
# of messages whose topic says of which system they are
_MAVLINK: Mapping[str, Callable[[Message], Statement | None]] = MappingProxyType(
    {
        "DEBUG_FLOAT_ARRAY": mavlink.ping_frame,
        "GLOBAL_POSITION_INT": mavlink.global_position_int,
        "GPS_RAW_INT": mavlink.gps_raw_int,
        "LOCAL_POSITION_NED": mavlink.local_position_ned,
        "GPS_GLOBAL_ORIGIN": mavlink.gps_global_origin,
    }
)
_ANY_PACKAGE: Mapping[str, Reader] = MappingProxyType({"CurrentProfile": profiles.current_profile})
_IMC: Mapping[str, Reader] = MappingProxyType(
    {**_ANY_PACKAGE, "GpsFix": vehicle.imc_gps_fix, "EstimatedState": vehicle.imc_estimated_state}
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
        or additions("sensors", callable, "a function").get(name)
    )
    if name in _POSES and _WISH.search(topic):
        return "topic name suggests a goal, not the vehicle position"
    if reader is None and topic == _BLUEOS_COPY:
        return "repeats messages of other topics"
    if reader is None and _BLUEOS_FIELD.fullmatch(topic):
        return "one field of a message on another topic"
    return reader


def canonical(schema: str) -> str:
    """Return a schema's name as ``package.Type``, whatever the spelling."""
    parts = [part for part in _SEPARATORS.split(schema) if part]
    if len(parts) < 2:
        return schema
    # DDS writes package::msg::dds_::Type_
    return ".".join(part.rstrip("_") for part in parts if part not in ("msg", "dds_"))
