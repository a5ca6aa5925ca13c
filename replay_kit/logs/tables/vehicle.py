"""Positions, depths, motion and attitude of vehicles in their messages.

Each function reads the payloads of a schema. ArduPilot's filter continues without GPS: its positions count as dead-reckoned in DataFlash
logs, and in telemetry where the GPS has no fix.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic_about
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    field,
    first_reason,
    padded_rows,
    stated_numbers,
    whole_number,
)

Payloads = Sequence[Payload]
_ATMOSPHERE_PA, _PA_PER_DBAR = 101_325.0, 10_000.0
_TRUE = ("true", "1")
_IMC_VALID_POSITION, _IMC_DEAD_RECKONING = 0x0004, (2, "DEAD_RECKONING")
_FIX_3D = 3
_EARTH = "position in the frame 'earth', whose axes are not east, north and up"
_NO_NUMBER = "position is not a number"
# ends of frames' names; a vehicle's base frame has z up (ROS REP-103)
_UP = re.compile(r"(^|[_/])(flu|base_link|base_footprint)$", re.IGNORECASE)
_DOWN = re.compile(r"(^|[_/])(frd|fsd|ned)$", re.IGNORECASE)
# m/s; of a DVL that states none: makers state 3 to 30 mm/s for a single ping
_DVL_STD = 0.03


def no_place(longitude: Any, latitude: Any) -> dict[str, Any]:
    """Return masks of invalid positions by reason."""
    return {
        _NO_NUMBER: ~(np.isfinite(longitude) & np.isfinite(latitude)),
        "position is 0, 0 (no fix)": np.equal(longitude, 0.0) & np.equal(latitude, 0.0),
        "position outside the range of longitude and latitude": (np.abs(latitude) > 90.0)
        | np.less(longitude, -180.0)
        | np.greater(longitude, 360.0),
    }


def _positions(
    payloads: Payloads,
    names: str = "longitude latitude",
    unit: float = 1.0,
    reasons: Mapping[str, Any] = MappingProxyType({}),
    depth: Any = math.nan,
    reckoned: Any = False,
) -> Rows:
    """Return positions.

    Args:
        payloads: Payloads.
        names: Fields of longitude and latitude.
        unit: Unit of longitude and latitude [degrees].
        reasons: Further reasons for exclusion.
        depth: Depth [m].
        reckoned: Whether they are dead-reckoned.
    """
    longitude, latitude = (unit * one for one in stated_numbers(payloads, names))
    place = {"longitude": longitude, "latitude": latitude}
    columns = {**place, "depth": depth, "dead_reckoned": reckoned}
    return Rows("position", columns, {**reasons, **no_place(longitude, latitude)})


def _location_fixes(payloads: Payloads) -> Rows:
    """Return positions with ``depth`` [m] and ``dead_reckoned`` in ``metadata``; the ellipsoidal altitude is no depth."""
    extra = [*map(_metadata, field(payloads, "metadata"))]
    reckoned = [str(one).strip().lower() in _TRUE for one in field(extra, "dead_reckoned")]
    return _positions(payloads, depth=stated_numbers(extra, "depth")[0], reckoned=reckoned)


def _metadata(pairs: Any) -> Payload:
    """Return key-value pairs or a mapping as a dict; other contents are ignored."""
    if isinstance(pairs, list | tuple):
        return {str(one.get("key")): one.get("value") for one in pairs if hasattr(one, "get")}
    return pairs or {}


def _nav_sat_fixes(payloads: Payloads) -> Rows:
    """Return positions; a missing status counts as valid."""
    status, inner = stated_numbers(payloads, "status status.status")
    return _positions(payloads, reasons={"no fix (status < 0)": (status < 0) | (inner < 0)})


def _stamped_poses(payloads: Payloads, part: str = "pose.") -> Rows:
    """Return the poses in a part of messages.

    x is east, y north, z up (ROS REP-103), or x north, y east, z down by the end of the frame's name.
    """
    frames = [frame.strip("/").lower() for frame in _frames(payloads)]
    ned = np.array([frame.endswith("ned") for frame in frames])
    held = field(payloads, part + "position")
    reasons = {
        f"no {part}position in it": [not isinstance(one, Mapping) for one in held],
        # REP-105 gives the name to the frame whose origin is the Earth's centre
        _EARTH: [frame == "earth" for frame in frames],
    }
    xyz = stated_numbers(payloads, "x y z", part + "position.")
    return _poses(xyz, ned, reasons, _quaternions(payloads, part), system="", oriented=True)


def _poses(
    xyz: Sequence[Array], ned: Any, reasons: Mapping[str, Any], quaternion: Any, **fixed: Any
) -> Rows:
    """Return poses with axes north, east, down or east, north, up."""
    x, y, z = xyz
    columns = {
        "east": np.where(ned, y, x),
        "north": np.where(ned, x, y),
        "depth": np.where(ned, z, -z),
        "quaternion": quaternion,
        "ned": ned,
    }
    return Rows("pose", columns, {**reasons, _NO_NUMBER: np.isnan(x + y + z)}, fixed)


def _frames(payloads: Payloads) -> list[str]:
    return [*map(str, field(payloads, "header.frame_id"))]


def _quaternions(payloads: Payloads, part: str = "") -> Array:
    """Return x, y, z, w of ROS ``Quaternion``s, shape (n, 4)."""
    return np.column_stack(stated_numbers(payloads, "x y z w", part + "orientation."))


def _imus(payloads: Payloads) -> Rows:
    """Return the orientations of ``sensor_msgs/Imu`` messages; a first covariance of -1 means none (ROS REP-145)."""
    none = padded_rows(field(payloads, "orientation_covariance"), 1)[:, 0] == -1.0
    columns = {"quaternion": _quaternions(payloads), "ned": False}
    return Rows("attitude", columns, {"attitude: no orientation stated": none})


def _imc_gps_fixes(payloads: Payloads) -> Rows:
    """Return positions; a missing validity counts as valid."""
    validity = map(whole_number, field(payloads, "validity"))
    invalid = [flags is not None and not flags & _IMC_VALID_POSITION for flags in validity]
    reckoned = [kind in _IMC_DEAD_RECKONING for kind in field(payloads, "type")]
    reasons = {"no fix (validity without VALID_POS)": invalid}
    return _positions(payloads, "lon lat", math.degrees(1.0), reasons, reckoned=reckoned)


def _imc_estimated_states(payloads: Payloads) -> Rows:
    """Return positions of a reference with offsets x north and y east; negative depths denote invalid estimates."""
    # an offset that the JSON leaves out is zero
    payloads = [{"x": 0.0, "y": 0.0, **payload} for payload in payloads]
    *reference, north, east, depth = stated_numbers(payloads, "lon lat x y depth")
    places = np.where(np.isnan(north + east), np.nan, np.degrees(reference))
    placed = first_reason(no_place(*places)) == ""
    places = np.where(placed, to_geographic_about(places[0], places[1], east, north), places)
    said = [{"longitude": x, "latitude": y} for x, y in places.T]
    return _positions(said, depth=np.where(depth >= 0.0, depth, np.nan), reckoned=True)


def _dvls(payloads: Payloads) -> Rows:
    """Return velocity, error, bottom lock and axes of DVL messages.

    x points forward and z along the beams, assumed down unless the frame's name differs; the velocity is the vehicle's, as ``course_gnd``
    is computed from it. Zeros mean no solution.
    """
    mode, coordinates = stated_numbers(payloads, "velocity_mode coordinate_mode")
    given = [one is not None for one in field(payloads, "coordinate_mode")]
    velocity = np.column_stack(stated_numbers(payloads, "x y z", "velocity."))
    variances = padded_rows(field(payloads, "velocity_covar"), 5)[:, (0, 4)]
    known, frames = (variances > 0.0).all(axis=1), _frames(payloads)
    columns = {
        "velocity": velocity,
        "error_std": np.where(known, np.sqrt(variances.sum(axis=1) / 2.0), _DVL_STD),
        "bottom": mode == 1,
        "axes": [2 if _UP.search(name) else 1 if _DOWN.search(name) else 0 for name in frames],
    }
    reasons = {
        "velocity_mode is neither 1 (bottom) nor 2 (water)": (mode != 1) & (mode != 2),
        "DVL: coordinate_mode is not 1 (instrument)": np.array(given) & (coordinates != 1),
        "DVL: no velocity": np.isnan(velocity).any(axis=1) | ~velocity.any(axis=1),
    }
    return Rows("dvl", columns, reasons)


def _no_fix(payloads: Payloads, name: str) -> dict[str, Any]:
    return {f"no fix ({name} < {_FIX_3D})": ~(stated_numbers(payloads, name)[0] >= _FIX_3D)}


def _pressures(payloads: Payloads) -> Rows:
    """Return sea pressures [dbar] from absolute ones [Pa]."""
    pressure = (stated_numbers(payloads, "fluid_pressure")[0] - _ATMOSPHERE_PA) / _PA_PER_DBAR
    return Rows("depth", {"pressure": pressure}, fixed={"by": "pressure"})


Read = Callable[[Payloads], Rows]
#: What reads the messages of which one sender counts. The positions of ArduPilot's filter, and the depths that its controller uses; BARO
#: is left alone: which of its sensors is in the water, and which in the hull or in the air, it does not say.
SENDING: Mapping[str, Read] = {
    "GLOBAL_POSITION_INT": lambda them: _positions(
        them, "lon lat", 1e-7, depth=-1e-3 * stated_numbers(them, "relative_alt")[0]
    ),
    "GPS_RAW_INT": lambda them: Rows(
        "gps", {"no_fix": first_reason(_no_fix(them, "fix_type")).astype(object)}
    ),
    "LOCAL_POSITION_NED": lambda them: _poses(
        stated_numbers(them, "x y z"), True, {}, np.full((1, 4), np.nan), oriented=False
    ),
    "GPS_GLOBAL_ORIGIN": lambda them: _positions(them, unit=1e-7)._replace(kind="origin"),
    "dataflash.GPS": lambda them: _positions(
        them,
        "Lng Lat",
        reasons={"not the first GPS receiver": stated_numbers(them, "I")[0] > 0}
        | _no_fix(them, "Status"),
    ),
    "dataflash.POS": lambda them: _positions(them, "Lng Lat", reckoned=True),
    "dataflash.CTUN": lambda them: Rows(
        "depth", {"depth": -stated_numbers(them, "Alt")[0]}, fixed={"by": "depth"}
    ),
}
#: What reads those of other schemas.
READERS: Mapping[str, Read] = {
    "foxglove.LocationFix": _location_fixes,
    "foxglove_msgs.LocationFix": _location_fixes,
    "sensor_msgs.NavSatFix": _nav_sat_fixes,
    "sensor_msgs.FluidPressure": _pressures,
    "sensor_msgs.Imu": _imus,
    "nav_msgs.Odometry": partial(_stamped_poses, part="pose.pose."),
    "geometry_msgs.PoseStamped": _stamped_poses,
    "geometry_msgs.PoseWithCovarianceStamped": partial(_stamped_poses, part="pose.pose."),
    "marine_acoustic_msgs.Dvl": _dvls,
    "ds_sensor_msgs.Dvl": _dvls,
}
#: What reads those of IMC.
IMC: Mapping[str, Read] = {"GpsFix": _imc_gps_fixes, "EstimatedState": _imc_estimated_states}
