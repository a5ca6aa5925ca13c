"""Tables of messages: raw ones of a topic, rows of one kind in SI units, and the measurements of a block as columns by kind.

Log readers give tables; the checks and the estimator take blocks, of which a row is one event. Rows do not depend on the division of the
stream into blocks: a ping that waits for a position belongs to the block of that position.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import Finding
from replay_kit.core.observation import LinearMeasurement, Reason

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


def chosen_rows(rows: Columns, at: Any) -> Rows:
    """Return a subset of the rows, without a copy if it is all of them in order."""
    if isinstance(at, np.ndarray) and rows:
        n = len(next(iter(rows.values())))
        if at.all() if at.dtype == np.bool_ else at.size == n and (at == np.arange(n)).all():
            return dict(rows)
    return {name: column[at] for name, column in rows.items()}


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
        columns = chosen_rows(self.columns, at)
        places = self.time[at], self.order[at], self.position[at]
        return Table(self.kind, self.topic, self.input, *places, columns, self.fixed)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]


#: Kinds of events, as in ``Block.events``.
POSITION, PING, MEAN, LINEAR = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class BinTest:
    """Result of one quality test of the pings of a block.

    Attributes:
        name: Name of the test, as in the settings.
        reason: Reason given to bins that fail or are suspect.
        flags: shape (n, m) int8, QARTOD flags; ``Flag.NOT_EVALUATED`` where the test is impossible.
        why_not: shape (n,), why a ping was not tested; empty if it was.
    """

    name: str
    reason: Reason
    flags: NDArray[np.int8]
    why_not: NDArray[np.object_]


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Events of a block of messages, in columns.

    All kinds but ``linear`` have the columns ``time`` [ns, UTC], ``dive`` (0 before the first), and of the message that an event came from
    ``input`` (number of the log), ``topic`` (number in ``topics``), ``ordinal`` (in the log) and ``order`` (position in the stream); times,
    numbers and orders are int64. Unknown values are NaN. Further columns, with shapes after (n,):

    * position, one row per position: longitude, latitude [degrees], depth (of the vehicle, by this or the last message that states one)
      [m], dead_reckoned, submerged (bool).
    * ping, one row per profile of m bins; missing bins, from ``bins`` on, are NaN with ``Flag.MISSING`` and no reason: longitude, latitude
      [degrees]; position_std [m], 0 near a position; bins (int64), their number; depth (m) [m], positive down; velocity (m, 2) [m/s], true
      east and north; error_std (m) [m/s]; flags (m) int8, reasons (m) int32, as ``Flag`` and ``Reason``; common_std [m/s], error common to
      all bins, inf where the velocity is relative to the platform (``Observation.reference``); correlation_depth [m]; platform (2) [m/s],
      true east and north, velocity added to those measured, NaN if unknown; transducer_depth [m]; distance (m) [m], vertical, from the
      transducer; up (bool), whether the instrument looks up; vehicle_depth [m], by messages before; pressure_depth [m], of the transducer
      by the ping's own pressure; heading [degrees]; error_velocity [m/s], mean over solved beams; raw (m, k) [m/s], velocities before any
      rotation; components (int64), number of columns of ``raw`` in use; along_beams (bool), whether ``raw`` is along beams; messages
      (int64), number of messages in the ping.
    * mean, one row per mean current along a path of p points; points from ``points`` on have weight 0: velocity (2) [m/s], true east and
      north; error_std [m/s]; points (int64); path_time (p) [ns], path_longitude, path_latitude (p) [degrees], path_depth (p) [m], weight
      (p), fractions of the time, sum 1; start_time, end_time [ns], start, end (2), longitude and latitude of the fixes; deepest [m]; radius
      of the goal [m]; declination [degrees east]; reckoned (2) [m/s], by dead reckoning; beside_profiles (bool); source_time [ns].

    Attributes:
        events: shape (N, 3) int64, in order: position in the stream of the message that completes the event, its kind, its row.
        position: Positions.
        ping: Profiles.
        mean: Mean currents along paths.
        linear: Measurements from geostrophic shear, radars, drifters and sensors.
        topics: Names of topics.
        outcomes: shape (M, 3) int64, in order, one row per message: position in the stream at which its use was decided, number of its
            topic, number in ``reasons``, or -1 if it is used.
        reasons: Reasons why messages are not used.
        tests: Results of the quality tests of ``ping``.
        findings: Findings with their positions in the stream.
    """

    events: Integers
    position: Columns
    ping: Columns
    mean: Columns
    linear: Sequence[LinearMeasurement]
    topics: Sequence[str]
    outcomes: Integers
    reasons: Sequence[str]
    tests: Sequence[BinTest] = ()
    findings: Sequence[tuple[int, Finding]] = ()

    def counts(self) -> Mapping[tuple[str, str], int]:
        """Return the number of messages by topic and reason; the reason of used messages is empty."""
        pairs, numbers = np.unique(self.outcomes[:, 1:], axis=0, return_counts=True)
        return {
            (self.topics[topic], self.reasons[reason] if reason >= 0 else ""): int(number)
            for (topic, reason), number in zip(pairs.tolist(), numbers.tolist(), strict=True)
        }
