"""Messages of a glider's columns: fixes, positions, mean currents, pings and other instruments."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np

from replay_kit.core.message import NO_MEANS
from replay_kit.core.words.text import count_text
from replay_kit.logs.netcdf.adcp import INVERTED, PROFILES, absolute_profiles
from replay_kit.logs.netcdf.columns import Table, are_known, joined_columns, read_columns
from replay_kit.logs.netcdf.currents import DiveMean, fixes_of, mean_currents, places_in
from replay_kit.logs.netcdf.dialect import MISSIONS, Dialect
from replay_kit.logs.netcdf.variables import NetcdfFile
from replay_kit.logs.payloads import DIVE_MEAN, FIX, Entry, entries, fix_entries, location_fix
from replay_kit.logs.reader import Entries

_DECIMATED_NS = 60 * 1_000_000_000
# m; samples of one time that lie farther apart have no depth of their own
_ONE_DEPTH = 5.0


def glider(files: Sequence[NetcdfFile], dialect: Dialect) -> Entries:
    """Return the messages of a glider's files, which are read whole.

    ``/vehicle/fix``: GPS. ``/vehicle/position``: once a minute. ``/adcp``: velocity relative to the glider. ``/adcp/inverted``,
    ``/adcp/absolute``: absolute profiles. ``/dac``: mean current of each dive, at the fix after it. Others: see ``_INSTRUMENTS``.

    Args:
        files: Files of one log, in order of time.
        dialect: Dialect of the files.

    Raises:
        LogError: The unit of a variable is unknown.
    """
    told = files[0].told
    notes = told.notes
    if (count := sum(len(file.sources) or 1 for file in files)) > 1:
        notes.insert(0, f"{dialect.title}: {count} files are one log")
    if left_out := sum(file.attributes.get("lines_left_out", 0) for file in files):
        lines = count_text(left_out, "line")
        notes.append(f"{lines} with fewer or more columns than the heading, not used")
    told.mission = _one_mission(files, dialect, notes)
    columns = joined_columns([read_columns(file, dialect) for file in files])
    samples = columns.samples
    fixes = fixes_of(columns, told)
    means = mean_currents(columns, fixes, dialect, told)
    pings = [ping for file in files if dialect.pings for ping in dialect.pings(file)]
    pings += absolute_profiles(columns, means, notes)
    tracked = fixes["time"].size > 1 and np.isfinite(samples["longitude"] + samples["depth"]).any()
    if tracked and not (means or pings):
        notes.append(
            f"{NO_MEANS}none is stated; if the dead-reckoned positions include no current, "
            "--dead-reckoning through_water computes them"
        )
    if "heading" in samples:
        unknown = "whether headings are magnetic or true is not known"
        how = unknown if dialect.heading == "unknown" else f"headings are {dialect.heading}"
        notes.append(f"{how}; no declination was added to them")
    # an inversion weighs the mean current against the pings; profiles that were only shifted to it hold nothing else of it
    topics = {topic for _, topic, _, _ in pings}
    related = {"inverted_in": INVERTED} if INVERTED in topics else {}
    related = {"also_in": PROFILES} if PROFILES in topics else related
    # at one time a position comes before the velocities measured there
    return lambda: (
        chain(
            fix_entries(fixes),
            _positions(samples, means, fixes, dialect),
            ((mean.end.time_ns, "/dac", DIVE_MEAN, mean.payload | related) for mean in means),
            pings,
        ),
        *(_instrument(topic, samples) for topic in _INSTRUMENTS),
    )


def _positions(
    samples: Table, means: Sequence[DiveMean], fixes: Table, dialect: Dialect
) -> Iterator[Entry]:
    """Yield the track, one position per minute, first and deepest samples included."""
    for mean in means:
        if middle := mean.middle:
            fix = location_fix(*middle, mean.max_depth, True, math.nan)
            yield middle.time_ns, "/vehicle/position", FIX, fix
    # a basestation's positions are of its CTD, its attitude of its ADCP
    basestation = dialect.name == "seaglider"
    time, depth = samples["time"], _depth_at_times(samples)
    usable = are_known(places_in(samples)) & ~np.isin(time, fixes["time"])
    if basestation:
        usable &= np.isfinite(depth)
    if dialect.raw and fixes["time"].size:
        usable &= time >= fixes["time"][0]
    angles = [] if basestation else [a for a in ("heading", "pitch", "roll") if a in samples]
    due = 0
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


def _depth_at_times(samples: Table) -> Any:
    """Return the samples' depths [m], NaN where samples of one time have different depths."""
    _, first, of_time = np.unique(samples["time"], return_index=True, return_inverse=True)
    depth = samples["depth"]
    # samples are in order of time
    range_at_time = np.fmax.reduceat(depth, first) - np.fmin.reduceat(depth, first)
    return np.where(range_at_time[of_time] > _ONE_DEPTH, np.nan, depth)


#: Topics with the schema of their messages and the quantities in them (SI units, degrees, degrees Celsius, V, A h); a message is written
#: where one of the second group is known.
_INSTRUMENTS = MappingProxyType(
    {
        "/ctd": (
            "replay_kit.Ctd",
            ("depth", "pressure", "dive"),
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


def _instrument(topic: str, samples: Table) -> Iterator[Entry]:
    """Yield an instrument's messages in order of time: every CTD sample, changes of the waypoint, others once a minute."""
    schema, beside, measured = _INSTRUMENTS[topic]
    held = [name for name in measured if name in samples]
    if not held:
        return
    values = np.column_stack([samples[name] for name in held])
    known = np.flatnonzero(np.isfinite(values).any(axis=1))
    if topic == "/vehicle/waypoint":
        new = (np.diff(values[known], axis=0) != 0.0).any(axis=1)
    elif topic == "/ctd":
        new = np.ones(max(known.size - 1, 0), np.bool_)
    else:
        new = np.diff(samples["time"][known] // _DECIMATED_NS) > 0
    names = [*(name for name in beside if name in samples), *held]
    columns = {name: samples[name] for name in names}
    rows = known[np.r_[True, new][: known.size]]
    yield from entries((topic, schema), samples["time"], columns, rows, {})


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
        notes.append(f"{len(names)} missions in one log ({shown}): merged as those of one glider")
    return names[0] if len(names) == 1 else ""
