"""The check that a result file is complete, made before it gets its name."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader

from replay_kit.core.errors import ReplayKitError


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
    topics: dict[int, str] = {}
    read: Counter[str] = Counter()
    attached = 0
    statistics: Statistics | None = None
    try:
        with path.open("rb") as file:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=None).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    read[topics[record.channel_id]] += 1
                elif isinstance(record, Attachment):
                    attached += 1
                elif isinstance(record, Statistics):
                    statistics = record
    except (OSError, McapError, CRCValidationError, KeyError) as error:
        raise ReplayKitError(f"{path}: the result does not read back: {error}; is the disk full?") from error
    summary: Counter[str] = Counter()
    for channel, count in () if statistics is None else statistics.channel_message_counts.items():
        summary[topics[channel]] += count
    if not read == summary == Counter(messages) or attached != attachments:
        raise ReplayKitError(
            f"{path}: wrote {sum(messages.values())} messages and {attachments} attachments, but read back {read.total()} and {attached}, "
            f"and its summary says {summary.total()}; is the disk full?"
        )
