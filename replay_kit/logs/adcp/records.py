"""Records of raw ADCP files, found by their checksums and decoded by MHKiT's dolfyn reader.

MHKiT does not verify checksums: it receives valid records only, other bytes are counted. It is isolated because it prints, logs, warns and
writes an index file next to its input.

Sources: Teledyne RD Instruments, "WorkHorse Commands and Output Data Format", PD0 header and checksum; Nortek, "Integrators Guide, AD2CP"
(N3015-007), common header and checksum.
"""

import contextlib
import io
import logging
import os
import re
import struct
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.logs.shared.blocks import Indices, ReadStatistics, chain, lose_gaps

Bytes = NDArray[np.uint8]
#: Where records begin and end, and their kinds, each of shape (n,).
Found = tuple[Indices, Indices, Indices]

PD0_MAGIC = b"\x7f\x7f"
AD2CP_MAGICS = (b"\xa5\x0a", b"\xa5\x0c")
AD2CP_TEXT = 0xA0
#: Packets that Teledyne's instruments write between ensembles, with the same size and checksum: waves, and others that begin alike.
OTHER_PACKETS = (b"\x7f\x79",)
_CHECKSUM_SEED = 0xB58C
#: Bytes summed at once, even.
_BLOCK = 16
#: Bytes searched at once: every second may begin a candidate, for which the checks take some hundred bytes of memory.
_SEARCHED = 1 << 18
_FIXED_LEADERS = (0x0000, 0x0001)


@dataclass(frozen=True, slots=True)
class Record:
    """Record with valid checksums.

    Attributes:
        start: Offset of its first byte.
        end: Offset after its last byte.
        kind: Nortek's record identifier; 0 for a PD0 ensemble, the second byte of another packet of Teledyne.
    """

    start: int
    end: int
    kind: int


def holds_ensemble(head: bytes) -> bool:
    """Return whether the first bytes of a file contain a valid PD0 ensemble, possibly after other packets or bytes."""
    return PD0_MAGIC in head and any(record.kind == 0 for record in scan(head))


def scan(data: bytes) -> tuple[Record, ...]:
    """Return the valid records of a file.

    Args:
        data: The whole file; without Nortek's magic byte it is read as PD0 ensembles with other packets between them.
    """
    values = np.frombuffer(data, np.uint8)
    sums = _Sums(values)
    if data[:2] in AD2CP_MAGICS:
        return _chained(_candidates(values, sums, AD2CP_MAGICS, _ad2cp))
    ensembles = _chained(_candidates(values, sums, (PD0_MAGIC,), _pd0))
    others = _candidates(values, sums, (OTHER_PACKETS[0][:1],), _packets)
    start, end, kind = others
    at = np.array([(one.start, one.end) for one in ensembles], np.int64).reshape(-1, 2)
    # no ensemble overlaps it
    alone = np.searchsorted(at[:, 1], start, side="right") == np.searchsorted(at[:, 0], end)
    packets = _chained((start[alone], end[alone], kind[alone]))
    return tuple(sorted((*ensembles, *packets), key=lambda record: record.start))


def _candidates(
    values: Bytes,
    sums: "_Sums",
    magics: Sequence[bytes],
    find: Callable[[Bytes, "_Sums", Indices], Found],
) -> Found:
    """Return the records with valid checksums, possibly overlapping; after a magic of one byte any second byte is accepted."""
    found = []
    for first in range(0, values.size - 1, _SEARCHED):
        start = first + np.flatnonzero(values[first : first + _SEARCHED] == magics[0][0])
        if len(magics[0]) > 1:
            second = values.take(start + 1, mode="clip")
            start = start[np.isin(second, [magic[1] for magic in magics])]
        found.append(find(values, sums, start))
    start, end, kind = (np.concatenate(column) for column in zip(*found, strict=True))
    return start, end, kind


def _chained(found: Found) -> tuple[Record, ...]:
    start, end, kind = found
    columns = (column[chain(start, end)].tolist() for column in (start, end, kind))
    return tuple(Record(*record) for record in zip(*columns, strict=True))


def lose_between(statistics: ReadStatistics, records: Sequence[Record], size: int) -> None:
    """Record the bytes outside valid records as losses.

    Args:
        statistics: Statistics that receive the losses.
        records: Result of ``scan``.
        size: Size of the file [bytes].
    """
    start, end = (
        np.array([(record.start, record.end) for record in records], dtype=np.int64)
        .reshape(-1, 2)
        .T
    )
    last = lose_gaps(statistics, "bad bytes between two valid records, skipped", 0, start, end)
    if last < size:
        statistics.lose("at the end: a truncated record or bad bytes, skipped", last, size - last)


