"""Messages of the vehicle's motion and attitude: what they are, and why the estimator does not use them."""

from collections.abc import Mapping
from typing import Any

from replay_kit.measurements.adcp import number, whole_number

_BOTTOM, _WATER = 1, 2


def imu(payload: Mapping[str, Any]) -> str:
    """Return why a ``sensor_msgs/Imu`` is not used; a first covariance of -1 says that it has no orientation (ROS REP-145)."""
    covariance = payload.get("orientation_covariance")
    if isinstance(covariance, list | tuple) and covariance and number(covariance[0]) == -1.0:
        return "attitude: it states no orientation"
    return "attitude: needed only for profiles that are not in earth coordinates, which are not used yet"


def dvl(payload: Mapping[str, Any]) -> str:
    """Return why a ``marine_acoustic_msgs/Dvl`` or ``ds_sensor_msgs/Dvl`` is not used, by its ``velocity_mode``."""
    mode = whole_number(payload.get("velocity_mode"))
    if mode == _BOTTOM:
        return "bottom track: the vehicle's own velocity over ground, not used for currents yet"
    if mode == _WATER:
        return "water track: one velocity through the water, without bins, not used for currents yet"
    return "velocity_mode is neither 1 (bottom) nor 2 (water)"
