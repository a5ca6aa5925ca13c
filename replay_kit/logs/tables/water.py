"""Measurements of the water in messages: current profiles, mean currents, temperature and salinity, surface currents.

Profiles of other packages become payloads of ``replay_kit.AdcpPing``; fields that a message does not state are omitted, such as
``reference``, which the configuration may give. Definitions: ``ds_sensor_msgs/Adcp`` (Field-Robotics-Lab/ds_msgs),
``CurrentProfile`` of IMC (LSTS/imc, messages 1014 to 1016).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Times
from replay_kit.core.observation import Flag
from replay_kit.core.observation.table import Raw, Table
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    dive_number,
    field,
    first_reason,
    number,
    read_each,
    regular_array,
    result_or_reason,
    stated_numbers,
    whole_number,
)
from replay_kit.logs.tables.instruments import SYSTEMS, believed_errors, ping_tables
from replay_kit.logs.tables.vehicle import no_place

_NS = 1_000_000_000
#: Time of a fix that is not stated.
NO_TIME = -(2**63)
_CTD = "depth temperature salinity conductivity pressure dive"
_DRIFTER = "longitude latitude depth error"
_RADAR = "longitude latitude value error_std direction suspect depth averaged error_length kind"
Payloads = Sequence[Payload]
_WHOLE_METRES = "cell_depth is 0, for cells below 1 m: state their size in a [[measurements.map]]"
_NUCLEUS = (
    "profile along three beams (Nortek Nucleus), whose directions and heading it does not state"
)
# of the coordinate systems of IMC: by number and by name, ours, and where in a cell east, north and up are, with their signs
_ENU, _NED = ((0, 1.0), (1, 1.0), (2, 1.0)), ((1, 1.0), (0, 1.0), (2, -1.0))
_IMC_SYSTEMS = {1: "XYZ", 2: "NED", 4: "BEAMS", 8: "ENU"}
_IMC_COORDINATES = {
    "XYZ": ("instrument", None),
    "BEAMS": ("beam", None),
    "NED": ("earth", _NED),
    "ENU": ("earth", _ENU),
}
_BOTTOM_ALONE = "bottom track alone: motion of the vehicle, no current"


def adcp_pings(raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of ``replay_kit.AdcpPing`` messages; ``place`` marks a mooring or a drifter."""
    payloads = raw.payloads
    moored = np.array(
        [place is not None and hasattr(place, "get") for place in field(payloads, "place")]
    )
    cells, *place = stated_numbers(payloads, "n_cells place.lon place.lat")
    bottom = [*map(bool, field(payloads, "bottom_track"))]
    reasons = {_BOTTOM_ALONE: (cells == 0) & bottom}
    reasons |= {word: moored & wrong for word, wrong in no_place(*place).items()}
    words = np.broadcast_to(first_reason(reasons), len(payloads)).tolist()
    said = payloads
    if any(words):
        said = [word or payload for word, payload in zip(words, payloads, strict=True)]
    depth = np.where(moored, 0.0, np.nan)
    return ping_tables(raw, said, config, places=np.column_stack([*place, depth]))


def profiles(
    raw: Raw, config: MeasurementConfig, read: Callable[[Payload], Payload | str]
) -> list[Table]:
    """Return the tables of profiles of another package, which a function reads as fields of a ping, or the reason for exclusion."""
    return ping_tables(raw, [result_or_reason(read, one) for one in raw.payloads], config)


def ds_adcp(payload: Payload) -> Payload | str:
    """Return the profile of a ``ds_sensor_msgs/Adcp``, or the reason for exclusion.

    A cell holds one vector, or in beam coordinates one vector per beam; zeros mean no solution. Reference and orientation are not stated:
    downward is assumed, as for a DVL's water track.
    """
    mode, cells = whole_number(payload.get("coordinate_mode")), payload["vel_bin_beams"]
    if mode is None or not 0 <= mode < len(SYSTEMS):
        return "coordinate_mode is none of 0 (beam), 1 (instrument), 2 (ship), 3 (earth)"
    cell_size = number(payload.get("cell_depth"))
    if cell_size == 0.0:
        return _WHOLE_METRES
    directions = _vectors(payload["beam_unit_vec"])
    found = [_vectors(cell["velocity_bin_beam"]) for cell in cells]
    for vectors in found:
        vectors[~vectors.any(axis=1)] = np.nan
    velocity = [vectors[:1].ravel().tolist() or None for vectors in found]
    if SYSTEMS[mode] == "beam":
        velocity = [
            [float(one @ unit) for one, unit in zip(vectors, directions, strict=True)]
            for vectors in found
        ]
    return {
        "coordinate_system": SYSTEMS[mode],
        "orientation": "down",
        "n_cells": len(cells),
        "cell_size": cell_size,
        "bin0_distance": payload.get("bin0_distance"),
        "beam_unit_vectors": directions.tolist(),
        "velocity": velocity,
    }


def current_profile(payload: Payload) -> Payload | str:
    """Return the profile of an IMC message in JSON: velocities relative to the vehicle, cells at stated distances."""
    if "velocity_data" in payload:
        return _NUCLEUS
    code, profile = payload.get("coord_sys"), payload.get("profile")
    if not isinstance(profile, list | tuple):
        return "CurrentProfile has neither velocity_data (Nortek Nucleus) nor profile (IMC)"
    name = _IMC_SYSTEMS.get(whole_number(code) or 0, str(code).upper())
    if name not in _IMC_COORDINATES:
        return "coord_sys is none of XYZ, NED, BEAMS, ENU"
    system, axes = _IMC_COORDINATES[name]
    cells = [[*map(number, field(cell["beams"], "vel"))] for cell in profile]
    if axes is not None:
        if any(len(cell) < len(axes) for cell in cells):
            return f"fewer than three components in a cell of {name} coordinates"
        cells = [[sign * cell[at] for at, sign in axes] for cell in cells]
    return {
        "coordinate_system": system,
        "reference": "platform",
        "orientation": "down",
        "n_cells": len(cells),
        "cell_distances": [abs(number(cell.get("cell_position"))) for cell in profile],
        "velocity": cells,
        "amplitude": [field(cell["beams"], "amp") for cell in profile],
        "correlation": [field(cell["beams"], "cor") for cell in profile],
    }


