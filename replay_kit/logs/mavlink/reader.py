"""Streaming reader of MAVLink telemetry logs: entries are found and checked by blocks, wanted ones decoded."""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.errors import LogError
from replay_kit.core.message import MAVLINK_FRAMES, LogReport, Message, RawChannel, RawMessage
from replay_kit.logs.blocks import ReadStatistics
from replay_kit.logs.mavlink.clock import StartClock, SystemTimes, header_time
from replay_kit.logs.mavlink.fit import ClockFit, spikes_note, without_spikes
from replay_kit.logs.mavlink.frames import Frames, read_frames
from replay_kit.logs.reader import LogFile

Unpack = Callable[[bytes], dict[str, Any]]


def unpacker(message_id: int) -> Unpack:
    """Return the function that decodes the payload of a message of the dialect.

    Trailing zeros truncated by MAVLink 2 are restored, and fields unknown to the dialect are ignored. Character arrays are text without
    padding.
    """
    message = dialect.mavlink_map[message_id]
    size, unpack, names = (
        message.unpacker.size,
        message.unpacker.unpack_from,
        tuple(message.fieldnames),
    )
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
