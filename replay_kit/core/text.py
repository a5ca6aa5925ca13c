"""Short texts of values for people: times, places and ranges; rows as CSV."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def time_text(time_ns: int | None) -> str:
    """Return a time [ns, UTC] to the second, such as ``2018-11-16 03:20:00Z``; without one ``no time``."""
    return (
        "no time"
        if time_ns is None
        else f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%d %H:%M:%SZ}"
    )


def count_text(count: int, noun: str) -> str:
    """Return a number of things, such as ``1 file`` or ``3 files``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def some_text(names: Sequence[str], most: int = 6) -> str:
    """Return the first names of a list, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def span_text(values: ArrayLike, digits: int = 4) -> str:
    """Return the least and the greatest value that is a number, such as ``5..750``; one alone where they are equal."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return "unknown"
    least, most = f"{known.min():.{digits}g}", f"{known.max():.{digits}g}"
    return least if least == most else f"{least}..{most}"


def place_text(longitude: float, latitude: float) -> str:
    """Return a place [degrees] such as ``152.6000 E, 40.1000 S``."""
    return f"{abs(longitude):.4f} {'W' if longitude < 0.0 else 'E'}, {abs(latitude):.4f} {'S' if latitude < 0.0 else 'N'}"


def csv_text(rows: Iterable[Mapping[str, Any]], names: Iterable[str]) -> str:
    """Return rows as CSV with a header line of names."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
