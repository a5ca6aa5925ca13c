"""Text of values (times, positions, ranges), CSV, and escaping of foreign text for terminals and spreadsheets.

Source: OWASP, "CSV Injection" (owasp.org/www-community/attacks/CSV_Injection).
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def time_text(time_ns: int | None) -> str:
    """Return a time [ns, UTC] to the second, such as ``2018-11-16 03:20:00Z``; ``no time`` for None."""
    return (
        "no time"
        if time_ns is None
        else f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%d %H:%M:%SZ}"
    )


def count_text(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 file`` or ``3 files``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def some_text(names: Sequence[str], most: int = 6) -> str:
    """Return the first names of a list and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def span_text(values: "ArrayLike", digits: int = 4) -> str:
    """Return the range of the finite values, such as ``5..750``; one number if they are equal."""
    # most commands show no range
    import numpy as np

    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return "unknown"
    least, most = f"{known.min():.{digits}g}", f"{known.max():.{digits}g}"
    return least if least == most else f"{least}..{most}"


def place_text(longitude: float, latitude: float) -> str:
    """Return a position [degrees] as text, such as ``152.6000 E, 40.1000 S``."""
    return f"{abs(longitude):.4f} {'W' if longitude < 0.0 else 'E'}, {abs(latitude):.4f} {'S' if latitude < 0.0 else 'N'}"


# Controls of a terminal (ESC among them), ends of lines, marks that turn the direction of writing, and halves of characters, which have no
# bytes.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""Return text with control characters and line ends escaped, as ``\x1b`` or ``\n``, safe for a terminal."""
    return _CONTROLS.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def capitalized(text: str) -> str:
    """Return a text with its first letter raised; names and units after it keep their case."""
    return text[:1].upper() + text[1:]


#: What a text begins with that a spreadsheet takes for a formula, or for what comes before one; also as a full-width character.
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")


def csv_cell(value: Any) -> Any:
    """Return a value for a CSV file: text that a spreadsheet would execute begins with an apostrophe, a list is joined by spaces."""
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULAS) else value


def csv_text(rows: Iterable[Mapping[str, Any]], names: Collection[str]) -> str:
    """Return rows as CSV with a header line of unique names; see ``csv_cell``."""
    # most commands write none
    import csv
    import io

    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    for row in (dict(zip(names, names, strict=True)), *rows):
        writer.writerow({name: csv_cell(value) for name, value in row.items()})
    return text.getvalue()
