"""A status as lines for a terminal of 80 columns."""

import textwrap

from replay_kit.core.text import printable, time_text
from replay_kit.show.numbers import hours_text
from replay_kit.show.status.status import Line, Status

_LABEL, _AGE = 11, 8
_SECOND = 1_000_000_000


def age_text(seconds: float) -> str:
    """Return how old something is, such as ``now``, ``35 min``, ``4.2 h``, ``3.1 d``; of what lies ahead with ``in``."""
    if abs(seconds) < 60.0:
        return "now"
    text = hours_text(seconds).replace(" days", " d")
    return text if seconds > 0.0 else f"in {text}"


def line_age(status: Status, line: Line) -> str:
    """Return the age of an answer; empty for one without a time."""
    return "" if line.time_ns is None else age_text((status.now_ns - line.time_ns) / _SECOND)


def status_text(status: Status, width: int = 80) -> str:
    """Return a status as text: an alarm a line first, then the answers, each with its age.

    Args:
        status: The status.
        width: Columns of the terminal.
    """
    rows = [f"{printable(status.name)}, status for {time_text(status.now_ns)}"]
    for alarm in status.alarms:
        rows += _wrapped(f"! {alarm.kind.upper()}: ", printable(alarm.text), width, 2)
    rows.append(f"{'':{_LABEL}}{'age':>{_AGE}}  ")
    for line in status.lines:
        head = f"{'!' if line.alarms else ''}{line.label}"
        head = f"{head:<{_LABEL}}{line_age(status, line):>{_AGE}}  "
        for text in line.text:
            rows += _wrapped(head, printable(text), width, _LABEL + _AGE + 2)
            head = " " * (_LABEL + _AGE + 2)
    return "\n".join(row.rstrip() for row in rows) + "\n"


def _wrapped(head: str, text: str, width: int, indent: int) -> list[str]:
    return textwrap.wrap(
        text,
        max(width, 40),
        initial_indent=head,
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
    ) or [head]
