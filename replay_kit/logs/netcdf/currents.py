"""Fixes of a glider and mean currents of its dives, each once, with the fixes around it.

Files repeat a mean current at each sample of its dive, state it once per profile, or report it at the surface afterwards. All become a time
within the dive, from which the fixes before and after are found.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Indices
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.observation import Fix
from replay_kit.logs.netcdf.columns import Columns, Table, are_known, rows_of, stacked_tables
from replay_kit.logs.netcdf.dialect import Dialect
from replay_kit.logs.payloads import number, stamp
from replay_kit.logs.reader import Told

# m; less deep is at the surface
_SURFACE = 3.0
# ns; fixes farther apart than this enclose more than one dive, or a hole in the log
_LONGEST_NS = 48 * 3600 * 10**9
# of a SeaExplorer: at the surface with a fix
_FIX_STATE = 119
_NS = 1_000_000_000
_PLACE = ("time", "longitude", "latitude")

#: One row of a table by column.
Row = Mapping[str, float]


def places_in(table: Table, part: str = "") -> Table:
    """Return ``time``, ``longitude``, ``latitude`` and ``error`` of the columns whose names begin with ``part``; NaN if missing."""
    time_ns = table.get(f"{part}time", np.empty(0, np.int64))
    unknown = np.full(time_ns.size, np.nan)
    names = ("longitude", "latitude", "error")
    return {"time": time_ns, **{name: table.get(f"{part}{name}", unknown) for name in names}}


def _around(places: Table, inside: int) -> tuple[Fix, Fix] | None:
    """Return the positions before and at or after a time [ns, UTC]; None without them."""
    after = int(np.searchsorted(places["time"], inside))
    if not 0 < after < places["time"].size:
        return None
    before, end = (Fix(*(places[name][k].item() for name in _PLACE)) for k in (after - 1, after))
    return before, end


def fixes_of(columns: Columns, told: Told) -> Table:
    """Return time, longitude, latitude and error of the fixes of a mission; incomplete ones are counted.

    Fixes with their own variables are preferred; else samples at either end of each time at the surface, by dead-reckoning flag or vehicle
    state, as the last position is repeated between them.

    Args:
        columns: Columns of the mission.
        told: Receives assumptions and counts of unusable values.
    """
    samples = columns.samples
    at_fixes = places_in(columns.gps, "gps_")
    found = stacked_tables([at_fixes, places_in(samples, "end_")])
    # files repeat the fix, or write none, at each sample of a dive: only a time without a place in a table of fixes is a loss
    is_table = at_fixes["time"].size not in (0, samples["time"].size)
    lost = int((~are_known(found)).sum()) if is_table else 0
    flagged = sum(n for (topic, _), n in told.skipped.items() if topic == "/vehicle/fix")
    told.skipped["/vehicle/fix", "GPS fix without time or position"] += max(lost - flagged, 0)
    if not are_known(found).any():
        found = _measured(samples, told.notes)
    found = rows_of(found, are_known(found))
    _, first = np.unique(found["time"], return_index=True)
    repeated = found["time"].size - first.size
    if repeated and "end_time" not in samples:
        told.notes.append(f"{repeated} fixes at the time of another, excluded")
    return rows_of(found, first)


def _measured(samples: Table, notes: list[str]) -> Table:
    """Return the first and last sample of each period marked as measured by a flag or state."""
    places = places_in(samples)
    measured = np.zeros(places["time"].size, np.bool_)
    if "dead_reckoning" in samples:
        measured = samples["dead_reckoning"] == 0.0
    elif "nav_state" in samples:
        measured = samples["nav_state"] == _FIX_STATE
        if measured.any():
            notes.append(
                f"fixes: positions in the navigation state {_FIX_STATE}, because no flag marks dead reckoning"
            )
    held = np.r_[False, measured & are_known(places), False]
    edges = held[1:-1] & ~(held[:-2] & held[2:])
    if not edges.any():
        notes.append("no fixes: nothing marks measured positions; all are treated as dead-reckoned")
    return rows_of(places, edges)


class DiveMean(NamedTuple):
    """Mean current of a dive.

    Attributes:
        start: Fix before the dive.
        end: Fix after it.
        max_depth: Greatest depth of the dive [m]; NaN when unknown.
        middle: Position of the deepest point; None if the file has samples.
        payload: The message.
    """

    start: Fix
    end: Fix
    max_depth: float
    middle: Fix | None
    payload: dict[str, Any]


def mean_currents(
    columns: Columns, fixes: Table, dialect: Dialect, told: Told
) -> tuple[DiveMean, ...]:
    """Return the mean currents of a mission in order of time.

    Args:
        columns: Columns of the mission.
        fixes: Its fixes.
        dialect: Dialect of its files.
        told: Receives assumptions and counts of unusable values.
    """
    notes, samples = told.notes, columns.samples
    table = samples if "dac_east" in samples else columns.dac
    if not {"dac_east", "dac_north"} <= table.keys():
        return ()
    velocity = table["dac_east"] + 1j * table["dac_north"]
    dac_time = table.get("dac_time", np.zeros(velocity.size, np.int64))
    zero = velocity == 0.0
    if zero.any():
        begins = zero & np.r_[True, ~zero[:-1] | (dac_time[1:] != dac_time[:-1])]
        notes.append(f"mean current: {int(begins.sum())} of exactly (0, 0) taken as missing")
    rows = np.flatnonzero(np.isfinite(velocity) & ~zero)
    groups = list(rows[:, None])
    if table is samples:
        groups = _repeated(table, velocity, rows, fixes, notes)
    made: dict[tuple[int, int], DiveMean] = {}
    lost = 0
    for group in groups:
        within = group if table is samples else group[:0]
        mean = _mean(_row(table, group[0]), within, samples, fixes, dialect)
        if mean is None:
            lost += 1
        else:
            # of several reports at one surfacing the last is the glider's final one
            made[mean.start.time_ns, mean.end.time_ns] = mean
    if (replaced := len(groups) - lost - len(made)) > 0:
        notes.append(
            f"mean current: {replaced} earlier reports of the same dive replaced by the last one"
        )
    means = tuple(made[key] for key in sorted(made))
    ends = [end.time_ns for mean in means for end in (mean.start, mean.end)]
    if other := int((~np.isin(ends, fixes["time"])).sum()):
        how = "the first or last sample of their dive, or follow from its middle"
        notes.append(
            f"mean current: {other} of {len(ends)} ends are not fixes of the file; they are {how}"
        )
    told.skipped[
        "/dac", "mean current without fixes before and after it, or samples of its dive"
    ] += lost
    # numbered by order if the file neither numbers dives nor has samples at the surface
    surfaced = (samples["depth"] <= _SURFACE).any()
    if surfaced or any("dive" in mean.payload for mean in means):
        return means
    return tuple(
        mean._replace(payload={"dive": dive} | mean.payload) for dive, mean in enumerate(means, 1)
    )


def _row(table: Table, k: int) -> Row:
    return {key: column[k].item() for key, column in table.items()}


def _fix(row: Row, part: str) -> Fix | None:
    """Return the time and position in columns whose names begin with ``part``; None if either is incomplete."""
    time_ns, *place = (row.get(f"{part}{name}", np.nan) for name in _PLACE)
    return Fix(int(time_ns), *place) if time_ns > 0 and np.isfinite(place).all() else None


def _repeated(
    table: Table, velocity: NDArray[Any], rows: Indices, fixes: Table, notes: list[str]
) -> list[Indices]:
    """Return the samples that repeat each mean current, told apart by their own time or the fixes around them."""
    # a value that a dive repeats may stand at the fixes at its ends, too, where it could be of either dive
    at_fix = np.isin(table["time"][rows], fixes["time"])
    rows = rows[~(at_fix & np.isin(velocity[rows], velocity[rows[~at_fix]]))]
    value, dac_time = velocity[rows], table["dac_time"][rows]
    segment = np.where(dac_time > 0, dac_time, np.searchsorted(fixes["time"], table["time"][rows]))
    new = (np.diff(value) != 0.0) | (np.diff(segment) != 0)
    groups = np.split(rows, np.flatnonzero(new) + 1) if rows.size else []
    if rows.size > len(groups) > 1:
        notes.append(f"mean current: {len(groups)} in {rows.size} values, each counted once")
    return groups


def _mean(
    row: Row, rows: Indices, samples: Table, fixes: Table, dialect: Dialect
) -> DiveMean | None:
    """Return the mean current in a row, which some samples repeat; None without its ends."""
    ends = _ends(row, rows, samples, fixes, dialect.ascent_share)
    if ends is None or not 0 < ends[1].time_ns - ends[0].time_ns <= _LONGEST_NS:
        return None
    start, end = ends
    times = samples["time"]
    of_dive = (times >= start.time_ns) & (times <= end.time_ns)
    depth, declination = samples["depth"][of_dive], samples["declination"][of_dive]
    once, dive = np.unique(times[rows]).size == 1, row.get("dive", np.nan)
    deepest = np.fmax.reduce(depth, initial=row.get("deepest", np.nan))
    turn = np.nanmedian(declination) if np.isfinite(declination).any() else np.nan
    payload = {
        **({} if np.isnan(dive) else {"dive": int(dive)}),
        "stamp": stamp(end.time_ns),
        "dac_eastward": row["dac_east"],
        "dac_northward": row["dac_north"],
        "error": number(row.get("dac_error", np.nan)),
        "start_fix": _end(start),
        "end_fix": _end(end),
        "duration": (end.time_ns - start.time_ns) / _NS,
        "max_depth": number(float(deepest)),
        "radius": number(row.get("radius", np.nan)),
        "declination": number(float(turn)),
        "dac_kind": dialect.dac_kind,
    }
    return DiveMean(start, end, float(deepest), _fix(row, "dac_") if once else None, payload)


def _end(end: Fix) -> dict[str, Any]:
    return {"time": stamp(end.time_ns), "lon": end.longitude, "lat": end.latitude}


def _ends(
    row: Row, rows: Indices, samples: Table, fixes: Table, ascent_share: float
) -> tuple[Fix, Fix] | None:
    """Return the fixes before and after a dive: stated, around a time within it, its outer samples, or those at the surface."""
    end, middle = _fix(row, "end_"), _fix(row, "dac_")
    other = end or (_fix(row, "") if ascent_share > 0.5 else None)
    if middle and other:
        near = float(unwrap_longitude(other.longitude, middle.longitude))
        way = [at - mid for at, mid in zip(other._replace(longitude=near), middle, strict=True)]
        # from the middle to the profile's place is the ascent's share of the way, less a half
        step = way if end else [0.5 * part / (ascent_share - 0.5) for part in way]
        return _displaced(middle, [-part for part in step]), end or _displaced(middle, step)
    inside = _time_within(row, rows, samples)
    # where nothing tells a time of the dive, it is between the fixes farthest apart
    times = fixes["time"]
    farthest = times[np.argmax(np.diff(times)) + 1] if times.size > 1 else 0
    if found := _around(fixes, inside or farthest):
        return found
    if rows.size:
        first, last = (_fix(_row(samples, rows[k]), "") for k in (0, -1))
        if first and last and first.time_ns != last.time_ns:
            return first, last
    places = places_in(samples)
    shallow = are_known(places) & (samples["depth"] <= _SURFACE)
    return _around(rows_of(places, shallow), inside)


def _displaced(middle: Fix, step: Sequence[float]) -> Fix:
    """Return a displaced fix with its longitude wrapped at the antimeridian."""
    time_ns, longitude, latitude = (mid + part for mid, part in zip(middle, step, strict=True))
    turns = 360.0 * (longitude < -180.0) - 360.0 * (longitude > 360.0)
    return Fix(round(time_ns), longitude + turns, latitude)


def _time_within(row: Row, rows: Indices, samples: Table) -> int:
    """Return a time within the dive [ns]; 0 if the file has neither times nor depths to determine it."""
    time_ns, depth = samples["time"], samples["depth"]
    known, stated = np.isfinite(depth), int(row.get("dac_time", 0))
    if not known.any() or not (stated or rows.size):
        return stated
    at = stated or int(time_ns[rows[-1]])
    if np.interp(at, time_ns[known], depth[known]) > _SURFACE:
        return at
    # a report at the surface is of the dive before it
    deep = np.flatnonzero(known & (depth > _SURFACE) & (time_ns < at))
    return int(time_ns[deep[-1]]) if deep.size else -1
