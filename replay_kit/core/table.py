"""Messages of a topic as a reader gave them, and rows of one kind in SI columns: what passes from logs to measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
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


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """Messages of one topic, schema and log, in the order of the stream.

    Attributes:
        topic: Channel name.
        schema: Name of the schema, as in the log.
        input: Position of the log among the run's inputs.
        time: shape (n,) [ns, UTC].
        order: shape (n,), each message's place in the stream of all topics and logs.
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
    """Rows of one kind in SI units: one row a message, or of MAVLink's pings one row for several.

    A number that a message does not state is NaN. Columns by kind, with shapes after (n,):

    * position: longitude, latitude [degrees], depth [m], dead_reckoned (bool). ``fixed["system"]``: MAVLink system whose GPS says whether
      they are dead-reckoned; ``fixed["beside"]``: True where the same messages are pings and count as those.
    * gps: has_fix (bool), of ``fixed["system"]``.
    * origin: longitude, latitude [degrees], of the local frame of ``fixed["system"]``.
    * pose: east, north, depth [m] in a local frame, quaternion (4); ``fixed`` has ``ned``, ``oriented`` and ``system``, empty outside MAVLink.
    * depth: depth [m], or pressure [dbar] above that of the atmosphere; ``fixed["by"]`` says which is stated.
    * attitude: quaternion (4), x, y, z, w, from the body's axes to the frame's; ``fixed["ned"]``: axes forward, starboard, down.
    * dvl: velocity (3) [m/s], error_std [m/s]; ``fixed`` has ``mode``, bottom or water, and ``axes``.
    * ping: see ``logs.tables.instruments``.
    * mean: velocity (2), error_std [m/s], start, end (3: s from the message, longitude, latitude), start_time, end_time [ns], dive (-1 for
      none), deepest [m], inverted (bool).
    * ctd: depth [m], temperature [degrees C], salinity, conductivity [S/m], pressure [dbar].
    * radar: one row a table: longitude, latitude, value (v, c), error_std, direction (v), suspect (v); ``fixed`` has depth, averaged,
      error_length and what they are, ``of``.
    * drifter: name (text), longitude, latitude, depth, error [m].
    * sensor: measurement (``LinearMeasurement``).
    * unused: reason (text), why the message cannot be used.

    Attributes:
        kind: What the rows are.
        topic: Channel name.
        input: Position of the log among the run's inputs.
        time: shape (n,) [ns, UTC].
        order: shape (n,), place of the message, or of the one that completes the row, in the stream.
        position: shape (n,), ordinal or byte offset in the log.
        columns: By name.
        fixed: What is the same for all rows.
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

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]
