"""Tables of positions, poses, depths and attitudes to rows of positions: whose count, which are dead-reckoned, where local frames lie."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import moved
from replay_kit.core.table import Columns, Integers, Table
from replay_kit.measurements.dives import depth_of
from replay_kit.measurements.ledger import Ledger
from replay_kit.measurements.positions import (
    LONG_AGO,
    Places,
    as_of,
    joined,
    no_rows,
)

NO_ORIGIN = "local position without an origin: state it with --origin LON,LAT"
NAVIGATED = "local position beside the system's position on the Earth, which is used"
_NO_NUMBER, _NO_FIX, _OUTSIDE = (
    "position is not a number",
    "position is 0, 0 (no fix)",
    "position outside the range of longitude and latitude",
)
_NEVER = np.iinfo(np.int64).max
# ns; a MAVLink position is measured while the last three-dimensional fix is no older than this
_FIX_AGE = 5_000_000_000
#: Places in the stream, and times of a GPS' fixes up to each [ns, UTC].
Status = tuple[Integers, Integers]
#: Numbers of the MAVLink system and component whose position and depth count.
Sender = tuple[str | None, str | None]
#: Places in the stream, depths [m].
Depth = tuple[Integers, Array]


def of_sender(
    sender: Sender, tables: Sequence[Table], ledger: Ledger
) -> tuple[Sender, list[Table]]:
    """Return the MAVLink sender that counts, the first that states a position of those asked for, and the tables without others' rows."""
    senders = [one.fixed.get("sender") for one in tables]
    if not any(senders):
        return sender, list(tables)
    candidates = [
        (int(one.order[0]), own)
        for one, own in zip(tables, senders, strict=True)
        if own and one.kind in ("position", "pose") and not _other(own, sender)
    ]
    # rows before the first position are taken as those of the sender
    since, first = min(candidates, default=(_NEVER, sender))
    since, first = (since, first) if None in sender else (-1, sender)
    kept = []
    for one, own in zip(tables, senders, strict=True):
        if own:
            refused = one.order > since if not _other(own, sender) else one.order >= 0
            reason = _other(own, sender) or _other(own, first)
            if reason and refused.any():
                ledger.add(one.order[refused], one.topic, reason)
                one = one.rows(~refused)
        if len(one):
            kept.append(one)
    return first, kept


def _other(own: tuple[str, str], used: Sender) -> str:
    """Return why messages of a sender do not count; empty where they do."""
    for what, number, counted in zip(("system", "component"), own, used, strict=True):
        if counted not in (None, number):
            return f"MAVLink {what} {number}, but {what} {counted} is used; choose with {what} in [logs]"
    return ""


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Positions of a block.

    Attributes:
        places: What is remembered, without the last position and the fixes.
        positions: Rows without the vehicle's depth and dive; ``depth`` is the position's own.
        depths: Depths that positions, and poses without a place, state.
    """

    places: Places
    positions: Columns
    depths: list[Depth]


def located(
    places: Places, tables: Sequence[Table], config: MeasurementConfig, ledger: Ledger
) -> Located:
    """Return the positions of a block in order, and note its messages.

    Args:
        places: Remembered before.
        tables: Those of kinds position, gps, origin and pose count.
        config: The origin of local frames.
        ledger: Of the block.
    """
    gps, status = _gps(places.gps, [one for one in tables if one.kind == "gps"], ledger)
    stated = [one for one in tables if one.kind == "position"]
    parts = [_direct(one, places.gps, status, ledger) for one in stated]
    direct = _in_order(joined(no_rows(), *parts))
    navigated = dict.fromkeys(places.navigated, -1)
    for one in sorted(stated, key=lambda table: int(table.order[0])):
        if "system" in one.fixed:
            navigated.setdefault(one.fixed["system"], int(one.order[0]))
    local, origins_of = _local(
        places.local, [one for one in tables if one.kind == "origin"], ledger
    )
    poses = _Poses(places, direct, navigated, origins_of, config)
    posed = poses.rows([one for one in tables if one.kind == "pose"], ledger)
    positions = _in_order(joined(direct, *posed))
    measured = (~direct["dead_reckoned"]).any()
    origins = poses.origins if measured else {**places.origins, **poses.origins}
    after = replace(places, gps=gps, navigated=frozenset(navigated), local=local, origins=origins)
    return Located(after, positions, [(positions["order"], positions["depth"]), *poses.depths])


def _in_order(rows: Columns) -> dict[str, NDArray[Any]]:
    at = np.argsort(rows["order"], kind="stable")
    return {name: column[at] for name, column in rows.items()}


def _gps(
    known: Mapping[str, int], tables: Sequence[Table], ledger: Ledger
) -> tuple[dict[str, int], dict[str, Status]]:
    """Return the time of the last fix of each system's GPS at the end, and what its GPS says in the block."""
    after, status = dict(known), {}
    for one in tables:
        ledger.add(one.order, one.topic, one["no_fix"])
    for system in {one.fixed["system"] for one in tables}:
        own = [one for one in tables if one.fixed["system"] == system]
        order, time = (
            np.concatenate([getattr(one, name) for one in own]) for name in ("order", "time")
        )
        fixed = np.concatenate([one["no_fix"] == "" for one in own])
        at = np.argsort(order)
        before = known.get(system, LONG_AGO)
        times = np.maximum.accumulate(np.where(fixed, time, before)[at])
        status[system], after[system] = (order[at], times), int(times[-1])
    return after, status


