"""Positions, depths, motion and attitude of the vehicle in the messages that vehicles write.

Each function takes a payload and returns a row's values, or in words why that cannot be used. A filter's position in ArduPilot's logs goes
on when GPS is lost: in the log that it writes itself it is taken for dead-reckoned, in telemetry where the GPS says so.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.columns import (
    Payload,
    each,
    field,
    number,
    numbers,
    table,
    unused,
    whole_number,
)

_ATMOSPHERE_PA, _PA_PER_DBAR = 101_325.0, 10_000.0
_TRUE = ("true", "1")
_IMC_VALID_POSITION, _IMC_DEAD_RECKONING = 0x0004, (2, "DEAD_RECKONING")
_NAN4 = (math.nan,) * 4
_FIX_3D = 3
NO_NUMBER, NO_FIX, OUTSIDE = (
    "position is not a number",
    "position is 0, 0 (no fix)",
    "position outside the range of longitude and latitude",
)

#: Longitude, latitude, depth (NaN where not stated), whether it is dead-reckoned.
Place = tuple[float, float, float, bool]
#: East, north, depth, quaternion x, y, z, w, whether its axes are forward, starboard, down.
Pose = tuple[float, float, float, tuple[float, float, float, float], bool]


def location_fixes(raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the positions of ``foxglove.LocationFix`` messages.

    ``metadata`` may carry ``depth`` [m] and ``dead_reckoned``; the altitude is above the ellipsoid and is not a depth.
    """
    del config
    payloads = raw.payloads
    longitude, latitude = (numbers(field(payloads, name)) for name in ("longitude", "latitude"))
    reasons = np.full(longitude.size, "", object)
    reasons[(np.abs(latitude) > 90.0) | (longitude < -180.0) | (longitude > 360.0)] = OUTSIDE
    reasons[(longitude == 0.0) & (latitude == 0.0)] = NO_FIX
    reasons[~np.isfinite(longitude + latitude)] = NO_NUMBER
    try:
        # as most encodings write it
        extra = [
            {pair["key"]: pair["value"] for pair in pairs} if pairs else {}
            for pairs in field(payloads, "metadata")
        ]
    except (TypeError, LookupError):
        extra = [dict(_metadata(pairs)) for pairs in field(payloads, "metadata")]
    reckoned = each(lambda said: str(said).strip().lower() in _TRUE, field(extra, "dead_reckoned"))
    good = reasons == ""
    columns = {
        "longitude": longitude[good],
        "latitude": latitude[good],
        "depth": numbers(field(extra, "depth"))[good],
        "dead_reckoned": np.array(reckoned)[good],
    }
    found = [table(raw, "position", good, columns)] if good.any() else []
    return unused(raw, reasons) + found


def _metadata(pairs: Any) -> Payload:
    """Return key-value pairs as a dict; a plain mapping is read too, and what is no pair says nothing."""
    if isinstance(pairs, list | tuple):
        return {
            str(pair.get("key")): pair.get("value") for pair in pairs if isinstance(pair, Mapping)
        }
    return {str(key): value for key, value in pairs.items()} if isinstance(pairs, Mapping) else {}


def checked(longitude: Any, latitude: Any, depth: float, dead_reckoned: bool) -> Place | str:
    """Return a position, or why its numbers are none."""
    x, y = number(longitude), number(latitude)
    if not (math.isfinite(x) and math.isfinite(y)):
        return NO_NUMBER
    if x == 0.0 and y == 0.0:
        return NO_FIX
    if abs(y) > 90.0 or not -180.0 <= x <= 360.0:
        return OUTSIDE
    return x, y, depth, dead_reckoned


def nav_sat_fix(payload: Payload) -> Place | str:
    """Return the position in a ``sensor_msgs/NavSatFix``, or why it is none; one that states no status is taken at its word."""
    status = payload.get("status")
    if number(status.get("status") if isinstance(status, Mapping) else status) < 0:
        return "no fix (status < 0)"
    return checked(payload.get("longitude"), payload.get("latitude"), math.nan, False)


