"""Small files of each dialect of gliders without a real sample, all of one mission through one known field.

Two dives to 100 m, an hour each, the second from where the first ended; the field is linear in depth and place, so that mean currents
and profiles are known exactly.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np

START = 1_700_000_000.0
DIVE = 3600.0
DEPTHS = np.arange(10.0, 101.0, 10.0)
EPOCH = {"units": "seconds since 1970-01-01T00:00:00Z"}
#: of the start and the end of each dive: seconds, longitude, latitude
FIXES = np.array(
    [
        [0.0, -30.0, 40.0],
        [3600.0, -29.99, 40.01],
        [4200.0, -29.989, 40.011],
        [7800.0, -29.979, 40.021],
    ]
)
#: The same in seconds since 1970.
PLACES = np.add(FIXES, [START, 0.0, 0.0])
_PLACE = ("time", "longitude", "latitude")

#: Columns of one length by name.
Table = dict[str, np.ndarray]
#: Dimensions, values and attributes by name.
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]


def current(depth: Any, dive: int) -> tuple[Any, Any]:
    """Return the field, east and north [m/s], at a depth in the middle of a dive (0 or 1)."""
    return 0.2 - 0.001 * np.asarray(depth) + 0.05 * dive, -0.1 + 0.0005 * np.asarray(depth)


def mean(dive: int) -> tuple[float, float]:
    """Return the mean current of a dive: that at half its depth."""
    east, north = current(50.0, dive)
    return float(east), float(north)


def _table(places: np.ndarray, depth: Any, dive: np.ndarray) -> Table:
    u, v = (np.array([mean(k)[to] for k in dive]) for to in (0, 1))
    held = dict(zip(_PLACE, np.add(places, [START, 0.0, 0.0]).T, strict=True))
    return held | {"depth": np.broadcast_to(depth, dive.shape), "dive": dive, "u": u, "v": v}


def _of_dives(share: float) -> Table:
    """Return a row a dive, at a share of its way."""
    return _table(FIXES[::2] + share * (FIXES[1::2] - FIXES[::2]), 50.0, np.array([0, 1]))


def samples(step: float = 60.0) -> Table:
    """Return the track under water: seconds since 1970, longitude, latitude, depth, dive (0 or 1), its mean current; one sample a step."""
    share = np.tile(np.arange(step, DIVE, step) / DIVE, 2)
    dive = np.repeat([0, 1], share.size // 2)
    before, after = FIXES[2 * dive], FIXES[2 * dive + 1]
    places = before + share[:, None] * (after - before)
    return _table(places, 100.0 * (1.0 - np.abs(2.0 * share - 1.0)), dive)


def middles() -> np.ndarray:
    """Return the middles of the dives: seconds since 1970, longitude, latitude."""
    return np.column_stack([_of_dives(0.5)[key] for key in _PLACE])


def _with_fixes(track: Table) -> tuple[Table, np.ndarray]:
    """Return the track with a row for each fix, in order of time, and which rows these are."""
    fixes = _table(FIXES, 0.0, np.array([0, 0, 1, 1]))
    order = np.argsort(np.concatenate([track["time"], fixes["time"]]), kind="stable")
    whole = {name: np.concatenate([track[name], fixes[name]])[order] for name in track}
    return whole, order >= track["time"].size


def write(
    path: Path, variables: Variables, attributes: dict[str, Any] | None = None, group: str = ""
) -> Path:
    """Write variables: name to dimensions, values, attributes."""
    with h5netcdf.File(path, "w") as file:
        file.attrs.update(attributes or {})
        into = file.create_group(group) if group else file
        for name, (dims, values, attrs) in variables.items():
            values = np.asarray(values)
            for dim, size in zip(dims, values.shape, strict=True):
                if dim not in into.dimensions:
                    into.dimensions[dim] = size
            fill = attrs.get("_FillValue")
            variable = into.create_variable(name, dims, data=values, fillvalue=fill)
            variable.attrs.update({key: v for key, v in attrs.items() if key != "_FillValue"})
    return path


def over(
    dims: str | tuple[str, ...], columns: Mapping[str, Any], table: Table | None = None, **more: Any
) -> Variables:
    """Return variables over one dimension, or several.

    Args:
        dims: The dimensions.
        columns: Of each variable its values, perhaps with a unit or attributes; or the column of a table, perhaps with a unit.
        table: Columns by name; times are in seconds since 1970.
        more: Attributes of all.
    """
    found: Variables = {}
    for name, held in columns.items():
        if isinstance(held, str) and table is not None:
            key, _, unit = held.partition(" ")
            held = table[key], EPOCH if key == "time" else unit
        values, about = held if isinstance(held, tuple) else (held, "")
        own = about if isinstance(about, dict) else {"units": about} if about else {}
        found[name] = ((dims,) if isinstance(dims, str) else dims), values, own | more
    return found


def packed(values: Any, scale: float) -> tuple[np.ndarray, dict[str, Any]]:
    """Return values as 16-bit integers, -32768 where missing, and the attributes that say so."""
    whole = np.round(np.nan_to_num(np.asarray(values, np.float64)) / scale)
    stored = np.where(np.isfinite(values), whole, -32768).astype(np.int16)
    return stored, {"scale_factor": scale, "_FillValue": np.int16(-32768)}


_LATLON = {"lon": "longitude degrees_east", "lat": "latitude degrees_north"}
_UV = {"time_uv": "time", "lon_uv": "longitude degrees", "lat_uv": "latitude degrees"}


def spray(path: Path) -> Path:
    """Spray, binned: depth before profile, profiles stamped at three quarters of their dives."""
    profiles = np.array([current(DEPTHS, dive) for dive in (0, 1)])
    profiles[1, :, -1] = np.nan
    means = {"u_depth_mean": "u m s-1", "v_depth_mean": "v m s-1"}
    binned = {name: packed(profiles[:, k].T, 1e-4) for k, name in enumerate("uv")}
    depth = (DEPTHS.astype(np.int16), {"units": "m", "positive": "down"})
    variables = (
        over("depth", {"depth": depth})
        | over("profile", {"time": "time"} | _LATLON, _of_dives(0.75))
        | over("profile", _UV | means, _of_dives(0.5))
        | over(("depth", "profile"), binned, units="m s-1")
    )
    return write(path, variables)


def gliderdac(folder: Path) -> list[Path]:
    """GliderDAC v3: a file for each descent and ascent; both of a dive state its mean current."""
    track, made, fill = samples(), [], {"_FillValue": -999.0}
    folder.mkdir(exist_ok=True)
    flags = {"flag_values": np.array([0, 1, 4], np.int8), "_FillValue": np.int8(-127)}
    flags["flag_meanings"] = "no_qc_performed good_data bad_data"
    for profile in range(4):
        middle = {key: values[profile // 2] for key, values in _of_dives(0.5).items()}
        down = (track["time"] <= middle["time"]) == (profile % 2 == 0)
        part = {
            key: values[down & (track["dive"] == profile // 2)] for key, values in track.items()
        }
        own = middle | {"time": part["time"].mean()}
        names = {"profile_time": "time", "profile_lat": "latitude degrees"}
        variables = (
            over("time", {"time": "time", "depth": "depth m"} | _LATLON, part, **fill)
            | over((), _UV | {"u": "u m s-1", "v": "v m s-1"}, middle, **fill)
            | over((), names | {"profile_lon": "longitude degrees"}, own, **fill)
            | over((), {"profile_id": (np.int32(profile), {}), "u_qc": (np.int8(1), flags)})
        )
        # names that do not sort by time
        made.append(write(folder / f"sp_{9 - profile}.nc", variables, {"Conventions": "CF-1.6"}))
    return made


_PROFILE = {"time": "time", "longitude": "longitude", "latitude": "latitude"}
_PRECISE = {"precise_time": "time", "precise_lon": "longitude", "precise_lat": "latitude"}


def erddap(path: Path) -> Path:
    """ERDDAP's aggregation: one row a sample, the profile's own time and place and the mean current of its dive in each."""
    track = samples()
    middle = {key: values[track["dive"]] for key, values in _of_dives(0.5).items()}
    own = _PROFILE | {f"{name}_uv": name for name in _PLACE} | {"u": "u", "v": "v"}
    along = _PRECISE | {"depth": "depth", "profile_id": "dive"}
    return write(path, over("row", own, middle) | over("row", along, track))


def ragged(path: Path) -> Path:
    """ERDDAP's rows as a ragged array, in which a profile's own are stated once."""
    own = _PROFILE | {name: key.split()[0] for name, key in _UV.items()} | {"u": "u", "v": "v"}
    sizes = {"rowSize": (np.array([59, 59], np.int32), {"sample_dimension": "obs"})}
    variables = over("profile", own | {"profile_id": "dive"}, _of_dives(0.5))
    along = over("obs", _PRECISE | {"depth": "depth"}, samples())
    return write(path, variables | along | over("profile", sizes))


def _reported(whole: Table, fix: np.ndarray) -> Table:
    """Return the rows with mean currents in the one row after each dive alone."""
    after = np.isin(np.arange(fix.size), np.flatnonzero(fix)[[1, 3]])
    return whole | {key: np.where(after, whole[key], np.nan) for key in "uv"}


def bodc(path: Path) -> Path:
    """OG1 as BODC writes it for a Slocum: mean currents in cm/s, GPS times at all rows, flags whose fill value is 0."""
    whole, fix = _with_fixes(samples())
    whole |= {f"gps_{key}": np.where(fix, whole[key], np.nan) for key in _PLACE}
    whole |= {f"cm_{key}": np.where(fix, np.nan, 100.0 * whole[key]) for key in "uv"}
    depth = {"units": "m", "standard_name": "depth"}
    rows = {
        "TIME": "time",
        "LONGITUDE": "longitude degrees_east",
        "LATITUDE": "latitude degrees_north",
        "TIME_GPS": "time",
        "LONGITUDE_GPS": "gps_longitude degrees_east",
        "LATITUDE_GPS": "gps_latitude degrees_north",
        "DEPTH_Z": (-whole["depth"], depth | {"positive": "up"}),
        "GLIDER_DEPTH": (whole["depth"], depth | {"positive": "down"}),
        "WATERCURRENTS_U": "cm_u cm/s",
        "WATERCURRENTS_V": "cm_v cm/s",
        "WATERCURRENTS_U_QC": (np.zeros(fix.size, np.int8), {"_FillValue": np.int8(0)}),
    }
    about = {"Conventions": "CF-1.10, OG-1.0", "featureType": "trajectory"}
    return write(path, over("N_MEASUREMENTS", rows, whole), about)


def socib(path: Path) -> Path:
    """SOCIB L1: the report of the mean current in the one row after each dive, attitude in radians that says degrees."""
    whole, fix = _with_fixes(samples())
    rows = {
        "time": "time",
        "longitude": "longitude degree_east",
        "latitude": "latitude degree_north",
        "depth": (-whole["depth"], "m"),
        "heading": (np.full(fix.size, 1.5), "degrees"),
        "dead_reckoning": np.where(fix, 0.0, 1.0),
        "water_velocity_eastward": "u m s-1",
        "water_velocity_northward": "v m s-1",
    }
    return write(path, over("time", rows, _reported(whole, fix)))


def slocum_glide(path: Path) -> Path:
    """slocum-glide L2: fixes and mean currents on dimensions of their own, the latter at the middle of the segment."""
    track, fixes = samples(), _table(FIXES, 0.0, np.zeros(4, int))
    own = dict.fromkeys(("dive_id", "climb_id", "state"), np.zeros(track["time"].size, np.int32))
    gps = {"time_gps": "time", "lon_gps": "longitude", "lat_gps": "latitude"}
    variables = (
        over("time", {"time": "time", "lon": "longitude", "lat": "latitude"} | own, track)
        | over("time", {"depth": "depth m"}, track)
        | over("time_gps", gps, fixes)
        | over("time_uv", _UV | {"u": "u m/s", "v": "v m/s"}, _of_dives(0.5))
    )
    return write(path, variables)


def nmea(degrees: Any) -> Any:
    """Return degrees as ddmm.mmm."""
    degrees = np.asarray(degrees)
    return np.sign(degrees) * (np.floor(np.abs(degrees)) * 100.0 + np.abs(degrees) % 1.0 * 60.0)


def slocum(path: Path, written: Any = nmea) -> Path:
    """A Slocum's own names, as its exporters write them: degrees and minutes, radians, a mark of no fix, reports after dives."""
    whole, fix = _with_fixes(samples())
    table = _reported(whole, fix)
    table["u"][0] = table["v"][0] = 0.0
    for key in ("longitude", "latitude"):
        table[key] = written(table[key])
        table[f"gps_{key}"] = np.where(fix, table[key], 69_696_969.0)
    rows = {
        "m_present_time": (table["time"], "timestamp"),
        "m_lon": "longitude lon",
        "m_lat": "latitude lat",
        "m_gps_lon": "gps_longitude lon",
        "m_gps_lat": "gps_latitude lat",
        "m_depth": "depth m",
        "m_heading": (np.full(fix.size, 1.5), "rad"),
        "m_final_water_vx": "u m/s",
        "m_final_water_vy": "v m/s",
    }
    return write(path, over("i", rows, table))


