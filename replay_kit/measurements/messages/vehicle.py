"""Positions, depths, motion and attitude of the vehicle from the messages that vehicles write.

Each function takes a payload and returns what it states, or in words why that cannot be used. Messages of IMC written as JSON (LSTS/imc,
IMC.xml, messages 253 and 350) have angles in radians and offsets north, east, down.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.measurements.messages.fields import number, whole_number
from replay_kit.measurements.ping.adcp_ping import Attitude, Orientation
from replay_kit.measurements.ping.frames import nortek_rotation

_ATMOSPHERE_PA = 101_325.0
_PA_PER_DBAR = 10_000.0
_TRUE = ("true", "1")
_IMC_VALID_POSITION = 0x0004
_IMC_DEAD_RECKONING = (2, "DEAD_RECKONING")


@dataclass(frozen=True, slots=True)
class Position:
    """A position that a message states; NaN where it does not say.

    Attributes:
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
        dead_reckoned: True when computed, not measured.
    """

    longitude: float
    latitude: float
    depth: float
    dead_reckoned: bool


@dataclass(frozen=True, slots=True)
class Depth:
    """How deep the vehicle is.

    Attributes:
        depth: [m], positive down.
    """

    depth: float


@dataclass(frozen=True, slots=True)
class Pressure:
    """The pressure at the vehicle.

    Attributes:
        pressure_dbar: Sea pressure, 0 at the surface.
    """

    pressure_dbar: float


@dataclass(frozen=True, slots=True)
class Pose:
    """A place in a local frame of the log's own.

    Attributes:
        east: [m].
        north: [m].
        depth: [m], positive down.
        orientation: Of the vehicle; None where its messages are others.
        system: ``mavlink/{system}`` that states the origin of the frame elsewhere; empty for others.
    """

    east: float
    north: float
    depth: float
    orientation: Orientation | None
    system: str = ""


def location_fix(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in a ``foxglove.LocationFix``, or why it is none.

    ``metadata`` may carry ``depth`` [m] and ``dead_reckoned``; the altitude is above the ellipsoid and is not a depth.
    """
    extra = _metadata(payload.get("metadata"))
    dead_reckoned = str(extra.get("dead_reckoned", "")).strip().lower() in _TRUE
    return checked(
        payload.get("longitude"), payload.get("latitude"), number(extra.get("depth")), dead_reckoned
    )


