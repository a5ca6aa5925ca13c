"""The last estimate in a result MCAP, and the messages of a topic, read back for planning and analysis."""

import struct
from collections.abc import Iterator
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.load import load_bytes
from replay_kit.core.paths import as_path
from replay_kit.results.mcap_writer import ESTIMATE_NAME, WINDOW_NAME, WINDOWS_RECORD

# opcode, length; channel, sequence, time of log, time of publication
_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")


def read_messages(path: Path, topic: str) -> Iterator[tuple[int, bytes]]:
    """Yield time [ns, UTC] and payload of the messages of a topic by time, those of one time as they lie in the file.

    The messages of other topics are passed over by their lengths: the library makes a value of each, which takes longer than all else.

    Raises:
        McapError: The file is damaged.
    """
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None or not summary.chunk_indexes:
            yield from ((message.log_time, message.data) for _, _, message in reader.iter_messages(topics=topic))
            return
        wanted = {number for number, channel in summary.channels.items() if channel.topic == topic}
        waiting: list[tuple[int, int, bytes]] = []
        for index in sorted(summary.chunk_indexes, key=lambda one: (one.message_start_time, one.chunk_start_offset)):
            if not wanted.isdisjoint(index.message_index_offsets) or not index.message_index_offsets:
                waiting.sort()
                before = next((k for k, one in enumerate(waiting) if one[0] >= index.message_start_time), len(waiting))
                yield from ((time_ns, data) for time_ns, _, data in waiting[:before])
                file.seek(index.chunk_start_offset + _HEAD.size)
                waiting = [*waiting[before:], *_in_chunk(Chunk.read(ReadDataStream(file)), wanted, index.chunk_start_offset)]
        yield from ((time_ns, data) for time_ns, _, data in sorted(waiting))


def _in_chunk(chunk: Chunk, wanted: set[int], offset: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield time, place in the file and payload of the messages of some channels; a message's place grows by chunk, then within it."""
    stream, size = get_chunk_data_stream(chunk)
    data, at = stream.read(size), 0
    while at < size:
        opcode, length = _HEAD.unpack_from(data, at)
        begin, at = at + _HEAD.size, at + _HEAD.size + length
        if opcode == Opcode.MESSAGE:
            number, _, time_ns, _ = _MESSAGE.unpack_from(data, begin)
            if number in wanted:
                # less than 2^64 in a chunk, in which places of files lie
                yield time_ns, (offset << 64) + begin, data[begin + _MESSAGE.size : at]


def read_windows(path: str | Path) -> tuple[FlowEstimate, ...]:
    """Return the estimates of all windows of a result, in order; that of the last one is ``read_estimate``'s.

    Raises:
        ForecastError: As for ``read_estimate``.
    """
    last, path = read_estimate(path), as_path(path, "result")
    with path.open("rb") as file:
        reader = make_reader(file)
        records = [record.metadata for record in reader.iter_metadata() if record.name == WINDOWS_RECORD]
        left = {
            int(record.name.removeprefix(WINDOW_NAME).removesuffix(".nc")): record
            for record in reader.iter_attachments()
            if record.name.startswith(WINDOW_NAME)
        }
    withdrawn = int(records[0]["withdrawn"]) if records else 0
    return (*(load_bytes(left[number].data, f"{path}#{left[number].name}") for number in sorted(left) if number > withdrawn), last)


def read_estimate(path: str | Path) -> FlowEstimate:
    """Return the last estimate of a result MCAP, from its attachment ``estimate.nc``.

    Args:
        path: A file written by ``ResultWriter``.

    Raises:
        ForecastError: The file is no readable MCAP or carries no estimate.
    """
    path = as_path(path, "result")
    try:
        with path.open("rb") as file:
            attachments = [record.data for record in make_reader(file).iter_attachments() if record.name == ESTIMATE_NAME]
    except OSError as error:
        raise ForecastError(f"{path}: cannot read the result: {error.strerror}") from error
    except (McapError, ValueError) as error:
        raise ForecastError(f"{path}: not a complete MCAP: {error!r}") from error
    if not attachments:
        raise ForecastError(
            f"{path}: carries no {ESTIMATE_NAME}, as a result written without its estimate, of an unfinished run or of a plan alone; "
            "its fixes, innovations and plans can be read, but no current: replay the log for an estimate"
        )
    return load_bytes(attachments[-1], f"{path}#{ESTIMATE_NAME}")
