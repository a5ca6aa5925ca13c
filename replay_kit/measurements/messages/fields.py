"""Numbers and words of a payload, whatever encoding wrote them."""

import math
from collections.abc import Sequence
from reprlib import repr as shorten
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError

# m/s; an error outside is no statement of one, and its square would not survive the filter's arithmetic
STD_BELIEVED = (1e-6, 1e3)
_LARGEST_DIVE = 2**32 - 1


def number(value: Any) -> float:
    """Return a payload's number; None, strings such as "NaN" and anything infinite become NaN."""
    try:
        result = float("nan") if value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")
    return result if math.isfinite(result) else float("nan")


def numbers(value: Any) -> Array:
    """Return a list of numbers, shape (n,), NaN where an item is none; anything but a list has no items."""
    return rows([value]).reshape(-1) if isinstance(value, list | tuple) else np.empty(0)


def rows(values: Sequence[Any]) -> Array:
    """Return rows of any lengths, shape (n, longest); NaN where a row is shorter or holds no number."""
    try:
        plain = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        plain = np.empty(0)
    if plain.ndim == 2:
        return np.where(np.isfinite(plain), plain, np.nan)
    found = [[number(item) for item in (row if isinstance(row, list | tuple) else [row])] for row in values]
    width = max(map(len, found), default=0)
    return np.array([row + [np.nan] * (width - len(row)) for row in found], np.float64).reshape(len(found), width)


def whole_number(value: Any) -> int | None:
    """Return an integer, which some encodings write as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return int(value) if isinstance(value, int) or value.is_integer() else None


def dive_number(value: Any) -> int | None:
    """Return the dive that a message states; None for what can be none."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _LARGEST_DIVE else None


def word(value: Any, known: Sequence[str]) -> str:
    """Return a word given by itself or by its number among the known; of anything else a short text that is none of them."""
    if isinstance(value, str) and value in known:
        return value
    code = whole_number(value)
    if code is not None and 0 <= code < len(known):
        return known[code]
    # most payloads leave most of them out
    return "None" if value is None else shorten(value)


def known_word(name: str, value: str, known: Sequence[str]) -> str:
    """Return a word that ``word`` gave.

    Raises:
        MeasurementError: It is none of the known ones.
    """
    if value not in known:
        raise MeasurementError(f"ping: expected {name} to be one of {', '.join(known)}, got {value}; state it in the message")
    return value
