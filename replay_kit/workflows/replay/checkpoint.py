"""State from which a replay or a followed mission resumes, to the same bytes as without an interruption.

A state covers all stages after a block of messages, where a run ends a chunk of its result. The output before it is taken from the
unfinished result, or from the last one of a mission. A followed log may grow within its reordering window: its state is older, and has a
digest of all messages before it, which reveals any change of the files.
"""

import hashlib
import json
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from enum import Enum
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import orjson

from replay_kit.core.errors import LogError
from replay_kit.core.files.atomic import sealed, unsealed, write_whole
from replay_kit.core.files.inputs import open_input
from replay_kit.core.message import Message
from replay_kit.results.mcap.file import Written
from replay_kit.workflows.replay.run import END, Run


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Point at which a run resumes.

    Attributes:
        state: State of all stages, as in ``Run.state``.
        begun_ns: Time of the first message [ns, UTC].
        digest: Digest of the messages before, for growing logs.
        writer: State of the result's writer.
    """

    state: Mapping[str, Any]
    begun_ns: int
    digest: str
    writer: tuple[Written, float | None]

    @property
    def last_ns(self) -> int:
        """Time of the last message [ns, UTC]."""
        return int(self.state["last_ns"])


def run_identity(metadata: Mapping[str, Mapping[str, str]], settings_toml: str) -> str:
    """Return the identity of a run, which its state must match: inputs, options, region, versions, configuration."""
    text = json.dumps([metadata, settings_toml], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class States:
    """State file of one run; mutable, updated during the run."""

    def __init__(
        self, path: Path, identity: str, interval_s: float, window_s: float | None
    ) -> None:
        """Bind the file to a run.

        Args:
            path: The file.
            identity: Identity of the run; the state of another is refused.
            interval_s: Log time between states of finished logs [s].
            window_s: Reordering window of growing logs [s]; None for finished ones.
        """
        self.path, self._identity = path, identity
        self._before = path.with_name(path.name + ".before")
        self._interval_ns, self._grows = int(1e9 * interval_s), window_s is not None
        self._window_ns = int(1e9 * (window_s or 0.0))
        self._digest, self._begun_ns, self._written_ns = hashlib.sha256(), 0, 0
        self._waiting: list[Checkpoint] = []
        self._ready: Checkpoint | None = None
        self._ended = False

    def resume(
        self, messages: Callable[[], Iterator[Message]]
    ) -> tuple[Checkpoint | None, Iterator[Message]]:
        """Return the state from which the run resumes, None at its beginning, and the messages after it.

        Raises:
            LogError: The file was not written by this program.
            StateError: No state is usable: damaged, of another run, or the logs before it have changed.
        """
        errors = list[StateError]()
        for path in filter(Path.exists, (self.path, self._before)):
            try:
                return self._from(path, messages())
            except StateError as error:
                errors.append(error)
        if errors:
            raise errors[0]
        return None, self._counted(messages())

    def _from(
        self, path: Path, messages: Iterator[Message]
    ) -> tuple[Checkpoint, Iterator[Message]]:
        """Return the state in a file, and the messages after it; for errors see ``resume``."""
        stream, self._digest = self._counted(messages), hashlib.sha256()
        checkpoint: Checkpoint = read_state(path, self._identity)
        deque(islice(stream, checkpoint.state["messages"]), 0)
        if self._grows and self._digest.hexdigest() != checkpoint.digest:
            raise unusable(path, "the logs have changed before it")
        self._written_ns = checkpoint.last_ns
        self._ready = checkpoint if self._grows else None
        return checkpoint, stream

    def restore(self, run: Run, checkpoint: Checkpoint, begin: Callable[[int], None]) -> None:
        """Restore stages and result from a state.

        Args:
            run: Stages, with the result's writer.
            checkpoint: State to resume from.
            begin: Writes the head of a result, given the time of its first message [ns, UTC].

        Raises:
            StateError: Earlier output is missing or damaged.
        """
        run.state = checkpoint.state
        begin(checkpoint.begun_ns)
        if (writer := run.writer) is not None:
            try:
                writer.resume(writer.path if self._grows else writer.part, checkpoint.writer)
            except LogError as error:
                raise unusable(self.path, str(error)) from error

    def _counted(self, messages: Iterator[Message]) -> Iterator[Message]:
        """Yield messages after adding them to the digest."""
        for number, message in enumerate(messages):
            if not number:
                self._begun_ns = self._written_ns = message.time_ns
            if self._grows:
                self._digest.update(_bytes_of(message))
            yield message

    def keep(self, run: Run, block: Sequence[Message]) -> None:
        """Write a state when due, or keep it in memory for growing logs.

        Args:
            run: The replay.
            block: Last messages read.
        """
        due = self._grows or run.last_ns >= self._written_ns + self._interval_ns
        if run.writer is None or self._ended or not due:
            return
        if self._grows:
            # where the log of a vehicle ends more of it may come
            ends = [message.time_ns for message in block if message.schema == END]
            before_ns, self._ended = min(ends, default=run.last_ns), bool(ends)
            while self._waiting and self._waiting[0].last_ns + self._window_ns < before_ns:
                self._ready = self._waiting.pop(0)
        digest = self._digest.hexdigest() if self._grows else ""
        checkpoint = Checkpoint(run.state, self._begun_ns, digest, run.writer.state)
        if self._grows:
            self._waiting.append(checkpoint)
        else:
            run.writer.flush()
            write_state(self.path, self._identity, checkpoint)
            self._written_ns = run.last_ns

    def end(self) -> None:
        """Write the state of growing logs; delete that of finished ones, whose result is complete.

        The previous state of growing logs is kept too: another file of a dive may arrive after the first was processed.
        """
        if not self._grows:
            self.path.unlink(missing_ok=True)
        elif self._ready is not None:
            if self.path.exists():
                self.path.replace(self._before)
            write_state(self.path, self._identity, self._ready)

    def forget(self) -> None:
        """Delete unusable states."""
        self.path.unlink(missing_ok=True)
        self._before.unlink(missing_ok=True)


def _bytes_of(message: Message) -> bytes:
    """Return the bytes that identify a message: time, topic, position in the logs, and content."""
    options = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS
    return orjson.dumps(tuple(message), default=_plain, option=options)


def _plain(value: Any) -> Any:
    """Return a form for JSON: bytes as text, other values as their representation."""
    return value.hex() if isinstance(value, bytes | bytearray | memoryview) else repr(value)


# First line of the file; the number is that of the form.
_KIND, _FORM = b"replay-kit state ", b"19\n"
_ARRAYS = frozenset({"_reconstruct", "_frombuffer", "scalar", "dtype", "ndarray"})


class StateError(LogError):
    """Error: a state is unusable, and the run restarts."""


def write_state(path: Path, run: str, value: Any) -> None:
    """Write the state of a run, completely or not at all.

    Args:
        path: The file; an existing one is replaced.
        run: Identity of the run.
        value: State.

    Raises:
        ConfigError, ReplayKitError: See ``atomic_file``.
    """
    write_whole(path, sealed(_KIND + _FORM + pickle.dumps((run, value), protocol=5)))


def read_state(path: Path, run: str) -> Any:
    """Return the state of a run written by ``write_state``.

    Raises:
        LogError: The file was not written by this program.
        StateError: It is of another run or version, truncated or damaged.
    """
    try:
        with open_input(path) as file:
            if file.read(len(_KIND)) != _KIND:
                raise LogError(f"{path}: exists and is not the state of a run; choose another name")
            content = unsealed(_KIND + file.read())
        if content is None or not content.startswith(_KIND + _FORM):
            raise ValueError("it is incomplete, or of another version")
        identity, value = _OwnValues(BytesIO(content[len(_KIND + _FORM) :])).load()
    except OSError as error:
        raise LogError(f"{path}: the state of a run cannot be read: {error.strerror}") from error
    except (
        *(ValueError, LookupError, TypeError, AttributeError, ImportError),
        *(pickle.UnpicklingError, EOFError, MemoryError, OverflowError),
    ) as error:
        raise unusable(path, str(error)) from error
    if identity != run:
        raise unusable(path, "it is of another run: inputs, options, versions or settings differ")
    return value


def unusable(path: Path, why: str) -> StateError:
    """Return the error for an unusable state, with the reason."""
    return StateError(f"{path}: the run cannot resume from it: {' '.join(why.split())[:200]}")


class _OwnValues(pickle.Unpickler):
    """Reader of pickles that hold only values of this program and arrays."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a class of values, or what makes an array; all other names are refused."""
        package = module.partition(".")[0]
        if package in ("replay_kit", "planners", "numpy") and "." not in name:
            found = super().find_class(module, name)
            if package == "numpy" and name in _ARRAYS:
                return found
            # what a module merely imports may be anything
            if isinstance(found, type) and found.__module__ == module and _is_value(found):
                return found
        raise pickle.UnpicklingError(
            f"it holds {module}.{name}, which is not a value of this program"
        )


def _is_value(kind: type) -> bool:
    return is_dataclass(kind) or issubclass(kind, tuple | Enum)
