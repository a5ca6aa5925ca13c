"""States of a run from which it continues to the same bytes: in one file until its end, or several of a mission that is followed.

A checkpoint holds the states of all stages after a message, without the prior, which the ensemble and the configuration give again, and
the place in the result's journal at that time. It is made between two blocks of observations only, so that a run with checkpoints and one
without assimilate the same blocks. Its file is a store file (``core/sealed.py``), whose head names the run and the part of the forecast
that it found, so that the continued one reads the same.
"""

import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from replay_kit.core.errors import ConfigError
from replay_kit.core.message import Message
from replay_kit.core.sealed import read_store, unusable, write_store
from replay_kit.measurements.observed import Stream
from replay_kit.results.journal import BEGIN, Journal, Place, read_journal
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.workflows.replay.array import ArraySession, ArrayState
from replay_kit.workflows.replay.inputs.job import checkpoint_files
from replay_kit.workflows.replay.inputs.region import CHECKPOINT, FoundRegion
from replay_kit.workflows.replay.session import ReplayState, Session
from replay_kit.workflows.replay.store.pickling import check_opcodes, dump, load

# What stages raise on a state whose parts are of other kinds or sizes.
_FOREIGN_STATE = (
    TypeError,
    ValueError,
    LookupError,
    AttributeError,
    ArithmeticError,
    MemoryError,
    RecursionError,
)


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Where an interrupted replay continues.

    Attributes:
        state: Of all stages, or of those of several vehicles.
        measurement: Of the measurement step, vehicle by vehicle.
        messages: Number of messages read before.
        journal: Where the part of the journal ends that belongs to the result.
        writer_state: Of the result's writer.
        begun_ns: Time of the first message [ns, UTC]; None where the journal has what precedes it in the result.
    """

    state: ReplayState | ArrayState
    measurement: tuple[Stream, ...]
    messages: int
    journal: Place
    writer_state: float | None
    begun_ns: int | None = None


def run_identity(metadata: Mapping[str, Mapping[str, str]], settings_toml: str) -> str:
    """Return what a run must have in common with a checkpoint: inputs, options, region, versions, configuration."""
    return hashlib.sha256(
        json.dumps([metadata, settings_toml], sort_keys=True).encode()
    ).hexdigest()


def journal_path(path: Path) -> Path:
    """Return the journal of a checkpoint."""
    return checkpoint_files(path)[1]


@contextmanager
def resuming(path: Path | None) -> Iterator[None]:
    """Turn an error of a run that goes on from a checkpoint into one that names it: with the right checksum it may hold what no run left.

    Raises:
        LogError: The run cannot go on from the checkpoint.
    """
    resumed = path is not None and path.exists()
    try:
        yield
    except _FOREIGN_STATE as error:
        if path is None or not resumed:
            raise
        raise unusable(path, CHECKPOINT, error) from error


class StateStore:
    """The states of one run on the disk, and the journal of its result.

    Attributes:
        next_ns: When the next one is due, in the log's time [ns, UTC]; inf where that does not hang on it.
    """

    next_ns: float = math.inf

    def __init__(self, journal: Path, identity: str) -> None:
        """Bind the store to a run.

        Args:
            journal: The file of the journal.
            identity: Of the run; states of another are of no use.
        """
        self._journal_path, self._identity = journal, identity
        self._journal: Journal | None = None

    def read_state(self, path: Path) -> Checkpoint:
        """Return the state in a file.

        Raises:
            ConfigError: The file is of another run.
            LogError: It cannot be used; as of ``read_store``.
        """
        head, (body,) = read_store(path, CHECKPOINT)
        if head.get("run") != self._identity:
            raise ConfigError(
                f"{path}: the checkpoint of another run: inputs, options, versions or settings differ; delete it, or name another"
            )
        # pickle states no end to what it raises on bytes that are not its own
        try:
            check_opcodes(data := bytes(body))
            checkpoint = load(io.BytesIO(data))
            if not isinstance(checkpoint, Checkpoint):
                raise TypeError(f"expected a checkpoint, got {type(checkpoint).__name__}")
            int(checkpoint.state.last_ns)
        except Exception as error:
            raise unusable(path, CHECKPOINT, error) from error
        return checkpoint

    def write_state(self, path: Path, checkpoint: Checkpoint, head: Mapping[str, Any]) -> None:
        """Write a state to a file, whole or not at all.

        Args:
            path: The file.
            checkpoint: The state.
            head: What is looked at before the state is read.
        """
        body = io.BytesIO()
        dump(checkpoint, body)
        write_store(path, CHECKPOINT, {"run": self._identity, **head}, [body.getbuffer()])

    def resume(
        self, messages: Callable[[], Iterator[Message]]
    ) -> tuple[Checkpoint | None, Iterator[Message]]:
        """Return the state from which the run goes on, None when it begins, and the messages after it.

        Args:
            messages: Begins the messages of the logs anew.
        """
        raise NotImplementedError

    def write_when_due(
        self,
        session: Session | ArraySession,
        measurement: tuple[Stream, ...],
        messages: int,
    ) -> None:
        """Write a state when it is time and no observation waits.

        Args:
            session: The replay.
            measurement: States of the measurement step, vehicle by vehicle.
            messages: Number of messages read.
        """
        raise NotImplementedError

    def write_last(self) -> None:
        """Write the last state, where the logs may grow."""

    def open_journal(self, checkpoint: Checkpoint | None) -> Journal:
        """Return the journal, cut to what belongs to the checkpoint."""
        self._journal = Journal(
            self._journal_path, BEGIN if checkpoint is None else checkpoint.journal
        )
        return self._journal

    def restore_result(
        self,
        writer: ResultWriter,
        checkpoint: Checkpoint,
        copy_inputs: Callable[[], None],
        begin: Callable[[int], None],
    ) -> None:
        """Write again what had been written up to a state.

        Args:
            writer: Of the result.
            checkpoint: Where it goes on.
            copy_inputs: Copies the inputs into the result, which the journal does not hold.
            begin: Writes what precedes the messages of a result, whose first is of a time [ns, UTC], where the journal does not hold it.
        """
        if checkpoint.begun_ns is not None:
            begin(checkpoint.begun_ns)
        journal = read_journal(self._journal_path, checkpoint.journal)
        writer.replay_journal(journal, checkpoint.writer_state, copy_inputs)

    def close(self) -> None:
        """Close the journal."""
        if self._journal is not None:
            self._journal.close()

    def remove(self) -> None:
        """Delete what no longer run goes on from: nothing, where the logs may grow."""


class CheckpointFile(StateStore):
    """The checkpoint file of one run, and its journal."""

    def __init__(
        self,
        path: Path,
        identity: str,
        interval_s: float,
        region: FoundRegion | None = None,
    ) -> None:
        """Bind the file to a run.

        Args:
            path: The file.
            identity: Of the run.
            interval_s: Between checkpoints [s, in the log's time].
            region: The part of the forecast that was found from the log; None where it was not.
        """
        super().__init__(journal_path(path), identity)
        self.path = path
        self._interval_ns = int(interval_s * 1e9)
        self._region = region
        self.next_ns = -math.inf

    def resume(
        self, messages: Callable[[], Iterator[Message]]
    ) -> tuple[Checkpoint | None, Iterator[Message]]:
        """Return the checkpoint, None when there is none yet, and the messages after it; those before it are passed over.

        Raises:
            ConfigError, LogError: As of ``read_state``.
        """
        if not self.path.exists():
            return None, messages()
        checkpoint = self.read_state(self.path)
        self.next_ns = int(checkpoint.state.last_ns) + self._interval_ns
        return checkpoint, islice(messages(), checkpoint.messages, None)

    def write_when_due(
        self,
        session: Session | ArraySession,
        measurement: tuple[Stream, ...],
        messages: int,
    ) -> None:
        """Write a checkpoint when it is time."""
        if session.writer is None or self._journal is None:
            return
        if session.last_ns < self.next_ns:
            return
        begins, self.next_ns = math.isinf(self.next_ns), session.last_ns + self._interval_ns
        if begins:
            return
        checkpoint = Checkpoint(
            session.state,
            measurement,
            messages,
            self._journal.flushed(),
            session.writer.state,
        )
        region = None if self._region is None else self._region.to_record()
        self.write_state(self.path, checkpoint, {"region": region})

    def close(self) -> None:
        """Close the journal; without a checkpoint no run can continue from it, and it is deleted."""
        super().close()
        if self._journal is not None and not self.path.exists():
            self._journal_path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the checkpoint and its journal: the result is complete."""
        self.path.unlink(missing_ok=True)
        self._journal_path.unlink(missing_ok=True)
