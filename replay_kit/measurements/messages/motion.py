"""Messages of the vehicle's motion and attitude, which give no position."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from replay_kit.measurements.messages.fields import number, whole_number
from replay_kit.measurements.messages.position import orientation_of
from replay_kit.measurements.ping.attitude import Attitude, Orientation
from replay_kit.measurements.ping.frames import nortek_rotation

_MODES: Mapping[int | None, Literal["bottom", "water"]] = {1: "bottom", 2: "water"}
_INSTRUMENT = 1
# m/s; of a DVL that states none: makers state 3 to 30 mm/s for a single ping
_STD = 0.03


@dataclass(frozen=True, slots=True)
class Dvl:
    """How a vehicle moves, by its DVL.

    Attributes:
        mode: Relative to the bottom, or to a layer of water.
        velocity: Of the vehicle [m/s], along forward, starboard, down.
        error_std: Of a component [m/s].
    """

    mode: Literal["bottom", "water"]
    velocity: tuple[float, float, float]
    error_std: float


def imu(payload: Mapping[str, Any]) -> Orientation | str:
    """Return the orientation of a ``sensor_msgs/Imu``, or why it has none; a first covariance of -1 says so (ROS REP-145)."""
    covariance = payload.get("orientation_covariance")
    if isinstance(covariance, list | tuple) and covariance and number(covariance[0]) == -1.0:
        return "attitude: it states no orientation"
    return orientation_of(payload.get("orientation"))


def dvl(payload: Mapping[str, Any]) -> Dvl | str:
    """Return what a ``marine_acoustic_msgs/Dvl`` or ``ds_sensor_msgs/Dvl`` says of the motion, or why it says nothing.

    The message's convention is that x points forward and z where the instrument looks, which is taken to be down; the velocity is
    the vehicle's, as its ``course_gnd`` is computed from it. Zeros are no solution.
    """
    mode = _MODES.get(whole_number(payload.get("velocity_mode")))
    if mode is None:
        return "velocity_mode is neither 1 (bottom) nor 2 (water)"
    if whole_number(payload.get("coordinate_mode", _INSTRUMENT)) != _INSTRUMENT:
        return "DVL: its coordinate_mode is not 1 (instrument)"
    forward, starboard, down = (number(payload["velocity"].get(axis)) for axis in "xyz")
    if not math.isfinite(forward + starboard + down) or not any((forward, starboard, down)):
        return "DVL: no velocity"
    covariance = payload.get("velocity_covar")
    variances = (
        [number(covariance[k]) for k in (0, 4)]
        if isinstance(covariance, list | tuple) and len(covariance) > 4
        else []
    )
    known = len(variances) == 2 and all(variance > 0.0 for variance in variances)
    return Dvl(mode, (forward, starboard, down), math.sqrt(sum(variances) / 2.0) if known else _STD)


def horizontal(stated: Dvl, attitude: Attitude, declination: float) -> tuple[float, float]:
    """Return the velocity of a DVL along true east and north [m/s].

    Args:
        stated: Along the vehicle's axes.
        attitude: Of the vehicle.
        declination: To be added to its heading [degrees east].
    """
    # Nortek's angles are those of an attitude: nose up, starboard down
    turn = nortek_rotation(attitude.heading + declination, attitude.pitch, attitude.roll, down=True)
    east, north, _ = turn @ np.array(stated.velocity)
    return float(east), float(north)


def water_track(east: float, north: float, error_std: float, distance: float) -> dict[str, Any]:
    """Return a velocity through a layer of water as a ping of one cell: the water's velocity relative to the vehicle is its opposite.

    Args:
        east: Of the vehicle relative to the water, true east [m/s].
        north: True north [m/s].
        error_std: Of each [m/s].
        distance: Of the layer below the vehicle [m].
    """
    return {
        "coordinate_system": "earth",
        "reference": "platform",
        "orientation": "down",
        "n_cells": 1,
        "velocity": [[-east, -north]],
        "velocity_std": error_std,
        "cell_distances": [distance],
        "declination_applied": True,
    }
