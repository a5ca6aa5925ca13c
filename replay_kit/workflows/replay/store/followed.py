"""States of a replay whose logs may grow or be corrected: the next replay goes on from the last one before which nothing changed.

A state is a checkpoint with a digest of all messages before it. The logs are read from their beginning again and the digests compared, so
that whatever happened to the files, appended, replaced, given out of order, renumbered, shows in the messages and in nothing else. Some
states are kept: the latest ones, and older ones at growing distances. The journal of the result holds what was written after its
beginning, which names the inputs and is written anew.
"""

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.message import Message
from replay_kit.core.sealed import read_head
from replay_kit.measurements.observed import Stream
from replay_kit.workflows.replay.array import ArraySession
from replay_kit.workflows.replay.inputs.region import CHECKPOINT
from replay_kit.workflows.replay.session import Session
from replay_kit.workflows.replay.store.checkpoint import Checkpoint, StateStore

#: States kept at most, and how many of them are the latest.
_KEPT, _LATEST = 6, 3
# Least wall time between states of one run [s]; no result depends on it.
_LEAST = 30.0


@dataclass(frozen=True, slots=True)
class _Known:
    """A state on the disk, as its head says: number of messages before it and their digest."""

    messages: int
    digest: str

    @property
    def name(self) -> str:
        return f"state-{self.messages:012d}"


def message_digest(message: Message) -> bytes:
    """Return what tells a message from any other: its time, topic, place in the logs and content."""
    head = (message.time_ns, message.topic, message.schema, message.input, message.position)
    return orjson.dumps(
        (*head, message.payload),
        default=_plain,
        option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS,
    )


def _plain(value: Any) -> Any:
    """Return what JSON has no form for: bytes as text, whatever else as its representation."""
    return value.hex() if isinstance(value, bytes | bytearray | memoryview) else repr(value)


class FollowedStates(StateStore):
    """The states of one followed mission, in a folder of their own."""

    def __init__(self, folder: Path, identity: str) -> None:
        """Bind the folder to a run.

        Args:
            folder: It is made when it does not exist.
            identity: Of the forecast, the settings and the versions; with another the states are of no use.

        Raises:
            ConfigError: The folder cannot be made.
        """
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"{folder}: expected a folder for the states of a followed log: {error.strerror}; choose another"
            ) from error
        super().__init__(folder / "journal", identity)
        self.path = folder
        self._known = self._on_disk()
        # of the messages read so far: a state is of all of them
        self._begun_ns, self._digest = 0, hashlib.sha256()
        self._pending: tuple[_Known, Checkpoint] | None = None
        self._written_at = time.monotonic()

    def resume(
        self, messages: Callable[[], Iterator[Message]]
    ) -> tuple[Checkpoint | None, Iterator[Message]]:
        """Return the last state before which no message changed, None when there is none, and the messages after it."""
        fit, stream = self._longest_fit(messages())
        if fit is not None and fit is not self._known[-1]:
            # what was read beyond the state is read again
            stream = self._counted(messages())
            for _ in range(fit.messages):
                next(stream)
        elif fit is None:
            stream = self._counted(messages())
        # what is of other messages or another run would name places in a journal that is no more
        self._keep([state for state in self._known if fit and state.messages <= fit.messages])
        if fit is None:
            return None, stream
        try:
            return self.read_state(self.path / fit.name), stream
        except (ConfigError, LogError):
            # a damaged state costs time alone
            self._keep([state for state in self._known if state is not fit])
            return self.resume(messages)

    def _longest_fit(self, messages: Iterator[Message]) -> tuple[_Known | None, Iterator[Message]]:
        """Return the last state whose messages are the first of the logs, and the messages after the last state that was looked at."""
        stream, fit, count = self._counted(messages), None, 0
        for state in self._known:
            while count < state.messages and next(stream, None) is not None:
                count += 1
            if count < state.messages or self._digest.hexdigest() != state.digest:
                break
            fit = state
        return fit, stream

    def _counted(self, messages: Iterator[Message]) -> Iterator[Message]:
        """Yield messages after they went into the digest."""
        self._digest = hashlib.sha256()
        for number, message in enumerate(messages):
            if not number:
                self._begun_ns = message.time_ns
            self._digest.update(message_digest(message))
            yield message

    def write_when_due(
        self,
        session: Session | ArraySession,
        measurement: tuple[Stream, ...],
        messages: int,
    ) -> None:
        """Remember a state, and now and then write it."""
        if session.writer is None or self._journal is None:
            return
        known = _Known(messages, self._digest.hexdigest())
        self._pending = (
            known,
            Checkpoint(
                session.state,
                measurement,
                messages,
                self._journal.place,
                session.writer.state,
                self._begun_ns,
            ),
        )
        if time.monotonic() - self._written_at > _LEAST:
            self.write_last()

    def write_last(self) -> None:
        """Write the state remembered last, if it is not on the disk."""
        self._written_at = time.monotonic()
        if self._pending is None or self._journal is None:
            return
        (known, checkpoint), self._pending = self._pending, None
        self._journal.flushed()
        head = {"messages": known.messages, "sha256": known.digest}
        self.write_state(self.path / known.name, checkpoint, head)
        self._keep(thinned([*self._known, known]))

    def _on_disk(self) -> list[_Known]:
        """Return the states on the disk, sorted; none of another run, nor those whose head cannot be read."""
        heads = [read_head(path, CHECKPOINT) or {} for path in self.path.glob("state-*")]
        return sorted(
            (
                _Known(head["messages"], str(head.get("sha256")))
                for head in heads
                if head.get("run") == self._identity and isinstance(head.get("messages"), int)
            ),
            key=lambda state: state.messages,
        )

    def _keep(self, states: list[_Known]) -> None:
        """Make some states those that are kept, and delete the others."""
        names = {state.name for state in states}
        for path in self.path.glob("state-*"):
            if path.name not in names:
                path.unlink(missing_ok=True)
        self._known = states


def thinned(states: list[_Known]) -> list[_Known]:
    """Return some of the states, sorted: the latest, and of the older ones those without which the gaps are widest for their age."""
    left = sorted(
        {state.messages: state for state in states}.values(), key=lambda state: state.messages
    )
    while len(left) > _KEPT:
        end = left[-1].messages

        def gap(k: int, left: list[_Known] = left, end: int = end) -> float:
            before = left[k - 1].messages if k else 0
            return (left[k + 1].messages - before) / (end - before)

        del left[min(range(len(left) - _LATEST), key=gap)]
    return left