def fluid_pressure(payload: Payload) -> tuple[float]:
    """Return the sea pressure [dbar] of a ``sensor_msgs/FluidPressure`` (absolute, Pa)."""
    return ((number(payload.get("fluid_pressure")) - _ATMOSPHERE_PA) / _PA_PER_DBAR,)


def odometry(payload: Payload) -> Pose | str:
    """Return the pose of a ``nav_msgs/Odometry`` or ``geometry_msgs/PoseWithCovarianceStamped``, or why there is none."""
    pose = payload.get("pose")
    inner = pose.get("pose") if isinstance(pose, Mapping) else None
    return _pose(payload, inner, "pose.pose.position")


def pose_stamped(payload: Payload) -> Pose | str:
    """Return the pose of a ``geometry_msgs/PoseStamped``, or why there is none."""
    return _pose(payload, payload.get("pose"), "pose.position")


def _pose(payload: Payload, pose: Any, where: str) -> Pose | str:
    """Return a pose in its frame: x east, y north, z up (ROS REP-103), or x north, y east, z down where the frame's name ends so."""
    position = pose.get("position") if isinstance(pose, Mapping) else None
    if not isinstance(position, Mapping):
        return f"no {where} in it"
    x, y, z = (number(position.get(axis)) for axis in "xyz")
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        return NO_NUMBER
    frame = _frame(payload).strip("/").lower()
    # REP-105 gives the name to the frame whose origin is the Earth's centre
    if frame == "earth":
        return "position in the frame 'earth', whose axes are not east, north and up"
    quaternion, ned = _quaternion(pose.get("orientation")), frame.endswith("ned")
    return (y, x, z, quaternion, True) if ned else (x, y, -z, quaternion, False)


def _frame(payload: Payload) -> str:
    header = payload.get("header")
    return str(header.get("frame_id", "")) if isinstance(header, Mapping) else ""


def _quaternion(stated: Any) -> tuple[float, float, float, float]:
    """Return x, y, z, w of a ROS ``Quaternion``; NaN where it does not state them."""
    held = stated if isinstance(stated, Mapping) else {}
    x, y, z, w = (number(held.get(name)) for name in "xyzw")
    return x, y, z, w


def imu(payload: Payload) -> tuple[tuple[float, float, float, float], bool] | str:
    """Return the orientation of a ``sensor_msgs/Imu``, or why it has none; a first covariance of -1 says so (ROS REP-145)."""
    covariance = payload.get("orientation_covariance")
    if isinstance(covariance, list | tuple) and covariance and number(covariance[0]) == -1.0:
        return "attitude: no orientation stated"
    return _quaternion(payload.get("orientation")), False


def imc_gps_fix(payload: Payload) -> Place | str:
    """Return the position in an IMC ``GpsFix`` in JSON, or why it is none; one that states no validity is taken at its word."""
    validity = whole_number(payload.get("validity"))
    if validity is not None and not validity & _IMC_VALID_POSITION:
        return "no fix (validity without VALID_POS)"
    longitude, latitude = (math.degrees(number(payload.get(name))) for name in ("lon", "lat"))
    return checked(longitude, latitude, math.nan, payload.get("type") in _IMC_DEAD_RECKONING)


def imc_estimated_state(payload: Payload) -> Place | str:
    """Return the position in an IMC ``EstimatedState``, or why it is none: a reference with offsets x north and y east."""
    longitude, latitude = (math.degrees(number(payload.get(name))) for name in ("lon", "lat"))
    reference = checked(longitude, latitude, math.nan, True)
    if isinstance(reference, str):
        return reference
    # an offset that the JSON leaves out is zero
    north, east = (number(payload.get(name, 0.0)) for name in ("x", "y"))
    if not (math.isfinite(north) and math.isfinite(east)):
        return NO_NUMBER
    depth = number(payload.get("depth"))
    moved = to_geographic(Projection(reference[0], reference[1]), east, north)
    # negative values denote invalid estimates
    return checked(float(moved[0]), float(moved[1]), depth if depth >= 0.0 else math.nan, True)


