"""Messages of the vehicle's motion and attitude, which give no position: what they are, and why some are not used."""

from collections.abc import Mapping
from typing import Any

from replay_kit.measurements.adcp import number, whole_number
from replay_kit.measurements.attitude import Orientation

_BOTTOM, _WATER = 1, 2


def imu(payload: Mapping[str, Any]) -> Orientation | str:
    """Return the orientation of a ``sensor_msgs/Imu``, or why it has none; a first covariance of -1 says so (ROS REP-145)."""
    covariance = payload.get("orientation_covariance")
    if isinstance(covariance, list | tuple) and covariance and number(covariance[0]) == -1.0:
        return "attitude: it states no orientation"
    return Orientation(payload.get("orientation"))


def dvl(payload: Mapping[str, Any]) -> str:
    """Return why a ``marine_acoustic_msgs/Dvl`` or ``ds_sensor_msgs/Dvl`` is not used, by its ``velocity_mode``."""
    mode = whole_number(payload.get("velocity_mode"))
    if mode == _BOTTOM:
        return "bottom track: the vehicle's own velocity over ground, not used for currents yet"
    if mode == _WATER:
        return "water track: one velocity through the water, without bins, not used for currents yet"
    return "velocity_mode is neither 1 (bottom) nor 2 (water)"
