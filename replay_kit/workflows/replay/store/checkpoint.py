"""Checkpoints: a replay that was killed continues where it was, to the same bytes.

A checkpoint holds the states of all stages after a message, without the prior, which the ensemble and the configuration give again, and
the length of the result's journal at that time. It is made between two blocks of observations only, so that a run with checkpoints and one
without assimilate the same blocks. The messages before it are read again and passed over. Before the states stands the part of
the forecast that the run found, so that the continued one reads the same.
"""

import hashlib
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.message import Message
from replay_kit.measurements import MeasurementState
from replay_kit.results import Journal, ResultWriter, read_journal
from replay_kit.workflows.replay.inputs.job import checkpoint_files
from replay_kit.workflows.replay.inputs.region import MAGIC, FoundRegion, head
from replay_kit.workflows.replay.session import ReplayState, Session
from replay_kit.workflows.replay.store.pickling import check_opcodes, dump, load

# Bytes of the run's identity, and of the SHA-256 of what follows it.
_IDENTITY, _DIGEST = 64, 32
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
        state: Of all stages.
        measurement: Of the measurement step.
        messages: Number of messages read before.
        journal_bytes: How much of the journal belongs to the result.
        writer_state: Of the result's writer.
        begun_ns: Time of the first message [ns, UTC]; None where the journal has what precedes it in the result.
    """

    state: ReplayState
    measurement: MeasurementState
    messages: int
    journal_bytes: int
    writer_state: tuple[int, float | None]
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
        raise _unusable(path, error) from error


def _unusable(path: Path, error: Exception) -> LogError:
    words = " ".join(str(error).split())[:200]
    return LogError(
        f"{path}: the checkpoint cannot be used: {type(error).__name__}: {words}; delete it to begin anew"
    )


def read_checkpoint(path: Path, identity: str, prior: object | None) -> Checkpoint:
    """Return the checkpoint in a file.

    Args:
        path: The file.
        identity: Of the run.
        prior: The estimator's prior, which is not stored; None when the estimator has none.

    Raises:
        ConfigError: The file is no checkpoint, or of another run, or of another version of its inputs or settings.
        LogError: It cannot be read, or is damaged.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: the checkpoint cannot be read: {error.strerror}") from error
    if not data.startswith(MAGIC):
        raise ConfigError(
            f"{path}: exists and is no checkpoint of this version; choose another name for the checkpoint"
        )
    rest = data[len(MAGIC) :].partition(b"\n")[2]
    stored, digest, body = (
        rest[:_IDENTITY],
        rest[_IDENTITY : _IDENTITY + _DIGEST],
        rest[_IDENTITY + _DIGEST :],
    )
    if hashlib.sha256(body).digest() != digest:
        raise LogError(
            f"{path}: the checkpoint is damaged: its checksum does not match; delete it to begin anew"
        )
    if stored != identity.encode():
        raise ConfigError(
            f"{path}: the checkpoint of another run: inputs, options, versions or settings differ; delete it, or name another"
        )
    # pickle states no end to what it raises on bytes that are not its own
    try:
        check_opcodes(body)
        checkpoint = load(io.BytesIO(body), prior)
        if not isinstance(checkpoint, Checkpoint):
            raise TypeError(f"expected a checkpoint, got {type(checkpoint).__name__}")
        int(checkpoint.state.last_ns)
    except Exception as error:
        raise _unusable(path, error) from error
    return checkpoint


def write_checkpoint(
    path: Path, run: tuple[str, FoundRegion | None], prior: object | None, checkpoint: Checkpoint
) -> None:
    """Write a checkpoint to a file, whole or not at all.

    Args:
        path: The file.
        run: Its identity, and the part of the forecast that it found.
        prior: As of ``read_checkpoint``.
        checkpoint: What is written.
    """
    body, (identity, region) = io.BytesIO(), run
    dump(checkpoint, body, prior)
    with atomic_file(path) as file:
        file.write(
            head(region)
            + identity.encode()
            + hashlib.sha256(body.getvalue()).digest()
            + body.getvalue()
        )


