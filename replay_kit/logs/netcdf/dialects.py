"""Dialects of glider files, and reading of columnar files, NetCDF and text tables, by dialect.

To add one, write its ``Dialect`` here and add it to ``GLIDERS``. Quantities are those of samples along the track, or begin with what they
are of: fixes (``gps_``), fixes after dives (``end_``), mean currents (``dac_``), absolute profiles (``profile_``).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from replay_kit.config.run import LogConfig
from replay_kit.core.extensions import additions
from replay_kit.logs.netcdf.adcp import midas_pings, seaexplorer_pings, seaglider_pings
from replay_kit.logs.netcdf.dialect import Dialect
from replay_kit.logs.netcdf.glider import glider, missions_of
from replay_kit.logs.netcdf.surface import DRIFTERS, TOTALS
from replay_kit.logs.netcdf.unknown import NEEDED, PINGS, ROWS, pings_as, require_no_grid
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored, open_netcdf, open_text
from replay_kit.logs.reader import LogFile, Told, WholeLog

# Seaglider: the files of its basestation, with or without an ADCP.
_SEAGLIDER = Dialect(
    "seaglider",
    "Seaglider basestation",
    "log_gps_time log_gps_lat log_gps_lon",
    {
        "time": "ctd_time time",
        "longitude": "longitude",
        "latitude": "latitude",
        "depth": "ctd_depth depth",
        "pressure": "ctd_pressure",
        "temperature": "temperature",
        "salinity": "salinity",
        "declination": "magnetic_variation",
        "gps_time": "log_gps_time",
        "gps_longitude": "log_gps_lon",
        "gps_latitude": "log_gps_lat",
        "gps_error": "log_gps_hpe",
        "gps_flag": "log_gps_qc",
        "dac_east": "depth_avg_curr_east",
        "dac_north": "depth_avg_curr_north",
        "dac_error": "depth_avg_curr_error",
        "dac_flag": "depth_avg_curr_qc",
        "radius": "log_tgt_radius",
    },
    flag_meanings="3 QC_PROBABLY_BAD 4 QC_BAD 6 QC_UNSAMPLED 9 QC_MISSING",
    heading="magnetic",
    beside="(ad2cp_|log_dive).*",
    dac_kind="hydrodynamic_model",
    pings=seaglider_pings,
)

# Nortek's AD2CP on a glider, exported by MIDAS: pings alone.
_MIDAS = Dialect(
    "midas",
    "Nortek AD2CP exported by MIDAS",
    "time velocitybeam1 velocitybeam2 heading pitch roll",
    {"time": "time"},
    heading="magnetic",
    beside="(velocity|correlation|amplitude|heading|pitch|roll|pressure|speedofsound|accelerometerz|temperature).*",
    pings=midas_pings,
)

# Slocum: NetCDF with the glider's own names, as of dbd2netcdf and xarray-dbd.
_SLOCUM = Dialect(
    "slocum",
    "Slocum, exported with the glider's own names",
    "m_present_time|sci_m_present_time m_lat|m_gps_lat",
    {
        "time": "m_present_time sci_m_present_time",
        "longitude": "m_lon",
        "latitude": "m_lat",
        "depth": "m_depth",
        "pressure": "sci_water_pressure m_pressure",
        "temperature": "sci_water_temp",
        "conductivity": "sci_water_cond",
        "heading": "m_heading",
        "pitch": "m_pitch",
        "roll": "m_roll",
        "declination": "m_gps_mag_var",
        "gps_longitude": "m_gps_lon",
        "gps_latitude": "m_gps_lat",
        "dac_east": "m_final_water_vx m_water_vx m_initial_water_vx",
        "dac_north": "m_final_water_vy m_water_vy m_initial_water_vy",
    },
    units={
        **dict.fromkeys(("longitude", "latitude", "gps_longitude", "gps_latitude"), "nmea"),
        **dict.fromkeys(("heading", "pitch", "roll", "declination"), "rad"),
        "pressure": "bar",
    },
    raw=True,
)

#: Slocum's binary files, put together by ``logs/slocum``; the files themselves are recognised by their first bytes.
SLOCUM_BINARY = replace(
    _SLOCUM,
    name="slocum-binary",
    title="Slocum's binary files",
    signature="",
    names={
        **_SLOCUM.names,
        "gps_time": "gps_time",
        "gps_flag": "m_gps_status",
        "dac_time": "report_time",
        "dac_east": "m_water_vx",
        "dac_north": "m_water_vy",
        "altitude": "m_altitude",
        "water_depth": "m_water_depth",
        "voltage": "m_battery",
        "charge_used": "m_coulomb_amphr_total",
        "waypoint_longitude": "c_wpt_lon",
        "waypoint_latitude": "c_wpt_lat",
    },
    units={},
    log_of="mission",
)

# of OG1, IOOS templates and pyglider, in any case
_CTD, _ATTITUDE = "pressure temperature salinity conductivity", "heading pitch roll"
_USUAL = {name: name for name in f"time longitude latitude depth {_CTD} {_ATTITUDE}".split()}
# a profile's means have one name in all files that follow the IOOS template
_UV = {
    "dac_east": "u",
    "dac_north": "v",
    "dac_time": "time_uv",
    "dac_longitude": "lon_uv",
    "dac_latitude": "lat_uv",
    "dac_flag": "u_qc",
}

# IOOS GliderDAC v2 and v3: a file a profile.
_GLIDERDAC = Dialect(
    "gliderdac",
    "IOOS GliderDAC",
    "time lat lon profile_id profile_time|time_uv",
    {**_USUAL, "longitude": "lon", "latitude": "lat", **_UV},
    log_of="mission",
)

# Spray: dives in bins, as CUGN publishes them.
_SPRAY = Dialect(
    "spray",
    "Spray, binned (CUGN)",
    "time lat lon depth u|u_depth_mean u_depth_mean|mission_name|mission_profile|trajectory_index",
    {
        "time": "time",
        "longitude": "lon",
        "latitude": "lat",
        "profile_depth": "depth",
        "profile_east": "u",
        "profile_north": "v",
        **_UV,
        "dac_east": "u_depth_mean",
        "dac_north": "v_depth_mean",
        "dac_flag": "",
    },
    ascent_share=0.75,
)

# OceanGliders OG1, as of seagliderOG1, VOTO, BODC and Spray; and EGO before it, of which no real file was tried.
_OG1 = Dialect(
    "og1",
    "OceanGliders OG1",
    "time latitude longitude profile_number|divenum|dive_number|phase_number phase|trajectory",
    {
        **_USUAL,
        # not depth_z, which has the standard name of a depth and the sign of a height
        "depth": "depth glider_depth",
        "pressure": "pres pressure",
        "temperature": "temp temperature",
        "salinity": "psal salinity",
        "conductivity": "cndc conductivity",
        "heading": "heading glider_heading",
        "pitch": "pitch glider_pitch",
        "roll": "roll glider_roll",
        "dive": "dive_number divenum",
        "gps_time": "time_gps",
        "gps_longitude": "longitude_gps",
        "gps_latitude": "latitude_gps",
        "end_time": "time_gps_end",
        "end_longitude": "longitude_gps_end",
        "end_latitude": "latitude_gps_end",
        "end_flag": "gps_end_qc",
        "gps_flag": "gps_start_qc latitude_gps_qc",
        "dac_east": "davg_curr_east watercurrents_u wcur_x water_velocity_eastward",
        "dac_north": "davg_curr_north watercurrents_v wcur_y water_velocity_northward",
        "dac_time": "time_uv",
        "dac_longitude": "longitude_uv",
        "dac_latitude": "latitude_uv",
        "dac_flag": "davg_curr_east_qc wcur_qc watercurrents_u_qc",
    },
    convention="OG-1",
    heading="magnetic",
)

# slocum-glide's L2.
_SLOCUM_GLIDE = Dialect(
    "slocum-glide",
    "slocum-glide (L2)",
    "time lat lon dive_id climb_id state",
    {
        **_GLIDERDAC.names,
        "gps_time": "time_gps",
        "gps_longitude": "lon_gps",
        "gps_latitude": "lat_gps",
    },
)

# GliderDAC's profiles, aggregated by ERDDAP.
_ERDDAP = Dialect(
    "erddap",
    "GliderDAC aggregated by ERDDAP",
    "time latitude longitude profile_id depth|precise_time",
    {
        **_GLIDERDAC.names,
        # time, latitude and longitude are those of the profile, repeated at each of its samples
        "time": "precise_time time",
        "longitude": "precise_lon longitude",
        "latitude": "precise_lat latitude",
        "dac_longitude": "longitude_uv lon_uv",
        "dac_latitude": "latitude_uv lat_uv",
    },
)

# pyglider's time series, L0.
_PYGLIDER = Dialect(
    "pyglider",
    "pyglider time series (L0)",
    "time latitude longitude profile_index|profile_num|dive_num",
    {
        **_USUAL,
        "declination": "declination",
        "dive": "dive_num",
        "dead_reckoning": "dead_reckoning",
        "nav_state": "nav_state",
        "dac_east": "water_velocity_eastward u",
        "dac_north": "water_velocity_northward v",
    },
)

# The SOCIB glider toolbox, L1 and L2.
_SOCIB = Dialect(
    "socib",
    "SOCIB glider toolbox (L1, L2)",
    "time latitude longitude water_velocity_eastward water_velocity_northward",
    _PYGLIDER.names,
)

# SeaExplorer: raw files of the glider and its payload.
_SEAEXPLORER = Dialect(
    "seaexplorer",
    "SeaExplorer raw",
    "timestamp|pld_realtimeclock lat|nav_latitude lon|nav_longitude",
    {
        "time": "timestamp pld_realtimeclock",
        "longitude": "lon nav_longitude",
        "latitude": "lat nav_latitude",
        "depth": "depth nav_depth",
        "heading": "heading",
        "pitch": "pitch",
        "roll": "roll",
        "declination": "declination",
        "dead_reckoning": "deadreckoning",
        "nav_state": "navstate nav_resource",
    },
    units={
        **dict.fromkeys(("longitude", "latitude"), "nmea"),
        **dict.fromkeys(("heading", "pitch", "roll", "declination"), "degrees"),
        "depth": "m",
    },
    beside="ad2cp_.*",
    pings=seaexplorer_pings,
    log_of="mission",
    raw=True,
)

#: In the order in which they are tried: the narrower signature first.
GLIDERS: tuple[Dialect, ...] = (
    _SEAGLIDER,
    _MIDAS,
    _SLOCUM,
    _SPRAY,
    _OG1,
    _SLOCUM_GLIDE,
    _GLIDERDAC,
    _ERDDAP,
    _PYGLIDER,
    _SOCIB,
    _SEAEXPLORER,
)


Form = Literal["netcdf", "seaexplorer", "table"]
#: All dialects, in the order in which they are tried; a file of none is of ``PINGS`` or ``ROWS``.
DIALECTS: tuple[Dialect, ...] = (*GLIDERS, TOTALS, DRIFTERS)


def dialect_of(
    held: Mapping[str, Stored], attributes: Mapping[str, Any], text: bool = False
) -> Dialect | None:
    """Return the dialect of a file with these variables and attributes; None if unknown.

    Args:
        held: Variables of the file.
        attributes: Global attributes of the file.
        text: Whether it is a text table other than a SeaExplorer's, which excludes glider dialects and those read in parts.
    """
    added = additions("dialects", lambda value: isinstance(value, Dialect), "a Dialect").values()
    return next(
        (
            dialect
            for dialect in (*DIALECTS, *added)
            if (not text or (dialect.read is not None and not dialect.by_times))
            and dialect.recognises(held, attributes)
        ),
        None,
    )


def log_of_columns(
    files: Sequence[NetcdfFile], dialect: Dialect, told: Told, config: LogConfig | None
) -> WholeLog:
    """Return the log of some files in one dialect.

    Args:
        files: Files of the log in order of time; the first gives its name.
        dialect: Dialect of the files.
        told: Findings when the files were opened.
        config: Settings of log reading.

    Raises:
        LogError: A file cannot be read, or the unit of a variable is unknown.
    """
    paths = [path for file in files for path in file.sources or (file.path,)]
    files = [replace(file, told=told) for file in files]
    entries = (dialect.read or glider)(files, dialect)
    return WholeLog(paths, dialect.name, told, entries, config, dialect.read is None)


def logs_of_columns(
    paths: Sequence[Path], config: LogConfig | None, form: Form = "netcdf"
) -> list[LogFile]:
    """Return the readers of files, of which those of one mission, or of one dialect, are one log.

    Args:
        paths: Files.
        config: Settings of log reading.
        form: NetCDF, text of a SeaExplorer, or another text table.

    Raises:
        LogError: A file cannot be read, or is a forecast.
    """
    groups: dict[Any, tuple[Dialect, list[NetcdfFile]]] = {}
    for number, path in enumerate(paths):
        file, dialect = _opened(path, form, config or LogConfig())
        missions = missions_of(file, dialect.name) if dialect.log_of == "mission" else ()
        key = number if dialect.log_of == "file" else (dialect.name, *missions)
        groups.setdefault(key, (dialect, []))[1].append(file)
    return [log_of_columns(files, dialect, Told(), config) for dialect, files in groups.values()]


def _opened(path: Path, form: Form, config: LogConfig) -> tuple[NetcdfFile, Dialect]:
    """Return the variables of a file that its dialect reads, and the dialect."""
    found: list[Dialect] = []

    def choose(held: Mapping[str, Stored], attributes: Mapping[str, Any]) -> list[str]:
        dialect = dialect_of(held, attributes, form == "table")
        if dialect is None:
            flat = {name: stored for name, stored in held.items() if stored.extents < 3}
            require_no_grid(path, held)
            asked = form != "netcdf" or config.columns or PINGS.chosen(flat).keys() >= NEEDED
            dialect, held = (pings_as(config.columns), flat) if asked else (ROWS, held)
        found.append(dialect)
        if dialect.by_times:
            return [dialect.chosen(held)["time"]]
        return dialect.wanted(held)

    file = (
        open_netcdf(path, choose) if form == "netcdf" else open_text(path, choose, form == "table")
    )
    return file, found[0]


#: Readers of text.
logs_of_seaexplorers = partial(logs_of_columns, form="seaexplorer")
logs_of_tables = partial(logs_of_columns, form="table")
