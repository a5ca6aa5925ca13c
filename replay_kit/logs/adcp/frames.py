"""Records of raw ADCP files, found by their checksums; bytes between them are losses.

Sources: Teledyne RD Instruments, "WorkHorse Commands and Output Data Format", PD0 header and checksum; Nortek, "Integrators Guide, AD2CP"
(N3015-007), common header and checksum.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from replay_kit.core.message import Loss
from replay_kit.logs.blocks import gaps

PD0_MAGIC = b"\x7f\x7f"
AD2CP_MAGICS = (b"\xa5\x0a", b"\xa5\x0c")
AD2CP_TEXT = 0xA0
_CHECKSUM_SEED = 0xB58C
_FIXED_LEADERS = (0x0000, 0x0001)


class Record(NamedTuple):
    """Record with valid checksums.

    Attributes:
        start: Offset of its first byte.
        end: Offset after its last byte.
        kind: Nortek's record identifier; 0 for a PD0 ensemble, the second byte of another packet of Teledyne.
    """

    start: int
    end: int
    kind: int


#: Returns end and kind of the record at an offset; None without a valid one.
_Found = Callable[[int], tuple[int, int] | None]


def holds_ensemble(head: bytes) -> bool:
    """Return whether the first bytes of a file contain a valid PD0 ensemble, possibly after other packets or bytes."""
    return PD0_MAGIC in head and any(record.kind == 0 for record in scan(head))


def scan(data: bytes) -> tuple[Record, ...]:
    """Return the valid records of a file.

    Args:
        data: The whole file; without Nortek's magic byte it is read as PD0 ensembles with other packets between them.
    """
    sums = _Sums(data)
    if data[:2] in AD2CP_MAGICS:
        return tuple(_walk(data, AD2CP_MAGICS[0][:1], lambda at: _ad2cp(data, sums, at)))
    ensembles = [*_walk(data, PD0_MAGIC, lambda at: _pd0(data, sums, at))]
    edges = [(0, 0), *((one.start, one.end) for one in ensembles), (len(data), len(data))]
    packets = [
        packet
        for (_, begin), (stop, _) in pairwise(edges)
        for packet in _walk(data, PD0_MAGIC[:1], lambda at: _packet(data, sums, at), begin, stop)
    ]
    return tuple(sorted(ensembles + packets))


def _walk(
    data: bytes, magic: bytes, found_at: _Found, begin: int = 0, stop: int | None = None
) -> Iterator[Record]:
    """Yield the valid records of a part of a file; each search begins at the end of a record."""
    end = len(data) if stop is None else stop
    at = data.find(magic, begin, end)
    while at >= 0:
        after, found = at + 1, found_at(at)
        if found is not None and found[0] <= end:
            yield Record(at, *found)
            after = found[0]
        at = data.find(magic, after, end)


def losses_between(records: Sequence[Record], size: int) -> list[Loss]:
    """Return the bytes outside valid records as losses.

    Args:
        records: Result of ``scan``.
        size: Size of the file [bytes].
    """
    start, end, _ = np.array(records, np.int64).reshape(-1, 3).T
    lost = gaps("bad bytes between two valid records, skipped", 0, start, end)
    last = int(end[-1]) if end.size else 0
    rest = Loss("at the end: a truncated record or bad bytes, skipped", last, size - last)
    return lost + [rest] * (last < size)


def _pd0(data: bytes, sums: "_Sums", at: int) -> tuple[int, int] | None:
    """Return the end and kind of the ensemble at an offset: its length, number and offsets of data types, leader, sum."""
    if at + 8 > len(data):
        return None
    size, _, n_types, first = struct.unpack_from("<HBBH", data, at + 2)
    check = at + size
    if not n_types or first != 6 + 2 * n_types or size < first + 2 or check + 2 > len(data):
        return None
    leader, stated = (struct.unpack_from("<H", data, place)[0] for place in (at + first, check))
    return (
        (check + 2, 0) if leader in _FIXED_LEADERS and sums.of_bytes(at, check) == stated else None
    )


def _packet(data: bytes, sums: "_Sums", at: int) -> tuple[int, int] | None:
    """Return the end and kind of a packet of another kind: two bytes of kind, size, contents, checksum."""
    if at + 4 > len(data) or data[at + 1] == PD0_MAGIC[1]:
        return None
    check = at + struct.unpack_from("<H", data, at + 2)[0]
    if check < at + 4 or check + 2 > len(data):
        return None
    return (
        (check + 2, data[at + 1])
        if sums.of_bytes(at, check) == int.from_bytes(data[check : check + 2], "little")
        else None
    )


def _ad2cp(data: bytes, sums: "_Sums", at: int) -> tuple[int, int] | None:
    """Return the end and kind of Nortek's record at an offset; a header of the long kind has a size of four bytes."""
    form = {AD2CP_MAGICS[0]: "<HHH", AD2CP_MAGICS[1]: "<IHH"}.get(data[at : at + 2], "")
    body = at + 4 + struct.calcsize(form)
    if not form or body > len(data):
        return None
    size, data_check, header_check = struct.unpack_from(form, data, at + 4)
    # where the content is damaged, bytes may be missing in it, and the next record begins before the header says
    fits = (
        body + size <= len(data)
        and sums.of_words(at, body - 2) == header_check
        and sums.of_words(body, body + size) == data_check
    )
    return (body + size, data[at + 2]) if fits else None


class _Sums:
    """Sums of byte ranges modulo 2^16 from sums since the file's beginning, as each magic byte without a record may claim 65 kB."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        values = np.frombuffer(data, np.uint8)
        even = values.copy()
        even[1::2] = 0
        self._all, self._even = (np.cumsum(part, dtype=np.uint16) for part in (values, even))

    def of_bytes(self, start: int, end: int) -> int:
        """Return the sum of the bytes of a part."""
        return self._between(self._all, start, end)

    def of_words(self, start: int, end: int) -> int:
        """Return Nortek's checksum of a part: of its 16-bit words; a last single byte is the high one of its word."""
        every, even = (self._between(sums, start, end) for sums in (self._all, self._even))
        low = even if start % 2 == 0 else every - even
        last = self._data[end - 1] if (end - start) % 2 else 0
        return (_CHECKSUM_SEED + low + 256 * (every - low) + 255 * last) & 0xFFFF

    def _between(self, sums: np.ndarray, start: int, end: int) -> int:
        before = int(sums[start - 1]) if start else 0
        return ((int(sums[end - 1]) if end else 0) - before) & 0xFFFF