def _without_gps(table: Table, status: Status, known: int | None) -> NDArray[np.bool_]:
    """Return whether a filter's positions are computed: its system has a GPS whose last fix is more than five seconds old, or had none.

    A system without a GPS so far, for which ``known`` is None, is taken at its word.
    """
    at, times = as_of(table.order, status[0]), status[1]
    last = np.append(times, LONG_AGO if known is None else known)[at]
    return np.asarray(((at >= 0) | (known is not None)) & (table.time - last > _FIX_AGE))


def _direct(
    table: Table,
    gps: Mapping[str, int],
    status: Mapping[str, Status],
    ledger: Ledger,
) -> dict[str, NDArray[Any]]:
    """Return the rows of a table of positions."""
    reckoned, system = table["dead_reckoned"].astype(np.bool_), table.fixed.get("system")
    if system is not None:
        none = np.empty(0, np.int64)
        reckoned = _without_gps(table, status.get(system, (none, none)), gps.get(system))
    depth = table.columns.get("depth")
    if depth is None:
        pressure = table["pressure"]
        depth = np.where(np.isfinite(pressure), depth_of(pressure, table["latitude"]), np.nan)
    rows = _rows(table, table["longitude"], table["latitude"], depth, reckoned, ledger)
    return {**rows, "own": np.full(len(table), not table.fixed.get("beside"))}


def _rows(
    table: Table,
    longitude: Array,
    latitude: Array,
    depth: Array,
    reckoned: NDArray[np.bool_],
    ledger: Ledger,
) -> dict[str, NDArray[Any]]:
    n = len(table)
    return {
        "time": table.time,
        "order": table.order,
        "longitude": longitude,
        "latitude": latitude,
        "depth": depth,
        "dead_reckoned": reckoned,
        "submerged": np.zeros(n, np.bool_),
        "dive": np.zeros(n, np.int64),
        "input": np.full(n, table.input),
        "topic": np.full(n, ledger.topic(table.topic)),
        "ordinal": table.position,
        "own": np.zeros(n, np.bool_),
    }


def _local(
    known: Mapping[str, tuple[float, float]], tables: Sequence[Table], ledger: Ledger
) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[Integers, Array]]]:
    """Return the origins of local frames by system at the end, and places in the stream and places of those stated before each."""
    after = dict(known)
    stated = {system: (np.array([-1]), np.array([place])) for system, place in known.items()}
    for one in tables:
        ledger.add(one.order, one.topic)
        system = one.fixed["system"]
        order, place = stated.get(system, (np.empty(0, np.int64), np.empty((0, 2))))
        order = np.concatenate([order, one.order])
        place = np.concatenate([place, np.column_stack([one["longitude"], one["latitude"]])])
        at = np.argsort(order, kind="stable")
        stated[system] = order[at], place[at]
        after[system] = (float(place[at][-1, 0]), float(place[at][-1, 1]))
    return after, stated


