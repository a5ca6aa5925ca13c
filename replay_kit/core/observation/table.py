"""Raw messages of a topic, and tables of one kind in SI units: output of the log readers, input of the measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
Rows = dict[str, NDArray[Any]]
Integers = NDArray[np.int64]

#: What the rows of a table are. The columns of each kind, with their shapes and units, are those of ``Table``.
Kind = Literal[
    "position",
    "gps",
    "origin",
    "pose",
    "depth",
    "attitude",
    "dvl",
    "ping",
    "mean",
    "ctd",
    "radar",
    "drifter",
    "sensor",
    "unused",
]


def chosen(rows: Columns, at: Any) -> Rows:
    """Return a subset of the rows, without a copy if it is all of them in order."""
    if isinstance(at, np.ndarray) and rows and _are_all(at, len(next(iter(rows.values())))):
        return dict(rows)
    return {name: column[at] for name, column in rows.items()}


def _are_all(at: NDArray[Any], n: int) -> bool:
    return bool(at.all() if at.dtype == np.bool_ else at.size == n and (at == np.arange(n)).all())


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """Messages of one topic, schema and log, in the order of the stream.

    Attributes:
        topic: Channel name.
        schema: Name of the schema, as in the log.
        input: Position of the log among the run's inputs.
        time: shape (n,) [ns, UTC].
        order: shape (n,), position of each message in the stream of all topics and logs.
        position: shape (n,), ordinal or byte offset in the log.
        payloads: Fields of each message.
    """

    topic: str
    schema: str
    input: int
    time: Integers
    order: Integers
    position: Integers
    payloads: Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Rows of one kind in SI units, one per message; a MAVLink ping may join several messages.

    Numbers not stated are NaN. Columns by kind, with shapes after (n,):

    * position: longitude, latitude [degrees], depth [m] or pressure [dbar], dead_reckoned (bool). ``fixed["system"]``: MAVLink system whose
      GPS says whether they are dead-reckoned; ``fixed["beside"]``: True where the same messages are pings and count as those.
    * gps: no_fix (text), why the GPS of ``fixed["system"]`` has no fix; empty where it has one.
    * origin: longitude, latitude [degrees], of the local frame of ``fixed["system"]``.
    * pose: east, north, depth [m] in a local frame, quaternion (4), ned (bool: axes forward, starboard, down); ``fixed`` has ``oriented``,
      whether a quaternion is stated, and ``system``, empty outside MAVLink.
    * depth: depth [m], or pressure [dbar] above that of the atmosphere; ``fixed["by"]`` says which is stated.
    * attitude: quaternion (4), x, y, z, w, from the body's axes to the frame's, ned (bool).
    * dvl: velocity (3) [m/s], error_std [m/s], bottom (bool: relative to it, else to a layer of water), axes (0 not stated, 1 forward,
      starboard, down, 2 forward, left, up).
    * ping: see ``logs.tables.instruments``.
    * mean: velocity (2), error_std [m/s], start, end (2: longitude, latitude of the fixes), start_time, end_time [ns, UTC], long ago where
      not stated, dive (-1 for none), deepest [m], inverted (bool: profiles were computed from it, among other things).
    * ctd: depth [m], temperature [degrees C], salinity, conductivity [S/m], pressure [dbar].
    * radar: arrays of v vectors as objects: longitude, latitude, value (v, c), error_std, direction (or None), suspect; depth [m], averaged
      [s], error_length [m], kind (radar or sensors).
    * drifter: name (text), longitude, latitude, depth, error [m].
    * sensor: measurement (``LinearMeasurement``).
    * unused: reason (text), why the message cannot be used.

    Attributes:
        kind: Kind of the rows.
        topic: Channel name.
        input: Position of the log among the run's inputs.
        time: shape (n,) [ns, UTC].
        order: shape (n,), position in the stream of the message that completes the row.
        position: shape (n,), ordinal or byte offset in the log.
        columns: Columns by name.
        fixed: Values common to all rows; ``sender`` is the MAVLink system and component where only one sender counts.
    """

    kind: Kind
    topic: str
    input: int
    time: Integers
    order: Integers
    position: Integers
    columns: Columns
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.time)

    def rows(self, at: NDArray[Any] | slice) -> "Table":
        """Return a subset of the rows."""
        columns = chosen(self.columns, at)
        places = self.time[at], self.order[at], self.position[at]
        return Table(self.kind, self.topic, self.input, *places, columns, self.fixed)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]