class StateStore:
    """The states of one run on the disk, and the journal of its result."""

    def __init__(self, journal: Path, identity: str, prior: object | None) -> None:
        """Bind the store to a run.

        Args:
            journal: The file of the journal.
            identity: Of the run; states of another are of no use.
            prior: The estimator's prior, which is not stored; None when the estimator has none.
        """
        self._journal_path, self._identity, self._prior = journal, identity, prior
        self._journal: Journal | None = None

    def resume(
        self, messages: Callable[[], Iterator[Message]]
    ) -> tuple[Checkpoint | None, Iterator[Message]]:
        """Return the state from which the run goes on, None when it begins, and the messages after it.

        Args:
            messages: Begins the messages of the logs anew.
        """
        raise NotImplementedError

    def write_when_due(
        self, session: Session, measurement: MeasurementState, messages: int
    ) -> None:
        """Write a state when it is time and no observation waits.

        Args:
            session: The replay.
            measurement: State of the measurement step.
            messages: Number of messages read.
        """
        raise NotImplementedError

    def write_last(self) -> None:
        """Write the last state, where the logs may grow."""

    def open_journal(self, checkpoint: Checkpoint | None) -> Journal:
        """Return the journal, cut to what belongs to the checkpoint."""
        written = 0 if checkpoint is None else checkpoint.journal_bytes
        self._journal = Journal(self._journal_path, written)
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
        journal = read_journal(self._journal_path, checkpoint.journal_bytes)
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
        prior: object | None,
        region: FoundRegion | None = None,
    ) -> None:
        """Bind the file to a run.

        Args:
            path: The file.
            identity: Of the run.
            interval_s: Between checkpoints [s, in the log's time].
            prior: The estimator's prior, which is not stored; None when the estimator has none.
            region: The part of the forecast that was found from the log; None where it was not.
        """
        super().__init__(journal_path(path), identity, prior)
        self.path = path
        self._interval_ns = int(interval_s * 1e9)
        self._region = region
        self._next_ns: int | None = None

    def read(self) -> Checkpoint | None:
        """Return the checkpoint; None when there is none yet.

        Raises:
            ConfigError: The file is no checkpoint, or of another run, or of another version of its inputs or settings.
            LogError: It cannot be read, or is damaged.
        """
        if not self.path.exists():
            return None
        checkpoint = read_checkpoint(self.path, self._identity, self._prior)
        self._next_ns = int(checkpoint.state.last_ns) + self._interval_ns
        return checkpoint

    def resume(
        self, messages: Callable[[], Iterator[Message]]
    ) -> tuple[Checkpoint | None, Iterator[Message]]:
        """Return the checkpoint, None when there is none yet, and the messages after it; those before it are passed over.

        Raises:
            ConfigError, LogError: As of ``read``.
        """
        checkpoint = self.read()
        return checkpoint, islice(
            messages(), 0 if checkpoint is None else checkpoint.messages, None
        )

    def write_when_due(
        self, session: Session, measurement: MeasurementState, messages: int
    ) -> None:
        """Write a checkpoint when it is time and no observation waits."""
        if session.writer is None or self._journal is None:
            return
        if self._next_ns is None:
            self._next_ns = session.last_ns + self._interval_ns
        if session.last_ns < self._next_ns or (state := session.state) is None:
            return
        self._next_ns = state.last_ns + self._interval_ns
        checkpoint = Checkpoint(
            state, measurement, messages, self._journal.flushed(), session.writer.state
        )
        write_checkpoint(self.path, (self._identity, self._region), self._prior, checkpoint)

    def close(self) -> None:
        """Close the journal; without a checkpoint no run can continue from it, and it is deleted."""
        super().close()
        if self._journal is not None and not self.path.exists():
            self._journal_path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the checkpoint and its journal: the result is complete."""
        self.path.unlink(missing_ok=True)
        self._journal_path.unlink(missing_ok=True)
