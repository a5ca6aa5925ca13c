"""Streaming reader of MAVLink telemetry logs: frames scanned here, checked and decoded by pymavlink.

A log is a row of entries: eight bytes of microseconds, big-endian, then one MAVLink 1 or 2 frame. Nothing but the frame's own
checksum says that an entry is sound, so after bad bytes the scan goes on byte by byte until the next entry that passes.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config import LogConfig
from replay_kit.errors import LogError
from replay_kit.logs.tally import Tally
from replay_kit.types import LogReport, Message

_STAMP = struct.Struct(">Q")
_V1, _V2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
_SIGNED = dialect.MAVLINK_IFLAG_SIGNED
_BLOCK = 1 << 20
#: Stamp, longest header, longest payload, checksum, signature [bytes].
_LONGEST = 8 + 10 + 255 + 2 + 13
#: Microseconds that fit int64 nanoseconds; later stamps are no stamps. Their first byte is 0, their second at most 0x20.
_MAX_STAMP_US = (2**63 - 1) // 1000
_CANDIDATE = re.compile(rb"\x00[\x00-\x20].{6}[\xfd\xfe]", re.DOTALL)


class _Frame(NamedTuple):
    """One entry of the log whose frame passed its checksum, or whose message is unknown and followed by another entry."""

    start: int
    end: int
    stamp_us: int
    message_id: int
    system: int
    component: int


def is_tlog(head: bytes) -> bool:
    """Return whether a sound entry of a telemetry log is among these first bytes of a file."""
    start = 0
    while match := _CANDIDATE.search(head, start):
        frame = _frame_at(head, match.start(), at_end=False)
        if frame is not None and frame.message_id in dialect.mavlink_map:
            return True
        start = match.start() + 1
    return False


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

    def messages(self) -> Iterator[Message]:
        """Yield the wanted messages in the order in which the file holds them.

        ``topic`` is ``mavlink/{system}/{component}/{NAME}``, ``schema`` the message's name, ``position`` the ordinal of the
        frame in the file, unwanted ones counted.

        Raises:
            LogError: The file cannot be read.
        """
        self._tally = Tally()
        decoder = dialect.MAVLink(None)
        topics: dict[tuple[int, int, int], tuple[str, str, bool]] = {}
        position = -1
        try:
            with open(self.path, "rb") as file:
                for frame, entry in _frames(file, self._tally):
                    position += 1
                    key = (frame.system, frame.component, frame.message_id)
                    topic, name, decoded = topics.get(key) or topics.setdefault(key, self._topic(key))
                    self._tally.read[topic] += 1
                    if not decoded:
                        if not name:
                            self._tally.undecodable(topic, f"message id {frame.message_id} is not in the ardupilotmega dialect")
                        continue
                    try:
                        payload = _payload(decoder.decode(bytearray(entry[8:])))
                    except dialect.MAVError as error:
                        self._tally.undecodable(topic, str(error))
                        continue
                    yield Message(frame.stamp_us * 1000, topic, name, payload, self._input, position)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}; check the file and its permissions") from error

    def report(self) -> LogReport:
        """Return what was met so far."""
        frames = self._tally.read.total()
        return replace(self._tally.report(self.path, self.format), unchecked={"stamps of frames": frames} if frames else {})

    def _topic(self, key: tuple[int, int, int]) -> tuple[str, str, bool]:
        """Return (topic, name, whether to decode) of the messages of one sender; the name is empty when it is unknown."""
        system, component, message_id = key
        known = dialect.mavlink_map.get(message_id)
        if known is None:
            return f"mavlink/{system}/{component}/UNKNOWN_{message_id}", "", False
        name: str = known.msgname
        return f"mavlink/{system}/{component}/{name}", name, self._wanted is None or name in self._wanted


def entries(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the stamp [us] and the frame of each sound entry of a telemetry log, as they stand in it."""
    with open(path, "rb") as file:
        for frame, entry in _frames(file, Tally()):
            yield frame.stamp_us, entry[8:]


def _payload(message: Any) -> dict[str, Any]:
    """Return a message's fields; character arrays as text without the padding."""
    fields = {}
    for name in message.fieldnames:
        value = getattr(message, name)
        fields[name] = value.decode(errors="backslashreplace").rstrip("\x00") if isinstance(value, bytes) else value
    return fields


def _frames(file: BinaryIO, tally: Tally) -> Iterator[tuple[_Frame, bytes]]:
    """Yield each sound entry with its bytes; bad bytes between two of them, and a cut last entry, are losses."""
    buffer, base, position, bad = b"", 0, 0, -1
    at_end = False
    while True:
        if not at_end and len(buffer) - position < 2 * _LONGEST:
            block = file.read(_BLOCK)
            at_end = not block
            buffer, base, position = buffer[position:] + block, base + position, 0
            continue
        if position >= len(buffer):
            break
        frame = _frame_at(buffer, position, at_end)
        if frame is not None:
            if bad >= 0:
                _lose(tally, bad, base + position)
                bad = -1
            yield frame, buffer[position : frame.end]
            position = frame.end
            continue
        if bad < 0:
            bad = base + position
        match = _CANDIDATE.search(buffer, position + 1)
        # Without a candidate the last bytes are kept: the next block may complete one.
        position = match.start() if match else len(buffer) if at_end else max(position + 1, len(buffer) - 2 * _LONGEST + 1)
    if bad >= 0:
        _lose(tally, bad, base + len(buffer), last=True)


def _lose(tally: Tally, start: int, end: int, last: bool = False) -> None:
    where = "at the end: a cut frame or bad bytes" if last else "bad bytes between two sound frames"
    tally.lose(f"{where}, skipped", start, end - start)


def _frame_at(buffer: bytes, start: int, at_end: bool) -> _Frame | None:
    """Return the entry that begins here; None when none does.

    Args:
        buffer: Part of the log.
        start: Where the entry's stamp begins.
        at_end: Whether the log ends with the buffer.
    """
    body = start + 8
    if len(buffer) < body + 8:
        return None
    magic = buffer[body]
    if magic == _V2:
        flags = buffer[body + 2]
        if flags & ~_SIGNED or len(buffer) < body + 12:
            return None
        header, signature = 10, 13 if flags & _SIGNED else 0
        system, component = buffer[body + 5], buffer[body + 6]
        message_id = buffer[body + 7] | buffer[body + 8] << 8 | buffer[body + 9] << 16
    elif magic == _V1:
        header, signature = 6, 0
        system, component, message_id = buffer[body + 3], buffer[body + 4], buffer[body + 5]
    else:
        return None
    check = body + header + buffer[body + 1]
    end = check + 2 + signature
    (stamp_us,) = _STAMP.unpack_from(buffer, start)
    if end > len(buffer) or stamp_us > _MAX_STAMP_US:
        return None
    known = dialect.mavlink_map.get(message_id)
    if known is None:
        sound = _entry_follows(buffer, end, at_end)
    else:
        crc = dialect.x25crc(buffer[body + 1 : check] + bytes((known.crc_extra,))).crc
        sound = crc == buffer[check] | buffer[check + 1] << 8
    return _Frame(start, end, stamp_us, message_id, system, component) if sound else None


def _entry_follows(buffer: bytes, end: int, at_end: bool) -> bool:
    """Return whether another entry seems to begin here: the checksum of an unknown message cannot be verified."""
    if end == len(buffer):
        return at_end
    return _CANDIDATE.match(buffer, end) is not None
