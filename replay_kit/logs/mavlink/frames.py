"""Entries of a MAVLink telemetry log, found and checked by blocks.

An entry is eight bytes of microseconds, big-endian, then one MAVLink 1 or 2 frame. Only the frame's checksum validates an entry: every
candidate is checked, and the next entry is the first valid one after the end of the last.
"""

import re
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.arrays import Mask
from replay_kit.logs.blocks import Indices, ReadStatistics, chain, gaps

#: Read at once [bytes]: large enough for arrays to be efficient; noise can look like an entry of 280 bytes at every second byte.
BLOCK = 1 << 20
_V1, _V2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
_SIGNED = dialect.MAVLINK_IFLAG_SIGNED
_SIGNATURE = 13
#: Stamp, shortest header, checksum [bytes].
_SHORTEST = 8 + 6 + 2
#: Stamp, longest header, longest payload, checksum, signature [bytes].
_LONGEST = 8 + 10 + 255 + 2 + _SIGNATURE
#: Beyond an entry, to see whether another follows: stamp and marker [bytes].
_BEYOND = 9
#: Microseconds that fit int64 nanoseconds; later stamps are no stamps. Their first byte is 0, their second at most 0x20.
_MAX_STAMP_US = (2**63 - 1) // 1000
_ENTRY = re.compile(rb"\x00[\x00-\x20].{6}[\xfd\xfe]", re.DOTALL)
_UNKNOWN = 256
#: Checksum byte of each message id; the last element is for all ids beyond the known ones.
_EXTRA = np.full(max(dialect.mavlink_map) + 2, _UNKNOWN, dtype=np.uint16)
for _id, _message in dialect.mavlink_map.items():
    _EXTRA[_id] = _message.crc_extra


class Frames(NamedTuple):
    """Entries of one block with valid checksums, or of unknown messages followed by another entry.

    Attributes:
        data: Block with padding.
        offset: Offset of the block in the file.
        start: Start of each entry in the block, shape (n,).
        end: End of each entry.
        payload: Start of each payload.
        length: Length of each payload [bytes].
        stamp_us: Recorder's stamp [microseconds].
        sender: 256 times the system number plus the component number.
        message_id: MAVLink message number.
    """

    data: bytes
    offset: int
    start: Indices
    end: Indices
    payload: Indices
    length: Indices
    stamp_us: Indices
    sender: Indices
    message_id: Indices

    def take(self, which: Indices | Mask) -> "Frames":
        """Return a subset of the entries."""
        data, offset, *columns = self
        return Frames(data, offset, *(column[which] for column in columns))


def is_tlog(head: bytes) -> bool:
    """Return whether the first bytes of a file contain a valid entry of a telemetry log."""
    frames, _ = scan(head, 0, at_end=True)
    return any(message_id in dialect.mavlink_map for message_id in frames.message_id.tolist())


def read_frames(file: BinaryIO, statistics: ReadStatistics) -> Iterator[Frames]:
    """Yield the valid entries by blocks; bytes between them and a truncated last entry are losses."""
    data, offset, sound_end, at_end = b"", 0, 0, False
    while not at_end:
        block = file.read(BLOCK)
        at_end = not block
        data += block
        frames, used = scan(data, offset, at_end)
        gap = "bad bytes between two valid frames, skipped"
        for loss in gaps(gap, sound_end, frames.start + offset, frames.end + offset):
            statistics.lose(loss.what, loss.offset, loss.bytes)
        sound_end = offset + int(frames.end[-1]) if frames.end.size else sound_end
        yield frames
        data, offset = data[used:], offset + used
    if offset > sound_end:
        statistics.lose(
            "at the end: a truncated frame or bad bytes, skipped", sound_end, offset - sound_end
        )


def scan(data: bytes, offset: int, at_end: bool) -> tuple[Frames, int]:
    """Return the valid entries of part of a log, and the number of bytes that are finished.

    Args:
        data: Part of the log, from an entry or from bytes to be searched.
        offset: Offset of the part in the file.
        at_end: Whether the log ends with it; otherwise incomplete entries are left for the next part.
    """
    size = len(data)
    searched = size if at_end else max(size - _LONGEST - _BEYOND, 0)
    frames = _candidates(data + bytes(_LONGEST), offset, size, searched)
    frames = frames.take(_sound(frames, size, at_end))
    frames = frames.take(chain(frames.start, frames.end))
    return frames, max(int(frames.end[-1]) if frames.start.size else 0, searched)


