"""Common parts of the readers of all formats: a log file as a context manager, read in passes, with statistics and copies."""

import os
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, ClassVar

from mcap.records import Attachment, Metadata

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.files.inputs import open_input
from replay_kit.core.message import LogReader, LogReport, Loss, Message, RawMessage
from replay_kit.core.words.progress import Progress
from replay_kit.logs.blocks import Block, ReadStatistics, blocks_of
from replay_kit.logs.payloads import Entry, JsonChannels, by_variable, merged_notes

# Messages between two looks at how much is read.
_LOOK = 64

#: Called with each attachment and metadata record of a log that is copied.
OnExtra = Callable[[Attachment | Metadata], None]


class LogFile(AbstractContextManager["LogFile"]):
    """Log opened for reading; each pass reads it again. Leaving the context closes passes.

    ``logs.remap`` renames topics in messages, copies and the report.

    Attributes:
        path: Path of the log.
        format: As in ``LogReport.format``.
        input: Position among the run's inputs.
        files: Its files.
        mission: Name of the mission, if stated.
        statistics: Statistics of the latest pass.
        unchecked: Part of each message without a checksum; empty where the pass counts it.
        has_own_frames: Whether a copy needs ``frames`` beside ``raw_messages``.
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
        """Create the reader.

        Args:
            path: Log, or its files; the first gives its name.
            input: Position of the log among the run's inputs.
            config: Clock and renamed topics; None for the defaults.
            wanted: MAVLink message names and DataFlash schemas to decode; others are only counted. None decodes all. Ignored for other
                formats.
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
        """Read the parts that a format needs before its first message; nothing by default."""

    def __repr__(self) -> str:
        """Return the file and the progress of the latest pass as text."""
        topics = self.statistics.read
        read = (
            f"{topics.total()} messages of {len(topics)} topics read so far"
            if topics
            else "messages() reads it"
        )
        return f"Log {self.path} ({self.format}, {Path(self.path).stat().st_size / 1e6:.2f} MB): {read}"

    def __exit__(self, *error: object) -> None:
        """Close the files of unfinished passes."""
        for file in self._files:
            file.close()

    def __iter__(self) -> Iterator[Message]:
        """Yield ``messages()``; unlike the context, an early end of the loop does not close the file."""
        return self.messages()

    @abstractmethod
    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in the file's order.

        Raises:
            LogError: The file cannot be read.
        """

    def overview(self) -> Block | str:
        """Return first and last times of each topic, and its first messages, by the log's index; the report counts all messages.

        A text states why an index does not suffice; it is empty for formats without one and for logs read whole as quickly.

        Raises:
            LogError: The file cannot be read.
        """
        return ""

    def blocks(self, wanted: Callable[[str, str], bool]) -> Iterator[Block]:
        """Yield the messages in file order as blocks; few messages of unwanted topics are decoded.

        Args:
            wanted: Returns whether messages of a topic and schema are decoded; of others at least the first is.

        Raises:
            LogError: The file cannot be read.
        """
        del wanted
        yield from blocks_of(self.messages())

    def raw_messages(self, on_extra: OnExtra | None = None) -> Iterator[RawMessage]:
        """Yield the messages to copy: raw, or as JSON if MCAP cannot hold the format's own form.

        Args:
            on_extra: Called with each attachment and metadata record.

        Raises:
            LogError: The file cannot be read, or a payload has no JSON form.
        """
        del on_extra
        channels = JsonChannels()
        yield from map(channels.raw, self.messages())

    def is_gliders(self) -> bool:
        """Return whether the log is a glider's: a glider file, or a log with mean currents of dives."""
        return False

    def frames(self) -> Iterator[RawMessage]:
        """Yield the entries of the original telemetry log, if any; the statistics are unchanged."""
        return iter(())

    def profile(self) -> str | None:
        """Return the profile in an MCAP header; None for other formats and damaged headers."""
        return None

    def report(self) -> LogReport:
        """Return the report on the messages read so far."""
        report = replace(self.statistics.report(self.path, self.format), mission=self.mission)
        messages = self.statistics.read.total()
        return (
            replace(report, unchecked={self.unchecked: messages})
            if self.unchecked and messages
            else report
        )

    def share_read(self) -> float:
        """Return the fraction of the file read by the latest pass; 1 if it is read whole before its first message."""
        return (
            self._files[-1].tell() / max(os.fstat(self._files[-1].fileno()).st_size, 1)
            if self._files
            else 1.0
        )

    def _topic(self, name: str) -> str:
        """Return the name of a topic after renaming."""
        return self._config.remap.get(name, name)

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        """Open the file for one pass."""
        try:
            with open_input(self.path) as file:
                self._files.append(file)
                try:
                    yield file
                finally:
                    self._files.remove(file)
        except OSError as error:
            raise unreadable(self.path, error) from error


