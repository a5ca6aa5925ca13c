"""Mean currents between fixes, and the paths that they are means over.

A depth-averaged current is how far a vehicle surfaced from where its motion through the water alone would have brought it, over the
time between the fixes; it is the mean of the current along the path. Dead-reckoned positions are joined by straight lines at constant
speed. Each stretch counts at its middle with the time that it took, which is exact for whatever is linear along it, and neighbours are
merged at their common middle when they become many: the weights sum to the whole time, and the mean depth stays that of the lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.table import Columns, Integers
from replay_kit.measurements.dives import dive_begins

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
_COMPUTED = "depth-averaged current: already computed from dead reckoning"
_NO_DEPTH = "depth-averaged current: no path, and no fixes with a depth"
_NO_PATH = "depth-averaged current: no path from its first fix to its last"


@dataclass(frozen=True, slots=True)
class Spot:
    """A time [ns, UTC], longitude, latitude [degrees] and depth [m]."""

    time: int
    longitude: float
    latitude: float
    depth: float = 0.0


def spot(positions: Columns, row: int) -> Spot:
    """Return where and when one of the positions was."""
    place = (float(positions[name][row]) for name in ("longitude", "latitude", "depth"))
    return Spot(int(positions["time"][row]), *place)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where the vehicle was since a fix.

    Attributes:
        start: The fix.
        last: Last position on the path.
        stretches: shape (s, 5), of at most 256: time [s]; since the start [s], longitude, latitude [degrees] and depth [m] of the middle.
        deepest: Greatest depth since the start [m]; NaN when none is known.
        reckoned: Number of positions on it.
    """

    start: Spot
    last: Spot
    stretches: Array = field(default_factory=lambda: np.empty((0, 5)))
    deepest: float = math.nan
    reckoned: int = 0

    @property
    def end(self) -> Spot:
        """Where it ends by dead reckoning."""
        return self.last if self.reckoned else self.start


def begun(fix: Spot) -> Path:
    """Return the path that begins at a fix."""
    return Path(fix, fix)


def extended(path: Path, positions: Columns, depth: Array) -> Path:
    """Return a path with more positions and depths; a position without a depth, or not later than the last, changes nothing.

    Args:
        path: So far.
        positions: In order.
        depth: shape (n,) [m], all depths that were met since.
    """
    time, below = positions["time"], positions["depth"]
    sound = np.isfinite(below)
    latest = np.maximum.accumulate(
        np.concatenate([[path.last.time], np.where(sound, time, _LONG_AGO)])
    )
    at = np.flatnonzero(sound & (time > latest[:-1]))
    deepest = np.fmax.reduce(np.concatenate([[path.deepest], depth, below[at]]))
    if not at.size:
        return replace(path, deepest=float(deepest))
    # a fix does not always say how deep it is: at the surface
    first = path.last.depth if math.isfinite(path.last.depth) else 0.0
    when = np.concatenate([[path.last.time], time[at]])
    places = np.column_stack(
        [
            np.concatenate([[path.last.longitude], positions["longitude"][at]]),
            np.concatenate([[path.last.latitude], positions["latitude"][at]]),
            np.concatenate([[first], below[at]]),
        ]
    )
    found, pieces = _stretches(path.start, when, places)
    last = Spot(int(when[-1]), *places[-1].tolist())
    stretches = _folded(path.stretches, found, pieces)
    return Path(path.start, last, stretches, float(deepest), path.reckoned + at.size)


