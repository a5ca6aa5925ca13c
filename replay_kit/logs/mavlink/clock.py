"""Clocks of a telemetry log from its SYSTEM_TIME messages: each sender's time since boot, and UTC if known.

The recorder's stamps order a replay unless the clock is ``header``. They are compared with UTC, and the senders' clocks are fitted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.logs.mavlink.fit import ClockFit, fit_clock
from replay_kit.logs.mavlink.frames import Frames

MESSAGE_ID = dialect.MAVLINK_MSG_ID_SYSTEM_TIME
#: UTC [microseconds] before the year 2000 is a clock that was never set.
UTC_SINCE_US = 946_684_800_000_000
_MAX_US = (2**63 - 1) // 1000
#: UTC, then the time since start.
_PAYLOAD = np.dtype([("utc_us", "<u8"), ("boot_ms", "<u4")])
#: A clock that goes back by more was started anew [ms].
_RESTART_MS = 1000
_PAIR = np.dtype(
    [
        ("position", "i8"),
        ("sender", "i8"),
        ("start", "i8"),
        ("stamp_us", "i8"),
        ("utc_us", "i8"),
        ("boot_ms", "i8"),
    ]
)


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


class SystemTimes:
    """SYSTEM_TIME messages of a log, 48 bytes each."""

    def __init__(self) -> None:
        self._kept: list[NDArray[np.void]] = []
        self._starts: dict[int, tuple[int, int]] = {}

    def add(self, frames: Frames, position: int) -> None:
        """Add a block of entries; ``position`` is that of the first in the file."""
        places = np.flatnonzero(frames.message_id == MESSAGE_ID)
        if not places.size:
            return
        payload = sliding_window_view(
            np.frombuffer(frames.data, dtype=np.uint8), _PAYLOAD.itemsize
        )[frames.payload[places]]
        # MAVLink 2 cuts zeros at the end
        payload[np.arange(_PAYLOAD.itemsize) >= frames.length[places, None]] = 0
        stated = payload.view(_PAYLOAD)[:, 0]
        pairs = np.zeros(places.size, dtype=_PAIR)
        pairs["position"], pairs["sender"] = places + position, frames.sender[places]
        pairs["stamp_us"], pairs["boot_ms"] = frames.stamp_us[places], stated["boot_ms"]
        pairs["utc_us"] = np.minimum(stated["utc_us"], _MAX_US)
        for sender in np.unique(pairs["sender"]).tolist():
            self._count_starts(pairs, sender)
        self._kept.append(pairs)

    def clocks(self) -> list[StartClock]:
        """Return the clock of each sender after each boot, in file order."""
        found = []
        pairs = self._pairs()
        for sender, start in np.unique(pairs[["sender", "start"]]).tolist():
            own = pairs[
                (pairs["sender"] == sender) & (pairs["start"] == start) & (pairs["boot_ms"] > 0)
            ]
            if own.size:
                timed = own[own["utc_us"] >= UTC_SINCE_US]
                used, utc = (timed, "utc_us") if timed.size else (own, "stamp_us")
                fit = fit_clock(used["boot_ms"] * 1_000_000, used[utc] * 1000)
                found.append(StartClock(sender, int(own["position"][0]), fit, bool(timed.size)))
        return sorted(found, key=lambda clock: clock.position)

    def notes(self) -> tuple[str, ...]:
        """Return notes on the recorder's stamps against UTC, and on the fit of each clock."""
        pairs = self._pairs()
        timed = pairs[pairs["utc_us"] >= UTC_SINCE_US]
        notes = []
        if timed.size:
            late = (timed["stamp_us"] - timed["utc_us"]) * 1e-6
            notes.append(
                f"the recorder's stamps are {np.median(late):+.3f} s from UTC by {timed.size} of {pairs.size} SYSTEM_TIME messages "
                f"({late.min():+.3f} to {late.max():+.3f} s)"
            )
        elif pairs.size:
            notes.append(
                f"none of {pairs.size} SYSTEM_TIME messages has UTC: times are right if the recorder's clock was"
            )
        for clock in self.clocks():
            source = "UTC" if clock.from_utc else "the recorder's stamps"
            notes.append(
                f"clock of {clock.sender >> 8}/{clock.sender & 0xFF} since its start against {source}: {clock.fit}"
            )
        return tuple(notes)

    def _pairs(self) -> NDArray[np.void]:
        return np.concatenate(self._kept) if self._kept else np.zeros(0, dtype=_PAIR)

    def _count_starts(self, pairs: NDArray[np.void], sender: int) -> None:
        """Number the boots of one sender in its pairs."""
        own = np.flatnonzero(pairs["sender"] == sender)
        start, last_ms = self._starts.get(sender, (0, 0))
        boot_ms = pairs["boot_ms"][own]
        numbers = start + np.cumsum(np.diff(boot_ms, prepend=last_ms) < -_RESTART_MS)
        pairs["start"][own] = numbers
        self._starts[sender] = int(numbers[-1]), int(boot_ms[-1])


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
