"""An MCAP file with an index in the order of log times, whatever the order of its chunks.

Recorders and tools write topic after topic, or chunks that overlap in time. Where the index says that messages come later than the reorder
window allows, the file is scanned once for the times in each chunk, and then read in slices of time, each of which fits into memory: the
chunks that reach into a slice are decompressed for it, some more than once.

A file that is damaged keeps its order, as does one whose clock was set back: of such a topic times fall by more than a day.
"""

import struct
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from replay_kit.logs.mcap.records import (
    RECORD_ERRORS,
    Record,
    chunk_contents,
    file_records,
    parse_chunk,
)
from replay_kit.logs.mcap.scanner import McapScanner
from replay_kit.logs.mcap.summary import Channels, Summary
from replay_kit.logs.mcap.survey import Columns, columns_of, index_entries
from replay_kit.logs.merge import FAR_NS
from replay_kit.logs.shared.blocks import ReadStatistics

# Bytes of a slice of time, about: its messages are held twice. Times that describe the messages of a chunk.
_SLICE, _TIMES = 1 << 26, 17


class ChunkTimes(NamedTuple):
    """When the messages of a chunk were logged.

    Attributes:
        first: Ordinal in the file of the first message.
        size: Bytes of the contents.
        times: shape (17,) [ns], from the earliest to the latest; between two neighbours are equally many messages.
    """

    first: int
    size: int
    times: NDArray[np.int64]


class Slice(NamedTuple):
    """The messages of a span of time, in its order.

    Attributes:
        contents: Their records, one after the other.
        found: Where each begins, and its head.
        ordinals: Of each in the file.
    """

    contents: bytes
    found: Columns
    ordinals: NDArray[np.int64]


class _Census:
    """Takes the times of the messages in each chunk, and whether they can be ordered by them."""

    def __init__(self) -> None:
        self._newest: dict[int, int] = {}
        self.is_orderable = True

    def takes(self, found: Columns, span: tuple[int, int] | None) -> bool:
        """Return True: a message that is odd is so wherever it is read."""
        return True

    def block(self, channels: Channels, data: bytes, found: Columns, first: int) -> ChunkTimes:
        """Return the times in a chunk."""
        log_ns = found.head["log_ns"]
        self.is_orderable &= bool((log_ns < 2**63).all())
        times = log_ns.astype(np.int64)
        for number in np.unique(found.head["channel"]).tolist():
            own = times[found.head["channel"] == number]
            newest = np.maximum.accumulate(np.append(self._newest.get(number, own[0]), own))
            self.is_orderable &= int((newest[1:] - own).max()) <= FAR_NS
            self._newest[number] = int(newest[-1])
        at = np.linspace(0, times.size - 1, _TIMES).astype(np.int64)
        return ChunkTimes(first, len(data), np.sort(times)[at])

    def single(self, channels: Channels, data: bytes, start: int, end: int, position: int) -> None:
        """Note a message outside chunks, or in one that holds more than messages."""
        self.is_orderable = False


def is_disordered(file: BinaryIO, summary: Summary, window_ns: int) -> bool:
    """Return whether the index says that messages come later in the file than a window allows.

    Args:
        file: The open file.
        summary: Its summary.
        window_ns: How long messages are held back for older ones [ns].
    """
    newest = 0
    held = [chunk for chunk in summary.chunks if chunk.message_index_offsets]
    for chunk in held:
        if chunk.message_start_time + window_ns < newest:
            return True
        newest = max(newest, chunk.message_end_time)
    return any(
        chunk.message_end_time - chunk.message_start_time > window_ns
        and _is_mixed(file, chunk, window_ns)
        for chunk in held
    )


def _is_mixed(file: BinaryIO, chunk: ChunkIndex, window_ns: int) -> bool:
    """Return whether the messages within a chunk are out of order by more than a window, by its message indexes."""
    try:
        entries = np.concatenate(
            [index_entries(file, number, chunk) for number in chunk.message_index_offsets]
        )
    except (*RECORD_ERRORS, struct.error):
        return False
    times = entries["log_ns"][np.argsort(entries["offset"], kind="stable")]
    return bool(times.size and int((np.maximum.accumulate(times) - times).max()) > window_ns)


def times_of(
    file: BinaryIO, summary: Summary, statistics: ReadStatistics, on_extra: Callable[[Record], None]
) -> list[ChunkTimes] | None:
    """Return the times in each chunk that the index lists; None for a file that is damaged, or cannot be ordered by them.

    Args:
        file: The open file.
        summary: Its summary.
        statistics: Counts what no checksum covers.
        on_extra: Called with each attachment and metadata record.
    """
    census = _Census()
    scanner: McapScanner[ChunkTimes] = McapScanner(
        file, statistics, census.single, str, on_extra, census
    )
    found = list(scanner.messages())
    listed = sum(bool(chunk.message_index_offsets) for chunk in summary.chunks)
    whole = census.is_orderable and not statistics.lost and len(found) == listed
    return found if whole and found else None


def slices(file: BinaryIO, summary: Summary, held: list[ChunkTimes]) -> Iterator[Slice]:
    """Yield the messages of a file in the order of their log times, those of one time in the order of the file.

    Args:
        file: The open file.
        summary: Its summary.
        held: The times in each chunk, of ``times_of``.
    """
    chunks = [chunk for chunk in summary.chunks if chunk.message_index_offsets]
    times = np.concatenate([each.times[1:] for each in held])
    sizes = np.repeat([each.size / (_TIMES - 1) for each in held], _TIMES - 1)
    order = np.argsort(times, kind="stable")
    filled = np.cumsum(sizes[order])
    cuts = times[order][np.searchsorted(filled, np.arange(_SLICE, filled[-1], _SLICE))]
    first = min(int(each.times[0]) for each in held)
    for begin, end in pairwise([first, *np.unique(np.append(cuts, times.max())).tolist()]):
        # the first slice has its beginning, too
        begin -= begin == first
        pieces, logged, ordinals = list[bytes](), [], []
        for chunk, each in zip(chunks, held, strict=True):
            if each.times[0] > end or each.times[-1] <= begin:
                continue
            offset = chunk.chunk_start_offset
            record = next(file_records(file, offset, offset + chunk.chunk_length))
            data = chunk_contents(parse_chunk(record.body))
            columns = columns_of(data)
            assert columns is not None, "it was scanned"
            log_ns = columns.head["log_ns"].astype(np.int64)
            at = np.flatnonzero((log_ns > begin) & (log_ns <= end))
            starts, stops = columns.offset[at].tolist(), columns.stop[at].tolist()
            pieces += [data[start:stop] for start, stop in zip(starts, stops, strict=True)]
            logged.append(log_ns[at])
            ordinals.append(each.first + at)
        ordinal = np.concatenate(ordinals)
        in_time = np.lexsort((ordinal, np.concatenate(logged)))
        contents = b"".join([pieces[k] for k in in_time.tolist()])
        found = columns_of(contents)
        assert found is not None, "it holds messages alone"
        yield Slice(contents, found, ordinal[in_time])