def _candidates(data: bytes, offset: int, size: int, searched: int) -> Frames:
    """Return the candidates: every offset at which a whole entry may begin.

    Args:
        data: Block with padding for reading beyond its end.
        offset: Offset of the block in the file.
        size: Size of the block [bytes].
        searched: End of the search in the block.
    """
    view = np.frombuffer(data, dtype=np.uint8)
    start = np.flatnonzero(view[8 : min(searched, max(size - _SHORTEST + 1, 0)) + 8] >= _V2)
    start = start[view.take(start) == 0]
    start = start[(view.take(start + 1) <= 0x20) & (view.take(start + 8) <= _V1)]
    head = sliding_window_view(view, 18)[start]
    second = head[:, 8] == _V2
    length = head[:, 9].astype(np.int64)
    flags = np.where(second, head[:, 10], 0)
    payload = start + np.where(second, 18, 14)
    end = payload + length + 2 + _SIGNATURE * (flags == _SIGNED)
    ids = head[:, 11:].astype(np.int32)
    sender = np.where(second, ids[:, 2] << 8 | ids[:, 3], ids[:, 0] << 8 | ids[:, 1])
    message_id = np.where(second, ids[:, 4] | ids[:, 5] << 8 | ids[:, 6] << 16, ids[:, 2])
    stamp_us = np.ascontiguousarray(head[:, :8]).view(">u8")[:, 0].astype(np.int64)
    frames = Frames(data, offset, start, end, payload, length, stamp_us, sender, message_id)
    return frames.take((flags <= _SIGNED) & (end <= size) & (stamp_us <= _MAX_STAMP_US))


def _sound(frames: Frames, size: int, at_end: bool) -> Mask:
    """Return the mask of valid entries: the checksum matches, or another candidate follows an unknown message."""
    view = np.frombuffer(frames.data, dtype=np.uint8)
    check = frames.payload + frames.length
    stated = view[check].astype(np.uint16) | view[check + 1].astype(np.uint16) << 8
    extra = _EXTRA[np.minimum(frames.message_id, _EXTRA.size - 1)]
    sound: Mask = checksums(view, frames.start + 9, check, extra) == stated
    for at in np.flatnonzero(extra == _UNKNOWN).tolist():
        end = int(frames.end[at])
        sound[at] = at_end if end == size else _ENTRY.match(frames.data, end, size) is not None
    return sound


_REVERSED = 0x8408
#: Frames are processed together when their lengths differ by fewer words.
_WORDS = 16
PADDING = 2 * _WORDS


def checksums(
    data: NDArray[np.uint8], start: Indices, end: Indices, extra: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """Return the checksums of parts of the data, each with one more byte, shape (n,).

    Args:
        data: The bytes, and ``PADDING`` more of any value after the last part.
        start: Start of each part, shape (n,).
        end: End of each part.
        extra: Additional byte of each.
    """
    words = (end - start) // 2
    longest_first = np.argsort(words.astype(np.uint16), kind="stable")[::-1]
    words, first = words[longest_first], start[longest_first]
    register = np.full(start.size, 0xFFFF, dtype=np.uint16)
    edges = np.flatnonzero(np.diff(-(-words // _WORDS), prepend=-1, append=-1))
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        most = int(words[low])
        if most == 0:
            continue
        # one row a word, one column a part; parts without such a word come last
        rows = np.ascontiguousarray(
            sliding_window_view(data, 2 * most)[first[low:high]].view("<u2").T
        )
        having = high - np.searchsorted(words[low:high][::-1], np.arange(most), side="right")
        for row, stop in zip(rows, having.tolist(), strict=True):
            register[low:stop] = _TWO_BYTES.take(register[low:stop] ^ row[: stop - low])
    crc = np.empty_like(register)
    crc[longest_first] = register
    odd = np.flatnonzero((end - start) % 2)
    crc[odd] = _with_byte(crc[odd], data[end[odd] - 1])
    return _with_byte(crc, extra)


def _with_byte(
    register: NDArray[np.uint16], byte: NDArray[np.uint8] | NDArray[np.uint16]
) -> NDArray[np.uint16]:
    return (register >> np.uint16(8)) ^ _ONE_BYTE.take((register ^ byte) & 0xFF)


def _after_bits(bits: int) -> NDArray[np.uint16]:
    """Return each register value, shape (2**bits,), after ``bits`` shifts."""
    register = np.arange(1 << bits, dtype=np.uint16)
    for _ in range(bits):
        register = (register >> np.uint16(1)) ^ (register & np.uint16(1)) * np.uint16(_REVERSED)
    return register


# The register is as wide as a word: its value after sixteen bits depends on its sum with the word alone.
_ONE_BYTE = _after_bits(8)
_TWO_BYTES = _after_bits(16)
