"""Mean currents between fixes, and the paths of the means.

A depth-averaged current is the distance of the surfacing fix from the position by motion through water alone, over the time between fixes;
it is the mean of the current along the path. Dead-reckoned positions are joined by straight lines at constant speed. Each segment counts at
its midpoint with its duration, exact for linear quantities; neighbouring segments are merged if there are too many, preserving time and
mean depth.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation.table import Columns, Integers, Rows, Table, chosen_rows
from replay_kit.measurements.profiles.pings import COMPUTED, OWN, padded
from replay_kit.measurements.step import Step
from replay_kit.measurements.track.dives import dive_begins
from replay_kit.measurements.track.positions import NEVER

# m and s; a longer stretch counts as several, because a current is not linear in depth or along the way
_LONGEST_DEPTH, _LONGEST_S = 10.0, 300.0
_MOST_PIECES = 64
# stretches kept of a path; when they are more, two become one
_MOST = 256
# of a descent and an ascent at constant speed: an even number, so that none reaches over the deepest point
_V_PIECES = 128
# ns; a stated fix this near in time to one of the log's is that fix
_SAME_FIX = 60 * 10**9
_LONG_AGO = -(2**63)
TOO_FAST = "depth-averaged current: faster than measurements.max_speed"
_THROWN = "depth-averaged current: a fix of its dive is out of the vehicle's reach"
_NO_PATH = "depth-averaged current: no path from its first fix to its last"
_NO_DEPTH = "depth-averaged current: no path, and no fixes with a depth below the surface"


class Spot(NamedTuple):
    """Time [ns, UTC], longitude, latitude [degrees] and depth [m] of a position."""

    time: int
    longitude: float
    latitude: float
    depth: float = 0.0


def spot(positions: Columns, row: int) -> Spot:
    """Return time and location of one of the positions."""
    return Spot(*(positions[name][row].item() for name in Spot._fields))


class Path(NamedTuple):
    """Path of the vehicle since a fix.

    Attributes:
        start: Fix at the start.
        last: Last position on the path.
        stretches: shape (s, 5), at most 256 segments: duration [s]; time since the start [s], longitude, latitude [degrees] and depth [m]
            of the midpoint.
        deepest: Greatest depth since the start [m]; NaN if unknown.
        reckoned: Number of dead-reckoned positions.
    """

    start: Spot
    last: Spot
    stretches: Array = np.empty((0, 5))
    deepest: float = math.nan
    reckoned: int = 0


def path_from(fix: Spot) -> Path:
    """Return the path that begins at a fix."""
    return Path(fix, fix)


def extended_path(path: Path, positions: Columns, depth: Array) -> Path:
    """Return a path extended by positions and depths; positions without a depth, or not later than the last, are ignored.

    Args:
        path: Path so far.
        positions: Positions in order.
        depth: shape (n,) [m], all depths since then.
    """
    sound = np.isfinite(positions["depth"])
    at = _later(positions["time"], sound, path.last.time)
    below = positions["depth"][at]
    deepest = np.fmax.reduce(np.concatenate([[path.deepest], depth, below]))
    when = np.append(path.last.time, positions["time"][at])
    # a fix does not always say how deep it is: at the surface
    before = np.nan_to_num(path.last[1:])
    places = np.vstack(
        [before, np.column_stack([positions[name][at] for name in Spot._fields[1:]])]
    )
    found, pieces = _stretches(path.start, when, places)
    return Path(
        path.start,
        Spot(int(when[-1]), *places[-1].tolist()),
        _folded(path.stretches, found, pieces),
        float(deepest),
        path.reckoned + at.size,
    )


def _later(time: Integers, mask: Mask, than: int) -> Indices:
    """Return the indices of times later than a time and than all earlier ones."""
    latest = np.maximum.accumulate(np.append(than, np.where(mask, time, _LONG_AGO)))
    return np.flatnonzero(mask & (time > latest[:-1]))


def _stretches(start: Spot, when: Integers, places: Array) -> tuple[Array, Integers]:
    """Return the segments of straight lines between positions, shape (s, 5), and their number per line, shape (n,).

    Args:
        start: Origin of times, and reference of longitudes.
        when: shape (n + 1,) [ns].
        places: shape (n + 1, 3), longitude, latitude [degrees], depth [m].
    """
    seconds = np.diff(when) * 1e-9
    wanted = np.maximum(np.abs(np.diff(places[:, 2])) / _LONGEST_DEPTH, seconds / _LONGEST_S)
    pieces = np.maximum(np.ceil(np.minimum(wanted, _MOST_PIECES)).astype(np.int64), 1)
    pieces = np.where(seconds > 0.0, pieces, 0)
    way = np.repeat(np.arange(pieces.size), pieces)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = ((np.arange(way.size) - first + 0.5) / pieces[way])[:, None]
    turned = unwrap_longitude(places[:, 0], start.longitude)
    ends = np.column_stack([(when - start.time) * 1e-9, turned, places[:, 1:]])
    middles = ends[way] + share * (ends[way + 1] - ends[way])
    return np.column_stack([seconds[way] / pieces[way], middles]), pieces


def _folded(stretches: Array, more: Array, pieces: Integers) -> Array:
    """Return segments joined with those of more positions; neighbours are merged to keep at most 256."""
    ends, done = np.cumsum(pieces), 0
    while len(more) - done > _MOST - len(stretches):
        upto = ends[np.searchsorted(ends, done + _MOST - len(stretches), side="right")]
        stretches, done = _halved(np.concatenate([stretches, more[done:upto]])), upto
    return np.concatenate([stretches, more[done:]])


def _halved(stretches: Array) -> Array:
    """Return segments merged pairwise at their time-weighted midpoints; an odd last one is kept."""
    even = len(stretches) // 2 * 2
    pairs = stretches[:even].reshape(-1, 2, 5)
    time, total = pairs[..., :1], pairs[..., :1].sum(axis=1)
    merged = np.hstack([total, (time * pairs[..., 1:]).sum(axis=1) / total])
    return np.concatenate([merged, stretches[even:]])


def drift(path: Path, end: Spot) -> tuple[float, float]:
    """Return the offset of a fix from the dead-reckoned end of a path over the time between fixes, east and north [m/s]."""
    here, seconds = path.last, (end.time - path.start.time) * 1e-9
    east, north = to_local(Projection(here.longitude, here.latitude), end.longitude, end.latitude)
    return float(east) / seconds, float(north) / seconds


def path_mean(path: Path, end: Spot, velocity: ArrayLike, error_std: float) -> dict[str, Any]:
    """Return a mean current with its path, adjusted to end at a fix: one row of the columns of ``Block.mean``.

    The offset of the fix from the dead-reckoned end is distributed linearly in time, as for a constant current. Without positions between
    the fixes the path is a straight line, down to the greatest depth and up again at constant speed.
    """
    start, here = path.start, path.last
    seconds, since, longitude, latitude, depth = _segments_to(path, end).T
    projection = Projection(start.longitude, start.latitude)
    east, north = to_local(projection, longitude, latitude)
    # the last stretch ends where the dead reckoning does: at the surface nothing drives the vehicle
    (reckoned_east, end_east), (reckoned_north, end_north) = to_local(
        projection, [here.longitude, end.longitude], [here.latitude, end.latitude]
    )
    share = since / ((end.time - start.time) * 1e-9)
    longitude, latitude = to_geographic(
        projection,
        east + share * (end_east - reckoned_east),
        north + share * (end_north - reckoned_north),
    )
    return {
        "path_time": start.time + np.round(since * 1e9).astype(np.int64),
        "path_longitude": unwrap_longitude(longitude, start.longitude),
        "path_latitude": latitude,
        "path_depth": np.maximum(depth, 0.0),
        "weight": seconds / seconds.sum(),
        "velocity": velocity,
        "error_std": error_std,
        "start_time": start.time,
        "start": (start.longitude, start.latitude),
        "end_time": end.time,
        "end": (end.longitude, end.latitude),
        "deepest": path.deepest,
        "reckoned": drift(path, end) if path.reckoned else (math.nan, math.nan),
    }


def _segments_to(path: Path, end: Spot) -> Array:
    """Return the segments of a path up to a fix, before its adjustment."""
    start, last = path.start, path.last
    if path.reckoned:
        places = np.array([last[1:], last[1:]])
        places[1, 2] = max(end.depth, 0.0)
        rest, _ = _stretches(start, np.array([last.time, end.time]), places)
        return np.concatenate([path.stretches, rest])
    middles = (np.arange(_V_PIECES) + 0.5) / _V_PIECES
    seconds = (end.time - start.time) * 1e-9
    columns = (
        seconds / _V_PIECES,
        middles * seconds,
        start.longitude,
        start.latitude,
        np.nan_to_num(path.deepest) * (1.0 - np.abs(2.0 * middles - 1.0)),
    )
    return np.column_stack(np.broadcast_arrays(*columns))


class Ways(NamedTuple):
    """State of the path since the last fixes.

    Attributes:
        path: Path since the last fix at the surface; None before the first.
        done: Path and end fix of the last dive, until its mean current arrives.
        stated: Whether the log states mean currents.
        computed: Time of the end fix of the last dive with a computed mean current [ns, UTC]; long ago before the first.
    """

    path: Path | None = None
    done: tuple[Path, Spot] | None = None
    stated: bool = False
    computed: int = _LONG_AGO


def means_of(ways: Ways, tables: Sequence[Table], step: Step) -> tuple[Ways, Rows]:
    """Return the state after a block, and its mean currents as columns, with ``due``, position in the stream, and ``rank``.

    Args:
        ways: State before the block.
        tables: Tables of stated mean currents.
        step: Block.
    """
    positions, config = chosen_rows(step.positions, slice(step.new, None)), step.config
    order, depth_order, depth = positions["order"], step.depths["order"], step.depths["measured"]
    on_path = positions["dead_reckoned"] | positions["submerged"]
    first = _LONG_AGO if ways.path is None else ways.path.start.time
    # the others at the surface, no later than one before, are left out
    fixes = _later(positions["time"], ~on_path, first)
    ends = order[fixes]

    def path(number: int, upto: int) -> Path | None:
        """Return the path from a fix of the block, or the last earlier one, up to a position in the stream."""
        since, known = depth_order[0], ways.path
        if number:
            since, known = ends[number - 1], path_from(spot(positions, fixes[number - 1]))
        if known is None:
            return None
        rows = chosen_rows(positions, on_path & (order > since) & (order <= upto))
        return extended_path(known, rows, depth[(depth_order > since) & (depth_order <= upto)])

    made, messages = list[dict[str, Any]](), step.messages(tables)
    deep = depth_order[1:][dive_begins(depth[1:], config.surface_depth)]
    dives = {0, *np.searchsorted(ends, deep).tolist()} & {*range(ends.size)}
    stops = [(int(ends[number]), COMPUTED, number) for number in dives]
    stops += [(int(message.order[0]), OWN, number) for number, (message, _) in enumerate(messages)]
    for due, rank, number in sorted(stops):
        if rank == OWN:
            message, source = messages[number]
            row = chosen_rows(message.columns, 0)
            way = path(int(np.searchsorted(ends, due, side="right")), due)
            ways, found, why = _match_stated(ways, way, row, step, due)
            velocity, time = row["velocity"], source.time_ns
            std = float(row["error_std"])
            stated = {name: float(row[name]) for name in _KEPT}
            dive = int(row["dive"] if row["dive"] >= 0 else step.dived(message.order)["dive"][0])
            origin = [source.input, step.topic(source.topic), source.position, due, dive]
            beside = bool(row["inverted"]) and config.use_inverted
        else:
            way, end = path(number, due), spot(positions, fixes[number])
            if way is None or not dive_begins(way.deepest, config.surface_depth):
                continue
            found, time, std = (way, end), end.time, math.nan
            stated = dict.fromkeys(_KEPT, math.nan)
            velocity = np.array(drift(way, end))
            ways = ways._replace(done=found)
            origin = [positions[column][fixes[number]] for column in _SOURCE]
            if config.dead_reckoning == "corrected" or ways.stated or not way.reckoned:
                continue
            why, beside = "" if np.abs(velocity).max() <= config.max_speed else TOO_FAST, False
            ways = ways if why else ways._replace(done=None, computed=time)
        if not why:
            way, end = found
            seconds = (end.time - way.start.time) * 1e-9
            of_fixes = math.hypot(config.dac_std, math.sqrt(2.0) * config.fix_std / seconds)
            mean = path_mean(way, end, velocity, of_fixes if math.isnan(std) else std)
            # between opposite sides of the Earth no way is the shortest
            why = "" if np.isfinite(mean["path_longitude"]).all() else _NO_PATH
        why = step.left_out("dac", origin[-1]) or why
        if rank == OWN:
            step.note(message, why)
        if not why:
            mean |= dict(zip(_SOURCE, origin, strict=True)) | {"source_time": time, "due": due}
            mean |= {"time": max(mean["end_time"], time), "beside_profiles": beside, "rank": rank}
            made.append(mean | stated)
    names = made[0] if made else ()
    rows = {name: padded([np.asarray(row[name])[None] for row in made]) for name in names}
    if made:
        rows["points"] = np.array([len(row["weight"]) for row in made])
        rows["weight"] = np.nan_to_num(rows["weight"])
    return ways._replace(path=path(ends.size, NEVER)), rows


_SOURCE = ("input", "topic", "ordinal", "order", "dive")
# of a stated mean current, beside the current
_KEPT = ("radius", "declination")


def _match_stated(
    ways: Ways, path: Path | None, row: Columns, step: Step, due: int
) -> tuple[Ways, Any, str]:
    """Return the state after a stated mean current, its path and end fix, and the reason for exclusion."""
    stated = [Spot(int(row[f"{name}_time"]), *row[name].tolist()) for name in ("start", "end")]
    if np.abs(row["velocity"]).max() > step.config.max_speed:
        return ways, None, TOO_FAST
    # one that does not count is as none that is stated: the log's own take its place
    doubted = [step.reach.doubts(fix[:3], due) for fix in stated]
    start, end = (
        fix._replace(time=_LONG_AGO) if off else fix
        for fix, off in zip(stated, doubted, strict=True)
    )
    ways, done = ways._replace(stated=True), ways.done
    if _LONG_AGO < end.time <= ways.computed + _SAME_FIX:
        return ways, None, "depth-averaged current: already computed from dead reckoning"
    if done is not None and _same(done[0].start, start) and _same(done[1], end):
        found = done
    elif not _LONG_AGO < start.time < end.time:
        return ways, None, _THROWN if any(doubted) else _NO_DEPTH
    else:
        known = [one.deepest for one in (path, done and done[0]) if one is not None]
        deepest = float(row["deepest"])
        if math.isnan(deepest):
            deepest = float(np.fmax.reduce([deepest, *known]))
        found = Path(start, start, deepest=deepest), end
        if path is not None and _same(path.start, start) and path.last.time <= end.time:
            # the fix after the dive has not come yet
            found = (path, end) if math.isfinite(path.deepest) else found
    # of a glider that stays at the surface the current is no mean over a dive
    if not found[0].deepest > step.config.surface_depth:
        return ways, None, _NO_DEPTH
    if done is not None and done[1].time <= found[1].time:
        ways = ways._replace(done=None)
    return ways, found, ""


def _same(fix: Spot, stated: Spot) -> bool:
    """Return whether a fix equals a stated one; an unstated one equals any."""
    return stated.time == _LONG_AGO or abs(fix.time - stated.time) <= _SAME_FIX
