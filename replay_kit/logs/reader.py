"""What the readers of all formats share: a log file as a context, read in passes, with its statistics and its copies."""

import os
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

from mcap.records import Attachment, Metadata

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.inputs import open_input
from replay_kit.core.message import LogReader, LogReport, Message, RawMessage
from replay_kit.core.progress import Progress
from replay_kit.logs.decode.to_json import JsonChannels
from replay_kit.logs.shared.blocks import Block, Overview, ReadStatistics, blocks_of

# Messages between two looks at how much is read.
_LOOK = 64

#: A message before it has a position: time [ns], topic, schema, payload.
Entry = tuple[int, str, str, dict[str, Any]]
#: Called with each attachment and metadata record of a log that is copied.
OnExtra = Callable[[Attachment | Metadata], None]


class LogFile(AbstractContextManager["LogFile"]):
    """A log opened for reading. Each pass reads the file anew; leaving the context closes the passes that were not finished.

    Topics are renamed as ``logs.remap`` states, in messages, copies and the report.

    Attributes:
        path: The log.
        format: As in ``LogReport.format``.
        input: Position of the log among the run's inputs.
        files: The files of the log.
        mission: Name of the mission that it is of; empty when it does not state it.
        statistics: What the pass begun last has found.
        unchecked: What of each message no checksum of the format covers; empty when all is covered, or the pass counts it itself.
        has_own_frames: Whether a copy of ``raw_messages`` holds the log in another form than its own, so that a copy needs ``frames`` too.
    """

    format: str
    mission = ""
    unchecked = ""
    has_own_frames: ClassVar[bool] = False

    def __init__(
        self,
        path: Path | Sequence[Path],
        input: int = 0,
        config: LogConfig | None = None,
        wanted: frozenset[str] | None = None,
    ) -> None:
        """Remember what to read.

        Args:
            path: The log, or its files; it is named after the first.
            input: Position of the log among the run's inputs.
            config: Which clock orders the messages, which topics are renamed; the defaults when None.
            wanted: MAVLink message names, and schemas of DataFlash records, to decode; others are counted only. None decodes all.
                Without effect on other formats.
        """
        self.files: tuple[Path, ...] = (path,) if isinstance(path, Path) else tuple(path)
        self.path = str(self.files[0])
        self.input = input
        self.statistics = ReadStatistics()
        self._config = config or LogConfig()
        self._clock = self._config.clock
        self._wanted = wanted
        self._files: list[BinaryIO] = []
        self._prepare()

    def _prepare(self) -> None:
        """Read what a format needs before its first message; nothing by default."""

    def __repr__(self) -> str:
        """Return the file, and what the pass begun last has read of it."""
        topics = self.statistics.read
        read = (
            f"{topics.total()} messages of {len(topics)} topics read so far"
            if topics
            else "messages() reads it"
        )
        return f"Log {self.path} ({self.format}, {Path(self.path).stat().st_size / 1e6:.2f} MB): {read}"

    def __exit__(self, *error: object) -> None:
        """Close the file of every unfinished pass."""
        for file in self._files:
            file.close()

    def __iter__(self) -> Iterator[Message]:
        """Yield ``messages()``; unlike the context, a loop that ends early leaves its file to be closed with it."""
        return self.messages()

    @abstractmethod
    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in the file's order.

        Raises:
            LogError: The file cannot be read.
        """

    def overview(self) -> Overview | str:
        """Return what the log's index says, and the first messages of each topic, for a log that takes long to read.

        Where an index should be and says too little the text says why. It is empty for formats without one, and for a log that is read
        whole as quickly.

        Raises:
            LogError: The file cannot be read.
        """
        return ""

    def blocks(self, wanted: Callable[[str, str], bool]) -> Iterator[Block]:
        """Yield the messages in the file's order as blocks; of topics that are not wanted as few are decoded as the format allows.

        Args:
            wanted: Whether the messages of a topic and schema must be decoded; of others at least the first is.

        Raises:
            LogError: The file cannot be read.
        """
        del wanted
        yield from blocks_of(self.messages())

    def raw_messages(self, on_extra: OnExtra | None = None) -> Iterator[RawMessage]:
        """Yield the messages to copy: as they are in the file, or as JSON when an MCAP cannot hold the format's own form.

        Args:
            on_extra: Called with each attachment and metadata record.

        Raises:
            LogError: The file cannot be read, or a payload has no JSON form.
        """
        del on_extra
        channels = JsonChannels()
        yield from map(channels.raw, self.messages())

    def is_gliders(self) -> bool:
        """Return whether the log is of a glider: a glider file, or one with mean currents of dives."""
        return False

    def frames(self) -> Iterator[RawMessage]:
        """Yield the entries of a telemetry log that the file is or was made of; nothing by default. The statistics stay as they are."""
        return iter(())

    def profile(self) -> str | None:
        """Return the profile that the header of an MCAP states; None for other formats and damaged headers."""
        return None

    def report(self) -> LogReport:
        """Return what was found so far."""
        report = replace(self.statistics.report(self.path, self.format), mission=self.mission)
        messages = self.statistics.read.total()
        return (
            replace(report, unchecked={self.unchecked: messages})
            if self.unchecked and messages
            else report
        )

    def share_read(self) -> float:
        """Return the share of the file that the pass begun last has read; 1 when it is read whole before its first message."""
        return (
            self._files[-1].tell() / max(os.fstat(self._files[-1].fileno()).st_size, 1)
            if self._files
            else 1.0
        )

    def _topic(self, name: str) -> str:
        """Return what a topic is called."""
        return self._config.remap.get(name, name)

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        """Give the file for one pass."""
        try:
            with open_input(self.path) as file:
                self._files.append(file)
                try:
                    yield file
                finally:
                    self._files.remove(file)
        except OSError as error:
            raise unreadable(self.path, error) from error

    def _by_time(self, entries: Iterable[Entry], *ordered: Iterable[Entry]) -> Iterator[Message]:
        """Yield the entries of a file that is read whole in order of time, those of one time in the order given.

        Args:
            entries: In any order.
            ordered: Further ones, of each in order of time; they are made as they are needed.
        """
        by_time = itemgetter(0)
        for position, (time_ns, topic, schema, payload) in enumerate(
            merge(sorted(entries, key=by_time), *ordered, key=by_time)
        ):
            name = self._topic(topic)
            self.statistics.read[name] += 1
            yield Message(time_ns, name, schema, payload, self.input, position)

    def _skip(self, topic: str, reason: str, count: int = 1) -> None:
        self.statistics.skip(self._topic(topic), reason, count)


@dataclass(frozen=True, slots=True)
class RawLog:
    """A log whose ``messages`` are those to copy, as ``merge`` wants them.

    Attributes:
        log: The log.
        on_extra: Called with each attachment and metadata record.
    """

    log: LogFile
    on_extra: OnExtra | None = None

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages to copy, in the file's order."""
        return self.log.raw_messages(self.on_extra)


def unreadable(path: str | Path, error: OSError) -> LogError:
    """Return the error that says why a log cannot be read."""
    return LogError(f"{path}: cannot be read: {error.strerror}; check the file and its permissions")


def reading(
    logs: Sequence[LogReader | LogFile], progress: Progress, what: str
) -> Callable[[int], None]:
    """Return a function that is called with numbers of messages and reports how much of the logs is read."""
    files, count = [log for log in logs if isinstance(log, LogFile)], 0

    def advance(messages: int) -> None:
        nonlocal count
        count += messages
        if count % _LOOK < messages:
            progress(sum(log.share_read() for log in files), len(files), what)

    return advance
