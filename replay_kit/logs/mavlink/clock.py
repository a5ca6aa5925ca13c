"""Clocks of a telemetry log from its SYSTEM_TIME messages: each sender's time since boot, and UTC if known.

The recorder's stamps order a replay unless the clock is ``header``. They are compared with UTC, and the senders' clocks are fitted.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.logs.mavlink.fit import ClockFit, fit_clock
from replay_kit.logs.mavlink.frames import Frames

MESSAGE_ID = dialect.MAVLINK_MSG_ID_SYSTEM_TIME
#: UTC [microseconds] before the year 2000 is a clock that was never set.
UTC_SINCE_US = 946_684_800_000_000
_MAX_US = (2**63 - 1) // 1000
#: UTC [microseconds], then the time since start [ms].
_PAYLOAD = struct.Struct("<QI")
#: A clock that goes back by more was started anew [ms].
_RESTART_MS = 1000
#: Position in the file, sender, recorder's stamp [microseconds], UTC [microseconds] and time since start [ms] of a SYSTEM_TIME message.
Pair = tuple[int, int, int, int, int]


@dataclass(frozen=True, slots=True)
class StartClock:
    """Clock of one sender between two boots.

    Attributes:
        sender: 256 times the system number plus the component number.
        position: Position of its first SYSTEM_TIME message in the file.
        fit: Fit of the clock to UTC.
        from_utc: Whether the fit uses UTC in the messages; otherwise the recorder's stamps.
    """

    sender: int
    position: int
    fit: ClockFit
    from_utc: bool


def pairs_in(frames: Frames, position: int) -> Iterator[Pair]:
    """Yield the SYSTEM_TIME messages of a block of entries; ``position`` is that of the first in the file."""
    for k in np.flatnonzero(frames.message_id == MESSAGE_ID).tolist():
        start = int(frames.payload[k])
        # MAVLink 2 cuts zeros at the end
        payload = frames.data[start : start + int(frames.length[k])].ljust(_PAYLOAD.size, b"\0")
        utc_us, boot_ms = _PAYLOAD.unpack_from(payload)
        stamped = int(frames.sender[k]), int(frames.stamp_us[k])
        yield position + k, *stamped, min(utc_us, _MAX_US), boot_ms


def start_clocks(pairs: Sequence[Pair]) -> list[StartClock]:
    """Return the clock of each sender after each boot, in file order, from the SYSTEM_TIME messages in that order."""
    found = []
    table = np.array(pairs, np.int64).reshape(-1, 5)
    for sender in np.unique(table[:, 1]).tolist():
        own = table[table[:, 1] == sender]
        boots = np.flatnonzero(np.diff(own[:, 4]) < -_RESTART_MS) + 1
        for start in np.split(own, boots):
            position, _, stamp_us, utc_us, boot_ms = start[start[:, 4] > 0].T
            if position.size:
                timed = utc_us >= UTC_SINCE_US
                from_utc = bool(timed.any())
                used = timed if from_utc else slice(None)
                true_us = utc_us if from_utc else stamp_us
                fit = fit_clock(boot_ms[used] * 1_000_000, true_us[used] * 1000)
                found.append(StartClock(sender, int(position[0]), fit, from_utc))
    return sorted(found, key=lambda clock: clock.position)


def clock_notes(pairs: Sequence[Pair]) -> list[str]:
    """Return notes on the recorder's stamps against UTC, and on the fit of each clock."""
    notes = []
    late = [stamp_us - utc_us for _, _, stamp_us, utc_us, _ in pairs if utc_us >= UTC_SINCE_US]
    if late:
        middle, least, most = 1e-6 * np.quantile(late, (0.5, 0.0, 1.0))
        notes.append(
            f"the recorder's stamps are {middle:+.3f} s from UTC by {len(late)} of {len(pairs)} SYSTEM_TIME messages "
            f"({least:+.3f} to {most:+.3f} s)"
        )
    elif pairs:
        notes.append(
            f"none of {len(pairs)} SYSTEM_TIME messages has UTC: times are right if the recorder's clock was"
        )
    for clock in start_clocks(pairs):
        source = "UTC" if clock.from_utc else "the recorder's stamps"
        notes.append(
            f"clock of {clock.sender >> 8}/{clock.sender & 0xFF} since its start against {source}: {clock.fit}"
        )
    return notes


def header_time(payload: dict[str, object], clock: ClockFit | None) -> int | None:
    """Return the time stated in a message [ns, UTC]; None without one or if the sender's clock is unknown.

    Args:
        payload: Message; ``time_usec`` is UTC if after the year 2000, else time since boot.
        clock: Clock of the sender.
    """
    time_us, boot_ms = payload.get("time_usec"), payload.get("time_boot_ms")
    if isinstance(time_us, int) and UTC_SINCE_US <= time_us <= _MAX_US:
        return time_us * 1000
    if clock is None:
        return None
    if isinstance(boot_ms, int):
        boot_ns = boot_ms * 1_000_000
    elif isinstance(time_us, int) and 0 < time_us < UTC_SINCE_US:
        boot_ns = time_us * 1000
    else:
        return None
    time_ns = int(clock.utc(np.array(boot_ns)))
    return time_ns if time_ns >= 0 else None