#: Velocity seen by the instrument of ``midas``: x, y, z [m/s].
SEEN = np.array([0.3, -0.1, 0.05])
_FORE, _SIDE = np.deg2rad([47.5, 25.0])
# of Nortek's head, from the instrument: fore, to starboard, aft, to port
_BEAMS = np.array(
    [
        [np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, -np.sin(_SIDE), np.cos(_SIDE)],
        [-np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, np.sin(_SIDE), np.cos(_SIDE)],
    ]
)


def midas(path: Path) -> Path:
    """A MIDAS export of an AD2CP that looks up: two pings of one velocity along its beams."""
    sensors = {
        "Heading": ([30.0, 40.0], "degrees"),
        "Pitch": ([0.0, 0.0], "degrees"),
        "Roll": ([0.0, 0.0], "degrees"),
        "Pressure": ([33.0, 50.0], "dbar"),
        "SpeedOfSound": ([1500.0, 1501.0], "m/s"),
        "AccelerometerZ": [9.8, 9.8],
        "time": (START + np.array([600.0, 900.0]), EPOCH),
    }
    cells = {}
    for k, along in enumerate(_BEAMS @ SEEN):
        cells[f"VelocityBeam{k + 1}"] = np.full((2, 5), along), "m/s"
        cells[f"CorrelationBeam{k + 1}"] = np.full((2, 5), 90.0 + k), "%"
    dim = "Velocity Range"
    variables = over("time", sensors) | over(dim, {dim: (np.arange(2.0, 12.0, 2.0), "m")})
    return write(path, variables | over(("time", dim), cells), group="Data/Average")


