"""Reader's reports on logs, mainly of damage, as lines for users and as JSON."""

import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np

from replay_kit.core.message import LogReport, Loss


def loss_words(loss: Loss) -> str:
    """Return a loss as text: bytes, messages and time."""
    return lost_text(loss_json(loss))


def lost_text(found: Mapping[str, Any]) -> str:
    """Return a loss in the form of ``loss_json`` as text: bytes, messages and time."""
    number, first, last = found["messages"], found["first"], found["last"]
    messages = "an unknown number of messages" if number is None else f"{number} messages"
    span = "" if first is None or last is None or number == 0 else f" of {first} to {last}"
    return (
        f"{found['what']} ({found['bytes']} bytes, from byte {found['offset']}; {messages}{span})"
    )


def loss_json(loss: Loss) -> dict[str, Any]:
    """Return a loss for JSON; unknown values are None."""
    return {
        "what": loss.what,
        "offset": loss.offset,
        "bytes": loss.bytes,
        "messages": loss.messages,
        "first": None if loss.first_ns is None else iso_time(loss.first_ns),
        "last": None if loss.last_ns is None else iso_time(loss.last_ns),
    }


def loss_lines(report: LogReport) -> Iterator[str]:
    """Yield a line per loss of a log."""
    return (f"LOST: {report.path}: {loss_words(loss)}" for loss in report.losses)


def note_lines(report: LogReport) -> Iterator[str]:
    """Yield a line per note on a log's clocks."""
    return (f"Note: {report.path}: {note}" for note in report.notes)


def unchecked_lines(report: LogReport) -> Iterator[str]:
    """Yield the line on unchecked records of a log, if any."""
    if report.unchecked:
        kinds = ", ".join(f"{kind} ({count})" for kind, count in report.unchecked.items())
        yield f"Without a checksum, so that damage cannot be detected: {report.path}: {kinds}"


def undecodable_lines(undecodable: Mapping[str, tuple[int, str]]) -> Iterator[str]:
    """Yield a line per topic with undecodable messages; argument as ``LogReport.undecodable``."""
    return (
        f"Cannot be decoded: {count} x {topic}: {reason}"
        for topic, (count, reason) in undecodable.items()
    )


def undecodable_json(undecodable: Mapping[str, tuple[int, str]]) -> dict[str, Any]:
    """Return undecodable messages for JSON, by topic."""
    return {
        topic: {"count": count, "reason": reason} for topic, (count, reason) in undecodable.items()
    }


def iso_time(time_ns: int, unit: Literal["s", "ms"] = "ms") -> str:
    """Return a time as ISO 8601 UTC, clipped to 0..2**63 - 1 ns, as a damaged stamp may be outside."""
    clipped = min(max(time_ns, 0), 2**63 - 1)
    return f"{np.datetime_as_string(np.datetime64(clipped, 'ns'), unit=unit)}Z"


def coded_reasons(counts: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return the count of each reason for JSON, with its code and its sentence."""
    return [
        {"code": code_of(reason), "reason": reason, "count": count}
        for reason, count in counts.items()
    ]


def code_of(reason: str) -> str:
    """Return the code of a reason: its first clause without numbers, quotations and parentheses."""
    clause = re.split(r"[:;,]", re.sub(r"'[^']*'|\([^)]*\)|-?\d[\d.]*", "", reason))[0]
    return "_".join(re.findall(r"[a-z0-9]+", clause.lower())) or "other"
