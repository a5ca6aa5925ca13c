"""Checkpoints: a replay that was killed goes on where it was, to the same bytes.

A checkpoint holds what the loop knows after a message, without the prior, which the ensemble and the configuration give again, and how much
of the result's journal belongs to it. It is made between two blocks of observations only, so that a run with checkpoints and one without
assimilate in the same blocks. The messages before it are read again and passed over.
"""

import hashlib
import io
import json
import os
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from replay_kit.core.errors import ConfigError, LogError
from replay_kit.estimator.update.buffer import Buffer
from replay_kit.estimator.update.observation_space import GrowingCholesky
from replay_kit.measurements import MeasurementState
from replay_kit.results import Journal, ResultWriter, read_journal
from replay_kit.workflows.replay.job import checkpoint_files
from replay_kit.workflows.replay.session import Run

#: Begins the file; then the run's identity, the SHA-256 of the rest, and the rest.
_MAGIC = b"replay-kit checkpoint 3\n"
_HEAD = len(_MAGIC) + 64 + 32
_OF_RUN = (
    *("tally", "state", "dive_start", "dive", "vehicle", "planned", "plan_note"),
    *("next_plan_ns", "next_grid_ns", "last_ns", "positions"),
    *("expected", "outcomes", "watch", "surfaced"),
)
# What a pickle of these values is made of; nothing else is loaded.
_FUNCTIONS = {("numpy._core.multiarray", "_reconstruct"), ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer")}
_CLASSES = {("numpy", "ndarray"), ("numpy", "dtype"), ("collections", "Counter"), ("collections", "defaultdict"), ("builtins", "float")}


@dataclass(frozen=True, slots=True)
class Resumed:
    """Where a replay goes on.

    Attributes:
        measurement: What the measurement step remembered.
        messages: Number of messages taken before.
        journal_bytes: How much of the journal is the result's.
        writer_memory: What the result's writer knew.
    """

    measurement: MeasurementState
    messages: int
    journal_bytes: int
    writer_memory: tuple[int, float | None]


def run_identity(metadata: Mapping[str, Mapping[str, str]], settings_toml: str) -> str:
    """Return what a run must have in common with a checkpoint: inputs, options, region, versions, configuration."""
    return hashlib.sha256(json.dumps([metadata, settings_toml], sort_keys=True).encode()).hexdigest()


def journal_path(path: Path) -> Path:
    """Return where the journal of a checkpoint is."""
    return checkpoint_files(path)[1]


class Checkpoints:
    """The checkpoint file of one run."""

    def __init__(self, path: Path, identity: str, interval_s: float) -> None:
        """Remember where and how often.

        Args:
            path: The file.
            identity: Of the run.
            interval_s: Between checkpoints [s, in the log's time].
        """
        self.path = path
        self._identity = identity
        self._interval_ns = int(interval_s * 1e9)
        self._next_ns: int | None = None
        self._journal: Journal | None = None

    def resume(self, run: Run) -> Resumed | None:
        """Put a run where the checkpoint was made and return the rest; None when there is none yet.

        Raises:
            ConfigError: It is no checkpoint, or that of another run, or of another version of its inputs or settings.
            LogError: It cannot be read, or is damaged.
        """
        if not self.path.exists():
            return None
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise LogError(f"{self.path}: the checkpoint cannot be read: {error.strerror}") from error
        if not data.startswith(_MAGIC):
            raise ConfigError(f"{self.path}: exists and is no checkpoint of this version; choose another name for the checkpoint")
        identity, digest, body = data[len(_MAGIC) : _HEAD - 32], data[_HEAD - 32 : _HEAD], data[_HEAD:]
        if hashlib.sha256(body).digest() != digest:
            raise LogError(f"{self.path}: the checkpoint is damaged: its checksum does not match; delete it to begin anew")
        if identity != self._identity.encode():
            raise ConfigError(
                f"{self.path}: the checkpoint of another run: inputs, options, versions or settings differ; delete it, or name another"
            )
        try:
            kept = _Loader(io.BytesIO(body), _prior_of(run)).load()
        except (ValueError, LookupError, TypeError, pickle.UnpicklingError, AttributeError, ImportError, EOFError) as error:
            raise LogError(f"{self.path}: the checkpoint cannot be used: {error}; delete it to begin anew") from error
        for name in _OF_RUN:
            setattr(run, name, kept[name])
        self._next_ns = run.last_ns + self._interval_ns
        return Resumed(kept["measurement"], kept["messages"], kept["journal_bytes"], kept["writer_memory"])

    def open_journal(self, resumed: Resumed | None) -> Journal:
        """Return the journal, which keeps what belongs to the checkpoint."""
        self._journal = Journal(journal_path(self.path), 0 if resumed is None else resumed.journal_bytes)
        return self._journal

    def write_again(self, writer: ResultWriter, resumed: Resumed, copy_again: Callable[[], None]) -> None:
        """Give a writer what the interrupted run's had been given; ``copy_again`` copies the inputs into it."""
        writer.write_again(read_journal(journal_path(self.path), resumed.journal_bytes), resumed.writer_memory, copy_again)

    def keep_when_due(self, run: Run, measurement: MeasurementState, messages: int) -> None:
        """Make a checkpoint when it is time and nothing waits.

        Args:
            run: The run.
            measurement: What the measurement step remembers.
            messages: Number of messages taken.
        """
        if run.waiting or run.writer is None or self._journal is None:
            return
        if self._next_ns is None:
            self._next_ns = run.last_ns + self._interval_ns
        if run.last_ns < self._next_ns:
            return
        self._next_ns = run.last_ns + self._interval_ns
        kept = {name: getattr(run, name) for name in _OF_RUN} | {
            "measurement": measurement,
            "messages": messages,
            "journal_bytes": self._journal.flushed(),
            "writer_memory": run.writer.memory,
        }
        body = io.BytesIO()
        _Dumper(body, _prior_of(run)).dump(kept)
        part = self.path.with_name(self.path.name + ".part")
        with part.open("wb") as file:
            file.write(_MAGIC + self._identity.encode() + hashlib.sha256(body.getvalue()).digest() + body.getvalue())
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, self.path)

    def close(self) -> None:
        """Close the journal; without a checkpoint nothing can go on from it, and it is deleted."""
        if self._journal is not None:
            self._journal.close()
            if not self.path.exists():
                self._journal.path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the checkpoint and its journal: the result is whole."""
        self.path.unlink(missing_ok=True)
        journal_path(self.path).unlink(missing_ok=True)


def _is_value(kind: type) -> bool:
    """Return whether making one of a kind does no more than hold values."""
    return is_dataclass(kind) or issubclass(kind, (Enum, tuple)) or kind in (GrowingCholesky, Buffer)


def _prior_of(run: Run) -> Any:
    return getattr(run.estimator, "prior", None)


class _Dumper(pickle.Pickler):
    def __init__(self, file: io.BytesIO, prior: Any) -> None:
        super().__init__(file, protocol=5)
        self._prior = prior

    def persistent_id(self, obj: Any) -> str | None:
        return "prior" if self._prior is not None and obj is self._prior else None


class _Loader(pickle.Unpickler):
    """Loads this project's values and arrays; nothing whose making acts."""

    def __init__(self, file: io.BytesIO, prior: Any) -> None:
        super().__init__(file)
        self._prior = prior

    def persistent_load(self, pid: Any) -> Any:
        return self._prior

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _FUNCTIONS | _CLASSES:
            return super().find_class(module, name)
        if module.startswith(("replay_kit.", "planners.")) and "." not in name:
            found = super().find_class(module, name)
            if isinstance(found, type) and found.__module__ == module and _is_value(found):
                return found
        raise pickle.UnpicklingError(f"it holds {module}.{name}, which no checkpoint does")
