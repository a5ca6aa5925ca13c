"""Counts of what a reader finds in one log, shared by the formats."""

from collections import Counter
from dataclasses import replace

from replay_kit.core.message import LogReport, Loss

#: Losses listed one by one; a log that is damaged in more places has the others summed in one more.
MAX_LOSSES = 20


class ReadStatistics:
    """Counts messages and damage while a log is read, and returns them as a ``LogReport``.

    Attributes:
        read: Messages found, by topic, decoded or not.
        unchecked: What no checksum covers: kind to count.
        without_stamp: Messages ordered by their log time for want of a stamp of their own.
        notes: What a user should know of the log's clocks.
    """

    def __init__(self) -> None:
        self.read: Counter[str] = Counter()
        self.unchecked: Counter[str] = Counter()
        self.without_stamp = 0
        self.notes: tuple[str, ...] = ()
        self._undecodable: dict[str, tuple[int, str]] = {}
        self._losses: list[Loss] = []
        self._further: Loss | None = None
        self._n_further = 0

    @property
    def lost(self) -> bool:
        """Whether any damage was found so far."""
        return bool(self._losses)

    def undecodable(self, topic: str, reason: str, messages: int = 1) -> None:
        """Count messages that no decoder could read; the topic's first reason is kept."""
        count, first = self._undecodable.get(topic, (0, reason))
        self._undecodable[topic] = (count + messages, first)

    def skip(self, topic: str, reason: str, messages: int = 1) -> None:
        """Count messages as found and as undecodable."""
        if messages:
            self.read[topic] += messages
            self.undecodable(topic, reason, messages)

    def lose(
        self,
        what: str,
        offset: int,
        size: int,
        messages: int | None = None,
        span: tuple[int, int] | None = None,
    ) -> None:
        """Record damage.

        Args:
            what: Description for a person.
            offset: Byte offset in the file at which whole records end.
            size: Number of bytes that could not be used.
            messages: Number of messages in them; None when unknown.
            span: Their first and last possible time [ns]; None when unknown.
        """
        first_ns, last_ns = span or (None, None)
        loss = Loss(what, offset, size, messages, first_ns, last_ns)
        if len(self._losses) < MAX_LOSSES:
            self._losses.append(loss)
            return
        self._n_further += 1
        self._further = _sum(
            self._further or replace(loss, bytes=0, messages=0), loss, self._n_further
        )

    def report(self, path: str, format_name: str) -> LogReport:
        """Return a copy of the counts.

        Args:
            path: The log.
            format_name: As in ``LogReport.format``.
        """
        return LogReport(
            path=path,
            format=format_name,
            read=dict(self.read),
            undecodable=dict(self._undecodable),
            losses=(*self._losses, *([self._further] if self._further else [])),
            without_stamp=self.without_stamp,
            unchecked=dict(self.unchecked),
            notes=self.notes,
        )


def _sum(total: Loss, loss: Loss, places: int) -> Loss:
    """Return two losses as one; a figure that is unknown in either is unknown in the sum."""
    return Loss(
        f"{places} further damaged places, not listed one by one",
        total.offset,
        total.bytes + loss.bytes,
        None if total.messages is None or loss.messages is None else total.messages + loss.messages,
        None
        if total.first_ns is None or loss.first_ns is None
        else min(total.first_ns, loss.first_ns),
        None if total.last_ns is None or loss.last_ns is None else max(total.last_ns, loss.last_ns),
    )