@dataclass(slots=True)
class Told:
    """Findings while the files of a log are read whole.

    Attributes:
        notes: Assumptions.
        skipped: Number of unusable messages by topic and reason.
        losses: Damage.
        mission: Name of the mission, if stated.
    """

    notes: list[str] = field(default_factory=list)
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    losses: Sequence[Loss] = ()
    mission: str = ""


#: Begins a pass: the messages of files in any order, then further ones, of each in order of time.
Entries = Callable[[], Sequence[Iterable[Entry]]]


class WholeLog(LogFile):
    """Log whose files are read when it is opened."""

    def __init__(
        self,
        paths: Sequence[Path],
        form: str,
        told: Told,
        entries: Entries,
        config: LogConfig | None,
        gliders: bool = False,
    ) -> None:
        """Create the log.

        Args:
            paths: Files of the log; the first gives its name.
            form: Name of the format, as in ``LogReport.format``.
            told: Findings; a pass may change its notes.
            entries: Begins a pass.
            config: Settings of log reading.
            gliders: Whether the files are a glider's.
        """
        super().__init__(paths, 0, config)
        self.format, self.mission = form, told.mission
        self._told, self._entries, self._gliders = told, entries, gliders
        self.statistics.notes = self._notes()

    def messages(self) -> Iterator[Message]:
        """Yield the messages of the log in order of time."""
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes()
        for loss in self._told.losses:
            self.statistics.lose(loss.what, loss.offset, loss.bytes)
        for (topic, reason), count in self._told.skipped.items():
            self.statistics.skip(self._topic(topic), reason, count)
        by_time, (entries, *ordered) = itemgetter(0), self._entries()
        for position, (time_ns, topic, schema, payload) in enumerate(
            merge(sorted(entries, key=by_time), *ordered, key=by_time)
        ):
            name = self._topic(topic)
            self.statistics.read[name] += 1
            yield Message(time_ns, name, schema, payload, self.input, position)
        self.statistics.notes = self._notes()

    def is_gliders(self) -> bool:
        """Return whether the files are a glider's."""
        return self._gliders

    def _notes(self) -> tuple[str, ...]:
        """Return each note once, with the number of files if several."""
        alike = merged_notes(self._told.notes).items()
        return tuple(
            by_variable(
                note if len(found) == 1 else f"{note} (in {len(found)} files)"
                for note, found in alike
            )
        )


@dataclass(frozen=True, slots=True)
class RawLog:
    """Log with ``messages`` to copy, for ``merge``.

    Attributes:
        log: Reader of the log.
        on_extra: Called with each attachment and metadata record.
    """

    log: LogFile
    on_extra: OnExtra | None = None

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages to copy, in file order."""
        return self.log.raw_messages(self.on_extra)


def unreadable(path: str | Path, error: OSError) -> LogError:
    """Return the error for an unreadable log."""
    return LogError(f"{path}: cannot be read: {error.strerror}; check the file and its permissions")


def read_bytes(path: Path, most: int = -1) -> bytes:
    """Return the bytes of a file, or at most so many of the first.

    Raises:
        LogError: It cannot be read.
    """
    try:
        with open_input(path) as file:
            return file.read(most)
    except OSError as error:
        raise unreadable(path, error) from error


def reading(
    logs: Sequence[LogReader | LogFile], progress: Progress, what: str
) -> Callable[[int], None]:
    """Return a function that takes numbers of messages and reports the fraction of the logs read."""
    files, count = [log for log in logs if isinstance(log, LogFile)], 0

    def advance(messages: int) -> None:
        nonlocal count
        count += messages
        if count % _LOOK < messages:
            progress(sum(log.share_read() for log in files), len(files), what)

    return advance