def seaexplorer(folder: Path) -> list[Path]:
    """A SeaExplorer's vehicle file in two parts, the second with one more column; at the surface it does not reckon."""
    whole, fix = _with_fixes(samples(300.0))
    folder.mkdir(exist_ok=True)
    lines = []
    for k, second in enumerate(np.round(whole["time"]).astype("datetime64[s]").tolist()):
        lon, lat = (nmea(whole[key][k]) for key in ("longitude", "latitude"))
        state, reckoned = (116, 0) if fix[k] else (100, 1)
        stated = f"{state};12.0;17;{whole['depth'][k]:.1f};{lat:.5f};{lon:.5f};{reckoned};"
        lines.append(f"{second:%d/%m/%Y %H:%M:%S};{stated}")
    heading = "Timestamp;NavState;Heading;Declination;Depth;Lat;Lon;DeadReckoning;"
    half = len(lines) // 2
    first, second = folder / "SEA063.22.gli.sub.9", folder / "SEA063.22.gli.sub.10"
    stale = "01/01/1970 00:00:05;116;0;17;0;0;0;1;"
    first.write_text("\n".join([heading, stale, *lines[:half], "cut off;"]))
    more = (f"{line}-1.0;" for line in lines[half:])
    second.write_text("\n".join([f"{heading}Altitude;", *more]))
    return [first, second]
