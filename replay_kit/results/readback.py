"""The check that a result file is complete, made before it gets its name."""

import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd

from replay_kit.core.errors import ReplayKitError
from replay_kit.logs.mcap.columns import columns_of
from replay_kit.logs.mcap.records import MAGIC, RECORD_ERRORS, chunk_contents, file_records, parse, parse_chunk
from replay_kit.logs.mcap.summary import read_summary


def check_written(path: Path, messages: Mapping[str, int], attachments: int) -> None:
    """Read a file from end to end, with its checksums, and compare it with what was written.

    The writing library reports a full disk in no return value: what it dropped shows here.

    Args:
        path: The file.
        messages: Topic to number of messages written.
        attachments: Number of attachments written.

    Raises:
        ReplayKitError: The file does not hold what was written.
    """
    try:
        with path.open("rb") as file:
            read, topics, attached = _read(file)
            counts = _stated(file)
        by_topic, summary = (_by_topic(numbers, topics) for numbers in (read, counts))
    except (OSError, KeyError, *RECORD_ERRORS) as error:
        raise ReplayKitError(f"{path}: the result does not read back: {error}; is the disk full?") from error
    if not by_topic == summary == Counter(messages) or attached != attachments:
        raise ReplayKitError(
            f"{path}: wrote {sum(messages.values())} messages and {attachments} attachments, but read back {by_topic.total()} and "
            f"{attached}, and its summary says {summary.total()}; is the disk full?"
        )


def _read(file: BinaryIO) -> tuple[Counter[int], dict[int, str], int]:
    """Return the number of messages of each channel, the channels' topics, and the number of attachments.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; the file is not whole.
    """
    read: Counter[int] = Counter()
    topics: dict[int, str] = {}
    attached = 0
    for record in file_records(file, len(MAGIC), os.fstat(file.fileno()).st_size):
        if not record.whole:
            raise ValueError(f"no whole record begins at byte {record.offset}")
        if record.opcode == Opcode.CHUNK:
            data = chunk_contents(parse_chunk(record.body))
            found = columns_of(data)
            if found is None:
                raise ValueError(f"the chunk at byte {record.offset} holds more than schemas, channels and messages")
            read.update(dict(enumerate(np.bincount(found.head["channel"]).tolist())))
            channels = [parse(Channel, data[start:stop]) for opcode, start, stop in found.declared if opcode == Opcode.CHANNEL]
            topics.update({channel.id: channel.topic for channel in channels})
        elif record.opcode == Opcode.ATTACHMENT:
            attached += 1
        elif record.opcode == Opcode.DATA_END and parse(DataEnd, record.body).data_section_crc != record.crc:
            raise ValueError("the checksum of its data does not match")
    return read, topics, attached


def _stated(file: BinaryIO) -> Mapping[int, int]:
    """Return the number of messages of each channel by the file's own summary.

    Raises:
        ValueError: ``RECORD_ERRORS``; there is no sound summary.
    """
    summary = read_summary(file, os.fstat(file.fileno()).st_size)
    if summary.statistics is None:
        raise ValueError(summary.problem or "it has no summary")
    return summary.statistics.channel_message_counts


def _by_topic(numbers: Mapping[int, int], topics: Mapping[int, str]) -> Counter[str]:
    found: Counter[str] = Counter()
    for number, count in numbers.items():
        if count:
            found[topics[number]] += count
    return found
