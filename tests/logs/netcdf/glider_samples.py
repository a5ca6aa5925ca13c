"""Small files of each dialect of gliders without a real sample, all of one mission through one known field.

Two dives to 100 m, an hour each, the second from where the first ended; the field is linear in depth and place, so that mean currents
and profiles are known exactly.
"""

from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np

START = 1_700_000_000.0
DIVE, SURFACE = 3600.0, 600.0
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

Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]


def current(depth: Any, dive: int) -> tuple[Any, Any]:
    """Return the field, east and north [m/s], at a depth in the middle of a dive (0 or 1)."""
    return 0.2 - 0.001 * np.asarray(depth) + 0.05 * dive, -0.1 + 0.0005 * np.asarray(depth)


def mean(dive: int) -> tuple[float, float]:
    """Return the mean current of a dive: that at half its depth."""
    east, north = current(50.0, dive)
    return float(east), float(north)


def samples(step: float = 60.0) -> dict[str, np.ndarray]:
    """Return the track under water: seconds since 1970, longitude, latitude, depth, dive (0 or 1), one sample a step."""
    parts = []
    for dive in (0, 1):
        before, after = FIXES[2 * dive : 2 * dive + 2]
        time = np.arange(before[0] + step, after[0], step)
        share = (time - before[0]) / DIVE
        place = before[1:] + share[:, None] * (after[1:] - before[1:])
        parts.append(
            np.column_stack(
                [
                    START + time,
                    place,
                    100.0 * (1.0 - np.abs(2.0 * share - 1.0)),
                    np.full(time.size, dive),
                ]
            )
        )
    time, longitude, latitude, depth, dive = np.concatenate(parts).T
    return {
        "time": time,
        "longitude": longitude,
        "latitude": latitude,
        "depth": depth,
        "dive": dive.astype(int),
    }


def middles() -> np.ndarray:
    """Return the middles of the dives: seconds since 1970, longitude, latitude."""
    return 0.5 * (FIXES[::2] + FIXES[1::2]) + [START, 0.0, 0.0]


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
            variable = into.create_variable(
                name, dims, data=values, fillvalue=attrs.get("_FillValue")
            )
            variable.attrs.update(
                {key: value for key, value in attrs.items() if key != "_FillValue"}
            )
    return path


def over(dims: str | tuple[str, ...], columns: dict[str, Any]) -> Variables:
    """Return variables over one dimension, or several: of each the values, perhaps with its unit or its attributes."""
    dims = (dims,) if isinstance(dims, str) else dims
    pairs = {
        name: held if isinstance(held, tuple) else (held, {}) for name, held in columns.items()
    }
    return {
        name: (dims, values, {"units": about} if isinstance(about, str) else about)
        for name, (values, about) in pairs.items()
    }


def packed(values: Any, scale: float) -> tuple[np.ndarray, dict[str, Any]]:
    """Return values as 16-bit integers, -32768 where missing, and the attributes that say so."""
    values = np.asarray(values, np.float64)
    stored = np.where(np.isfinite(values), np.round(np.nan_to_num(values) / scale), -32768).astype(
        np.int16
    )
    return stored, {"scale_factor": scale, "_FillValue": np.int16(-32768)}


def spray(path: Path) -> Path:
    """Spray, binned: depth before profile, profiles stamped at three quarters of their dives."""
    middle = middles()
    own = FIXES[::2] + 0.75 * (FIXES[1::2] - FIXES[::2]) + [START, 0.0, 0.0]
    profiles = np.array([current(DEPTHS, dive) for dive in (0, 1)])
    profiles[1, :, -1] = np.nan
    east, north = (packed(profiles[:, k].T, 1e-4) for k in (0, 1))
    (u, v) = np.array([mean(0), mean(1)]).T
    profile = {
        "time": (own[:, 0], EPOCH),
        "lon": (own[:, 1], "degrees_east"),
        "lat": (own[:, 2], "degrees_north"),
        "time_uv": (middle[:, 0], EPOCH),
        "lon_uv": (middle[:, 1], "degrees_east"),
        "lat_uv": (middle[:, 2], "degrees_north"),
        "u_depth_mean": (u, "m s-1"),
        "v_depth_mean": (v, "m s-1"),
    }
    binned = {
        name: (values, {"units": "m s-1", **attributes})
        for name, (values, attributes) in (("u", east), ("v", north))
    }
    depth = {"depth": (DEPTHS.astype(np.int16), {"units": "m", "positive": "down"})}
    return write(
        path, over("depth", depth) | over("profile", profile) | over(("depth", "profile"), binned)
    )


