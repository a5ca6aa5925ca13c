"""Counts of what a reader met in one log, shared by the formats."""

from collections import Counter

from replay_kit.types import LogReport, Loss

#: Losses listed one by one; a log that is damaged in more places has the rest in one line.
MAX_LOSSES = 20


class Tally:
    """Collects what a reader meets and gives it as a ``LogReport``."""

    def __init__(self) -> None:
        self.read: Counter[str] = Counter()
        self._undecodable: dict[str, tuple[int, str]] = {}
        self._losses: list[Loss] = []
        self._further: Loss | None = None
        self._further_count = 0

    @property
    def lost(self) -> bool:
        """Whether any damage was met so far."""
        return bool(self._losses)

    def undecodable(self, topic: str, reason: str) -> None:
        """Count one message that no decoder could read; the topic's first reason is kept."""
        count, first = self._undecodable.get(topic, (0, reason))
        self._undecodable[topic] = (count + 1, first)

    def lose(self, what: str, offset: int, size: int) -> None:
        """Record damage.

        Args:
            what: Words for a person.
            offset: Byte offset in the file at which whole records end.
            size: Number of bytes that could not be used.
        """
        if len(self._losses) < MAX_LOSSES:
            self._losses.append(Loss(what, offset, size))
            return
        self._further_count += 1
        first, total = (self._further.offset, self._further.bytes) if self._further else (offset, 0)
        self._further = Loss(f"{self._further_count} further damaged places, not listed one by one", first, total + size)

    def report(self, path: str, format_name: str) -> LogReport:
        """Return a copy of the counts.

        Args:
            path: The log.
            format_name: ``mcap`` or ``tlog``.
        """
        losses = (*self._losses, self._further) if self._further else tuple(self._losses)
        return LogReport(path, format_name, dict(self.read), dict(self._undecodable), losses)
