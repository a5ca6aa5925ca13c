"""Messages of a glider's columns: fixes, positions, mean currents, pings and other instruments."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.message import NO_MEANS
from replay_kit.core.observation import Fix
from replay_kit.core.text import count_text
from replay_kit.logs.netcdf.adcp import FROM_SURFACE, INVERTED, earth_ping
from replay_kit.logs.netcdf.columns import Columns, Table, joined, read_columns
from replay_kit.logs.netcdf.currents import DiveMean, fixes_of, mean_currents
from replay_kit.logs.netcdf.dialects import MISSIONS, Dialect, Entries, Told
from replay_kit.logs.netcdf.variables import NetcdfFile
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import FIX, PING, Positions, location_fix, number, stamp

_NS = 1_000_000_000
_DECIMATED_NS = 60 * _NS
# m; samples of one time that lie farther apart have no depth of their own
_ONE_DEPTH = 5.0
_DAC = "replay_kit.DepthAveragedCurrent"
# topic of the absolute profiles
_PROFILES = "/adcp/absolute"


def glider(files: Sequence[NetcdfFile], dialect: Dialect, config: LogConfig, told: Told) -> Entries:
    """Return the messages of a glider's files, which are read whole.

    ``/vehicle/fix``: GPS. ``/vehicle/position``: dead-reckoned or interpolated, with depth, once a minute. ``/adcp``: velocity relative to
    the glider. ``/ctd``, ``/vehicle/altimeter``, ``/vehicle/battery``, ``/vehicle/waypoint``: see ``_INSTRUMENTS``. ``/adcp/inverted``,
    ``/adcp/absolute``: absolute profiles. ``/dac``: mean current of each dive, at the fix after it.

    Args:
        files: Files of one log, in order of time.
        dialect: Dialect of the files.
        config: Ignored.
        told: Receives assumptions and counts of unusable values.

    Raises:
        LogError: The unit of a variable is unknown.
    """
    del config
    notes = told.notes
    count = sum(len(file.sources) or 1 for file in files)
    if count > 1:
        notes.insert(0, f"{dialect.title}: {count} files are one log")
    if left_out := sum(file.attributes.get("lines_left_out", 0) for file in files):
        notes.append(
            f"{count_text(left_out, 'line')} with fewer or more columns than the heading, not used"
        )
    told.mission = _one_mission(files, dialect, notes)
    columns = joined([read_columns(file, dialect, told) for file in files])
    fixes = fixes_of(columns, told)
    means = mean_currents(columns, fixes, dialect.ascent_share, told)
    pings = [ping for file in files if dialect.pings for ping in dialect.pings(file, notes)]
    pings += _absolute_profiles(columns, means, notes)
    samples = columns.samples
    tracked = fixes.time_ns.size > 1 and {"longitude", "depth"} <= set(samples)
    if tracked and not (means or pings):
        notes.append(
            f"{NO_MEANS}none is stated; if the dead-reckoned positions include no current, "
            "--dead-reckoning through_water computes them"
        )
    if "heading" in samples:
        unknown = "whether headings are magnetic or true is not known"
        how = unknown if dialect.heading == "unknown" else f"headings are {dialect.heading}"
        notes.append(f"{how}; no declination was added to them")
    # at one time a position comes before the velocities measured there
    return lambda: (
        chain(
            fixes.entries(),
            _positions(samples, means, fixes, dialect),
            _dacs(means, pings, dialect.dac_kind),
            pings,
        ),
        *_instrument_entries(samples),
    )


def _dacs(means: Sequence[DiveMean], pings: Sequence[Entry], kind: str) -> Iterator[Entry]:
    # an inversion weighs the mean current against the pings; profiles that were only shifted to it hold nothing else of it
    topics = {topic for _, topic, _, _ in pings}
    named = (
        {"also_in": _PROFILES}
        if _PROFILES in topics
        else {"inverted_in": INVERTED}
        if INVERTED in topics
        else {}
    )
    for mean in means:
        yield mean.end.time_ns, "/dac", _DAC, _dac(mean, kind) | named


def _positions(
    samples: Table, means: Sequence[DiveMean], fixes: Positions, dialect: Dialect
) -> Iterator[Entry]:
    """Yield the track, one position per minute, first and deepest samples included."""
    for mean in means:
        if (middle := mean.middle) is not None:
            fix = location_fix(*middle, mean.max_depth, True, math.nan)
            yield middle.time_ns, "/vehicle/position", FIX, fix
    if not {"longitude", "latitude"} <= set(samples):
        return
    # a basestation's positions are of its CTD, its attitude of its ADCP
    basestation = dialect.name == "seaglider"
    time, depth = samples["time"], _depth_at_times(samples)
    usable = np.isfinite(samples["longitude"] + samples["latitude"])
    usable &= ~np.isin(time, fixes.time_ns) & (np.isfinite(depth) | (not basestation))
    if dialect.raw and fixes.time_ns.size:
        usable &= time >= fixes.time_ns[0]
    angles = (
        [] if basestation else [name for name in ("heading", "pitch", "roll") if name in samples]
    )
    due = -_DECIMATED_NS
    for k in np.flatnonzero(usable).tolist():
        time_ns = int(time[k])
        if time_ns < due:
            continue
        due = time_ns + _DECIMATED_NS
        place = samples["longitude"][k], samples["latitude"][k], depth[k]
        fix = location_fix(time_ns, *place, True, math.nan)
        fix["metadata"] += [
            {"key": name, "value": f"{value:.2f}"}
            for name in angles
            if math.isfinite(value := samples[name][k])
        ]
        yield time_ns, "/vehicle/position", FIX, fix


def _depth_at_times(samples: Mapping[str, Any]) -> Any:
    """Return the samples' depths [m], NaN where samples of one time have different depths."""
    if "depth" not in samples:
        return np.full(samples["time"].size, np.nan)
    depth = np.array(samples["depth"], np.float64)
    _, of_time = np.unique(samples["time"], return_inverse=True)
    least, most = np.full((2, of_time.max(initial=-1) + 1), [[np.inf], [-np.inf]])
    np.fmin.at(least, of_time, depth)
    np.fmax.at(most, of_time, depth)
    return np.where((most - least)[of_time] > _ONE_DEPTH, np.nan, depth)