def _scalar(name: str) -> dict[str, Any]:
    """Return the attributes of what a profile states once."""
    unit = "degrees" if "lat" in name or "lon" in name else "m s-1"
    return (EPOCH if "time" in name else {"units": unit}) | {"_FillValue": -999.0}


def gliderdac(folder: Path) -> list[Path]:
    """GliderDAC v3: a file for each descent and ascent; both of a dive state its mean current."""
    track, middle, made = samples(), middles(), []
    fill = {"_FillValue": -999.0}
    folder.mkdir(exist_ok=True)
    for profile in range(4):
        dive = profile // 2
        down = track["time"] <= middle[dive, 0]
        rows = np.flatnonzero((track["dive"] == dive) & (down if profile % 2 == 0 else ~down))
        u, v = mean(dive)
        flags = {
            "flag_values": np.array([0, 1, 4], np.int8),
            "flag_meanings": "no_qc_performed good_data bad_data",
        }
        scalars = {
            "time_uv": middle[dive, 0],
            "lon_uv": middle[dive, 1],
            "lat_uv": middle[dive, 2],
            "u": u,
            "v": v,
            "profile_time": track["time"][rows].mean(),
            "profile_lat": 40.0,
            "profile_lon": -30.0,
        }

        along = {
            "time": (track["time"][rows], EPOCH | fill),
            "lon": (track["longitude"][rows], {"units": "degrees_east"} | fill),
            "lat": (track["latitude"][rows], {"units": "degrees_north"} | fill),
            "depth": (track["depth"][rows], {"units": "m", "positive": "down"} | fill),
        }
        once = {
            "profile_id": (np.int32(profile), {"_FillValue": np.int32(-999)}),
            "u_qc": (np.int8(1), flags | {"_FillValue": np.int8(-127)}),
            **{name: (value, _scalar(name)) for name, value in scalars.items()},
        }
        variables = over("time", along) | over((), once)
        # names that do not sort by time
        made.append(write(folder / f"sp_{9 - profile}.nc", variables, {"Conventions": "CF-1.6"}))
    return made


def erddap(path: Path) -> Path:
    """ERDDAP's aggregation: one row a sample, the profile's own time and place and the mean current of its dive in each."""
    track, middle = samples(), middles()
    dive = track["dive"]
    rows = {
        "time": middle[dive, 0],
        "longitude": middle[dive, 1],
        "latitude": middle[dive, 2],
        "precise_time": track["time"],
        "precise_lon": track["longitude"],
        "precise_lat": track["latitude"],
        "time_uv": middle[dive, 0],
        "longitude_uv": middle[dive, 1],
        "latitude_uv": middle[dive, 2],
        "depth": track["depth"],
        "profile_id": dive,
        "u": np.array([mean(k)[0] for k in dive]),
        "v": np.array([mean(k)[1] for k in dive]),
    }
    epochs = {name: (values, EPOCH) for name, values in rows.items() if "time" in name}
    return write(path, over("row", rows | epochs))


