"""What a log says: its messages by topic, and its report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.message import LogReport, Message
from replay_kit.logs import open_logs


class Said(NamedTuple):
    """The messages of one log, and its report after them."""

    messages: list[Message]
    report: LogReport

    def of(self, topic: str) -> list[Any]:
        """Return the payloads of a topic."""
        return [message.payload for message in self.messages if message.topic == topic]

    def counts(self) -> dict[str, int]:
        """Return the number of messages of each topic."""
        topics = [message.topic for message in self.messages]
        return {topic: topics.count(topic) for topic in topics}

    def fixes(self) -> np.ndarray:
        """Return time [s since 1970], longitude and latitude of the fixes, shape (n, 3)."""
        rows = [
            (message.time_ns * 1e-9, message.payload["longitude"], message.payload["latitude"])
            for message in self.messages
            if message.topic == "/vehicle/fix"
        ]
        return np.array(rows).reshape(-1, 3)

    def noted(self, words: str) -> bool:
        """Return whether a note holds some words."""
        return any(words in note for note in self.report.notes)


def read(given: Path | Sequence[Path], config: LogConfig | None = None) -> Said:
    """Return what the files of one log say; its messages are in order of time, each of them with its place."""
    (log,) = open_logs([given] if isinstance(given, Path) else given, config)
    messages = list(log.messages())
    times = [message.time_ns for message in messages]
    assert times == sorted(times)
    assert [message.position for message in messages] == list(range(len(messages)))
    return Said(messages, log.report())
