"""Fixes of a glider and mean currents of its dives, each once, with the fixes around it.

Files repeat a mean current at each sample of its dive, state it once per profile, or report it at the surface afterwards. All become a time
within the dive, from which the fixes before and after are found.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.observation import Fix
from replay_kit.logs.netcdf.columns import Columns, Table
from replay_kit.logs.netcdf.dialects import Told
from replay_kit.logs.shared.payloads import Positions

# m; less deep is at the surface
_SURFACE = 3.0
# ns; fixes farther apart than this enclose more than one dive, or a hole in the log
_LONGEST_NS = 48 * 3600 * 10**9
# of a SeaExplorer: at the surface with a fix
_FIX_STATE = 119


def fixes_of(columns: Columns, told: Told) -> Positions:
    """Return the fixes of a mission; incomplete ones are counted.

    Fixes with their own variables are preferred; else samples at either end of each time at the surface, by dead-reckoning flag or vehicle
    state, as the last position is repeated between them.

    Args:
        columns: Columns of the mission.
        told: Receives assumptions and counts of unusable values.
    """
    samples = columns.samples
    parts = ((columns.gps, "gps_"), (samples, "start_"), (samples, "end_"))
    found = [*map(np.concatenate, zip(*(_fixes_in(*part) for part in parts), strict=True))]
    whole = _whole(found)
    # files repeat the fix, or write none, at each sample of a dive: only a time without a place in a table of fixes is a loss
    own = columns.gps.get("gps_time", np.empty(0)).size
    lost = 0 if own in (0, samples.get("time", np.empty(0)).size) else int((~whole).sum())
    flagged = sum(n for (topic, _), n in told.skipped.items() if topic == "/vehicle/fix")
    told.skipped["/vehicle/fix", "GPS fix without time or position"] += max(lost - flagged, 0)
    if not whole.any():
        marked = _measured_samples(samples, told.notes)
        found = [*_fixes_in({key: held[marked] for key, held in samples.items()}, "")]
        whole = _whole(found)
    _, first = np.unique(found[0][whole], return_index=True)
    repeated = int(whole.sum()) - first.size
    if repeated and not {"start_time", "end_time"} & set(samples):
        told.notes.append(f"{repeated} fixes at the time of another, excluded")
    return Positions(*(values[whole][first] for values in found))


def _whole(fixes: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    return np.asarray((fixes[0] > 0) & np.isfinite(fixes[1] + fixes[2]))


def _fixes_in(table: Table, part: str) -> tuple[NDArray[Any], ...]:
    """Return time, longitude, latitude and error of the fixes in a table; empty if one of the first three is missing."""
    time_ns = table.get(f"{part}time", np.empty(0, np.int64))
    if not {f"{part}longitude", f"{part}latitude"} <= set(table):
        time_ns = time_ns[:0]
    columns = (
        table.get(f"{part}{name}", np.full(time_ns.size, np.nan))[: time_ns.size]
        for name in ("longitude", "latitude", "error")
    )
    return time_ns, *columns


def _measured_samples(samples: Table, notes: list[str]) -> NDArray[np.intp]:
    """Return the first and last sample of each period marked as measured by a flag or state."""
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


@dataclass(frozen=True, slots=True)
class DiveMean:
    """Mean current of a dive.

    Attributes:
        east: True east [m/s].
        north: True north [m/s].
        error: Standard error of each component [m/s]; NaN if not stated.
        start: Fix before the dive.
        end: Fix after it.
        max_depth: Greatest depth of the dive [m]; NaN when unknown.
        dive: Number of the dive; None without.
        middle: Position of the deepest point; None if the file has samples.
        radius: Radius of its goal [m]; NaN if not stated.
        declination: Magnetic declination [degrees east]; NaN if not stated.
    """

    east: float
    north: float
    error: float
    start: Fix
    end: Fix
    max_depth: float
    dive: int | None = None
    middle: Fix | None = None
    radius: float = np.nan
    declination: float = np.nan


@dataclass(frozen=True, slots=True)
class _Candidate:
    """Mean current before its fixes are known: its row in a table, and the samples that state it, if any."""

    row: int
    table: Table
    rows: NDArray[np.intp]

    def number(self, key: str) -> float:
        return float(self.table[key][self.row]) if key in self.table else float("nan")

    def time(self, part: str = "dac_") -> int:
        key = f"{part}time"
        return int(self.table[key][self.row]) if key in self.table else 0

    def fix(self, part: str = "dac_") -> Fix | None:
        """Return a time and position; None if either is incomplete."""
        place = self.number(f"{part}longitude"), self.number(f"{part}latitude")
        known = self.time(part) > 0 and np.isfinite(place).all()
        return Fix(self.time(part), *place) if known else None


def mean_currents(
    columns: Columns, fixes: Positions, ascent_share: float, told: Told
) -> tuple[DiveMean, ...]:
    """Return the mean currents of a mission in order of time.

    Args:
        columns: Columns of the mission.
        fixes: Its fixes.
        ascent_share: As in ``Dialect``.
        told: Receives assumptions and counts of unusable values.
    """
    notes = told.notes
    table = columns.samples if "dac_east" in columns.samples else columns.dac
    if not {"dac_east", "dac_north"} <= set(table):
        return ()
    east, north = table["dac_east"], table["dac_north"]
    finite = np.isfinite(east) & np.isfinite(north)
    zero = finite & (east == 0.0) & (north == 0.0)
    if zero.any():
        own = table.get("dac_time", np.zeros(zero.size, np.int64))
        begins = zero & np.r_[True, ~zero[:-1] | (own[1:] != own[:-1])]
        notes.append(f"mean current: {int(begins.sum())} of exactly (0, 0) taken as missing")
    rows = np.flatnonzero(finite & ~zero)
    candidates = [_Candidate(row, table, rows[:0]) for row in rows.tolist()]
    if table is columns.samples:
        candidates = _repeated(table, rows, fixes, notes)
    made: dict[tuple[int, int], DiveMean] = {}
    lost = 0
    for candidate in candidates:
        mean = _with_ends(candidate, columns.samples, fixes, ascent_share)
        if mean is None:
            lost += 1
        else:
            # of several reports at one surfacing the last is the glider's final one
            made[mean.start.time_ns, mean.end.time_ns] = mean
    if (replaced := len(candidates) - lost - len(made)) > 0:
        notes.append(
            f"mean current: {replaced} earlier reports of the same dive replaced by the last one"
        )
    _note_ends(made.values(), fixes, notes)
    told.skipped[
        "/dac", "mean current without fixes before and after it, or samples of its dive"
    ] += lost
    return _numbered([made[key] for key in sorted(made)], columns.samples)


def _numbered(means: Sequence[DiveMean], samples: Table) -> tuple[DiveMean, ...]:
    """Return the mean currents, numbered by order if the file neither numbers dives nor has samples at the surface."""
    depth = samples.get("depth", np.empty(0))
    if any(mean.dive is not None for mean in means) or (depth <= _SURFACE).any():
        return tuple(means)
    return tuple(replace(mean, dive=number) for number, mean in enumerate(means, 1))


def _repeated(
    table: Table, rows: NDArray[np.intp], fixes: Positions, notes: list[str]
) -> list[_Candidate]:
    """Return the mean currents repeated by samples, each once, by their own time or the fixes around them."""
    velocity = table["dac_east"] + 1j * table["dac_north"]
    # a value that a dive repeats may stand at the fixes at its ends, too, where it could be of either dive
    at_fix = np.isin(table["time"][rows], fixes.time_ns)
    rows = rows[~(at_fix & np.isin(velocity[rows], velocity[rows[~at_fix]]))]
    value, own = velocity[rows], table.get("dac_time", np.zeros(velocity.size, np.int64))[rows]
    segment = np.where(own > 0, own, np.searchsorted(fixes.time_ns, table["time"][rows]))
    if not fixes.time_ns.size:
        runs = np.cumsum((np.diff(value, prepend=np.nan) != 0) | (np.diff(own, prepend=0) != 0))
        segment = np.where(own > 0, own, runs)
    keys = np.column_stack([segment, value.real, value.imag])
    _, first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    groups = [rows[of.ravel() == k] for k in np.argsort(first)]
    if rows.size > len(groups) > 1:
        notes.append(f"mean current: {len(groups)} in {rows.size} values, each counted once")
    return [_Candidate(int(group[0]), table, group) for group in groups]


def _with_ends(
    candidate: _Candidate, samples: Table, fixes: Positions, ascent_share: float
) -> DiveMean | None:
    inside, time = _time_within(candidate, samples), fixes.time_ns
    # where nothing tells a time of the dive, it is between the fixes farthest apart
    farthest = int(time[np.argmax(np.diff(time)) + 1]) if time.size > 1 else 0
    ends = (
        _stated_ends(candidate, ascent_share)
        or _around(inside or farthest, time, fixes.longitude, fixes.latitude)
        or _outer_samples(candidate)
        or _around(inside, *_at_surface(samples))
    )
    if ends is None or not 0 < ends[1].time_ns - ends[0].time_ns <= _LONGEST_NS:
        return None
    start, end = ends
    depth, times = samples.get("depth", np.empty(0)), samples.get("time", np.empty(0))
    of_dive = (times >= start.time_ns) & (times <= end.time_ns)
    depth = depth[of_dive] if depth.size else depth
    declination = samples.get("declination", np.full(times.size, np.nan))[of_dive]
    deepest = float(np.nanmax(depth)) if np.isfinite(depth).any() else candidate.number("deepest")
    dive, once = candidate.number("dive"), np.unique(times[candidate.rows]).size == 1
    return DiveMean(
        candidate.number("dac_east"),
        candidate.number("dac_north"),
        candidate.number("dac_error"),
        start,
        end,
        deepest,
        int(dive) if np.isfinite(dive) else None,
        candidate.fix() if once else None,
        candidate.number("radius"),
        float(np.nanmedian(declination)) if np.isfinite(declination).any() else np.nan,
    )


def _stated_ends(candidate: _Candidate, ascent_share: float) -> tuple[Fix, Fix] | None:
    """Return the start and end stated in the file, or extrapolated from the deepest point and one other position of the dive."""
    start, end = candidate.fix("start_"), candidate.fix("end_")
    if start and end:
        return start, end
    middle, other = candidate.fix(), end or (candidate.fix("") if ascent_share > 0.5 else None)
    if middle is None or other is None:
        return None
    near = float(unwrap_longitude(other.longitude, middle.longitude))
    way = [at - mid for at, mid in zip(other._replace(longitude=near), middle, strict=True)]
    # from the middle to the profile's place is the ascent's share of the way, less a half
    step = way if end else [0.5 * part / (ascent_share - 0.5) for part in way]
    return _displaced(middle, [-part for part in step]), end or _displaced(middle, step)


def _displaced(middle: Fix, step: Sequence[float]) -> Fix:
    """Return a displaced fix with its longitude wrapped at the antimeridian."""
    time_ns, longitude, latitude = (mid + part for mid, part in zip(middle, step, strict=True))
    turns = 360.0 * (longitude < -180.0) - 360.0 * (longitude > 360.0)
    return Fix(round(time_ns), longitude + turns, latitude)


def _around(
    inside: int, time_ns: NDArray[np.int64], longitude: Array, latitude: Array
) -> tuple[Fix, Fix] | None:
    """Return the positions before and at or after a time within the dive; None without them."""
    after = int(np.searchsorted(time_ns, inside))
    if not 0 < after < time_ns.size:
        return None
    before, end = (
        Fix(int(time_ns[k]), float(longitude[k]), float(latitude[k])) for k in (after - 1, after)
    )
    return before, end


def _time_within(candidate: _Candidate, samples: Table) -> int:
    """Return a time within the dive [ns]; 0 if the file has neither times nor depths to determine it."""
    time_ns, depth = samples.get("time", np.empty(0, np.int64)), samples.get("depth", np.empty(0))
    known, stated = np.isfinite(depth), candidate.time()
    if not known.any() or not (stated or candidate.rows.size):
        return stated
    own = candidate.rows[known[candidate.rows]]
    if not stated and own.size and depth[own].max() > _SURFACE:
        return int(time_ns[own[np.argmax(depth[own])]])
    at = stated or int(time_ns[candidate.rows[-1]])
    if np.interp(at, time_ns[known], depth[known]) > _SURFACE:
        return at
    # a report at the surface is of the dive before it
    deep = np.flatnonzero(known & (depth > _SURFACE) & (time_ns < at))
    return int(time_ns[deep[-1]]) if deep.size else -1


def _outer_samples(candidate: _Candidate) -> tuple[Fix, Fix] | None:
    """Return the first and the last sample with the mean current, for files without fixes."""
    if not candidate.rows.size:
        return None
    first, last = (replace(candidate, row=int(candidate.rows[k])).fix("") for k in (0, -1))
    return (first, last) if first and last and first.time_ns != last.time_ns else None


def _at_surface(samples: Table) -> tuple[NDArray[np.int64], Array, Array]:
    """Return time [ns, UTC], longitude and latitude [degrees] of the samples at the surface."""
    names = ("time", "longitude", "latitude", "depth")
    if not {*names} <= set(samples):
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    time_ns, longitude, latitude, depth = (samples[name] for name in names)
    shallow = (depth <= _SURFACE) & np.isfinite(longitude + latitude)
    return time_ns[shallow], longitude[shallow], latitude[shallow]


def _note_ends(means: Iterable[DiveMean], fixes: Positions, notes: list[str]) -> None:
    known = set(fixes.time_ns.tolist())
    ends = [end.time_ns for mean in means for end in (mean.start, mean.end)]
    if made := sum(end not in known for end in ends):
        how = "the first or last sample of their dive, or follow from its middle"
        notes.append(
            f"mean current: {made} of {len(ends)} ends are not fixes of the file; they are {how}"
        )