class _Poses:
    """Places of poses: relative to the position known when their topic's first since the last measured fix came, or to a stated origin."""

    def __init__(
        self,
        places: Places,
        direct: Columns,
        navigated: Mapping[str, int],
        stated: Mapping[str, tuple[Integers, Array]],
        config: MeasurementConfig,
    ) -> None:
        self.places, self.direct, self.navigated = places, direct, navigated
        self.stated, self.config = stated, config
        self.fixes = direct["order"][~direct["dead_reckoned"]]
        self.origins: dict[str, tuple[float, float, float, float]] = {}
        self.depths: list[Depth] = []
        self.made: list[dict[str, NDArray[Any]]] = []

    def rows(self, tables: Sequence[Table], ledger: Ledger) -> list[dict[str, NDArray[Any]]]:
        """Return the positions of poses, and note their messages."""
        runs: list[tuple[int, int, Table]] = []
        for table in tables:
            system = table.fixed["system"]
            beside = (
                table.order > self.navigated.get(system, _NEVER)
                if system
                else np.zeros(len(table), bool)
            )
            ledger.add(table.order[beside], table.topic, NAVIGATED)
            rest = table.rows(~beside)
            runs_of = np.searchsorted(self.fixes, rest.order)
            for run in np.unique(runs_of):
                part = rest.rows(runs_of == run)
                runs.append((int(part.order[0]), int(run), part))
        for _, run, part in sorted(runs, key=lambda one: one[0]):
            self._place(part, run, ledger)
        return self.made

    def _place(self, table: Table, run: int, ledger: Ledger) -> None:
        """Place the poses of one topic between two measured fixes."""
        origin = self.places.origins.get(table.topic) if run == 0 else None
        lacks = np.zeros(len(table), np.bool_)
        if origin is None:
            origin, first = self._origin(table)
            lacks = table.order < first
            words = NO_ORIGIN if table.fixed["system"] else ""
            ledger.add(table.order[lacks], table.topic, words)
            self.depths.append((table.order[lacks], table["depth"][lacks]))
        if origin is None:
            return
        if run == self.fixes.size:
            self.origins[table.topic] = origin
        table = table.rows(~lacks)
        x, y = np.full(len(table), origin[0]), np.full(len(table), origin[1])
        longitude, latitude = moved(x, y, table["east"] - origin[2], table["north"] - origin[3])
        reasons = np.full(len(table), "", object)
        reasons[(np.abs(latitude) > 90.0) | (longitude < -180.0) | (longitude > 360.0)] = _OUTSIDE
        reasons[(longitude == 0.0) & (latitude == 0.0)] = _NO_FIX
        reasons[~np.isfinite(longitude + latitude)] = _NO_NUMBER
        ledger.add(table.order, table.topic, reasons)
        good = reasons == ""
        rows = _rows(
            table, longitude, latitude, table["depth"], np.ones(len(table), np.bool_), ledger
        )
        self.made.append({name: column[good] for name, column in rows.items()})

    def _origin(self, table: Table) -> tuple[tuple[float, float, float, float] | None, int]:
        """Return the origin for a topic's poses, and the place in the stream of the first that has it."""
        system, config = table.fixed["system"], self.config
        if not system:
            k, last = 0, self._last(int(table.order[0]))
            if last is None and config.origin is None:
                begun = [
                    rows["order"][0] for rows in (self.direct, *self.made) if len(rows["order"])
                ]
                k = int(np.searchsorted(table.order, min(begun, default=_NEVER), side="right"))
                last = self._last(int(table.order[k])) if k < len(table) else None
            if last is not None:
                place = *last, float(table["east"][k]), float(table["north"][k])
                return place, int(table.order[k])
            if config.origin is None:
                return None, _NEVER
        if config.origin is not None:
            return (*config.origin, 0.0, 0.0), int(table.order[0])
        orders, places = self.stated.get(system, (np.empty(0, np.int64), np.empty((0, 2))))
        known = as_of(table.order, orders)
        first = np.flatnonzero(known >= 0)
        if not first.size:
            return None, _NEVER
        longitude, latitude = places[known[first[0]]].tolist()
        return (longitude, latitude, 0.0, 0.0), int(table.order[first[0]])

    def _last(self, order: int) -> tuple[float, float] | None:
        """Return the last position before a place in the stream."""
        best: tuple[int, Columns, int] | None = None
        for rows in (self.places.last, self.direct, *self.made):
            at = int(np.searchsorted(rows["order"], order)) - 1
            if at >= 0 and (best is None or rows["order"][at] > best[0]):
                best = int(rows["order"][at]), rows, at
        return (
            None
            if best is None
            else (float(best[1]["longitude"][best[2]]), float(best[1]["latitude"][best[2]]))
        )
