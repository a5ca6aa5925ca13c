"""Tables of positions, poses, depths and attitudes to rows of positions: whose count, which are dead-reckoned, where local frames lie."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
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
    ROW,
    Places,
    Rows,
    as_of,
    chosen,
    in_order,
    no_rows,
)

NO_ORIGIN = "local position without an origin: state it with --origin LON,LAT"
NAVIGATED = "local position beside the system's position on the Earth, which is used"
_NO_NUMBER, _NO_FIX, _OUTSIDE = (
    "position is not a number",
    "position is 0, 0 (no fix)",
    "position outside the range of longitude and latitude",
)
_NONE, _NEVER = np.empty(0, np.int64), np.iinfo(np.int64).max
# ns; a MAVLink position is measured while the last three-dimensional fix is no older than this
_FIX_AGE = 5_000_000_000
#: By MAVLink system, places in the stream and what was stated there.
Stated = Mapping[str, tuple[Integers, NDArray[Any]]]
#: Numbers of the MAVLink system and component whose position and depth count.
Sender = tuple[str | None, str | None]
#: Places in the stream, depths [m].
Depth = tuple[Integers, Array]
#: Longitude, latitude [degrees] of a place, and its east and north [m] in a local frame.
Origin = tuple[float, float, float, float]


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
        if reason := own and (_other(own, sender) or _other(own, first)):
            refused = one.order > (-1 if _other(own, sender) else since)
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


def located(
    places: Places, tables: Mapping[str, Sequence[Table]], config: MeasurementConfig, ledger: Ledger
) -> tuple[Places, Rows, list[Depth]]:
    """Return the positions of a block in order, and note its messages.

    Of the places returned, the last position and the fixes are those before. ``depth`` of a position is its own. Last come the depths that
    positions, and poses without a place, state.

    Args:
        places: Remembered before.
        tables: By kind, those of positions, poses, origins and states of a GPS.
        config: The origin of local frames.
        ledger: Of the block.
    """
    stated = tables.get("position", ())
    for one in tables.get("gps", ()):
        ledger.add(one.order, one.topic, one["no_fix"])
    for one in tables.get("origin", ()):
        ledger.add(one.order, one.topic)
    gps = _by_system(
        places.gps,
        tables.get("gps", ()),
        lambda one: np.where(one["no_fix"] == "", one.time, LONG_AGO),
    )
    gps = {system: (at, np.maximum.accumulate(times)) for system, (at, times) in gps.items()}
    local = _by_system(
        places.local,
        tables.get("origin", ()),
        lambda one: np.column_stack([one["longitude"], one["latitude"]]),
    )
    direct = in_order(no_rows(), *(_direct(one, gps, ledger) for one in stated))
    navigated = dict.fromkeys(places.navigated, -1)
    for one in stated:
        if system := one.fixed.get("system"):
            navigated[system] = min(navigated.get(system, _NEVER), int(one.order[0]))
    fixes = direct["order"][~direct["dead_reckoned"]]
    origins = {} if fixes.size else dict(places.origins)
    made, depths = [direct], list[Depth]()
    for run, table in _runs(tables.get("pose", ()), navigated, fixes, ledger):
        origin, first = places.origins.get(table.topic) if run == 0 else None, -1
        if origin is None:
            origin, first = _origin(table, in_order(places.last, *made), local, config)
        lacks = table.order < first
        words = NO_ORIGIN if table.fixed["system"] else ""
        ledger.add(table.order[lacks], table.topic, words)
        depths.append((table.order[lacks], table["depth"][lacks]))
        if origin is not None:
            made.append(_posed(table.rows(~lacks), origin, ledger))
            origins |= {table.topic: origin} if run == fixes.size else {}
    positions = in_order(*made)
    after = replace(
        places,
        gps={system: int(times[-1]) for system, (_, times) in gps.items()},
        navigated=frozenset(navigated),
        local={system: tuple(place[-1].tolist()) for system, (_, place) in local.items()},
        origins=origins,
    )
    return after, positions, [(positions["order"], positions["depth"]), *depths]


def _by_system(
    known: Mapping[str, Any], tables: Sequence[Table], value: Callable[[Table], NDArray[Any]]
) -> Stated:
    """Return what tables state, after what was known of each system before."""
    parts = {system: [(np.array([-1]), np.array([value]))] for system, value in known.items()}
    for one in tables:
        parts.setdefault(one.fixed["system"], []).append((one.order, value(one)))
    found = {}
    for system, each in parts.items():
        order, values = (np.concatenate(column) for column in zip(*each, strict=True))
        at = np.argsort(order, kind="stable")
        found[system] = order[at], values[at]
    return found


def _direct(table: Table, gps: Stated, ledger: Ledger) -> Rows:
    """Return the rows of a table of positions.

    A filter's are computed where its system has a GPS whose last fix is more than five seconds old, or had none; a system without a GPS so
    far is taken at its word.
    """
    reckoned, system = table["dead_reckoned"].astype(bool), table.fixed.get("system")
    if system is not None:
        orders, times = gps.get(system, (_NONE, _NONE))
        last = np.append(times, table.time.max())[as_of(table.order, orders)]
        reckoned = table.time - last > _FIX_AGE
    depth = table.columns.get("depth")
    if depth is None:
        depth = depth_of(table["pressure"], table["latitude"])
    return _rows(
        table,
        ledger,
        longitude=table["longitude"],
        latitude=table["latitude"],
        depth=depth,
        dead_reckoned=reckoned,
        own=not table.fixed.get("beside"),
    )


def _rows(table: Table, ledger: Ledger, **columns: Any) -> Rows:
    """Return positions, those of no dive so far; of ``columns`` each is one number for all, or one each."""
    columns |= {
        "time": table.time,
        "order": table.order,
        "submerged": False,
        "dive": 0,
        "input": table.input,
        "topic": ledger.topic(table.topic),
        "ordinal": table.position,
    }
    return {
        name: np.broadcast_to(np.asarray(columns[name], kind), len(table))
        for name, kind in ROW.items()
    }


def _runs(
    tables: Sequence[Table], navigated: Mapping[str, int], fixes: Integers, ledger: Ledger
) -> list[tuple[int, Table]]:
    """Return the poses of each topic between two measured fixes, and the number of the fix after them, in the order of their first ones."""
    runs = []
    for table in tables:
        beside = table.order > navigated.get(table.fixed["system"], _NEVER)
        ledger.add(table.order[beside], table.topic, NAVIGATED)
        rest = table.rows(~beside)
        of = np.searchsorted(fixes, rest.order)
        runs += [(int(run), rest.rows(of == run)) for run in np.unique(of)]
    return sorted(runs, key=lambda one: int(one[1].order[0]))


def _origin(
    table: Table, rows: Columns, stated: Stated, config: MeasurementConfig
) -> tuple[Origin | None, int]:
    """Return the origin for a topic's poses, and the place in the stream of the first that has it.

    It is the position known when the first of them came, or of a MAVLink system the origin that it states.
    """
    system = table.fixed["system"]
    known = rows["order"], np.column_stack([rows["longitude"], rows["latitude"]])
    orders, places = stated.get(system, (_NONE, _NONE)) if system else known
    at = as_of(table.order, orders)
    if config.origin is not None and (system or at[0] < 0):
        return (*config.origin, 0.0, 0.0), int(table.order[0])
    if at[-1] < 0:
        return None, _NEVER
    k = int(np.argmax(at >= 0))
    start = (0.0, 0.0) if system else (float(table["east"][k]), float(table["north"][k]))
    longitude, latitude = places[at[k]].tolist()
    return (longitude, latitude, *start), int(table.order[k])


def _posed(table: Table, origin: Origin, ledger: Ledger) -> Rows:
    """Return the positions of poses that have an origin, and note their messages."""
    x, y = np.full(len(table), origin[0]), np.full(len(table), origin[1])
    longitude, latitude = moved(x, y, table["east"] - origin[2], table["north"] - origin[3])
    reasons = np.full(len(table), "", object)
    reasons[(np.abs(latitude) > 90.0) | (longitude < -180.0) | (longitude > 360.0)] = _OUTSIDE
    reasons[(longitude == 0.0) & (latitude == 0.0)] = _NO_FIX
    reasons[~np.isfinite(longitude + latitude)] = _NO_NUMBER
    ledger.add(table.order, table.topic, reasons)
    rows = _rows(
        table,
        ledger,
        longitude=longitude,
        latitude=latitude,
        depth=table["depth"],
        dead_reckoned=True,
        own=False,
    )
    return chosen(rows, reasons == "")