# ends of frames' names; a vehicle's base frame has z up (ROS REP-103)
_UP = re.compile(r"(^|[_/])(flu|base_link|base_footprint)$", re.IGNORECASE)
_DOWN = re.compile(r"(^|[_/])(frd|fsd|ned)$", re.IGNORECASE)
# m/s; of a DVL that states none: makers state 3 to 30 mm/s for a single ping
_DVL_STD = 0.03


def dvl(payload: Payload) -> tuple[tuple[float, float, float], float, bool, int] | str:
    """Return velocity, error, whether it is relative to the bottom, and axes of a DVL's message, or why it says nothing.

    The message's convention is that x points forward and z where the instrument looks, which is taken to be down, unless the frame's name
    says otherwise; the velocity is the vehicle's, as its ``course_gnd`` is computed from it. Zeros are no solution.
    """
    mode = whole_number(payload.get("velocity_mode"))
    if mode not in (1, 2):
        return "velocity_mode is neither 1 (bottom) nor 2 (water)"
    if whole_number(payload.get("coordinate_mode", 1)) != 1:
        return "DVL: coordinate_mode is not 1 (instrument)"
    forward, starboard, down = (number(payload["velocity"].get(axis)) for axis in "xyz")
    if not math.isfinite(forward + starboard + down) or not any((forward, starboard, down)):
        return "DVL: no velocity"
    covariance = payload.get("velocity_covar")
    variances = []
    if isinstance(covariance, list | tuple) and len(covariance) > 4:
        variances = [number(covariance[k]) for k in (0, 4)]
    known = bool(variances) and all(variance > 0.0 for variance in variances)
    std = math.sqrt(sum(variances) / 2.0) if known else _DVL_STD
    frame = _frame(payload)
    axes = 2 if _UP.search(frame) else 1 if _DOWN.search(frame) else 0
    return (forward, starboard, down), std, mode == 1, axes


def local_position_ned(payload: Payload) -> Pose | str:
    """Return the position in a ``LOCAL_POSITION_NED``, or why it is none."""
    north, east, down = (number(payload.get(axis)) for axis in "xyz")
    return (east, north, down, _NAN4, True) if math.isfinite(north + east + down) else NO_NUMBER


def gps_global_origin(payload: Payload) -> tuple[float, float] | str:
    """Return the origin in a ``GPS_GLOBAL_ORIGIN``, or why it is none."""
    longitude, latitude = (number(payload.get(name)) for name in ("longitude", "latitude"))
    found = checked(1e-7 * longitude, 1e-7 * latitude, math.nan, False)
    return found if isinstance(found, str) else found[:2]


def gps_raw_int(payload: Payload) -> tuple[str]:
    """Return why a ``GPS_RAW_INT`` has no three-dimensional fix; empty where it has one."""
    return (_no_fix(payload, "fix_type"),)


def global_position_int(payload: Payload) -> Place | str:
    """Return the position in a ``GLOBAL_POSITION_INT``, or why it is none."""
    longitude, latitude = number(payload.get("lon")) * 1e-7, number(payload.get("lat")) * 1e-7
    return checked(longitude, latitude, -number(payload.get("relative_alt")) * 1e-3, False)


def dataflash_gps(payload: Payload) -> Place | str:
    """Return the first receiver's fix, or why there is none."""
    if number(payload.get("I", 0)) > 0:
        return "not the first GPS receiver"
    return _no_fix(payload, "Status") or checked(
        payload.get("Lng"), payload.get("Lat"), math.nan, False
    )


def dataflash_position(payload: Payload) -> Place | str:
    """Return the filter's position, or why it is none."""
    return checked(payload.get("Lng"), payload.get("Lat"), math.nan, True)


def dataflash_depth(payload: Payload) -> tuple[float]:
    """Return the depth that the vehicle's controller uses.

    BARO is left alone: which of its sensors is in the water, and which in the hull or in the air, it does not say.
    """
    return (-number(payload.get("Alt")),)


def _no_fix(payload: Payload, name: str) -> str:
    return "" if number(payload.get(name)) >= _FIX_3D else f"no fix ({name} < {_FIX_3D})"
