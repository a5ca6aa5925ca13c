"""What a damaged log lost, as a sentence and as JSON."""

from typing import Any

import numpy as np

from replay_kit.core.message import LogReport, Loss


def loss_words(loss: Loss) -> str:
    """Return what was lost in bytes, messages and time."""
    messages = "an unknown number of messages" if loss.messages is None else f"{loss.messages} messages"
    span = "" if loss.first_ns is None or loss.last_ns is None else f" of {_iso(loss.first_ns)} to {_iso(loss.last_ns)}"
    return f"{loss.what} ({loss.bytes} bytes, from byte {loss.offset}; {messages}{span if loss.messages != 0 else ''})"


def loss_json(loss: Loss) -> dict[str, Any]:
    """Return a loss for JSON; what is not known is None."""
    return {
        "what": loss.what,
        "offset": loss.offset,
        "bytes": loss.bytes,
        "messages": loss.messages,
        "first": None if loss.first_ns is None else _iso(loss.first_ns),
        "last": None if loss.last_ns is None else _iso(loss.last_ns),
    }


def unchecked_words(report: LogReport) -> str:
    """Return what no checksum of a log covers, where damage would pass unseen; empty when all is covered."""
    return ", ".join(f"{kind} ({count})" for kind, count in report.unchecked.items())


def _iso(time_ns: int) -> str:
    # a damaged stamp may be anything
    clipped = min(max(time_ns, 0), 2**63 - 1)
    return f"{np.datetime_as_string(np.datetime64(clipped, 'ns'), unit='ms')}Z"
