"""The dialects of glider files: how each is recognised, and under which names it holds what.

A name is compared without regard to case. Of several names of a quantity the first that a file has is read.
To add a dialect, write its ``Dialect`` here and add it to ``DIALECTS``.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

from replay_kit.core.extensions import additions
from replay_kit.core.message import NO_MEANS
from replay_kit.core.quantities import metres_per_second
from replay_kit.logs.glider.adcp import midas_pings, seaexplorer_pings, seaglider_pings
from replay_kit.logs.glider.netcdf import NetcdfFile, Stored, stated_of
from replay_kit.logs.glider.units import (
    ANGLE,
    CHARGE,
    CONDUCTIVITY,
    HEIGHT,
    LATITUDE,
    LENGTH,
    LONGITUDE,
    NUMBER,
    PRESSURE,
    SALINITY,
    SPEED,
    TEMPERATURE,
    VOLTAGE,
    Quantity,
)
from replay_kit.logs.reader import Entry

Names = Mapping[str, str]
# not at the surface, nor relative to the vehicle
_CURRENT = re.compile(r"(?:[a-z]+_)*?(eastward|northward)_sea_water_velocity(?:_\w+)?")

_PLACES = ("", "gps_", "start_", "end_", "dac_", "waypoint_")
#: What the reader asks for: samples along the track, fixes before (``start_``), after (``end_``) or at any time (``gps_``), mean
#: currents (``dac_``), absolute profiles (``profile_``). Times are read apart.
QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        **{f"{part}longitude": LONGITUDE for part in _PLACES},
        **{f"{part}latitude": LATITUDE for part in _PLACES},
        **dict.fromkeys(("depth", "gps_error", "profile_depth", "radius"), LENGTH),
        **dict.fromkeys(("altitude", "water_depth"), HEIGHT),
        "pressure": PRESSURE,
        "temperature": TEMPERATURE,
        "conductivity": CONDUCTIVITY,
        "salinity": SALINITY,
        "voltage": VOLTAGE,
        "charge_used": CHARGE,
        **dict.fromkeys(("heading", "pitch", "roll", "declination"), ANGLE),
        **dict.fromkeys(
            ("dac_east", "dac_north", "dac_error", "profile_east", "profile_north"), SPEED
        ),
        **dict.fromkeys(("dive", "dead_reckoning", "nav_state"), NUMBER),
    }
)
TIMES = ("time", "gps_time", "start_time", "end_time", "dac_time")

# how many samples each profile of a ragged array has; which mission a file is of
_ALWAYS = ("rowsize", "row_size", "trajectory", "mission_name")


@dataclass(frozen=True, slots=True)
class Dialect:
    """One convention of glider files.

    Attributes:
        name: As in ``LogReport.format``.
        title: For a person.
        signature: Names that a file of the dialect has, all of them; ``a|b`` is one of both.
        names: Quantity to the names that it may have, the preferred first, with spaces between them.
        convention: Text in the attribute ``Conventions`` that is enough to recognise the dialect; empty for none.
        units: Unit of a quantity where the dialect has one that the files do not state.
        flag_meanings: ``value meaning`` pairs of flags in files that do not state them.
        heading: What headings count from.
        beside: Prefixes of further names that the dialect's ADCP reader needs.
        ascent_share: Where in a dive a profile's own time and place lie, from 0 at its start to 1 at its end; 0 where that is not known.
        dac_kind: How the mean currents were computed.
        pings: Reads the pings of an ADCP from a file, and adds to the notes what it assumed; None for a dialect without one.
        in_parts: Whether a mission is many files: one a profile, or one a segment.
        raw: Whether values are as the vehicle wrote them: their units are fixed, and positions before the first fix are unfounded.
    """

    name: str
    title: str
    signature: str
    names: Names
    convention: str = ""
    units: Names = field(default_factory=dict)
    flag_meanings: str = ""
    heading: Literal["magnetic", "true", "unknown"] = "unknown"
    beside: tuple[str, ...] = ()
    ascent_share: float = 0.0
    dac_kind: str = "dead_reckoning"
    pings: Callable[[NetcdfFile, list[str]], Iterator[Entry]] | None = None
    in_parts: bool = False
    raw: bool = False

    def recognises(self, names: Collection[str], attributes: Mapping[str, Any]) -> bool:
        """Return whether a file with these variables and attributes is of the dialect."""
        lower = {name.lower() for name in names}
        stated = str(attributes.get("Conventions", attributes.get("conventions", "")))
        wanted = [names.split("|") for names in self.signature.split()]
        by_name = bool(wanted) and all(not lower.isdisjoint(names) for names in wanted)
        return by_name or bool(self.convention and self.convention in stated.upper())

    def chosen(self, names: Collection[str]) -> dict[str, str]:
        """Return the variable of each quantity that a file has: the first of its names, in the file's own case."""
        own = {name.lower(): name for name in names}
        found = {
            key: [own[name] for name in listed.split() if name in own]
            for key, listed in self.names.items()
        }
        return {key: names[0] for key, names in found.items() if names}

    def wanted(self, names: Collection[str]) -> list[str]:
        """Return which of a file's variables are read: those of quantities, their flags, and those of the ADCP reader."""
        found = self.chosen(names)
        chosen = set(found.values())
        if not {"dac_east", "dac_north"} <= set(found):
            chosen |= {name for name in names if self.may_be_mean(names, name)}
        flags = {name + suffix for name in chosen for suffix in ("_QC", "_qc")}
        beside = (*self.beside, *_ALWAYS)
        return [
            name
            for name in names
            if name in chosen or name in flags or name.lower().startswith(beside)
        ]

    def may_be_mean(self, held: Collection[str], name: str) -> bool:
        """Return whether a variable may be a component of a mean current: by its standard name, or by a unit of velocity without one."""
        if name.lower().startswith(self.beside):
            return False
        unit = stated_of(held, name, "units")
        standard = stated_of(held, name, "standard_name")
        return bool(_direction(held, name)) or (
            not standard and bool(unit) and metres_per_second(unit) is not None
        )

    def by_standard_names(self, held: Mapping[str, Stored], notes: list[str]) -> dict[str, str]:
        """Return the variable of each quantity, components of currents by their standard names wherever one is present.

        Args:
            held: The file's variables.
            notes: What names and standard names contradict, and which variables may be mean currents, is added here.
        """
        found = self.chosen(held)
        for part in ("dac", "profile"):
            keys = (f"{part}_east", f"{part}_north")
            named = [found[key] for key in keys if key in found]
            stated = [_direction(held, name) for name in named]
            if stated in (["north", "east"], ["north", ""], ["", "east"]):
                found |= dict(zip(keys, reversed(named), strict=True))
                notes.append(
                    f"{' and '.join(named)}: read as their standard names state, northward and eastward; their names say the contrary"
                )
            elif stated in (["north"] * 2, ["east"] * 2):
                notes.append(
                    f"{' and '.join(named)}: both have the standard name of the {stated[0]}ward component; read by their names"
                )
        if {"dac_east", "dac_north"} <= set(found):
            return found
        free = [
            name
            for name, stored in held.items()
            if name not in found.values()
            and stored.values.ndim < 2
            and self.may_be_mean(held, name)
        ]
        directed = {name: to for name in free if (to := _direction(held, name))}
        sizes = {held[name].values.size for name in directed}
        if sorted(directed.values()) == ["east", "north"] and len(sizes) == 1:
            return found | {f"dac_{to}": name for name, to in directed.items()}
        if free:
            notes.append(
                f"{NO_MEANS}{', '.join(free)} may be them, by their unit, but no standard name says which is east and which north; "
                "state eastward_sea_water_velocity and northward_sea_water_velocity"
            )
        return found


