"""Rows of positions from tables of positions, poses, depths and attitudes: senders, dead reckoning and local frames."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.geodesy import to_geographic_about
from replay_kit.core.observation.table import Columns, Integers, Rows, Table, chosen_rows
from replay_kit.logs.tables.columns import first_reason
from replay_kit.logs.tables.vehicle import no_place
from replay_kit.measurements.step import Step
from replay_kit.measurements.track.dives import depth_of
from replay_kit.measurements.track.positions import LONG_AGO, NEVER, ROW, as_of, in_order, no_rows

NO_ORIGIN = "local position without an origin: state it with --origin LON,LAT"
NAVIGATED = "local position beside the system's position on the Earth, which is used"
_NONE = np.empty(0, np.int64)
_NOTHING: Mapping[Any, Any] = {}
# ns; a MAVLink position is measured while the last three-dimensional fix is no older than this
_FIX_AGE = 5_000_000_000
#: By kind of message and MAVLink system, places in the stream and what was stated there.
Stated = Mapping[tuple[str, str], tuple[Integers, NDArray[Any]]]
#: Numbers of the MAVLink system and component whose position and depth count.
Sender = tuple[str | None, str | None]
#: Places in the stream, depths [m], and that the vehicle states them.
Depth = tuple[Integers, Array, bool]


class Frames(NamedTuple):
    """State of the frames of positions.

    Attributes:
        stated: By kind of message and MAVLink system: for gps, time of the last 3D fix [ns, UTC], long ago without one; for origin,
            longitude and latitude of the local frame's origin [degrees]; for position, that it has stated a geographic one.
        place: Last geographic position, at most one row.
        origins: By topic of poses, longitude, latitude [degrees] of a position and its east and north [m] in the local frame.
    """

    stated: Mapping[tuple[str, str], Any] = _NOTHING
    place: Columns = no_rows()
    origins: Mapping[str, Array] = _NOTHING


def from_sender(sender: Sender, tables: Sequence[Table], step: Step) -> tuple[Sender, list[Table]]:
    """Return the used MAVLink sender, the first with a position of those requested, and tables without other senders."""
    candidates = (
        (table.order[0], stated)
        for table in tables
        if (stated := table.fixed.get("sender"))
        and table.kind in ("position", "pose")
        and not _other(stated, sender)
    )
    # rows before the first position are taken as those of the sender
    since, first = next(candidates, (NEVER, sender)) if None in sender else (-1, sender)
    kept = []
    for table in tables:
        stated = table.fixed.get("sender", first)
        asked = _other(stated, sender)
        table = step.kept(
            table, np.where(table.order > since, asked or _other(stated, first), asked)
        )
        if len(table):
            kept.append(table)
    return first, kept


def _other(found: Sender, used: Sender) -> str:
    """Return why messages of a sender are excluded; empty if they are not."""
    for what, number, counted in zip(("system", "component"), found, used, strict=True):
        if counted not in (None, number):
            return f"MAVLink {what} {number}, but {what} {counted} is used; choose with {what} in [logs]"
    return ""


def locate(
    frames: Frames, by_kind: Mapping[str, list[Table]], step: Step
) -> tuple[Frames, Rows, list[Depth]]:
    """Return the state and the positions of a block in order, and note its messages.

    ``depth`` of a position is its own. The last result are the depths of positions and of poses without an origin.

    Args:
        frames: State before the block.
        by_kind: Tables by kind: positions, poses, origins and GPS states.
        step: Block.
    """
    stated = _system_statements(
        frames.stated, [*by_kind["gps"], *by_kind["origin"], *by_kind["position"]], step
    )
    direct = in_order(
        no_rows(), *(_geographic(table, stated, step) for table in by_kind["position"])
    )
    known = in_order(frames.place, direct)
    fixes = direct["order"][~direct["dead_reckoned"]]
    origins = {} if fixes.size else dict(frames.origins)
    made, depths, runs = [direct], list[Depth](), list[tuple[int, int, Table]]()
    for table in by_kind["pose"]:
        since = stated.get(("position", table.fixed["system"]), (np.array([NEVER]),))[0]
        table = step.kept(table, np.where(table.order > since.min(), NAVIGATED, ""))
        run = np.searchsorted(fixes, table.order)
        # between fixes, in the order of their first ones: a topic goes on from where another has got to
        each = ((number, table.rows(run == number)) for number in np.unique(run).tolist())
        runs += [(int(rows.order[0]), number, rows) for number, rows in each]
    for _, number, table in sorted(runs, key=lambda run: run[0]):
        begun = None if number else frames.origins.get(table.topic)
        origin = _origins(table, begun, known, stated, step)
        rows, lacks = _pose_positions(table, origin, step)
        made.append(rows)
        known = in_order(known, rows)
        depths.append((table.order[lacks], table["depth"][lacks], True))
        if number == fixes.size and not lacks[-1]:
            origins[table.topic] = origin[-1]
    positions = in_order(*made)
    last = {key: values[-1] for key, (_, values) in stated.items()}
    after = Frames(last, chosen_rows(known, slice(-1, None)), origins)
    return after, positions, [(positions["order"], positions["depth"], True), *depths]


def _system_statements(
    known: Mapping[tuple[str, str], Any], tables: Sequence[Table], step: Step
) -> Stated:
    """Return the statements of MAVLink systems after earlier ones; notes the messages that state nothing else."""
    parts = {key: [(np.array([-1]), np.array([value]))] for key, value in known.items()}
    for one in tables:
        values = one.time
        if one.kind == "gps":
            step.note(one, one["no_fix"])
            values = np.where(one["no_fix"] == "", one.time, LONG_AGO)
        elif one.kind == "origin":
            step.note(one)
            values = np.column_stack([one["longitude"], one["latitude"]])
        if system := one.fixed.get("system"):
            parts.setdefault((one.kind, system), []).append((one.order, values))
    found = {}
    for key, each in parts.items():
        order, values = (np.concatenate(column) for column in zip(*each, strict=True))
        at = np.argsort(order, kind="stable")
        values = values[at] if key[0] == "origin" else np.maximum.accumulate(values[at])
        found[key] = order[at], values
    return found


def _geographic(table: Table, stated: Stated, step: Step) -> Rows:
    """Return the rows of a table of positions.

    A filter's positions count as dead-reckoned if its system's last GPS fix is more than five seconds old or missing; without a GPS so far
    they count as stated.
    """
    reckoned, system = table["dead_reckoned"].astype(bool), table.fixed.get("system")
    if system is not None:
        orders, times = stated.get(("gps", system), (_NONE, _NONE))
        last = np.append(times, table.time.max())[as_of(table.order, orders)]
        reckoned = table.time - last > _FIX_AGE
    depth = table.columns.get("depth")
    if depth is None:
        depth = depth_of(table["pressure"], table["latitude"])
    places = table["longitude"], table["latitude"], depth
    return _rows(table, step, *places, reckoned, not table.fixed.get("beside"))


def _rows(table: Table, step: Step, *columns: Any) -> Rows:
    """Return positions outside dives; ``columns`` are longitude, latitude, depth, dead_reckoned and own, common or per row."""
    message = table.input, step.topic(table.topic), table.position
    values = table.time, table.order, *message, *columns, False, 0
    return {
        name: np.broadcast_to(np.asarray(value, kind), len(table))
        for (name, kind), value in zip(ROW.items(), values, strict=True)
    }


def _origins(
    table: Table, begun: Array | None, known: Columns, stated: Stated, step: Step
) -> Array:
    """Return the origin of each pose of a topic between two fixes, as in ``Frames``, shape (n, 4); NaN before the first.

    It is the last position before the first pose after a fix, or the origin stated by a MAVLink system.

    Args:
        table: Table of poses.
        begun: Their origin since the previous fix; None without one.
        known: Positions, including poses of other topics.
        stated: Statements of MAVLink systems.
        step: Block.
    """
    n, configured = len(table), step.config.origin
    if system := table.fixed["system"]:
        if configured is not None:
            return np.tile([*configured, 0.0, 0.0], (n, 1))
        orders, places = stated.get(("origin", system), (_NONE, np.empty((0, 2))))
        rows = np.vstack([places, [np.nan, np.nan]])[as_of(table.order, orders)]
        return np.column_stack([rows, np.zeros((n, 2))])
    at = as_of(table.order, known["order"])
    if begun is None and configured is not None and at[0] < 0:
        begun = np.array([*configured, 0.0, 0.0])
    if begun is not None:
        return np.tile(begun, (n, 1))
    # the first pose that has a position before it
    first = int(np.argmax(at >= 0))
    place = [
        known[name][at[first]] if at[first] >= 0 else np.nan for name in ("longitude", "latitude")
    ]
    begun = np.array([*place, table["east"][first], table["north"][first]])
    return np.where((at >= 0)[:, None], begun, np.nan)


def _pose_positions(table: Table, origin: Array, step: Step) -> tuple[Rows, Mask]:
    """Return the positions of poses, and which poses have no origin; notes their messages."""
    x, y, east, north = origin.T
    longitude, latitude = to_geographic_about(x, y, table["east"] - east, table["north"] - north)
    lacks = np.isnan(x)
    reasons = {NO_ORIGIN if table.fixed["system"] else "": lacks} | no_place(longitude, latitude)
    words = first_reason(reasons)
    step.note(table, words)
    rows = _rows(table, step, longitude, latitude, table["depth"], True, False)
    return chosen_rows(rows, (words == "") & ~lacks), lacks
