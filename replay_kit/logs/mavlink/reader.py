"""Streaming reader of MAVLink telemetry logs: entries found and checked a block at a time, wanted ones decoded one by one."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import LogReport, Message
from replay_kit.logs.clock import ClockFit, without_spikes
from replay_kit.logs.mavlink.clock import StartClock, SystemTimes, header_time
from replay_kit.logs.mavlink.fields import Unpack, unpacker
from replay_kit.logs.mavlink.frames import Frames, read_frames, scan
from replay_kit.logs.statistics import Tally

_POSITION = "GLOBAL_POSITION_INT"
_first = attrgetter("position")


class _Kind(NamedTuple):
    """Messages of one kind from one sender: how they are called, and how they are decoded; None leaves them."""

    topic: str
    name: str
    unpack: Unpack | None


def is_tlog(head: bytes) -> bool:
    """Return whether a sound entry of a telemetry log is among these first bytes of a file."""
    frames, _ = scan(head, 0, at_end=True)
    return any(message_id in dialect.mavlink_map for message_id in frames.message_id.tolist())


class TlogReader:
    """A telemetry log opened for reading; each call of ``messages`` reads it anew.

    Attributes:
        path: The log.
        format: ``tlog``.
    """

    path: str
    format: str = "tlog"

    def __init__(self, path: Path, input: int = 0, config: LogConfig | None = None, wanted: frozenset[str] | None = None) -> None:
        """Remember what to read; the file is opened by ``messages``.

        Args:
            path: The log.
            input: Position of the log among the run's inputs.
            config: Clock and system. The clock ``publish`` is the recorder's as ``log`` is, ``header`` what a message states: UTC, or the
                time since its sender's start, which is fitted to UTC, or to the recorder's stamps when there is none in the log.
            wanted: Message names to decode; others are counted only. None decodes all.
        """
        config = config or LogConfig()
        self.path = str(path)
        self._input = input
        self._wanted = wanted
        self._by_header = config.clock == "header"
        self._system = config.system
        self._reset()

    def _reset(self) -> None:
        self._tally = Tally()
        self._times = SystemTimes()
        self._clocks: dict[int, list[StartClock]] = {}
        self._positions_of: set[int] = set()
        self._without_stamp = 0
        self._spikes = 0
        self._kinds: dict[int, _Kind] = {}

    def messages(self) -> Iterator[Message]:
        """Yield the wanted messages in the order in which the file holds them.

        ``topic`` is ``mavlink/{system}/{component}/{NAME}``, ``schema`` the message's name, ``position`` the ordinal of the
        frame in the file, unwanted ones counted.

        Raises:
            LogError: The file cannot be read; or only some messages are wanted, and positions of several systems are among them.
        """
        self._reset()
        if self._by_header:
            times = SystemTimes()
            for frames, position, _ in self._read(Tally()):
                times.add(frames, position)
            for clock in times.clocks():
                self._clocks.setdefault(clock.sender, []).append(clock)
        for frames, position, spikes in self._read(self._tally):
            self._spikes += spikes
            self._times.add(frames, position)
            yield from self._decoded(frames, position)

    def report(self) -> LogReport:
        """Return what was met so far."""
        notes = self._times.notes()
        if self._spikes:
            notes = (f"{self._spikes} stamps far from those before and after were replaced by the one after", *notes)
        if len(self._positions_of) > 1:
            notes = (f"positions of several systems; a replay needs one: {self._choose()}", *notes)
        met = sorted({key >> 8 & 0xFF for key in self._kinds})
        if self._system is not None and met and self._system not in met:
            notes = (f"no messages of system {self._system}, which [logs] asks for; it holds those of {', '.join(map(str, met))}", *notes)
        frames = self._tally.read.total()
        unchecked = {"stamps of frames": frames} if frames else {}
        return replace(self._tally.report(self.path, self.format), without_stamp=self._without_stamp, notes=notes, unchecked=unchecked)

    def _read(self, tally: Tally) -> Iterator[tuple[Frames, int, int]]:
        """Yield the entries block by block, the position of the first in the file, and how many stamps were far from their neighbours."""
        position, last_us = 0, None
        try:
            with open(self.path, "rb") as file:
                for frames in read_frames(file, tally):
                    stamp_us, spikes = without_spikes(frames.stamp_us, last_us)
                    yield replace(frames, stamp_us=stamp_us) if spikes else frames, position, spikes
                    position += frames.start.size
                    last_us = int(stamp_us[-1]) if stamp_us.size else last_us
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}; check the file and its permissions") from error

    def _decoded(self, frames: Frames, position: int) -> Iterator[Message]:
        """Yield the wanted messages of a block and count all; the first has this position."""
        keys, kind_of, counts = np.unique(frames.message_id.astype(np.int64) << 16 | frames.sender, return_inverse=True, return_counts=True)
        kinds = [self._kinds.get(key) or self._kinds.setdefault(key, self._kind(key)) for key in keys.tolist()]
        for kind, count in zip(kinds, counts.tolist(), strict=True):
            self._tally.read[kind.topic] += count
            if not kind.name:
                self._tally.undecodable(kind.topic, "its message id is not in the ardupilotmega dialect", count)
        wanted = np.flatnonzero(np.array([kind.unpack is not None for kind in kinds], dtype=np.bool_)[kind_of])
        data, begin = frames.data, frames.payload[wanted]
        columns = (wanted + position, kind_of[wanted], frames.stamp_us[wanted] * 1000, begin, begin + frames.length[wanted])
        for at, which, time_ns, start, end in zip(*(column.tolist() for column in columns), strict=True):
            topic, name, unpack = kinds[which]
            payload = unpack(data[start:end])
            if self._by_header:
                stated = header_time(payload, self._clock(int(keys[which]) & 0xFFFF, at))
                self._without_stamp += stated is None
                time_ns = time_ns if stated is None else stated
            yield Message(time_ns, topic, name, payload, self._input, at)

    def _clock(self, sender: int, position: int) -> ClockFit | None:
        """Return the clock of a sender at a position in the file."""
        clocks = self._clocks.get(sender)
        return clocks[max(bisect_right(clocks, position, key=_first) - 1, 0)].fit if clocks else None

    def _choose(self) -> str:
        return f"set system in [logs] of the configuration to one of {', '.join(map(str, sorted(self._positions_of)))}"

    def _kind(self, key: int) -> _Kind:
        """Return what is known of the messages of one kind from one sender."""
        message_id, system, component = key >> 16, key >> 8 & 0xFF, key & 0xFF
        known = dialect.mavlink_map.get(message_id)
        if known is None:
            return _Kind(f"mavlink/{system}/{component}/UNKNOWN_{message_id}", "", None)
        name: str = known.msgname
        wanted = (self._wanted is None or name in self._wanted) and self._system in (None, system)
        unpack = unpacker(message_id) if wanted else None
        if wanted and name == _POSITION:
            self._positions_of.add(system)
            if self._wanted is not None and len(self._positions_of) > 1:
                raise LogError(f"{self.path}: expected positions of one MAVLink system, it holds those of several; {self._choose()}")
        return _Kind(f"mavlink/{system}/{component}/{name}", name, unpack)


def entries(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the stamp [us] and the frame of each sound entry of a telemetry log, as they stand in it."""
    with open(path, "rb") as file:
        for frames in read_frames(file, Tally()):
            for stamp_us, start, end in zip(frames.stamp_us.tolist(), frames.start.tolist(), frames.end.tolist(), strict=True):
                yield stamp_us, frames.data[start + 8 : end]