def _vectors(values: Sequence[Payload]) -> Array:
    """Return x, y, z of messages, shape (n, 3)."""
    xyz = [[number(value.get(axis)) for axis in "xyz"] for value in values]
    return np.array(xyz, np.float64).reshape(-1, 3)


def _named(payloads: Payloads, names: str) -> dict[str, Array]:
    return dict(zip(names.split(), stated_numbers(payloads, names), strict=True))


def _mean_currents(payloads: Payloads) -> Rows:
    velocity = np.column_stack(stated_numbers(payloads, "dac_eastward dac_northward"))
    std, deepest, radius, declination = stated_numbers(
        payloads, "error max_depth radius declination"
    )
    (start_time, start), (end_time, end) = (_fix(payloads, f"{at}_fix.") for at in ("start", "end"))
    columns = {
        "velocity": velocity,
        "error_std": believed_errors(std),
        "start_time": start_time,
        "start": start,
        "end_time": end_time,
        "end": end,
        "dive": [*map(dive_number, field(payloads, "dive"))],
        "deepest": deepest,
        "radius": radius,
        "declination": declination,
        "inverted": [*map(bool, field(payloads, "inverted_in"))],
    }
    none = np.isnan(velocity).any(axis=1)
    return Rows("mean", columns, {"depth-averaged current: not a number": none})


def _fix(payloads: Payloads, part: str) -> tuple[Times, Array]:
    """Return times [ns, UTC] and positions of fixes; incomplete ones count as missing."""
    seconds, rest = stated_numbers(payloads, "sec nsec", part + "time.")
    place = np.column_stack(stated_numbers(payloads, "lon lat", part))
    known = (seconds >= 0.0) & (seconds < 2**33) & (rest >= 0.0) & (rest < 2 * _NS)
    known &= np.isfinite(place[:, 0]) & (np.abs(place[:, 1]) <= 90.0)
    whole = np.where(known, [seconds, rest], 0.0).astype(np.int64)
    time = np.where(known, whole[0] * _NS + whole[1], NO_TIME)
    return time, np.where(known[:, None], place, np.nan)


def _drifter_fixes(payloads: Payloads) -> Rows:
    columns = _named(payloads, _DRIFTER)
    placed = np.isfinite(columns["longitude"]) & (np.abs(columns["latitude"]) <= 90.0)
    drifter = np.array([*map(str, field(payloads, "id"))], object)
    reasons = {
        "drifter without its drogue: the wind moves it": [
            drogued is not True for drogued in field(payloads, "drogued")
        ],
        "drifter: no position, or no depth of its drogue": ~(placed & (columns["depth"] >= 0.0)),
    }
    return Rows("drifter", {"name": drifter, **columns}, reasons)


def _radar(payload: Payload) -> tuple[Any, ...] | str:
    """Return a row of complete vectors or radials, or the reason for exclusion.

    Arrays of v vectors: longitude, latitude, value (v, 2), or (v, 1) along direction, error, direction (None for vectors), suspect; then
    depth [m], averaging time [s], correlation length of errors [m] (0 if not stated), radar or sensors.
    """
    radials = "speed" in payload
    names = "speed direction error" if radials else "east north east_error north_error"
    said = [payload[name] for name in ("longitude", "latitude", *names.split())]
    columns = regular_array([*said, payload.get("flag", [Flag.GOOD] * len(said[0]))])
    if columns.ndim != 2:
        return "radar currents: columns are not numbers, or of unlike lengths"
    known = np.isfinite(columns[:-1]).all(axis=0) & (np.abs(columns[1]) <= 90.0)
    known &= ~np.isin(columns[-1], (Flag.FAIL, Flag.MISSING))
    if not known.any():
        return "radar currents: no vector that is whole"
    longitude, latitude, first, second, *errors, flags = columns[:, known]
    depth, averaged, length = (
        number(payload.get(name)) for name in ("depth", "averaged", "error_length")
    )
    if not (depth >= 0.0 and averaged > 0.0):
        return "radar currents: depth or time of averaging is not stated"
    value = np.column_stack([first] if radials else [first, second])
    # both components of a vector err alike
    std = np.sqrt(np.mean(np.square(errors), axis=0))
    direction, suspect = second if radials else None, flags == Flag.SUSPECT
    kind = "sensors" if payload.get("kind") == "sensors" else "radar"
    extent = depth, averaged, length if length > 0.0 else 0.0
    return longitude, latitude, value, std, direction, suspect, *extent, kind


#: What reads the messages of our own schemas.
READERS: Mapping[str, Callable[[Payloads], Rows]] = {
    "replay_kit.DepthAveragedCurrent": _mean_currents,
    "replay_kit.Ctd": lambda them: Rows("ctd", _named(them, _CTD)),
    "replay_kit.DrifterFix": _drifter_fixes,
    "replay_kit.RadarCurrents": lambda them: read_each("radar", _RADAR, them, _radar),
}
