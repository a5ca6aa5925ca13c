"""Streaming reader of MAVLink telemetry logs: entries found and checked a block at a time, wanted ones decoded one by one."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config import LogConfig
from replay_kit.errors import LogError
from replay_kit.logs.mavlink_fields import Unpack, unpacker
from replay_kit.logs.mavlink_frames import Frames, read_frames, scan
from replay_kit.logs.tally import Tally
from replay_kit.types import LogReport, Message


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
            config: Taken for the sake of one signature; a telemetry log has one clock, the recorder's.
            wanted: Message names to decode; others are counted only. None decodes all.
        """
        del config
        self.path = str(path)
        self._input = input
        self._wanted = wanted
        self._tally = Tally()
        self._kinds: dict[int, _Kind] = {}

    def messages(self) -> Iterator[Message]:
        """Yield the wanted messages in the order in which the file holds them.

        ``topic`` is ``mavlink/{system}/{component}/{NAME}``, ``schema`` the message's name, ``position`` the ordinal of the
        frame in the file, unwanted ones counted.

        Raises:
            LogError: The file cannot be read.
        """
        self._tally = Tally()
        position = 0
        try:
            with open(self.path, "rb") as file:
                for frames in read_frames(file, self._tally):
                    yield from self._decoded(frames, position)
                    position += frames.start.size
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}; check the file and its permissions") from error

    def report(self) -> LogReport:
        """Return what was met so far."""
        frames = self._tally.read.total()
        return replace(self._tally.report(self.path, self.format), unchecked={"stamps of frames": frames} if frames else {})

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
            yield Message(time_ns, topic, name, unpack(data[start:end]), self._input, at)

    def _kind(self, key: int) -> _Kind:
        """Return what is known of the messages of one kind from one sender."""
        message_id, system, component = key >> 16, key >> 8 & 0xFF, key & 0xFF
        known = dialect.mavlink_map.get(message_id)
        if known is None:
            return _Kind(f"mavlink/{system}/{component}/UNKNOWN_{message_id}", "", None)
        name: str = known.msgname
        unpack = unpacker(message_id) if self._wanted is None or name in self._wanted else None
        return _Kind(f"mavlink/{system}/{component}/{name}", name, unpack)


def entries(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the stamp [us] and the frame of each sound entry of a telemetry log, as they stand in it."""
    with open(path, "rb") as file:
        for frames in read_frames(file, Tally()):
            for stamp_us, start, end in zip(frames.stamp_us.tolist(), frames.start.tolist(), frames.end.tolist(), strict=True):
                yield stamp_us, frames.data[start + 8 : end]