def _pd0(values: Bytes, sums: "_Sums", start: Indices) -> Found:
    """Return the valid ensembles among candidates."""
    head = values.take(start[:, None] + np.arange(8), mode="clip").view("<u2").astype(np.int64)
    size, first = head[:, 1], head[:, 3]
    check, n_types = start + size, head[:, 2] >> 8
    fits = (
        (n_types > 0)
        & (first == 6 + 2 * n_types)
        & (size >= first + 2)
        & (check + 2 <= values.size)
    )
    start, check, first = start[fits], check[fits], first[fits]
    fits = np.isin(_word(values, start + first), _FIXED_LEADERS) & (
        sums.of(start, check).sum(axis=1) & 0xFFFF == _word(values, check)
    )
    return start[fits], check[fits] + 2, np.zeros(np.count_nonzero(fits), dtype=np.int64)


def _packets(values: Bytes, sums: "_Sums", start: Indices) -> Found:
    """Return the valid packets of other kinds among candidates: two bytes of kind, size, contents, checksum."""
    head = values.take(start[:, None] + np.arange(4), mode="clip").astype(np.int64)
    check = start + (head[:, 2] | head[:, 3] << 8)
    fits = (check >= start + 4) & (check + 2 <= values.size) & (head[:, 1] != PD0_MAGIC[1])
    start, check, kind = start[fits], check[fits], head[fits, 1]
    fits = sums.of(start, check).sum(axis=1) & 0xFFFF == _word(values, check)
    return start[fits], check[fits] + 2, kind[fits]


def _ad2cp(values: Bytes, sums: "_Sums", start: Indices) -> Found:
    """Return the valid records among candidates."""
    head = values.take(start[:, None] + np.arange(12), mode="clip")
    words = head.view("<u2").astype(np.int64)
    # a header of the long kind has a size of four bytes
    long = head[:, 1] == AD2CP_MAGICS[1][1]
    size = np.where(long, words[:, 2] | words[:, 3] << 16, words[:, 2])
    data_check, header_check = np.where(long, words[:, 4:6].T, words[:, 3:5].T)
    body = start + np.where(long, 12, 10)
    end = body + size
    header_sums = _CHECKSUM_SEED + words[:, :4].sum(axis=1) + np.where(long, words[:, 4], 0)
    fits = np.flatnonzero((end <= values.size) & (header_sums & 0xFFFF == header_check))
    # where the content is damaged, bytes may be missing in it, and the next record begins before the header says
    fits = fits[_nortek_checksums(values, sums, body[fits], end[fits]) == data_check[fits]]
    return start[fits], end[fits], head[fits, 2].astype(np.int64)


def _word(values: Bytes, at: Indices) -> Indices:
    return values[at].astype(np.int64) | values[at + 1].astype(np.int64) << 8


def _nortek_checksums(values: Bytes, sums: "_Sums", start: Indices, end: Indices) -> Indices:
    """Return the sum of the 16-bit words of each part of a file; a last single byte is the high one of its word."""
    bytes_of = sums.of(start, end)
    low = np.where(start % 2 == 0, bytes_of[:, 0], bytes_of[:, 1])
    last = np.where((end - start) % 2 == 1, values[end - 1].astype(np.int64), 0)
    checksums: Indices = (
        _CHECKSUM_SEED + low + 256 * (bytes_of.sum(axis=1) - low) + 255 * last
    ) & 0xFFFF
    return checksums