def nav_sat_fix(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in a ``sensor_msgs/NavSatFix``, or why it is none; one that states no status is taken at its word."""
    status = payload.get("status")
    if number(status.get("status") if isinstance(status, Mapping) else status) < 0:
        return "no fix (status < 0)"
    return checked(payload.get("longitude"), payload.get("latitude"), math.nan, False)


def fluid_pressure(payload: Mapping[str, Any]) -> Pressure:
    """Return the pressure of a ``sensor_msgs/FluidPressure`` (absolute, Pa)."""
    return Pressure((number(payload.get("fluid_pressure")) - _ATMOSPHERE_PA) / _PA_PER_DBAR)


def odometry(payload: Mapping[str, Any]) -> Pose | str:
    """Return the pose of a ``nav_msgs/Odometry`` or ``geometry_msgs/PoseWithCovarianceStamped``, or why there is none."""
    pose = payload.get("pose")
    return _pose(
        payload, pose.get("pose") if isinstance(pose, Mapping) else None, "pose.pose.position"
    )


def pose_stamped(payload: Mapping[str, Any]) -> Pose | str:
    """Return the pose of a ``geometry_msgs/PoseStamped``, or why there is none."""
    return _pose(payload, payload.get("pose"), "pose.position")


def _pose(payload: Mapping[str, Any], pose: Any, where: str) -> Pose | str:
    """Return a pose in its frame: x east, y north, z up (ROS REP-103), or x north, y east, z down where the frame's name ends so."""
    position = pose.get("position") if isinstance(pose, Mapping) else None
    if not isinstance(position, Mapping):
        return f"no {where} in it"
    x, y, z = (number(position.get(axis)) for axis in "xyz")
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        return "position is not a number"
    header = payload.get("header")
    frame = (
        str(header.get("frame_id", "")).strip("/").lower() if isinstance(header, Mapping) else ""
    )
    # REP-105 gives the name to the frame whose origin is the Earth's centre
    if frame == "earth":
        return "position in the frame 'earth', whose axes are not east, north and up"
    ned = frame.endswith("ned")
    orientation = orientation_of(pose.get("orientation"), ned)
    return Pose(y, x, z, orientation) if ned else Pose(x, y, -z, orientation)


def orientation_of(quaternion: Any, ned: bool = False) -> Orientation:
    """Return the orientation of a ROS ``Quaternion``; its numbers are NaN where it does not state them.

    Args:
        quaternion: The message, of whatever type.
        ned: Whether its frames have z down; see ``Orientation``.
    """
    stated = quaternion if isinstance(quaternion, Mapping) else {}
    x, y, z, w = (number(stated.get(name)) for name in "xyzw")
    return Orientation((x, y, z, w), ned)


def checked(longitude: Any, latitude: Any, depth: float, dead_reckoned: bool) -> Position | str:
    """Return a position, or why its numbers are none."""
    x, y = number(longitude), number(latitude)
    if not (math.isfinite(x) and math.isfinite(y)):
        return "position is not a number"
    if x == 0.0 and y == 0.0:
        return "position is 0, 0 (no fix)"
    if abs(y) > 90.0 or not -180.0 <= x <= 360.0:
        return "position outside the range of longitude and latitude"
    return Position(x, y, depth, dead_reckoned)


def imc_gps_fix(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in an IMC ``GpsFix`` in JSON, or why it is none; one that states no validity is taken at its word."""
    validity = whole_number(payload.get("validity"))
    if validity is not None and not validity & _IMC_VALID_POSITION:
        return "no fix (validity without VALID_POS)"
    longitude, latitude = (math.degrees(number(payload.get(name))) for name in ("lon", "lat"))
    return checked(longitude, latitude, math.nan, payload.get("type") in _IMC_DEAD_RECKONING)


def imc_estimated_state(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in an IMC ``EstimatedState``, or why it is none: a reference with offsets x north and y east."""
    longitude, latitude = (math.degrees(number(payload.get(name))) for name in ("lon", "lat"))
    reference = checked(longitude, latitude, math.nan, True)
    if isinstance(reference, str):
        return reference
    # an offset that the JSON leaves out is zero
    north, east = (number(payload.get(name, 0.0)) for name in ("x", "y"))
    if not (math.isfinite(north) and math.isfinite(east)):
        return "position is not a number"
    depth = number(payload.get("depth"))
    moved = to_geographic(Projection(reference.longitude, reference.latitude), east, north)
    # negative values denote invalid estimates
    return checked(float(moved[0]), float(moved[1]), depth if depth >= 0.0 else math.nan, True)


def _metadata(pairs: Any) -> dict[str, Any]:
    """Return key-value pairs as a dict; a plain mapping is read too, and what is no pair says nothing."""
    if isinstance(pairs, Mapping):
        return {str(key): value for key, value in pairs.items()}
    if not isinstance(pairs, list | tuple):
        return {}
    return {str(pair.get("key")): pair.get("value") for pair in pairs if isinstance(pair, Mapping)}


_MODES: Mapping[int | None, Literal["bottom", "water"]] = {1: "bottom", 2: "water"}
_INSTRUMENT = 1
Axes = Literal["forward-starboard-down", "forward-left-up"]
# ends of frames' names; a vehicle's base frame has z up (ROS REP-103)
_FRAMES: Mapping[Axes, re.Pattern[str]] = {
    "forward-left-up": re.compile(r"(^|[_/])(flu|base_link|base_footprint)$", re.IGNORECASE),
    "forward-starboard-down": re.compile(r"(^|[_/])(frd|fsd|ned)$", re.IGNORECASE),
}
# m/s; of a DVL that states none: makers state 3 to 30 mm/s for a single ping
_STD = 0.03


@dataclass(frozen=True, slots=True)
class Dvl:
    """How a vehicle moves, by its DVL.

    Attributes:
        mode: Relative to the bottom, or to a layer of water.
        velocity: Of the vehicle [m/s], along x, y, z of its axes.
        error_std: Of a component [m/s].
        axes: As its frame's name says; None where it says nothing.
    """

    mode: Literal["bottom", "water"]
    velocity: tuple[float, float, float]
    error_std: float
    axes: Axes | None = None


def imu(payload: Mapping[str, Any]) -> Orientation | str:
    """Return the orientation of a ``sensor_msgs/Imu``, or why it has none; a first covariance of -1 says so (ROS REP-145)."""
    covariance = payload.get("orientation_covariance")
    if isinstance(covariance, list | tuple) and covariance and number(covariance[0]) == -1.0:
        return "attitude: no orientation stated"
    return orientation_of(payload.get("orientation"))


def dvl(payload: Mapping[str, Any]) -> Dvl | str:
    """Return what a ``marine_acoustic_msgs/Dvl`` or ``ds_sensor_msgs/Dvl`` says of the motion, or why it says nothing.

    The message's convention is that x points forward and z where the instrument looks, which is taken to be down, unless the frame's name
    says otherwise; the velocity is the vehicle's, as its ``course_gnd`` is computed from it. Zeros are no solution.
    """
    mode = _MODES.get(whole_number(payload.get("velocity_mode")))
    if mode is None:
        return "velocity_mode is neither 1 (bottom) nor 2 (water)"
    if whole_number(payload.get("coordinate_mode", _INSTRUMENT)) != _INSTRUMENT:
        return "DVL: coordinate_mode is not 1 (instrument)"
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
    std = math.sqrt(sum(variances) / 2.0) if known else _STD
    header = payload.get("header")
    frame = str(header.get("frame_id", "")) if isinstance(header, Mapping) else ""
    axes = next((axes for axes, names in _FRAMES.items() if names.search(frame)), None)
    return Dvl(mode, (forward, starboard, down), std, axes)


def horizontal(
    stated: Dvl, attitude: Attitude, declination: float, axes: Axes | None = None
) -> tuple[float, float]:
    """Return the velocity of a DVL along true east and north [m/s].

    Args:
        stated: Along the vehicle's axes.
        attitude: Of the vehicle.
        declination: To be added to its heading [degrees east].
        axes: As configured; None takes those of the frame's name, else forward, starboard and down.
    """
    velocity = np.array(stated.velocity)
    if (axes or stated.axes) == "forward-left-up":
        velocity *= (1.0, -1.0, -1.0)
    # Nortek's angles are those of an attitude: nose up, starboard down
    turn = nortek_rotation(attitude.heading + declination, attitude.pitch, attitude.roll, down=True)
    east, north, _ = turn @ velocity
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