def _dac(mean: DiveMean, kind: str) -> dict[str, Any]:
    return {
        "stamp": stamp(mean.end.time_ns),
        **({} if mean.dive is None else {"dive": mean.dive}),
        "dac_eastward": number(mean.east),
        "dac_northward": number(mean.north),
        "error": number(mean.error),
        "start_fix": _end(mean.start),
        "end_fix": _end(mean.end),
        "duration": (mean.end.time_ns - mean.start.time_ns) / _NS,
        "max_depth": number(mean.max_depth),
        "radius": number(mean.radius),
        "declination": number(mean.declination),
        "dac_kind": kind,
    }


def _end(end: Fix) -> dict[str, Any]:
    return {"time": stamp(end.time_ns), "lon": end.longitude, "lat": end.latitude}


#: Topics with the schema of their messages and the quantities in them; a message is written where one of the second group is known.
_INSTRUMENTS = MappingProxyType(
    {
        "/ctd": (
            "replay_kit.Ctd",
            ("depth", "pressure"),
            ("temperature", "salinity", "conductivity"),
        ),
        "/vehicle/altimeter": ("replay_kit.Altimeter", ("depth",), ("altitude", "water_depth")),
        "/vehicle/battery": ("replay_kit.Battery", (), ("voltage", "charge_used")),
        "/vehicle/waypoint": (
            "replay_kit.Waypoint",
            (),
            ("waypoint_longitude", "waypoint_latitude"),
        ),
    }
)


def _instrument_entries(samples: Table) -> list[Iterator[Entry]]:
    """Return the messages of each instrument in order of time: SI units, degrees, degrees Celsius, V, A h; null if unknown.

    Args:
        samples: Samples along the track.
    """
    return [
        _entries(topic, samples)
        for topic, (_, _, own) in _INSTRUMENTS.items()
        if any(name in samples for name in own)
    ]


