"""Positions, depths, motion and attitude of the vehicle in the messages that vehicles write.

Each function reads the payloads of a schema. A filter's position in ArduPilot's logs goes on when GPS is lost: in the log
that it writes itself it is taken for dead-reckoned, in telemetry where the GPS says so.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.logs.tables.columns import Payload, Rows, field, rows, stated, whole_number, why

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
    """Return why numbers are no position, from where that holds."""
    return {
        _NO_NUMBER: ~(np.isfinite(longitude) & np.isfinite(latitude)),
        "position is 0, 0 (no fix)": np.equal(longitude, 0.0) & np.equal(latitude, 0.0),
        "position outside the range of longitude and latitude": (np.abs(latitude) > 90.0)
        | np.less(longitude, -180.0)
        | np.greater(longitude, 360.0),
    }


def _positions(
    place: Any, reasons: Mapping[str, Any], depth: Any = math.nan, reckoned: Any = False
) -> Rows:
    """Return positions.

    Args:
        place: Longitude and latitude [degrees].
        reasons: Why one is not used, whatever its place.
        depth: [m].
        reckoned: Whether they are dead-reckoned.
    """
    columns = {
        "longitude": place[0],
        "latitude": place[1],
        "depth": depth,
        "dead_reckoned": reckoned,
    }
    return Rows("position", columns, {**reasons, **no_place(*place)})


def _place(payloads: Payloads, names: str = "longitude latitude", unit: float = 1.0) -> Any:
    """Return longitudes and latitudes, shape (2, n) [degrees], of fields in another unit."""
    return unit * np.array(stated(payloads, names))


def location_fixes(payloads: Payloads) -> Rows:
    """Return the positions of ``foxglove.LocationFix`` messages.

    ``metadata`` may carry ``depth`` [m] and ``dead_reckoned``; the altitude is above the ellipsoid and is not a depth.
    """
    extra = [*map(_metadata, field(payloads, "metadata"))]
    reckoned = [str(one).strip().lower() in _TRUE for one in field(extra, "dead_reckoned")]
    return _positions(_place(payloads), {}, stated(extra, "depth")[0], reckoned)


def _metadata(pairs: Any) -> Payload:
    """Return key-value pairs as a dict; a plain mapping is read too, and what is no pair says nothing."""
    if isinstance(pairs, list | tuple):
        return {str(one.get("key")): one.get("value") for one in pairs if hasattr(one, "get")}
    return pairs or {}


def nav_sat_fixes(payloads: Payloads) -> Rows:
    """Return the positions of ``sensor_msgs/NavSatFix`` messages; one that states no status is taken at its word."""
    status, inner = stated(payloads, "status status.status")
    return _positions(_place(payloads), {"no fix (status < 0)": (status < 0) | (inner < 0)})


def fluid_pressures(payloads: Payloads) -> Rows:
    """Return the sea pressures [dbar] of ``sensor_msgs/FluidPressure`` messages (absolute, Pa)."""
    pressure = (stated(payloads, "fluid_pressure")[0] - _ATMOSPHERE_PA) / _PA_PER_DBAR
    return Rows("depth", {"pressure": pressure}, fixed={"by": "pressure"})


def poses(payloads: Payloads, part: str = "pose.") -> Rows:
    """Return the poses in a part of messages.

    x is east, y north, z up (ROS REP-103), or x north, y east, z down where the frame's name ends so.
    """
    frames = [frame.strip("/").lower() for frame in _frames(payloads)]
    ned = np.array([frame.endswith("ned") for frame in frames])
    held = field(payloads, part + "position")
    reasons = {
        f"no {part}position in it": [not isinstance(one, Mapping) for one in held],
        # REP-105 gives the name to the frame whose origin is the Earth's centre
        _EARTH: [frame == "earth" for frame in frames],
    }
    xyz = stated(payloads, "x y z", part + "position.")
    return _poses(xyz, ned, reasons, _quaternions(payloads, part), system="", oriented=True)


def _poses(
    xyz: Sequence[Array], ned: Any, reasons: Mapping[str, Any], quaternion: Any, **fixed: Any
) -> Rows:
    """Return poses whose axes are north, east and down, or east, north and up."""
    x, y, z = xyz
    columns = {
        "east": np.where(ned, y, x),
        "north": np.where(ned, x, y),
        "depth": np.where(ned, z, -z),
        "quaternion": quaternion,
        "ned": ned,
    }
    return Rows("pose", columns, {**reasons, _NO_NUMBER: np.isnan(x + y + z)}, fixed)


def poses_within(payloads: Payloads) -> Rows:
    """Return the poses of ``nav_msgs/Odometry`` or ``geometry_msgs/PoseWithCovarianceStamped`` messages."""
    return poses(payloads, "pose.pose.")


def local_positions_ned(payloads: Payloads) -> Rows:
    """Return the positions of ``LOCAL_POSITION_NED`` messages."""
    return _poses(stated(payloads, "x y z"), True, {}, np.full((1, 4), np.nan), oriented=False)


def _frames(payloads: Payloads) -> list[str]:
    return [*map(str, field(payloads, "header.frame_id"))]


def _quaternions(payloads: Payloads, part: str = "") -> Array:
    """Return x, y, z, w of ROS ``Quaternion``s, shape (n, 4)."""
    return np.column_stack(stated(payloads, "x y z w", part + "orientation."))


def imus(payloads: Payloads) -> Rows:
    """Return the orientations of ``sensor_msgs/Imu`` messages; a first covariance of -1 says that there is none (ROS REP-145)."""
    none = rows(field(payloads, "orientation_covariance"), 1)[:, 0] == -1.0
    columns = {"quaternion": _quaternions(payloads), "ned": False}
    return Rows("attitude", columns, {"attitude: no orientation stated": none})


def imc_gps_fixes(payloads: Payloads) -> Rows:
    """Return the positions of IMC ``GpsFix`` messages in JSON; one that states no validity is taken at its word."""
    validity = map(whole_number, field(payloads, "validity"))
    invalid = [flags is not None and not flags & _IMC_VALID_POSITION for flags in validity]
    reckoned = [kind in _IMC_DEAD_RECKONING for kind in field(payloads, "type")]
    place = _place(payloads, "lon lat", math.degrees(1.0))
    return _positions(place, {"no fix (validity without VALID_POS)": invalid}, reckoned=reckoned)


def imc_estimated_states(payloads: Payloads) -> Rows:
    """Return the positions of IMC ``EstimatedState`` messages: a reference with offsets x north and y east."""
    # an offset that the JSON leaves out is zero
    payloads = [{"x": 0.0, "y": 0.0, **payload} for payload in payloads]
    *reference, north, east, depth = stated(payloads, "lon lat x y depth")
    places = np.where(np.isnan(north + east), np.nan, np.degrees(reference))
    for k in np.flatnonzero(why(no_place(*places)) == ""):
        places[:, k] = to_geographic(Projection(*places[:, k]), east[k], north[k])
    # negative values denote invalid estimates
    return _positions(places, {}, np.where(depth >= 0.0, depth, np.nan), True)


def dvls(payloads: Payloads) -> Rows:
    """Return velocity, error, whether it is relative to the bottom, and axes of DVLs' messages.

    The message's convention is that x points forward and z where the instrument looks, which is taken to be down, unless the frame's name
    says otherwise; the velocity is the vehicle's, as its ``course_gnd`` is computed from it. Zeros are no solution.
    """
    mode, coordinates = stated(payloads, "velocity_mode coordinate_mode")
    given = [one is not None for one in field(payloads, "coordinate_mode")]
    velocity = np.column_stack(stated(payloads, "x y z", "velocity."))
    variances = rows(field(payloads, "velocity_covar"), 5)[:, (0, 4)]
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


def gps_global_origins(payloads: Payloads) -> Rows:
    """Return the origins of ``GPS_GLOBAL_ORIGIN`` messages."""
    return _positions(_place(payloads, unit=1e-7), {})._replace(kind="origin")


def gps_raw_ints(payloads: Payloads) -> Rows:
    """Return why ``GPS_RAW_INT`` messages have no three-dimensional fix; empty where one has."""
    return Rows("gps", {"no_fix": why(_no_fix(payloads, "fix_type")).astype(object)})


def global_positions_int(payloads: Payloads) -> Rows:
    """Return the positions of ``GLOBAL_POSITION_INT`` messages."""
    depth = -1e-3 * stated(payloads, "relative_alt")[0]
    return _positions(_place(payloads, "lon lat", 1e-7), {}, depth)


def dataflash_gps(payloads: Payloads) -> Rows:
    """Return the first receiver's fixes."""
    other = {"not the first GPS receiver": stated(payloads, "I")[0] > 0}
    return _positions(_place(payloads, "Lng Lat"), other | _no_fix(payloads, "Status"))


def dataflash_positions(payloads: Payloads) -> Rows:
    """Return the filter's positions."""
    return _positions(_place(payloads, "Lng Lat"), {}, reckoned=True)


def dataflash_depths(payloads: Payloads) -> Rows:
    """Return the depths that the vehicle's controller uses.

    BARO is left alone: which of its sensors is in the water, and which in the hull or in the air, it does not say.
    """
    return Rows("depth", {"depth": -stated(payloads, "Alt")[0]}, fixed={"by": "depth"})


def _no_fix(payloads: Payloads, name: str) -> dict[str, Any]:
    return {f"no fix ({name} < {_FIX_3D})": ~(stated(payloads, name)[0] >= _FIX_3D)}
