"""Where the sound records of a raw ADCP file are: Teledyne PD0 ensembles and Nortek AD2CP records, found by their checksums.

The library that decodes the records does not check them: only records that pass their checksums are given to it, other bytes are counted.

Sources: Teledyne RD Instruments, "WorkHorse Commands and Output Data Format", PD0 header and checksum; Nortek, "Integrators Guide,
AD2CP" (N3015-007), common header and checksum.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.logs.shared.record_chain import lose_gaps
from replay_kit.logs.shared.statistics import ReadStatistics

Bytes = NDArray[np.uint8]

PD0_MAGIC = b"\x7f\x7f"
AD2CP_MAGICS = (b"\xa5\x0a", b"\xa5\x0c")
AD2CP_TEXT = 0xA0
_CHECKSUM_SEED = 0xB58C
_BLOCK = 1024
_FIXED_LEADERS = (0x0000, 0x0001)
_HEADERS = {0x0A: struct.Struct("<BBBBHHH"), 0x0C: struct.Struct("<BBBBIHH")}


@dataclass(frozen=True, slots=True)
class Record:
    """A record that passed its checksums.

    Attributes:
        start: Offset of its first byte.
        end: Offset after its last byte.
        kind: Nortek's record identifier; 0 for a PD0 ensemble.
    """

    start: int
    end: int
    kind: int


def scan(data: bytes) -> tuple[Record, ...]:
    """Return the sound records of a file.

    Args:
        data: The whole file, which begins with one of the magics.
    """
    find = _pd0 if data[:2] == PD0_MAGIC else _ad2cp
    return tuple(find(data, np.frombuffer(data, np.uint8)))


def lose_between(statistics: ReadStatistics, records: Sequence[Record], size: int) -> None:
    """Record the bytes of a file that are in none of its sound records as losses.

    Args:
        statistics: Where the losses are recorded.
        records: From ``scan``.
        size: Size of the file [bytes].
    """
    start, end = np.array([(record.start, record.end) for record in records], dtype=np.int64).reshape(-1, 2).T
    last = lose_gaps(statistics, "bad bytes between two sound records, skipped", 0, start, end)
    if last < size:
        statistics.lose("at the end: a cut record or bad bytes, skipped", last, size - last)


def _pd0(data: bytes, values: Bytes) -> Iterator[Record]:
    position, sums = 0, _Sums(values)
    while (start := data.find(PD0_MAGIC, position)) >= 0:
        end = _pd0_end(data, sums, start)
        if end is not None:
            yield Record(start, end, 0)
        position = end if end is not None else start + 1


class _Sums:
    """Sums of parts of a file's bytes, from those of its blocks: magic bytes without an ensemble may each claim 65 kB to be summed."""

    def __init__(self, values: Bytes) -> None:
        self._values = values
        self._before = np.concatenate([[0], np.cumsum(np.add.reduceat(values, np.arange(0, values.size, _BLOCK), dtype=np.int64))])

    def of(self, start: int, end: int) -> int:
        """Return the sum from a byte up to another."""
        return self._up_to(end) - self._up_to(start)

    def _up_to(self, end: int) -> int:
        block = end // _BLOCK
        return int(self._before[block]) + int(self._values[block * _BLOCK : end].sum(dtype=np.int64))


def _pd0_end(data: bytes, sums: _Sums, start: int) -> int | None:
    """Return the end of the ensemble that begins here; None when none does."""
    if start + 8 > len(data):
        return None
    size, _, n_types, first = struct.unpack_from("<HBBH", data, start + 2)
    check = start + size
    # the checksum takes long: first check whether the header's own numbers fit together
    if n_types == 0 or first != 6 + 2 * n_types or size < first + 2 or check + 2 > len(data):
        return None
    if struct.unpack_from("<H", data, start + first)[0] not in _FIXED_LEADERS:
        return None
    stated = struct.unpack_from("<H", data, check)[0]
    return check + 2 if sums.of(start, check) & 0xFFFF == stated else None


def _ad2cp(data: bytes, values: Bytes) -> Iterator[Record]:
    position = 0
    while (start := data.find(AD2CP_MAGICS[0][:1], position)) >= 0:
        position = start + 1
        layout = _HEADERS.get(data[start + 1]) if start + 1 < len(data) else None
        if layout is None or start + layout.size > len(data):
            continue
        _, header_size, kind, _, size, data_check, header_check = layout.unpack_from(data, start)
        body, end = start + header_size, start + header_size + size
        if _nortek_checksum(values[start : body - 2]) != header_check or end > len(data):
            continue
        # where the content is damaged, bytes may be missing in it, and the next record begins before the header says
        if _nortek_checksum(values[body:end]) == data_check:
            position = end
            yield Record(start, end, kind)


def _nortek_checksum(values: Bytes) -> int:
    words = values[: values.size // 2 * 2].view("<u2")
    odd = int(values[-1]) << 8 if values.size % 2 else 0
    return (_CHECKSUM_SEED + int(words.sum(dtype=np.int64)) + odd) & 0xFFFF
