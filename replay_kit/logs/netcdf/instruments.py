"""What the columns hold beside the track: fixes, absolute profiles, water properties, echo sounder, battery, next waypoint."""

from collections.abc import Iterator, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.logs.netcdf.adcp import FROM_SURFACE, earth_ping
from replay_kit.logs.netcdf.columns import Columns, Table
from replay_kit.logs.netcdf.currents import DiveMean
from replay_kit.logs.netcdf.dialects import Told
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING, Positions, number, stamp

# of a SeaExplorer: at the surface with a fix
_FIX_STATE = 119


def fixes_of(columns: Columns, told: Told) -> Positions:
    """Return the fixes of a mission; those that lack a time or a position are counted.

    Those that have variables of their own; else those at either end of a stretch at the surface, by the flag of dead reckoning or by
    the vehicle's state, because between them the last position is repeated.

    Args:
        columns: The mission.
        told: What was assumed, and cannot be used, is added here.
    """
    samples = columns.samples
    parts = ((columns.gps, "gps_"), (samples, "start_"), (samples, "end_"))
    found = [*map(np.concatenate, zip(*(_stated(*part) for part in parts), strict=True))]
    whole = _whole(found)
    # files repeat the fix, or write none, at each sample of a dive: only a time without a place in a table of fixes is a loss
    own = columns.gps.get("gps_time", np.empty(0)).size
    lost = 0 if own in (0, samples.get("time", np.empty(0)).size) else int((~whole).sum())
    flagged = sum(n for (topic, _), n in told.skipped.items() if topic == "/vehicle/fix")
    told.skipped["/vehicle/fix", "GPS fix without time or position"] += max(lost - flagged, 0)
    if not whole.any():
        at_surface = _at_surface(samples, told.notes)
        found = [*_stated({key: held[at_surface] for key, held in samples.items()}, "")]
        whole = _whole(found)
    _, first = np.unique(found[0][whole], return_index=True)
    repeated = int(whole.sum()) - first.size
    if repeated and not {"start_time", "end_time"} & set(samples):
        told.notes.append(f"{repeated} fixes at the time of another, excluded")
    return Positions(*(values[whole][first] for values in found))


def _whole(fixes: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    return np.asarray((fixes[0] > 0) & np.isfinite(fixes[1] + fixes[2]))


def _stated(table: Table, part: str) -> tuple[NDArray[Any], ...]:
    """Return time, longitude, latitude and error of the fixes that a table states; none where it lacks any of the first three."""
    time_ns = table.get(f"{part}time", np.empty(0, np.int64))
    if not {f"{part}longitude", f"{part}latitude"} <= set(table):
        time_ns = time_ns[:0]
    columns = (
        table.get(f"{part}{name}", np.full(time_ns.size, np.nan))[: time_ns.size]
        for name in ("longitude", "latitude", "error")
    )
    return time_ns, *columns


def _at_surface(samples: Table, notes: list[str]) -> NDArray[np.intp]:
    """Return the samples at either end of each stretch that a flag or the state marks as measured."""
    measured = np.zeros(samples.get("time", np.empty(0)).size, np.bool_)
    if "dead_reckoning" in samples:
        measured = samples["dead_reckoning"] == 0.0
    elif "nav_state" in samples:
        measured = samples["nav_state"] == _FIX_STATE
        if measured.any():
            notes.append(
                f"fixes: positions in the navigation state {_FIX_STATE}, because no flag marks dead reckoning"
            )
    unknown = np.full(measured.size, np.nan)
    for name in ("longitude", "latitude"):
        measured = measured & np.isfinite(samples.get(name, unknown))
    held = np.r_[False, measured, False]
    edges = np.flatnonzero(measured & ~(held[:-2] & held[2:]))
    if not edges.size:
        notes.append("no fixes: nothing marks measured positions; all are treated as dead-reckoned")
    return edges


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
