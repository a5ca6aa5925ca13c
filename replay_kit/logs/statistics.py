"""Counts of what a reader met in one log, shared by the formats."""

from collections import Counter
from dataclasses import replace

from replay_kit.core.message import LogReport, Loss

#: Losses listed one by one; a log that is damaged in more places has the rest in one line.
MAX_LOSSES = 20


class Tally:
    """Collects what a reader meets and gives it as a ``LogReport``."""

    def __init__(self) -> None:
        self.read: Counter[str] = Counter()
        self.unchecked: Counter[str] = Counter()
        self._undecodable: dict[str, tuple[int, str]] = {}
        self._losses: list[Loss] = []
        self._further: Loss | None = None
        self._further_count = 0

    @property
    def lost(self) -> bool:
        """Whether any damage was met so far."""
        return bool(self._losses)

    def undecodable(self, topic: str, reason: str, messages: int = 1) -> None:
        """Count messages that no decoder could read; the topic's first reason is kept."""
        count, first = self._undecodable.get(topic, (0, reason))
        self._undecodable[topic] = (count + messages, first)

    def lose(self, what: str, offset: int, size: int, messages: int | None = None, span: tuple[int, int] | None = None) -> None:
        """Record damage.

        Args:
            what: Words for a person.
            offset: Byte offset in the file at which whole records end.
            size: Number of bytes that could not be used.
            messages: Number of messages in them; None when nothing says.
            span: First and last time that they may have [ns]; None when nothing says.
        """
        first_ns, last_ns = span or (None, None)
        loss = Loss(what, offset, size, messages, first_ns, last_ns)
        if len(self._losses) < MAX_LOSSES:
            self._losses.append(loss)
            return
        self._further_count += 1
        self._further = _sum(self._further, loss, f"{self._further_count} further damaged places, not listed one by one")

    def report(self, path: str, format_name: str) -> LogReport:
        """Return a copy of the counts.

        Args:
            path: The log.
            format_name: As ``LogReport.format`` says.
        """
        losses = (*self._losses, self._further) if self._further else tuple(self._losses)
        return LogReport(path, format_name, dict(self.read), dict(self._undecodable), losses, unchecked=dict(self.unchecked))


def _sum(loss: Loss | None, further: Loss, what: str) -> Loss:
    """Return two losses as one; what one of them does not know, the sum does not."""
    if loss is None:
        return replace(further, what=what)
    messages = None if loss.messages is None or further.messages is None else loss.messages + further.messages
    first_ns = None if loss.first_ns is None or further.first_ns is None else min(loss.first_ns, further.first_ns)
    last_ns = None if loss.last_ns is None or further.last_ns is None else max(loss.last_ns, further.last_ns)
    return Loss(what, loss.offset, loss.bytes + further.bytes, messages, first_ns, last_ns)