def _entries(topic: str, samples: Table) -> Iterator[Entry]:
    """Yield an instrument's messages: every CTD sample, changes of the waypoint, others once a minute."""
    schema, beside, own = _INSTRUMENTS[topic]
    held = [name for name in own if name in samples]
    values = np.column_stack([samples[name] for name in held])
    known = np.flatnonzero(np.isfinite(values).any(axis=1))
    if topic == "/vehicle/waypoint":
        known = known[
            np.r_[True, (np.diff(values[known], axis=0) != 0.0).any(axis=1)][: known.size]
        ]
    elif topic != "/ctd":
        minute = samples["time"][known] // _DECIMATED_NS
        known = known[np.r_[True, np.diff(minute) > 0][: known.size]]
    names = [*(name for name in beside if name in samples), *held]
    for k in known.tolist():
        time_ns = int(samples["time"][k])
        payload = {name: number(float(samples[name][k])) for name in names}
        yield time_ns, topic, schema, {"stamp": stamp(time_ns), **payload}


def _absolute_profiles(
    columns: Columns, means: Sequence[DiveMean], notes: list[str]
) -> Iterator[Entry]:
    """Yield the absolute profiles of a mission as pings at the stated middle of their dives.

    They are referenced to the DACs: ``computed_from`` and ``also_in`` of the DACs prevent double counting.
    """
    profile, samples = columns.profile, columns.samples
    if not profile:
        return
    depth = profile["depth"]
    steps = np.diff(depth)
    even = bool(steps.size and np.allclose(steps, steps[0]) and steps[0] > 0.0)
    placed = {mean.middle.time_ns for mean in means if mean.middle is not None}
    notes.append(
        "absolute profiles: taken as east and north relative to the earth, each at the middle of its dive"
    )
    for k in range(len(profile["east"])):
        velocity = np.column_stack([profile["east"][k], profile["north"][k]])
        if not np.isfinite(velocity).all(axis=1).any():
            continue
        middle_ns = int(samples["dac_time"][k]) if "dac_time" in samples else 0
        time_ns = middle_ns if middle_ns in placed else int(samples["time"][k])
        payload = earth_ping(
            time_ns,
            k,
            int(samples["dive"][k]),
            velocity,
            (float(steps[0]) if even else 1.0, float(depth[0])),
        )
        payload |= FROM_SURFACE | {
            "computed_from": ["/dac"],
            **({} if even else {"cell_distances": depth.tolist()}),
        }
        yield time_ns, _PROFILES, PING, payload


#: Attributes that name the mission, with the dialects of which they do; of others ``id`` names the file
_ATTRIBUTES = (("deployment_name", None), ("id", "og1"), ("glider_name", None))


def missions_of(file: NetcdfFile, dialect: str) -> tuple[str, ...]:
    """Return the names of the missions in a file; empty if not stated.

    Args:
        file: File with the variables ``trajectory`` and ``mission_name``, if any.
        dialect: Name of its dialect.
    """
    if dialect == "seaexplorer":
        return (".".join(file.path.name.lower().split(".")[:2]),)
    named = [stored for name, stored in file.variables.items() if name.lower() in MISSIONS]
    stated = tuple(dict.fromkeys(text for stored in named for text in stored.texts() if text))
    if stated:
        return stated
    held = {key.lower(): str(value).strip() for key, value in file.attributes.items()}
    if dialect == "seaglider" and held.get("mission"):
        vehicle = held.get("platform_id") or held.get("glider", "")
        return (f"{vehicle} mission {held['mission']}".strip(),)
    found = (held.get(key, "") for key, only in _ATTRIBUTES if only in (None, dialect))
    return tuple(name for name in found if name)[:1]


def _one_mission(files: Sequence[NetcdfFile], dialect: Dialect, notes: list[str]) -> str:
    """Return the mission of all files; empty if not stated or if there are several, which is noted."""
    names = list(dict.fromkeys(name for file in files for name in missions_of(file, dialect.name)))
    if len(names) > 1:
        shown = f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"
        notes.append(
            f"{len(names)} missions in one log ({shown}): their dives are merged as if one glider had made them"
        )
    return names[0] if len(names) == 1 else ""