def _direction(held: Collection[str], name: str) -> str:
    """Return ``east`` or ``north`` for a variable whose standard name is of a component of the current; empty for others."""
    match = _CURRENT.fullmatch(stated_of(held, name, "standard_name"))
    return "" if match is None or match[0].startswith("surface") else match[1][:-4]


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
    beside=("ad2cp_", "log_dive"),
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
    beside=(
        "velocity",
        "correlation",
        "amplitude",
        "heading",
        "pitch",
        "roll",
        "pressure",
        "speedofsound",
        "accelerometerz",
        "temperature",
    ),
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
    in_parts=True,
)

# IOOS GliderDAC v2 and v3: a file a profile.
# of IOOS templates and pyglider
_CTD = {name: name for name in ("pressure", "temperature", "salinity", "conductivity")}
#: A profile's means have one name in all files that follow the IOOS template.
UV = {
    "dac_east": "u",
    "dac_north": "v",
    "dac_time": "time_uv",
    "dac_longitude": "lon_uv",
    "dac_latitude": "lat_uv",
    "dac_flag": "u_qc",
}
_GLIDERDAC = Dialect(
    "gliderdac",
    "IOOS GliderDAC",
    "time lat lon profile_id profile_time|time_uv",
    {
        "time": "time",
        "longitude": "lon",
        "latitude": "lat",
        "depth": "depth",
        **_CTD,
        **UV,
    },
    in_parts=True,
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
        **UV,
        "dac_east": "u_depth_mean",
        "dac_north": "v_depth_mean",
        "dac_flag": "",
    },
    ascent_share=0.75,
)

# OceanGliders OG1, as of seagliderOG1, VOTO, BODC and Spray.
_OG1 = Dialect(
    "og1",
    "OceanGliders OG1",
    "time latitude longitude profile_number|divenum|dive_number phase|trajectory",
    {
        "time": "time",
        "longitude": "longitude",
        "latitude": "latitude",
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
        "pitch": "pitch",
        "roll": "roll",
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
        "time": "time",
        "longitude": "longitude",
        "latitude": "latitude",
        "depth": "depth",
        **_CTD,
        "heading": "heading",
        "pitch": "pitch",
        "roll": "roll",
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
    beside=("ad2cp_",),
    pings=seaexplorer_pings,
    in_parts=True,
    raw=True,
)

#: All dialects, in the order in which they are tried: the narrower signature first.
DIALECTS: tuple[Dialect, ...] = (
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


def dialect_of(names: Collection[str], attributes: Mapping[str, Any]) -> Dialect | None:
    """Return the dialect of a file with these variables and attributes; None for a file of no known dialect."""
    added = additions("dialects", lambda value: isinstance(value, Dialect), "a Dialect").values()
    dialects = (*DIALECTS, *added)
    return next((dialect for dialect in dialects if dialect.recognises(names, attributes)), None)
