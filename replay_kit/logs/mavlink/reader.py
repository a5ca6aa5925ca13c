"""Streaming reader of MAVLink telemetry logs: entries are found and checked by blocks, wanted ones decoded.

The recorder's stamps order a replay unless the clock is ``header``. They are compared with UTC, and the senders' clocks, times since boot
in SYSTEM_TIME messages, are fitted.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.errors import LogError
from replay_kit.core.message import MAVLINK_FRAMES, LogReport, Message, RawChannel, RawMessage
from replay_kit.logs.blocks import ReadStatistics
from replay_kit.logs.mavlink.fit import ClockFit, fit_clock, spikes_note, without_spikes
from replay_kit.logs.mavlink.frames import Frames, read_frames
from replay_kit.logs.reader import LogFile

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
            of_start = pairs[
                (pairs["sender"] == sender) & (pairs["start"] == start) & (pairs["boot_ms"] > 0)
            ]
            if of_start.size:
                timed = of_start[of_start["utc_us"] >= UTC_SINCE_US]
                used, utc = (timed, "utc_us") if timed.size else (of_start, "stamp_us")
                fit = fit_clock(used["boot_ms"] * 1_000_000, used[utc] * 1000)
                found.append(
                    StartClock(sender, int(of_start["position"][0]), fit, bool(timed.size))
                )
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
        of_sender = np.flatnonzero(pairs["sender"] == sender)
        start, last_ms = self._starts.get(sender, (0, 0))
        boot_ms = pairs["boot_ms"][of_sender]
        numbers = start + np.cumsum(np.diff(boot_ms, prepend=last_ms) < -_RESTART_MS)
        pairs["start"][of_sender] = numbers
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


Unpack = Callable[[bytes], dict[str, Any]]


def unpacker(message_id: int) -> Unpack:
    """Return the function that decodes the payload of a message of the dialect.

    Trailing zeros truncated by MAVLink 2 are restored, and fields unknown to the dialect are ignored. Character arrays are text without
    padding.
    """
    message = dialect.mavlink_map[message_id]
    size = message.unpacker.size
    unpack = message.unpacker.unpack_from
    names = tuple(message.fieldnames)
    # on the wire the fields have another order; an array is several values, a text is one
    ends = [sum(message.lengths[: place + 1]) for place in range(len(names))]
    wire = [
        slice(end - n, end) if n > 1 else end - 1
        for n, end in zip(message.lengths, ends, strict=True)
    ]
    # one place more, as of a single one there is no tuple
    ordered = itemgetter(*(wire[order] for order in message.orders), 0)
    special = [
        name
        for name, kind, order in zip(names, message.fieldtypes, message.orders, strict=True)
        if kind == "char" or message.lengths[order] > 1
    ]

    def fields(payload: bytes) -> dict[str, Any]:
        values = unpack(payload if len(payload) >= size else payload.ljust(size, b"\0"))
        found = dict(zip(names, ordered(values), strict=False))
        for name in special:
            found[name] = _value(found[name])
        return found

    return fields


def _value(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.split(b"\0", 1)[0].decode("ascii", errors="replace")
    return list(value) if isinstance(value, tuple) else value


_FRAMES_TOPIC = "mavlink/frames"
_POSITION = "GLOBAL_POSITION_INT"
_first = attrgetter("position")


class _Kind(NamedTuple):
    """Messages of one kind from one sender: topic, name and decoder; None leaves them undecoded."""

    topic: str
    name: str
    unpack: Unpack | None


class TlogReader(LogFile):
    """Reader of a telemetry log.

    The clocks ``log`` and ``publish`` are the recorder's; ``header`` is the time stated in a message: UTC, or the time since boot, fitted
    to UTC or, in a log without UTC, to the recorder's stamps.
    """

    format = "tlog"
    has_own_frames = True

    def _prepare(self) -> None:
        self._system = self._config.system
        self.statistics = ReadStatistics()
        self._times = SystemTimes()
        self._clocks: dict[int, list[StartClock]] = {}
        self._positions_of: set[int] = set()
        self._spikes = 0
        self._kinds: dict[int, _Kind] = {}

    def messages(self) -> Iterator[Message]:
        """Yield the wanted messages in file order.

        ``topic`` is ``mavlink/{system}/{component}/{NAME}``, ``schema`` the message name, ``position`` the ordinal among all frames of the
        file.

        Raises:
            LogError: The file cannot be read; or only some messages are wanted and several systems send positions.
        """
        self._prepare()
        if self._clock == "header":
            times = SystemTimes()
            for frames, position, _ in self._read(ReadStatistics()):
                times.add(frames, position)
            for clock in times.clocks():
                self._clocks.setdefault(clock.sender, []).append(clock)
        for frames, position, spikes in self._read(self.statistics):
            self._spikes += spikes
            self._times.add(frames, position)
            yield from self._decoded(frames, position)

    def frames(self) -> Iterator[RawMessage]:
        """Yield the raw entries on the topic ``mavlink/frames``, or ``mavlink/frames/{input}`` after the first log."""
        topic = _FRAMES_TOPIC if self.input == 0 else f"{_FRAMES_TOPIC}/{self.input}"
        channel = RawChannel(0, topic, MAVLINK_FRAMES, (), None)
        position = 0
        with self._opened() as file:
            for frames in read_frames(file, ReadStatistics()):
                columns = (frames.stamp_us * 1000, frames.start + 8, frames.end)
                for time_ns, start, end in zip(
                    *(column.tolist() for column in columns), strict=True
                ):
                    data = frames.data[start:end]
                    yield RawMessage(
                        time_ns,
                        self.input,
                        position,
                        channel,
                        position % 2**32,
                        time_ns,
                        time_ns,
                        data,
                    )
                    position += 1

    def report(self) -> LogReport:
        """Return the report on the entries read so far."""
        notes = self._times.notes()
        if self._spikes:
            notes = (spikes_note(self._spikes), *notes)
        if len(self._positions_of) > 1:
            notes = (f"positions of several systems; a replay needs one: {self._choose()}", *notes)
        found = sorted({key >> 8 & 0xFF for key in self._kinds})
        if self._system is not None and found and self._system not in found:
            notes = (
                f"no messages of system {self._system}, which [logs] chooses; it holds those of {', '.join(map(str, found))}",
                *notes,
            )
        return replace(super().report(), notes=notes)

    def _read(self, statistics: ReadStatistics) -> Iterator[tuple[Frames, int, int]]:
        """Yield blocks of entries, the position of the first in the file, and the number of outlier stamps."""
        position, last_us = 0, None
        with self._opened() as file:
            for frames in read_frames(file, statistics):
                stamp_us, spikes = without_spikes(frames.stamp_us, last_us)
                yield frames._replace(stamp_us=stamp_us), position, spikes
                position += frames.start.size
                last_us = int(stamp_us[-1]) if stamp_us.size else last_us

    def _decoded(self, frames: Frames, position: int) -> Iterator[Message]:
        """Yield the wanted messages of a block and count all; ``position`` is that of the first."""
        keys, kind_of, counts = np.unique(
            frames.message_id.astype(np.int64) << 16 | frames.sender,
            return_inverse=True,
            return_counts=True,
        )
        kinds = [
            self._kinds.get(key) or self._kinds.setdefault(key, self._kind(key))
            for key in keys.tolist()
        ]
        for kind, count in zip(kinds, counts.tolist(), strict=True):
            self.statistics.read[kind.topic] += count
            if not kind.name:
                self.statistics.undecodable(
                    kind.topic, "its message id is not in the ardupilotmega dialect", count
                )
        wanted = np.flatnonzero(
            np.array([kind.unpack is not None for kind in kinds], dtype=np.bool_)[kind_of]
        )
        data, begin = frames.data, frames.payload[wanted]
        columns = (
            wanted + position,
            kind_of[wanted],
            frames.stamp_us[wanted] * 1000,
            begin,
            begin + frames.length[wanted],
        )
        for at, which, time_ns, start, end in zip(
            *(column.tolist() for column in columns), strict=True
        ):
            topic, name, unpack = kinds[which]
            payload = unpack(data[start:end])
            if self._clock == "header":
                stated = header_time(payload, self._fitted_clock(int(keys[which]) & 0xFFFF, at))
                self.statistics.without_stamp += stated is None
                time_ns = time_ns if stated is None else stated
            yield Message(time_ns, topic, name, payload, self.input, at)

    def _fitted_clock(self, sender: int, position: int) -> ClockFit | None:
        """Return the clock of a sender at a position in the file."""
        clocks = self._clocks.get(sender)
        return (
            clocks[max(bisect_right(clocks, position, key=_first) - 1, 0)].fit if clocks else None
        )

    def _choose(self) -> str:
        return f"set system in [logs] to one of {', '.join(map(str, sorted(self._positions_of)))}"

    def _kind(self, key: int) -> _Kind:
        """Return topic, name and decoder of the messages of one kind from one sender."""
        message_id, system, component = key >> 16, key >> 8 & 0xFF, key & 0xFF
        known = dialect.mavlink_map.get(message_id)
        if known is None:
            return _Kind(
                self._topic(f"mavlink/{system}/{component}/UNKNOWN_{message_id}"), "", None
            )
        name: str = known.msgname
        wanted = (self._wanted is None or name in self._wanted) and self._system in (None, system)
        unpack = unpacker(message_id) if wanted else None
        if wanted and name == _POSITION:
            self._positions_of.add(system)
            if self._wanted is not None and len(self._positions_of) > 1:
                raise LogError(
                    f"{self.path}: expected positions of one MAVLink system, it holds those of several; {self._choose()}"
                )
        return _Kind(self._topic(f"mavlink/{system}/{component}/{name}"), name, unpack)