def _with_fixes(track: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the track with a row for each fix, in order of time, and which rows these are."""
    fixes = {
        "time": START + FIXES[:, 0],
        "longitude": FIXES[:, 1],
        "latitude": FIXES[:, 2],
        "depth": np.zeros(4),
        "dive": np.array([0, 0, 1, 1]),
    }
    order = np.argsort(np.concatenate([track["time"], fixes["time"]]), kind="stable")
    whole = {name: np.concatenate([track[name], fixes[name]])[order] for name in track}
    return whole, order >= track["time"].size


def _reported(fix: np.ndarray) -> np.ndarray:
    """Return the mean currents, east and north, in the one row after each dive."""
    found = np.full((2, fix.size), np.nan)
    found[:, np.flatnonzero(fix)[[1, 3]]] = np.array([mean(0), mean(1)]).T
    return found


def bodc(path: Path) -> Path:
    """OG1 as BODC writes it for a Slocum: mean currents in cm/s, GPS times at all rows, flags whose fill value is 0."""
    whole, fix = _with_fixes(samples())
    nan = np.where(fix, 1.0, np.nan)
    under = np.where(fix, np.nan, 1.0)
    rows = {
        "TIME": (whole["time"], EPOCH),
        "LONGITUDE": (whole["longitude"], "degrees_east"),
        "LATITUDE": (whole["latitude"], "degrees_north"),
        "TIME_GPS": (whole["time"], EPOCH),
        "LONGITUDE_GPS": (whole["longitude"] * nan, "degrees_east"),
        "LATITUDE_GPS": (whole["latitude"] * nan, "degrees_north"),
        "DEPTH_Z": (
            -whole["depth"],
            {"units": "m", "standard_name": "depth", "positive": "up"},
        ),
        "GLIDER_DEPTH": (
            whole["depth"],
            {"units": "m", "standard_name": "depth", "positive": "down"},
        ),
        "WATERCURRENTS_U": (under * [100.0 * mean(k)[0] for k in whole["dive"]], "cm/s"),
        "WATERCURRENTS_V": (under * [100.0 * mean(k)[1] for k in whole["dive"]], "cm/s"),
        "WATERCURRENTS_U_QC": (
            np.zeros(fix.size, np.int8),
            {"_FillValue": np.int8(0)},
        ),
    }
    return write(
        path,
        over("N_MEASUREMENTS", rows),
        {"Conventions": "CF-1.10, OG-1.0", "featureType": "trajectory"},
    )


def socib(path: Path) -> Path:
    """SOCIB L1: the report of the mean current in the one row after each dive, attitude in radians that says degrees."""
    whole, fix = _with_fixes(samples())
    east, north = _reported(fix)
    rows = {
        "time": (whole["time"], EPOCH),
        "longitude": (whole["longitude"], "degree_east"),
        "latitude": (whole["latitude"], "degree_north"),
        "depth": (-whole["depth"], "m"),
        "heading": (np.full(fix.size, 1.5), "degrees"),
        "dead_reckoning": np.where(fix, 0.0, 1.0),
        "water_velocity_eastward": (east, "m s-1"),
        "water_velocity_northward": (north, "m s-1"),
    }
    return write(path, over("time", rows))


def slocum_glide(path: Path) -> Path:
    """slocum-glide L2: fixes and mean currents on dimensions of their own, the latter at the middle of the segment."""
    track, middle = samples(), middles()
    (u, v) = np.array([mean(0), mean(1)]).T
    own = np.zeros(track["time"].size, np.int32)
    along = {
        "time": (track["time"], EPOCH),
        "lon": track["longitude"],
        "lat": track["latitude"],
        "depth": (track["depth"], "m"),
        **dict.fromkeys(("dive_id", "climb_id", "state"), own),
    }
    gps = {
        "time_gps": (START + FIXES[:, 0], EPOCH),
        "lon_gps": FIXES[:, 1],
        "lat_gps": FIXES[:, 2],
    }
    means = {
        "time_uv": (middle[:, 0], EPOCH),
        "lon_uv": middle[:, 1],
        "lat_uv": middle[:, 2],
        "u": (u, "m/s"),
        "v": (v, "m/s"),
    }
    return write(path, over("time", along) | over("time_gps", gps) | over("time_uv", means))


def nmea(degrees: Any) -> Any:
    """Return degrees as ddmm.mmm."""
    degrees = np.asarray(degrees)
    return np.sign(degrees) * (np.floor(np.abs(degrees)) * 100.0 + np.abs(degrees) % 1.0 * 60.0)


def slocum(path: Path) -> Path:
    """A Slocum's own names, as its exporters write them: degrees and minutes, bar, radians, a mark of no fix, reports after dives."""
    whole, fix = _with_fixes(samples())
    east, north = _reported(fix)
    east[0] = north[0] = 0.0
    rows = {
        "m_present_time": (whole["time"], "timestamp"),
        "m_lon": (nmea(whole["longitude"]), "lon"),
        "m_lat": (nmea(whole["latitude"]), "lat"),
        "m_gps_lon": (np.where(fix, nmea(whole["longitude"]), 69_696_969.0), "lon"),
        "m_gps_lat": (np.where(fix, nmea(whole["latitude"]), 69_696_969.0), "lat"),
        "m_depth": (whole["depth"], "m"),
        "m_heading": (np.full(fix.size, 1.5), "rad"),
        "m_final_water_vx": (east, "m/s"),
        "m_final_water_vy": (north, "m/s"),
    }
    return write(path, over("i", rows))


def midas(path: Path, velocity: np.ndarray, beams: np.ndarray) -> Path:
    """A MIDAS export of an AD2CP that looks up: two pings of one velocity, x, y, z of the instrument, along its beams."""
    ranges = np.arange(2.0, 12.0, 2.0)
    along = beams @ velocity
    sensors = {
        "Heading": ([30.0, 40.0], "degrees"),
        "Pitch": ([0.0, 0.0], "degrees"),
        "Roll": ([0.0, 0.0], "degrees"),
        "Pressure": ([33.0, 50.0], "dbar"),
        "SpeedOfSound": ([1500.0, 1501.0], "m/s"),
        "AccelerometerZ": [9.8, 9.8],
    }
    cells = {f"VelocityBeam{k + 1}": (np.full((2, 5), along[k]), "m/s") for k in range(4)}
    cells |= {f"CorrelationBeam{k + 1}": (np.full((2, 5), 90.0 + k), "%") for k in range(4)}
    variables = (
        over("time", {"time": (START + np.array([600.0, 900.0]), EPOCH)})
        | over("Velocity Range", {"Velocity Range": (ranges, "m")})
        | over("time", sensors)
        | over(("time", "Velocity Range"), cells)
    )
    return write(path, variables, group="Data/Average")


def seaexplorer(folder: Path) -> list[Path]:
    """A SeaExplorer's vehicle file in two parts, the second with one more column; at the surface it does not reckon."""
    whole, fix = _with_fixes(samples(300.0))
    folder.mkdir(exist_ok=True)
    stamps = [
        str(np.datetime64(round(time), "s").astype(object).strftime("%d/%m/%Y %H:%M:%S"))
        for time in whole["time"]
    ]
    lines = [
        f"{stamp};{116 if at_surface else 100};12.0;17;{depth:.1f};{nmea(y):.5f};{nmea(x):.5f};{0 if at_surface else 1};"
        for stamp, depth, y, x, at_surface in zip(
            stamps, whole["depth"], whole["latitude"], whole["longitude"], fix, strict=True
        )
    ]
    heading = "Timestamp;NavState;Heading;Declination;Depth;Lat;Lon;DeadReckoning;"
    half = len(lines) // 2
    first, second = folder / "SEA063.22.gli.sub.9", folder / "SEA063.22.gli.sub.10"
    first.write_text(
        "\n".join([heading, "01/01/1970 00:00:05;116;0;17;0;0;0;1;", *lines[:half], "cut off;"])
    )
    second.write_text(
        "\n".join([heading + "Altitude;", *(line + "-1.0;" for line in lines[half:])])
    )
    return [first, second]
