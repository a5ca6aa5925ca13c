"""Measurements of a block of messages as columns by kind: input of the checks and of the estimator.

A row is one event. Rows do not depend on the division of the stream into blocks: a ping that waits for a position belongs to the block of
that position.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import Finding
from replay_kit.core.observation import LinearMeasurement, Reason
from replay_kit.core.observation.table import Columns, Integers

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
