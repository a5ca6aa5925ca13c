"""Fields of many payloads as columns: numbers, words and cells, whatever encoding wrote them; and messages grouped by topic."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter, methodcaller
from reprlib import repr as shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.table import Columns, Kind, Raw, Table

# what reading a payload raises that is not what its schema promises
_MALFORMED = (ValueError, TypeError, LookupError, AttributeError, OverflowError)
#: The reason of a message of a kind that is not known.
NOT_A_KIND = "message type not used by the estimator"
Payload = Mapping[str, Any]
Chosen = NDArray[np.bool_] | NDArray[np.intp] | slice
_LARGEST_DIVE = 2**32 - 1


def raws_of(messages: Sequence[Message], first: int = 0) -> list[Raw]:
    """Return messages grouped by log, topic and schema.

    Args:
        messages: In the order of the stream.
        first: Place of the first one in the stream.
    """
    groups: dict[tuple[int, str, str], list[int]] = {}
    for k, key in enumerate(map(itemgetter(4, 1, 2), messages)):
        groups.setdefault(key, []).append(k)
    found = []
    for (log, topic, schema), at in groups.items():
        times, _, _, payloads, _, ordinals = zip(*[messages[k] for k in at], strict=True)
        order = np.array(at, np.int64) + first
        found.append(
            Raw(topic, schema, log, np.array(times, np.int64), order, _integers(ordinals), payloads)
        )
    return found


def _integers(values: Sequence[int]) -> NDArray[np.int64]:
    return np.array(values, np.int64)


def some(raw: Raw, at: Sequence[int]) -> Raw:
    """Return some messages of a topic."""
    return raw if len(at) == len(raw.time) else part_of(raw, at)


def part_of(raw: Raw, at: Sequence[int]) -> Raw:
    """Return messages of a topic by their numbers, in any order."""
    rows = np.array(at, np.intp)
    places = raw.time[rows], raw.order[rows], raw.position[rows]
    return Raw(raw.topic, raw.schema, raw.input, *places, [raw.payloads[k] for k in at])


def table(
    raw: Raw, kind: Kind, at: Chosen, columns: Columns, fixed: Mapping[str, Any] | None = None
) -> Table:
    """Return a table of some of a topic's messages."""
    rows = raw.time[at], raw.order[at], raw.position[at]
    return Table(kind, raw.topic, raw.input, *rows, columns, fixed or {})


def unused(raw: Raw, reasons: Sequence[str] | NDArray[np.object_]) -> list[Table]:
    """Return the table of the messages that have a reason not to be used; none without any."""
    words = np.empty(len(reasons), object)
    words[:] = reasons
    at = words != ""
    return [table(raw, "unused", at, {"reason": words[at]})] if at.any() else []


def read_each(
    raw: Raw,
    kind: Kind,
    names: Sequence[str],
    read: Callable[[Payload], tuple[Any, ...] | str],
    fixed: Mapping[str, Any] | None = None,
) -> list[Table]:
    """Return tables of messages that are read one by one.

    Args:
        raw: The messages.
        kind: Of the rows.
        names: Of the columns.
        read: Returns a row's values, or in words why there are none.
        fixed: As in ``Table``.
    """
    found = [guarded(read, payload) for payload in raw.payloads]
    good = [k for k, row in enumerate(found) if not isinstance(row, str)]
    tables = unused(raw, [row if isinstance(row, str) else "" for row in found])
    if good:
        values = zip(*[found[k] for k in good], strict=True)
        columns = {name: as_column(column) for name, column in zip(names, values, strict=True)}
        tables.append(table(raw, kind, np.array(good), columns, fixed))
    return tables


def as_column(values: Sequence[Any]) -> NDArray[Any]:
    """Return values as a column, of objects where they are no numbers."""
    if isinstance(values[0], float | int | tuple):
        return np.array(values)
    column = np.empty(len(values), object)
    column[:] = values
    return column


def guarded(read: Callable[[Payload], Any], payload: Payload) -> Any:
    """Return what a function reads of a payload, or in words why it cannot."""
    try:
        return read(payload)
    except MeasurementError as error:
        return str(error)
    except _MALFORMED as error:
        return malformed(error)


def malformed(error: Exception) -> str:
    """Return the reason of a message that raised one of ``_MALFORMED``; without values, so that alike messages count as one."""
    return f"malformed: a field is missing or of the wrong kind ({type(error).__name__})"


def field(payloads: Iterable[Payload], name: str) -> list[Any]:
    """Return the values of a field, None where there is none."""
    return [*map(methodcaller("get", name), payloads)]


def each(read: Callable[[Any], Any], values: Sequence[Any]) -> list[Any]:
    """Return what a function makes of values, of which most are the same."""
    keys = [*zip(map(type, values), values, strict=True)]
    try:
        known = {key: read(key[1]) for key in {*keys}}
    except TypeError:
        return [*map(read, values)]
    return [*map(known.__getitem__, keys)]


def numbers(values: Sequence[Any]) -> Array:
    """Return values as numbers, shape (n,); NaN for what is none and for anything infinite."""
    try:
        plain = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        plain = np.empty((0, 0))
    if plain.ndim != 1:
        return np.array([number(value) for value in values], np.float64)
    return np.where(np.isfinite(plain), plain, np.nan)


def number(value: Any) -> float:
    """Return a payload's number; None, strings such as "NaN" and anything infinite become NaN."""
    if value is None:
        return math.nan
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return result if math.isfinite(result) else math.nan


def listed(value: Any) -> Array:
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
    found = [numbers(row if isinstance(row, list | tuple) else [row]) for row in values]
    padded = np.full((len(found), max(map(len, found), default=0)), np.nan)
    for k, row in enumerate(found):
        padded[k, : row.size] = row
    return padded


def whole_number(value: Any) -> int | None:
    """Return an integer, which some encodings write as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return int(value) if isinstance(value, int) or value.is_integer() else None


def dive_number(value: Any) -> int:
    """Return the dive that a message states; -1 for what can be none."""
    known = isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _LARGEST_DIVE
    return value if known else -1


def word(value: Any, known: Sequence[str]) -> str:
    """Return a word given by itself or by its number among the known; of anything else a short text that is none of them."""
    if isinstance(value, str) and value in known:
        return value
    code = whole_number(value)
    if code is not None and 0 <= code < len(known):
        return known[code]
    return "None" if value is None else shorten(value)


def known_word(payload: Payload, name: str, known: Sequence[str]) -> str:
    """Return the word in a field, given by itself or by its number.

    Raises:
        MeasurementError: It is none of the known ones.
    """
    value = word(payload.get(name), known)
    if value not in known:
        raise MeasurementError(
            f"ping: expected {name} to be one of {', '.join(known)}, got {value}; state it in the message"
        )
    return value