class _Sums:
    """Sums of byte ranges modulo 2^16 from block sums, as each magic byte without a record may claim 65 kB."""

    def __init__(self, values: Bytes) -> None:
        self._values = values
        lanes = [
            np.add.reduceat(part, np.arange(0, part.size, _BLOCK // 2), dtype=np.uint16)
            for part in (values[::2], values[1::2])
        ]
        self._before = np.zeros((lanes[0].size + 1, 2), dtype=np.uint16)
        for lane, of_blocks in enumerate(lanes):
            np.cumsum(of_blocks, dtype=np.uint16, out=self._before[1 : 1 + of_blocks.size, lane])

    def of(self, start: Indices, end: Indices) -> Indices:
        """Return the sums of the bytes at even and at odd offsets of each part, shape (n, 2)."""
        return (self._up_to(end) - self._up_to(start)).astype(np.int64)

    def _up_to(self, end: Indices) -> NDArray[np.uint16]:
        block, within = np.divmod(end, _BLOCK)
        places = np.arange(_BLOCK)
        rest = self._values.take(block[:, None] * _BLOCK + places, mode="clip") * (
            places < within[:, None]
        )
        sums: NDArray[np.uint16] = self._before[block] + rest.reshape(-1, _BLOCK // 2, 2).sum(
            axis=1, dtype=np.uint16
        )
        return sums


_AVERAGE, BURST = 0x16, 0x15
_CLOCK_LINE = re.compile(rb"GETCLOCKSTR[^\r\n]*")
#: Where a record's kind is in its head, and a profile's ensemble counter in its data [bytes].
_KIND, _ENSEMBLE = 2, 72
NO_ENSEMBLE = "no valid ensemble of velocities (checksums); copy it from the instrument again"


def read_pd0(path: Path, parts: Sequence[bytes], has_pressure: bool) -> Any:
    """Return the MHKiT dataset (xarray) of ensembles of one configuration.

    Args:
        path: File named in errors.
        parts: The ensembles.
        has_pressure: Whether the leaders hold the pressure; otherwise it is dropped.

    Raises:
        LogError: MHKiT is not installed or fails.
    """
    read_rdi, _ = _readers(path)
    # MHKiT reads an ensemble only where another follows, and needs two to begin
    (dataset,) = _read(
        path,
        b"".join([*parts, parts[-1], parts[-1]]),
        lambda copy: [read_rdi(copy, userdata=False, nens=len(parts), debug=0)],
    )
    return dataset if has_pressure else dataset.drop_vars("pressure", errors="ignore")


class Mode(NamedTuple):
    """Profiles of one kind and configuration of an AD2CP file.

    Attributes:
        kind: Record identifier, bursts or averages.
        text: Record with the instrument's configuration.
        pings: Records of the profiles.
        ordinals: Ordinal of each among the records of its kind.
    """

    kind: int
    text: bytes
    pings: list[bytes]
    ordinals: list[int]


def modes_of(path: Path, data: bytes, records: Sequence[Record]) -> list[Mode]:
    """Return the profiles of an AD2CP file by kind and configuration, in order of first occurrence.

    MHKiT fails on several configurations and on modes with unequal numbers of pings.

    Args:
        path: File named in errors.
        data: Its bytes.
        records: Its valid records.

    Raises:
        LogError: There is no profile, or no record with the instrument's configuration.
    """
    texts = [data[record.start : record.end] for record in records if record.kind == AD2CP_TEXT]
    if not {record.kind for record in records} & {_AVERAGE, BURST}:
        raise LogError(f"{path}: {NO_ENSEMBLE}")
    if not texts:
        raise LogError(
            f"{path}: the record with the instrument's configuration is missing or damaged; copy the file again"
        )
    found: dict[tuple[Any, ...], Mode] = {}
    text, counts = texts[0], Counter[int]()
    for record in records:
        body = data[record.start : record.end]
        if record.kind == AD2CP_TEXT:
            text = body
        if record.kind in (BURST, _AVERAGE):
            at = body[1]
            # version, offset and contents of the data; beams, coordinates, cells; cell size, blanking
            settings = body[at : at + 4] + body[at + 30 : at + 36]
            lines = _CLOCK_LINE.sub(b"", text[text[1] :])
            mode = found.setdefault(
                (record.kind, settings, len(body), lines), Mode(record.kind, text, [], [])
            )
            mode.pings.append(body)
            mode.ordinals.append(counts[record.kind])
            counts[record.kind] += 1
    return list(found.values())


def read_mode(path: Path, mode: Mode) -> Any:
    """Return the MHKiT dataset (xarray) of one mode.

    Raises:
        LogError: MHKiT is not installed or fails.
    """
    _, read_signature = _readers(path)
    # MHKiT needs a second ping to know how long one is
    alone = len(mode.pings) == 1
    pings = _numbered(2 * mode.pings if alone else mode.pings)
    (dataset,) = _read(
        path, b"".join([mode.text, *pings]), lambda copy: [read_signature(copy, userdata=False)]
    )
    if not alone:
        return dataset
    return dataset.isel(
        {name: slice(0, 1) for name in dataset.dims if str(name).startswith("time")}
    )


def _numbered(pings: Sequence[bytes]) -> Iterator[bytes]:
    """Yield profile records with consecutive ensemble counters, as MHKiT merges or drops others.

    Checksums are not updated: MHKiT does not verify them.
    """
    numbers: Counter[int] = Counter()
    for ping in pings:
        numbers[ping[_KIND]] += 1
        at = ping[1] + _ENSEMBLE
        yield ping[:at] + struct.pack("<I", numbers[ping[_KIND]]) + ping[at + 4 :]


def _read(path: Path, content: bytes, read: Callable[[str], list[Any]]) -> list[Any]:
    """Return the result of MHKiT for a file of this content."""
    with tempfile.TemporaryDirectory() as folder, _without_output():
        copy = Path(folder) / "records"
        copy.write_bytes(content)
        # MHKiT raises whatever its arithmetic raises on settings it does not know, bare Exception too
        try:
            return read(os.fspath(copy))
        except Exception as error:
            words = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    # not raised from the error, which would keep the file that MHKiT left open
    raise LogError(f"{path}: MHKiT cannot read this raw ADCP file: {words}")


def _readers(path: Path) -> tuple[Any, Any]:
    try:
        with _without_output():
            from mhkit.dolfyn.io.nortek2 import read_signature
            from mhkit.dolfyn.io.rdi import read_rdi
    except ImportError as error:
        raise LogError(
            f"{path}: raw ADCP files are read through MHKiT, which is not installed; pip install 'replay-kit[adcp]'"
        ) from error
    return read_rdi, read_signature


@contextlib.contextmanager
def _without_output() -> Iterator[None]:
    """Suppress output, log records and warnings of MHKiT."""
    # without a handler of its own the root logger would be configured for the whole program by the first warning
    handler, disabled = logging.NullHandler(), logging.root.manager.disable
    logging.root.addHandler(handler)
    logging.disable()
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)
        logging.root.removeHandler(handler)
