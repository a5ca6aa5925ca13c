"""Text helpers for tables, sentences and JSON: folded topics, short times, reasons with codes."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from rich.console import Console
from rich.text import Text

from replay_kit.core.words.text import printable
from replay_kit.results.losses import iso_time

# Columns that a cell which is never folded has at most.
_SHORT = 12
_NUMBER = re.compile(r"\d+")


def print_lines(console: Console, lines: Iterable[str]) -> None:
    """Print lines wrapped by the terminal only, so that pipes receive them whole."""
    for line in lines:
        console.print(line)


def print_table(
    console: Console, title: str | None, columns: Sequence[str], rows: Iterable[Sequence[str]]
) -> None:
    """Print a table whose first column keeps its width; others fold in a narrow terminal.

    Args:
        console: Output console.
        title: Title above the table, or None.
        columns: Column headings.
        rows: Rows of cells; numeric columns are right-aligned.
    """
    # here, because most commands print lines alone
    from rich.table import Table

    if title is not None:
        console.print(title)
    cells = [list(row) for row in rows]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for k, column in enumerate(columns):
        numbers = bool(cells) and all(re.fullmatch(r"[-\d.]*", row[k]) for row in cells)
        longest = max((len(row[k]) for row in cells), default=0)
        # what is cut in no case: names, unless they fill the line, and what is short
        kept = longest <= (2 * console.width // 3 if k == 0 else _SHORT)
        # a heading folds between its words
        narrowest = max([longest, *map(len, column.split())])
        table.add_column(
            column,
            overflow="fold",
            justify="right" if numbers and k else "left",
            no_wrap=kept and k == 0,
            min_width=narrowest if kept else None,
        )
    for row in cells:
        table.add_row(*row)
    console.print(table)


def folded(rows: Iterable[tuple[str, ...]], whole: bool = False) -> list[tuple[str, ...]]:
    """Return rows with consecutive ones folded that differ only by numbers in the topic's name, ``/a1 ... /a8, 8 topics``.

    Args:
        rows: Rows of cells, the topic's name first.
        whole: Whether to keep all rows.
    """
    if whole:
        return [*rows]
    found = []
    for (_, cells), those in groupby(rows, key=lambda row: (_NUMBER.sub("0", row[0]), row[1:])):
        first, *more = (row[0] for row in those)
        name = f"{first} ... {more[-1]}, {len(more) + 1} topics" if more else first
        found.append((name, *cells))
    return found


def iso(time_ns: int | None) -> str | None:
    """Return a time as ISO 8601 UTC to the second, clipped to 64-bit nanoseconds; None for None."""
    return None if time_ns is None else iso_time(time_ns, "s")


def short_times(times_ns: Sequence[int | None]) -> list[str]:
    """Return times [ns, UTC] of a table without their common day or year; empty for None."""
    texts = [iso(time_ns) for time_ns in times_ns]
    known = [text for text in texts if text is not None]
    # 2018-11-16T06:30:00Z
    begin, end = next(
        ((k, e) for k, e in ((11, 19), (5, 16)) if len({text[:k] for text in known}) == 1), (0, 16)
    )
    return ["" if text is None else text[begin:end].replace("T", " ") for text in texts]


def not_used_lines(not_used: Mapping[str, Mapping[str, int]], whole: bool = True) -> Iterator[str]:
    """Yield a line for each topic and reason of unused messages; similar topics share one unless ``whole``."""
    rows = [
        (topic, str(count), reason)
        for topic, reasons in not_used.items()
        for reason, count in reasons.items()
    ]
    if whole:
        yield from (f"Not used: {count} x {topic}: {reason}" for topic, count, reason in rows)
        return
    by_reason = sorted(rows, key=lambda row: row[2])
    for reason, those in groupby(by_reason, key=lambda row: row[2]):
        alike = list(those)
        names = [row[0] for row in folded((topic, "", reason) for topic, _, _ in alike)]
        yield f"Not used: {sum(int(count) for _, count, _ in alike)} x {', '.join(names)}: {reason}"


class SafeConsole(Console):
    """Console that displays control characters, for example in names of a log, instead of obeying them."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print objects, with text wrapped by the terminal only."""
        whole = all(isinstance(each, str) for each in objects)
        super().print(*objects, soft_wrap=whole, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return the text of a line, cell or heading with control characters displayed."""
        return super().render_str(printable(text), **options)
