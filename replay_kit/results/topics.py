"""What a result MCAP is made of: the names of its records and attachments, and the messages of a topic by time.

It needs none of the libraries that read estimates.
"""

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from replay_kit.core.errors import LogError

#: Names of attachments and metadata records.
ESTIMATE_NAME = "estimate.npz"
#: Its name in results of earlier versions, where it is NetCDF.
EARLIER_ESTIMATE = "estimate.nc"
#: Beginning of the names of the estimates of windows that the vehicle left; their number and the same ending follow.
WINDOW_NAME = "estimate_window_"
#: Name of the metadata record that holds how many of them, the first ones, belong to an estimate that was rebuilt.
WINDOWS_RECORD = "replay_kit.windows"
CONFIG_NAME = "config.toml"
SUMMARY_NAME = "summary.json"
LAYOUT_NAME = "layout.json"
DIGEST_NAME = "replay_kit.digest"

# opcode, length; channel, sequence, time of log, time of publication
_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")


@dataclass(frozen=True, slots=True)
class Digest:
    """The digest of a result's messages up to some place.

    Attributes:
        time_ns: When in the log [ns, UTC].
        messages: Number of messages before.
        sha256: Of their topics, times and data, in order.
    """

    time_ns: int
    messages: int
    sha256: str


@contextmanager
def complete(path: Path) -> Iterator[None]:
    """Turn what reading a result raises into an error that names it.

    Raises:
        LogError: The file is missing, or is no complete result.
    """
    try:
        yield
    except OSError as error:
        raise LogError(
            f"{path}: cannot read the result: {error.strerror}; check the path"
        ) from error
    except (McapError, ValueError, struct.error) as error:
        raise LogError(
            f"{path}: expected a complete result of replay-kit replay: {error!r}; replay-kit convert recovers the messages of a partial one"
        ) from error


def read_messages(path: Path, topics: Collection[str]) -> Iterator[tuple[int, bytes]]:
    """Yield time [ns, UTC] and payload of the messages of topics by time, those of one time as they lie in the file.

    The messages of other topics are passed over by their lengths: the library makes a value of each, which takes longer than all else.

    Raises:
        McapError: The file is damaged.
    """
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None or not summary.chunk_indexes:
            yield from (
                (message.log_time, message.data)
                for _, _, message in reader.iter_messages(topics=[*topics])
            )
            return
        wanted = {number for number, channel in summary.channels.items() if channel.topic in topics}
        waiting: list[tuple[int, int, bytes]] = []
        for index in sorted(
            summary.chunk_indexes, key=lambda one: (one.message_start_time, one.chunk_start_offset)
        ):
            if (
                not wanted.isdisjoint(index.message_index_offsets)
                or not index.message_index_offsets
            ):
                waiting.sort()
                before = next(
                    (k for k, one in enumerate(waiting) if one[0] >= index.message_start_time),
                    len(waiting),
                )
                yield from ((time_ns, data) for time_ns, _, data in waiting[:before])
                file.seek(index.chunk_start_offset + _HEAD.size)
                waiting = [
                    *waiting[before:],
                    *_in_chunk(Chunk.read(ReadDataStream(file)), wanted, index.chunk_start_offset),
                ]
        yield from ((time_ns, data) for time_ns, _, data in sorted(waiting))


def newest_messages(
    path: Path, topics: Collection[str], until_ns: int | None = None
) -> Iterator[tuple[int, bytes]]:
    """Yield time [ns, UTC] and payload of the messages of topics from the last one back; no more of the file is read than is asked for.

    Args:
        path: The result.
        topics: Their topics.
        until_ns: Time of the latest message [ns, UTC]; None for the last.
    """
    end = None if until_ns is None else until_ns + 1
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        found = reader.iter_messages([*topics], ending_before=end, reverse=True)
        if summary is None or not summary.chunk_indexes:
            # the library then reads from the beginning
            found = reversed([*found])
        for _, _, message in found:
            yield message.log_time, message.data


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
