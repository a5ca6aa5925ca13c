"""Positions, depths, motion and attitude of the vehicle in the messages that vehicles write.

Each function returns the tables of the messages of a schema. A filter's position in ArduPilot's logs goes on when GPS is lost: in the log
that it writes itself it is taken for dead-reckoned, in telemetry where the GPS says so.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.table import Raw
from replay_kit.logs.tables.columns import (
    Payload,
    Tables,
    each,
    field,
    kept,
    rows,
    stated,
    whole_number,
    why,
)

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


def no_place(longitude: Any, latitude: Any) -> Any:
    """Return why numbers are no position; empty where they are one."""
    return why(
        {
            _NO_NUMBER: ~(np.isfinite(longitude) & np.isfinite(latitude)),
            "position is 0, 0 (no fix)": np.equal(longitude, 0.0) & np.equal(latitude, 0.0),
            "position outside the range of longitude and latitude": (np.abs(latitude) > 90.0)
            | np.less(longitude, -180.0)
            | np.greater(longitude, 360.0),
        }
    )


def _positions(
    raw: Raw,
    place: Any,
    depth: Any = math.nan,
    dead_reckoned: Any = False,
    reasons: Any = "",
    **fixed: Any,
) -> Tables:
    """Return the positions of messages.

    Args:
        raw: The messages.
        place: Longitude and latitude [degrees].
        depth: [m].
        dead_reckoned: Whether they are.
        reasons: Why a message is not used, whatever its position.
        fixed: As in ``Table``.
    """
    columns = {
        **dict(zip(("longitude", "latitude"), place, strict=True)),
        "depth": depth,
        "dead_reckoned": dead_reckoned,
    }
    reasons = np.where(np.equal(reasons, ""), no_place(*place), reasons)
    return kept(raw, "position", reasons, columns, **fixed)


def _place(raw: Raw, names: str = "longitude latitude", unit: float = 1.0) -> Any:
    """Return longitudes and latitudes, shape (2, n) [degrees], of fields in another unit."""
    return unit * np.array(stated(raw.payloads, names))


def location_fixes(raw: Raw) -> Tables:
    """Return the positions of ``foxglove.LocationFix`` messages.

    ``metadata`` may carry ``depth`` [m] and ``dead_reckoned``; the altitude is above the ellipsoid and is not a depth.
    """
    extra = [*map(_metadata, field(raw.payloads, "metadata"))]
    reckoned = each(lambda said: str(said).strip().lower() in _TRUE, field(extra, "dead_reckoned"))
    (depth,) = stated(extra, "depth")
    return _positions(raw, _place(raw), depth, dead_reckoned=reckoned)


def _metadata(pairs: Any) -> Payload:
    """Return key-value pairs as a dict; a plain mapping is read too, and what is no pair says nothing."""
    if isinstance(pairs, list | tuple):
        return {str(one.get("key")): one.get("value") for one in pairs if isinstance(one, Mapping)}
    return pairs if isinstance(pairs, Mapping) else {}


def nav_sat_fixes(raw: Raw) -> Tables:
    """Return the positions of ``sensor_msgs/NavSatFix`` messages; one that states no status is taken at its word."""
    status, inner = stated(raw.payloads, "status status.status")
    reasons = why({"no fix (status < 0)": (status < 0) | (inner < 0)})
    return _positions(raw, _place(raw), reasons=reasons)


def fluid_pressures(raw: Raw) -> Tables:
    """Return the sea pressures [dbar] of ``sensor_msgs/FluidPressure`` messages (absolute, Pa)."""
    (pressure,) = stated(raw.payloads, "fluid_pressure")
    columns = {"pressure": (pressure - _ATMOSPHERE_PA) / _PA_PER_DBAR}
    return kept(raw, "depth", "", columns, by="pressure")


def poses(raw: Raw, part: str = "pose.") -> Tables:
    """Return the poses in a part of messages.

    x is east, y north, z up (ROS REP-103), or x north, y east, z down where the frame's name ends so.
    """
    payloads, frames = raw.payloads, _frames(raw)
    x, y, z = stated(payloads, "x y z", part + "position.")
    frames = [frame.strip("/").lower() for frame in frames]
    ned = np.array([frame.endswith("ned") for frame in frames])
    held = field(payloads, part + "position")
    reasons = {
        f"no {part}position in it": [not isinstance(one, Mapping) for one in held],
        _NO_NUMBER: np.isnan(x + y + z),
        # REP-105 gives the name to the frame whose origin is the Earth's centre
        _EARTH: [frame == "earth" for frame in frames],
    }
    columns = {
        "east": np.where(ned, y, x),
        "north": np.where(ned, x, y),
        "depth": np.where(ned, z, -z),
        "quaternion": _quaternions(raw, part),
        "ned": ned,
    }
    return kept(raw, "pose", why(reasons), columns, system="", oriented=True)


def poses_within(raw: Raw) -> Tables:
    """Return the poses of ``nav_msgs/Odometry`` or ``geometry_msgs/PoseWithCovarianceStamped`` messages."""
    return poses(raw, "pose.pose.")


def _frames(raw: Raw) -> list[str]:
    return [*map(str, field(raw.payloads, "header.frame_id"))]


def _quaternions(raw: Raw, part: str = "") -> Any:
    """Return x, y, z, w of ROS ``Quaternion``s, shape (n, 4)."""
    return np.column_stack(stated(raw.payloads, "x y z w", part + "orientation."))


def imus(raw: Raw) -> Tables:
    """Return the orientations of ``sensor_msgs/Imu`` messages; a first covariance of -1 says that there is none (ROS REP-145)."""
    none = rows(field(raw.payloads, "orientation_covariance"), 1)[:, 0] == -1.0
    reasons = {"attitude: no orientation stated": none}
    return kept(raw, "attitude", why(reasons), {"quaternion": _quaternions(raw), "ned": False})


def imc_gps_fixes(raw: Raw) -> Tables:
    """Return the positions of IMC ``GpsFix`` messages in JSON; one that states no validity is taken at its word."""
    validity = map(whole_number, field(raw.payloads, "validity"))
    invalid = [flags is not None and not flags & _IMC_VALID_POSITION for flags in validity]
    reckoned = [kind in _IMC_DEAD_RECKONING for kind in field(raw.payloads, "type")]
    reasons = why({"no fix (validity without VALID_POS)": invalid})
    place = np.degrees(_place(raw, "lon lat"))
    return _positions(raw, place, dead_reckoned=reckoned, reasons=reasons)


def imc_estimated_states(raw: Raw) -> Tables:
    """Return the positions of IMC ``EstimatedState`` messages: a reference with offsets x north and y east."""
    # an offset that the JSON leaves out is zero
    payloads = [{"x": 0.0, "y": 0.0, **payload} for payload in raw.payloads]
    *reference, north, east, depth = stated(payloads, "lon lat x y depth")
    places = np.degrees(reference)
    reasons = no_place(*places)
    reasons = np.where((reasons == "") & np.isnan(north + east), _NO_NUMBER, reasons)
    for k in np.flatnonzero(reasons == ""):
        places[:, k] = to_geographic(Projection(*places[:, k]), east[k], north[k])
    # negative values denote invalid estimates
    depth = np.where(depth >= 0.0, depth, np.nan)
    return _positions(raw, places, depth, True, reasons)


def dvls(raw: Raw) -> Tables:
    """Return velocity, error, whether it is relative to the bottom, and axes of DVLs' messages.

    The message's convention is that x points forward and z where the instrument looks, which is taken to be down, unless the frame's name
    says otherwise; the velocity is the vehicle's, as its ``course_gnd`` is computed from it. Zeros are no solution.
    """
    payloads = raw.payloads
    mode, coordinates = stated(payloads, "velocity_mode coordinate_mode")
    given = [one is not None for one in field(payloads, "coordinate_mode")]
    velocity = np.column_stack(stated(payloads, "x y z", "velocity."))
    reasons = {
        "velocity_mode is neither 1 (bottom) nor 2 (water)": (mode != 1) & (mode != 2),
        "DVL: coordinate_mode is not 1 (instrument)": np.array(given) & (coordinates != 1),
        "DVL: no velocity": np.isnan(velocity).any(axis=1) | ~velocity.any(axis=1),
    }
    variances = rows(field(payloads, "velocity_covar"), 5)[:, (0, 4)]
    known = (variances > 0.0).all(axis=1)
    columns = {
        "velocity": velocity,
        "error_std": np.where(known, np.sqrt(variances.sum(axis=1) / 2.0), _DVL_STD),
        "bottom": mode == 1,
        "axes": [
            2 if _UP.search(name) else 1 if _DOWN.search(name) else 0 for name in _frames(raw)
        ],
    }
    return kept(raw, "dvl", why(reasons), columns)


def _system(raw: Raw) -> str:
    """Return of which system a MAVLink message is, by its topic."""
    return "/".join(raw.topic.split("/")[:2])


def local_positions_ned(raw: Raw) -> Tables:
    """Return the positions of ``LOCAL_POSITION_NED`` messages."""
    north, east, down = stated(raw.payloads, "x y z")
    columns = {
        "east": east,
        "north": north,
        "depth": down,
        "quaternion": np.full((1, 4), np.nan),
        "ned": True,
    }
    reasons = {_NO_NUMBER: np.isnan(north + east + down)}
    return kept(raw, "pose", why(reasons), columns, oriented=False, system=_system(raw))


def gps_global_origins(raw: Raw) -> Tables:
    """Return the origins of ``GPS_GLOBAL_ORIGIN`` messages."""
    longitude, latitude = _place(raw, unit=1e-7)
    columns = {"longitude": longitude, "latitude": latitude}
    return kept(raw, "origin", no_place(longitude, latitude), columns, system=_system(raw))


def gps_raw_ints(raw: Raw) -> Tables:
    """Return why ``GPS_RAW_INT`` messages have no three-dimensional fix; empty where one has."""
    return kept(raw, "gps", "", {"no_fix": _no_fix(raw, "fix_type")}, system=_system(raw))


def global_positions_int(raw: Raw) -> Tables:
    """Return the positions of ``GLOBAL_POSITION_INT`` messages."""
    depth = -1e-3 * stated(raw.payloads, "relative_alt")[0]
    return _positions(raw, _place(raw, "lon lat", 1e-7), depth, system=_system(raw))


def dataflash_gps(raw: Raw) -> Tables:
    """Return the first receiver's fixes."""
    other = stated(raw.payloads, "I")[0] > 0
    reasons = np.where(other, "not the first GPS receiver", _no_fix(raw, "Status"))
    return _positions(raw, _place(raw, "Lng Lat"), reasons=reasons)


def dataflash_positions(raw: Raw) -> Tables:
    """Return the filter's positions."""
    return _positions(raw, _place(raw, "Lng Lat"), dead_reckoned=True)


def dataflash_depths(raw: Raw) -> Tables:
    """Return the depths that the vehicle's controller uses.

    BARO is left alone: which of its sensors is in the water, and which in the hull or in the air, it does not say.
    """
    return kept(raw, "depth", "", {"depth": -stated(raw.payloads, "Alt")[0]}, by="depth")


def _no_fix(raw: Raw, name: str) -> Any:
    fixed = stated(raw.payloads, name)[0] >= _FIX_3D
    return np.where(fixed, "", f"no fix ({name} < {_FIX_3D})").astype(object)
