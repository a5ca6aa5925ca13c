"""Fixes at the surface: stated by the file, or marked by a flag of dead reckoning or the vehicle's state."""

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.logs.glider.columns import Columns, Table
from replay_kit.logs.shared.payloads import Positions

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