def _stretches(start: Spot, when: Integers, places: Array) -> tuple[Array, Integers]:
    """Return the stretches of straight ways from place to place, shape (s, 5), and how many each way has, shape (n,).

    Args:
        start: From which times are counted, and near which longitudes are.
        when: shape (n + 1,) [ns].
        places: shape (n + 1, 3), longitude, latitude [degrees], depth [m].
    """
    seconds = np.diff(when) * 1e-9
    wanted = np.maximum(np.abs(np.diff(places[:, 2])) / _LONGEST_DEPTH, seconds / _LONGEST_S)
    pieces = np.maximum(np.ceil(np.minimum(wanted, _MOST_PIECES)).astype(np.int64), 1)
    pieces = np.where(seconds > 0.0, pieces, 0)
    way = np.repeat(np.arange(pieces.size), pieces)
    share = (np.arange(way.size) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[
        way
    ]
    since = (when[:-1] - start.time) * 1e-9
    turned = unwrap_longitude(places[:, 0], start.longitude)
    columns = [seconds[way] / pieces[way], since[way] + share * seconds[way]]
    for values in (turned, places[:, 1], places[:, 2]):
        columns.append(values[way] + share * (values[way + 1] - values[way]))
    return np.column_stack(columns), pieces


def _folded(stretches: Array, more: Array, pieces: Integers) -> Array:
    """Return stretches with those of more positions; where one makes them more than 256, neighbours become one."""
    ends, done = np.cumsum(pieces), 0
    while True:
        over = np.searchsorted(ends, done + _MOST - len(stretches), side="right")
        upto = int(ends[over]) if over < ends.size else len(more)
        stretches, done = np.concatenate([stretches, more[done:upto]]), upto
        if len(stretches) <= _MOST:
            return stretches
        while len(stretches) > _MOST:
            stretches = _halved(stretches)


def _halved(stretches: Array) -> Array:
    """Return stretches merged in twos at their middles, weighted by their times; an odd last one stays."""
    even = len(stretches) // 2 * 2
    a, b = stretches[:even:2], stretches[1:even:2]
    total = a[:, :1] + b[:, :1]
    merged = np.column_stack([total, (a[:, :1] * a[:, 1:] + b[:, :1] * b[:, 1:]) / total])
    return np.concatenate([merged, stretches[even:]])


def drift(path: Path, end: Spot) -> tuple[float, float]:
    """Return how far a fix lies from the dead-reckoned end of the path to it, over the time between the fixes, east and north [m/s]."""
    here, seconds = path.end, (end.time - path.start.time) * 1e-9
    east, north = to_local(Projection(here.longitude, here.latitude), end.longitude, end.latitude)
    return float(east) / seconds, float(north) / seconds


def path_mean(
    path: Path, end: Spot, velocity: tuple[float, float], error_std: float
) -> dict[str, Any]:
    """Return a mean current with the path that it belongs to, moved so that it ends at a fix: the columns of ``Block.mean`` for one row.

    The way from the dead-reckoned end to the fix is spread over the path linearly in time, as is usual practice: it is what a
    constant current would have done. Without positions between the fixes the path is a straight way, down to the greatest depth
    and up again at constant speed.
    """
    start, here = path.start, path.end
    seconds, since, longitude, latitude, depth = _closed(path, end).T
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


def _closed(path: Path, end: Spot) -> Array:
    """Return the stretches of a path up to a fix, before the path is moved to end there."""
    start, last = path.start, path.last
    if path.reckoned:
        places = np.array([[last.longitude, last.latitude, last.depth]] * 2)
        places[1, 2] = max(end.depth, 0.0)
        rest, _ = _stretches(start, np.array([last.time, end.time]), places)
        return np.concatenate([path.stretches, rest])
    total = (end.time - start.time) * 1e-9
    deepest = path.deepest if math.isfinite(path.deepest) else 0.0
    middles = (np.arange(_V_PIECES) + 0.5) / _V_PIECES
    depths, still = deepest * (1.0 - np.abs(2.0 * middles - 1.0)), np.ones(_V_PIECES)
    return np.column_stack(
        [
            total / _V_PIECES * still,
            middles * total,
            start.longitude * still,
            start.latitude * still,
            depths,
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class Ways:
    """What is remembered of the way since the last fixes.

    Attributes:
        path: Since the last fix at the surface; None before the first.
        done: The last dive's path, and the fix that ended it, until its mean current comes.
        stated: Whether the log states mean currents itself.
        computed: Time of the fix that ended the last dive whose mean current was computed [ns, UTC]; long ago before the first.
    """

    path: Path | None = None
    done: tuple[Path, Spot] | None = None
    stated: bool = False
    computed: int = _LONG_AGO


#: A mean current: place in the stream, number in its table of a stated one or of the fix of a computed one, its row or why there is none.
Found = tuple[int, int, dict[str, Any] | str]


def means_of(
    ways: Ways,
    positions: Columns,
    depths: tuple[Integers, Array],
    stated: Sequence[Columns],
    config: MeasurementConfig,
) -> tuple[Ways, list[Found], list[Found]]:
    """Return what is remembered after a block, the mean currents computed in it, and what became of each that is stated.

    Args:
        ways: Remembered before.
        positions: Of the block.
        depths: Places in the stream and depths [m] of all that state one.
        stated: Rows of mean currents, each with its place in the stream, in order.
        config: Which mean currents are computed, their errors and the fastest that is believed.
    """
    walk = _Walk(ways, positions, depths, config)
    computed: list[Found] = []
    found: list[Found] = []
    for number, row in enumerate(stated):
        computed += walk.until(int(row["order"]))
        found.append((int(row["order"]), number, walk.take(row)))
    computed += walk.until(np.iinfo(np.int64).max)
    return walk.ways, computed, found


class _Walk:
    """One way through a block's positions."""

    def __init__(
        self,
        ways: Ways,
        positions: Columns,
        depths: tuple[Integers, Array],
        config: MeasurementConfig,
    ) -> None:
        self.ways, self.config, self.positions = ways, config, positions
        self.order, self.depth_order, self.depth = positions["order"], *depths
        at_surface = ~(positions["dead_reckoned"] | positions["submerged"])
        first = _LONG_AGO if ways.path is None else ways.path.start.time
        time = np.where(at_surface, positions["time"], _LONG_AGO)
        latest = np.maximum.accumulate(np.concatenate([[first], time]))
        #: Fixes from which a path begins; the others at the surface, no later than one before, are left out.
        self.fixes = np.flatnonzero(at_surface & (positions["time"] > latest[:-1]))
        self.on_path = ~at_surface
        self.dived = self._dived()
        #: Rows of positions and of depths that are on a path already, and number of the next fix.
        self.row, self.depth_row, self.fix = 0, 0, 0

    def _dived(self) -> Any:
        """Return whether a dive ends at each fix, shape (f,)."""
        ends, count = self.order[self.fixes], self.fixes.size
        deepest = np.full(count + 1, -np.inf)
        if self.ways.path is not None:
            deepest[0] = np.fmax(deepest[0], self.ways.path.deepest)
        np.maximum.at(deepest, np.searchsorted(ends, self.depth_order), self.depth)
        on_path = self.on_path & np.isfinite(self.positions["depth"])
        np.maximum.at(
            deepest, np.searchsorted(ends, self.order[on_path]), self.positions["depth"][on_path]
        )
        dived = dive_begins(deepest[:count], self.config.surface_depth)
        if count and self.ways.path is None:
            dived[0] = False
        return dived

    def until(self, order: int) -> list[Found]:
        """Go on up to before a place in the stream; return the mean currents that are computed on the way."""
        found: list[Found] = []
        last = int(np.searchsorted(self.order[self.fixes], order, side="right"))
        # a path without a dive need not be followed: the next fix begins another
        dived = self.dived[self.fix : last]
        for fix in self.fix + np.flatnonzero(dived | np.append(dived[1:], True)[: dived.size]):
            if self.dived[fix]:
                found += self._ended(int(fix))
            else:
                self._begin(self.fixes[fix])
        self.fix = max(self.fix, last)
        if self.ways.path is not None:
            row = int(np.searchsorted(self.order, order, side="right"))
            depth_row = int(np.searchsorted(self.depth_order, order, side="right"))
            self._extend(row, depth_row)
        return found

    def _begin(self, row: int) -> None:
        self.ways = replace(self.ways, path=begun(spot(self.positions, row)))
        self.row = int(row) + 1
        self.depth_row = int(np.searchsorted(self.depth_order, self.order[row], side="right"))

    def _extend(self, row: int, depth_row: int) -> None:
        """Extend the path by positions and depths up to some rows."""
        path = self.ways.path
        assert path is not None, "it has begun"
        if row > self.row or depth_row > self.depth_row:
            at = self.row + np.flatnonzero(self.on_path[self.row : row])
            rows = {
                name: self.positions[name][at]
                for name in ("time", "longitude", "latitude", "depth")
            }
            extension = extended(path, rows, self.depth[self.depth_row : depth_row])
            self.ways = replace(self.ways, path=extension)
            self.row, self.depth_row = max(row, self.row), max(depth_row, self.depth_row)

    def _ended(self, number: int) -> list[Found]:
        """End a dive at a fix; return its mean current where it is computed."""
        row = int(self.fixes[number])
        order = int(self.order[row])
        self._extend(row, int(np.searchsorted(self.depth_order, order, side="right")))
        path, end, ways, config = self.ways.path, spot(self.positions, row), self.ways, self.config
        assert path is not None, "it dived"
        self._begin(row)
        self.ways = replace(self.ways, done=(path, end))
        if config.dead_reckoning == "corrected" or ways.stated or not path.reckoned:
            return []
        velocity = drift(path, end)
        if not _believed(velocity, config):
            return []
        mean = path_mean(path, end, velocity, _error(path, end, config))
        self.ways = replace(self.ways, done=None, computed=end.time)
        return [(order, row, mean)] if _is_path(mean) else []

    def take(self, row: Columns) -> dict[str, Any] | str:
        """Return a stated mean current with its path, or in words why it is not used."""
        velocity, config = (float(row["velocity"][0]), float(row["velocity"][1])), self.config
        if not _believed(velocity, config):
            return TOO_FAST
        self.ways = replace(self.ways, stated=True)
        ways, end_time = self.ways, int(row["end_time"])
        if (
            end_time != _LONG_AGO
            and ways.computed != _LONG_AGO
            and end_time <= ways.computed + _SAME_FIX
        ):
            return _COMPUTED
        found = _path_of(ways, row)
        if found is None:
            return _NO_DEPTH
        path, end = found
        std = float(row["error_std"])
        mean = path_mean(
            path, end, velocity, std if math.isfinite(std) else _error(path, end, config)
        )
        if not _is_path(mean):
            return _NO_PATH
        if ways.done is not None and ways.done[1].time <= end.time:
            self.ways = replace(ways, done=None)
        return mean


def _is_path(mean: dict[str, Any]) -> bool:
    """Return whether a path leads from place to place; between opposite sides of the Earth no way is the shortest."""
    places = mean["path_longitude"] + mean["path_latitude"] + mean["path_depth"]
    return bool(np.isfinite(places).all())


def _believed(velocity: tuple[float, float], config: MeasurementConfig) -> bool:
    return all(abs(component) <= config.max_speed for component in velocity)


def _error(path: Path, end: Spot, config: MeasurementConfig) -> float:
    """Return the error of a component [m/s]: its own, and that of the two fixes over the time between them."""
    seconds = (end.time - path.start.time) * 1e-9
    return math.hypot(config.dac_std, math.sqrt(2.0) * config.fix_std / seconds)


def _path_of(ways: Ways, row: Columns) -> tuple[Path, Spot] | None:
    """Return the path that a stated mean current belongs to, and the fix that ends it; None when neither is known."""
    start, end = (_fix(row, name) for name in ("start", "end"))
    done, path = ways.done, ways.path
    if done is not None and _same(done[0].start, start) and _same(done[1], end):
        return done
    if start is None or end is None or end.time <= start.time:
        return None
    on_the_way = path is not None and _same(path.start, start) and path.last.time <= end.time
    if path is not None and on_the_way and math.isfinite(path.deepest):
        # the fix after the dive has not come yet
        return path, end
    deepest = float(row["deepest"])
    if not math.isfinite(deepest):
        known = [one.deepest for one in (path, done and done[0]) if one is not None]
        deepest = max((depth for depth in known if math.isfinite(depth)), default=math.nan)
    return (replace(begun(start), deepest=deepest), end) if math.isfinite(deepest) else None


def _fix(row: Columns, name: str) -> Spot | None:
    time = int(row[f"{name}_time"])
    return None if time == _LONG_AGO else Spot(time, *row[name].tolist())


def _same(fix: Spot, stated: Spot | None) -> bool:
    return stated is None or abs(fix.time - stated.time) <= _SAME_FIX
