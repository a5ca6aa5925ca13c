"""Messages of an indexed MCAP file in order of log time, for any order of its chunks.

Recorders and tools write topic after topic, or chunks that overlap in time. If by the message indexes messages are later than the reorder
window allows, the file is read in time slices that fit into memory; some chunks are decompressed more than once. A file whose clock was set
back by more than a day keeps its order.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from replay_kit.logs.mcap.contents import Part, messages_alone, walk
from replay_kit.logs.mcap.overview import index_entries
from replay_kit.logs.mcap.records import RECORD_ERRORS, chunk_contents, file_records, parse_chunk
from replay_kit.logs.mcap.summary import Summary
from replay_kit.logs.merge import FAR_NS
from replay_kit.logs.shared.blocks import ReadStatistics

# Bytes of a slice of time, about: its messages are held twice. Times that describe the messages of a chunk.
_SLICE, _TIMES = 1 << 26, 17


class ChunkTimes(NamedTuple):
    """Log times of a chunk.

    Attributes:
        chunk: Index entry of the chunk.
        first: Ordinal of its first message in the file.
        messages: Number of messages.
        times: shape (17,) [ns], quantiles of the times in equal steps.
    """

    chunk: ChunkIndex
    first: int
    messages: int
    times: NDArray[np.int64]


def disordered(file: BinaryIO, summary: Summary, window_ns: int) -> list[ChunkTimes] | None:
    """Return the times of each chunk; None if the file order suffices or the index does not show another.

    Args:
        file: The open file.
        summary: Summary of the file.
        window_ns: Reorder window [ns].
    """
    held, newest, first, latest = list[ChunkTimes](), dict[int, int](), 0, 0
    for chunk in summary.chunks:
        try:
            parts = {
                number: index_entries(file, number, chunk) for number in chunk.message_index_offsets
            }
        except RECORD_ERRORS:
            return None
        if not parts:
            continue
        entries = np.concatenate([*parts.values()])
        order = np.argsort(entries["offset"], kind="stable")
        times = entries["log_ns"].astype(np.int64)[order]
        of = np.repeat([*parts], [part.size for part in parts.values()])[order]
        for number in parts:
            lag, newest[number] = _lag(times[of == number], newest.get(number, 0))
            if lag > FAR_NS:
                return None
        lag, newest[-1] = _lag(times, newest.get(-1, 0))
        latest = max(latest, lag)
        if times.size:
            at = np.linspace(0, times.size - 1, _TIMES).astype(np.int64)
            held.append(ChunkTimes(chunk, first, times.size, np.sort(times)[at]))
        first += times.size
    counted = summary.statistics is not None and summary.statistics.message_count == first
    return held if latest > window_ns and counted else None


def _lag(times: NDArray[np.int64], newest: int) -> tuple[int, int]:
    """Return the largest lag of times behind the newest before them [ns], and the newest of all."""
    tops = np.maximum.accumulate(np.append(newest, times))
    return int((tops[1:] - times).max(initial=0)), int(tops[-1])


def slices(file: BinaryIO, held: list[ChunkTimes], statistics: ReadStatistics) -> Iterator[Part]:
    """Yield the messages of a file in order of log time, equal times in file order.

    Args:
        file: The open file.
        held: Times of each chunk.
        statistics: Statistics that count damaged and unchecked chunks.
    """
    times = np.concatenate([each.times[1:] for each in held])
    sizes = np.repeat([each.chunk.uncompressed_size / (_TIMES - 1) for each in held], _TIMES - 1)
    order = np.argsort(times, kind="stable")
    filled = np.cumsum(sizes[order])
    cuts = times[order][np.searchsorted(filled, np.arange(_SLICE, filled[-1], _SLICE))]
    before, seen = min(int(each.times[0]) for each in held) - 1, set[int]()
    for begin, end in pairwise([before, *np.unique(np.append(cuts, times.max())).tolist()]):
        pieces, logged, ordinals = list[bytes](), [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        for each in held:
            if each.times[0] > end or each.times[-1] <= begin:
                continue
            offset, length = each.chunk.chunk_start_offset, each.chunk.chunk_length
            is_new = offset not in seen
            seen.add(offset)
            try:
                chunk = parse_chunk(next(file_records(file, offset, offset + length)).body)
                part = messages_alone(chunk_contents(chunk))
                if part.offset.size != each.messages:
                    raise ValueError("its messages are not those of its index")
            except RECORD_ERRORS as error:
                if is_new:
                    span = int(each.times[0]), int(each.times[-1])
                    statistics.lose(f"chunk skipped: {error}", offset, length, each.messages, span)
                continue
            if is_new and chunk.crc == 0:
                statistics.unchecked["chunks without a checksum"] += 1
            log_ns = part.head["log_ns"].astype(np.int64)
            at = np.flatnonzero((log_ns > begin) & (log_ns <= end))
            spans = zip(part.offset[at].tolist(), part.stop[at].tolist(), strict=True)
            pieces += [part.contents[start:stop] for start, stop in spans]
            logged.append(log_ns[at])
            ordinals.append(each.first + at)
        ordinal = np.concatenate(ordinals)
        in_time = np.lexsort((ordinal, np.concatenate(logged)))
        if in_time.size:
            contents = b"".join([pieces[k] for k in in_time.tolist()])
            yield walk(contents).part._replace(ordinal=ordinal[in_time])
