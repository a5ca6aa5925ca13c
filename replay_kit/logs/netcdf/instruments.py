"""What the columns hold beside the track: fixes, absolute profiles, water properties, echo sounder, battery, next waypoint."""

from collections.abc import Iterator, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.logs.netcdf.adcp import FROM_SURFACE, earth_ping
from replay_kit.logs.netcdf.columns import Columns, Table
from replay_kit.logs.netcdf.currents import DiveMean
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING, Positions, number, stamp

# of a SeaExplorer: at the surface with a fix
_FIX_STATE = 119


def fixes_of(columns: Columns, notes: list[str]) -> tuple[Positions, int]:
    """Return the fixes of a mission, and how many more lack a time or a position.

    Those that have variables of their own; else those at either end of a stretch at the surface, by the flag of dead reckoning or by
    the vehicle's state, because between them the last position is repeated.

    Args:
        columns: The mission.
        notes: What was assumed is added here.
    """
    found = [
        _table(columns.gps, "gps_"),
        *(_table(columns.samples, part) for part in ("start_", "end_")),
    ]
    time_ns, longitude, latitude, error = (
        np.concatenate([part[k] for part in found]) for k in range(4)
    )
    # files repeat the fix, or write none, at each sample of a dive: only a time without a place in a table of fixes is a loss
    stated = columns.gps.get("gps_time", np.empty(0)).size not in (
        0,
        columns.samples.get("time", np.empty(0)).size,
    )
    whole = (time_ns > 0) & np.isfinite(longitude + latitude)
    lost = int((~whole).sum()) if stated else 0
    if not whole.any():
        time_ns, longitude, latitude, error = _by_state(columns.samples, notes)
        whole = np.ones(time_ns.size, np.bool_)
    _, first = np.unique(time_ns[whole], return_index=True)
    if (repeated := int(whole.sum()) - first.size) and not {"start_time", "end_time"} & set(
        columns.samples
    ):
        notes.append(f"{repeated} fixes at the time of another, excluded")
    return Positions(
        *(values[whole][first] for values in (time_ns, longitude, latitude, error))
    ), lost


def _table(table: Table, part: str) -> tuple[NDArray[np.int64], Array, Array, Array]:
    if not {f"{part}time", f"{part}longitude", f"{part}latitude"} <= set(table):
        return np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0)
    time_ns = table[f"{part}time"]
    return (
        time_ns,
        table[f"{part}longitude"],
        table[f"{part}latitude"],
        table.get(f"{part}error", np.full(time_ns.size, np.nan)),
    )


def _by_state(samples: Table, notes: list[str]) -> tuple[NDArray[np.int64], Array, Array, Array]:
    if not {"longitude", "latitude"} <= set(samples):
        measured = np.zeros(0, np.bool_)
    elif "dead_reckoning" in samples:
        measured = samples["dead_reckoning"] == 0.0
    elif "nav_state" in samples:
        measured = samples["nav_state"] == _FIX_STATE
        if measured.any():
            notes.append(
                f"fixes: positions in the navigation state {_FIX_STATE}, because no flag marks dead reckoning"
            )
    else:
        measured = np.zeros(0, np.bool_)
    rows = (
        np.flatnonzero(measured & np.isfinite(samples["longitude"] + samples["latitude"]))
        if measured.size
        else np.empty(0, np.intp)
    )
    edges = (
        rows[(np.diff(rows, prepend=-2) > 1) | (np.diff(rows, append=rows[-1:] + 2) > 1)]
        if rows.size
        else rows
    )
    if not edges.size:
        notes.append("no fixes: nothing marks measured positions; all are treated as dead-reckoned")
        return np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0)
    return (
        samples["time"][edges],
        samples["longitude"][edges],
        samples["latitude"][edges],
        np.full(edges.size, np.nan),
    )


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
_MINUTE_NS = 60 * 10**9


def instrument_entries(samples: Table) -> list[Iterator[Entry]]:
    """Return the messages of each instrument that a glider has, in order of time: SI units, degrees, degrees Celsius, V, A h; null unknown.

    Args:
        samples: Along the track.
    """
    return [
        _entries(topic, samples)
        for topic, (_, _, own) in _INSTRUMENTS.items()
        if any(name in samples for name in own)
    ]


def _entries(topic: str, samples: Table) -> Iterator[Entry]:
    """Yield an instrument's messages: each of the CTD, a waypoint when it changes, others once a minute."""
    schema, beside, own = _INSTRUMENTS[topic]
    held = [name for name in own if name in samples]
    values = np.column_stack([samples[name] for name in held])
    known = np.flatnonzero(np.isfinite(values).any(axis=1))
    if topic == "/vehicle/waypoint":
        known = known[
            np.r_[True, (np.diff(values[known], axis=0) != 0.0).any(axis=1)][: known.size]
        ]
    elif topic != "/ctd":
        minute = samples["time"][known] // _MINUTE_NS
        known = known[np.r_[True, np.diff(minute) > 0][: known.size]]
    names = [*(name for name in beside if name in samples), *held]
    for k in known.tolist():
        time_ns = int(samples["time"][k])
        payload = {name: number(float(samples[name][k])) for name in names}
        yield time_ns, topic, schema, {"stamp": stamp(time_ns), **payload}


#: Topic of the profiles.
PROFILES = "/adcp/absolute"


def absolute_profiles(
    columns: Columns, means: Sequence[DiveMean], notes: list[str]
) -> Iterator[Entry]:
    """Yield the absolute profiles of a mission as pings at the middle of their dives, where the file states it.

    They were referenced to the mean currents: ``computed_from`` and, in the mean currents, ``also_in`` keep them from counting twice.
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
        yield time_ns, PROFILES, PING, payload
