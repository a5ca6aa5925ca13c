"""Fields of many payloads as columns of numbers, words and cells, for any encoding; and messages grouped by topic."""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from itertools import compress, repeat, zip_longest
from operator import itemgetter
from reprlib import repr as shorten
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation.table import Columns, Kind, Raw, Table

#: What reading a payload raises that is not what its schema promises.
MALFORMED = (ValueError, TypeError, LookupError, AttributeError, OverflowError)
Payload = Mapping[str, Any]
Tables = list[Table]
_LARGEST_DIVE = 2**32 - 1


class Rows(NamedTuple):
    """Contents of payloads, one row each.

    Attributes:
        kind: Kind of the rows.
        columns: Values of all payloads, or one common value, by name.
        reasons: Reasons for exclusion with masks, shape (n,); the first that applies counts.
        fixed: As in ``Table``.
    """

    kind: Kind
    columns: Mapping[str, Any]
    reasons: Mapping[str, Any] = MappingProxyType({})
    fixed: Mapping[str, Any] = MappingProxyType({})


def raws_of(messages: Sequence[Message], first: int = 0) -> list[Raw]:
    """Return messages grouped by log, topic and schema.

    Args:
        messages: Messages in the order of the stream.
        first: Position of the first one in the stream.
    """
    groups = defaultdict[tuple[int, str, str], list[int]](list)
    for k, key in enumerate(map(itemgetter(4, 1, 2), messages)):
        groups[key].append(k)
    found = []
    for (log, topic, schema), at in groups.items():
        times, _, _, payloads, _, ordinals = zip(*[messages[k] for k in at], strict=True)
        time, order, position = np.array([times, at, ordinals], np.int64)
        found.append(Raw(topic, schema, log, time, order + first, position, payloads))
    return found


def some_messages(raw: Raw, chosen: Mask) -> Raw:
    """Return the chosen messages of a topic."""
    if chosen.all():
        return raw
    at_rows = raw.time[chosen], raw.order[chosen], raw.position[chosen]
    return Raw(raw.topic, raw.schema, raw.input, *at_rows, tuple(compress(raw.payloads, chosen)))


def table_of(raw: Raw, kind: Kind, at: Any, columns: Columns, fixed: Mapping[str, Any]) -> Table:
    """Return a table of a subset of a topic's messages."""
    at_rows = raw.time[at], raw.order[at], raw.position[at]
    return Table(kind, raw.topic, raw.input, *at_rows, columns, fixed)


def unused_table(raw: Raw, reasons: Any, times: Any = 1) -> Tables:
    """Return the table of excluded messages, each ``times`` times; empty without any."""
    words = np.full(len(raw.time), reasons, object)
    at = np.repeat(np.arange(words.size), times)
    at = at[words[at] != ""]
    return [table_of(raw, "unused", at, {"reason": words[at]}, {})] if at.size else []


def used_and_unused(raw: Raw, rows: Rows) -> Tables:
    """Return the tables of used and excluded messages."""
    n = len(raw.time)
    words = np.broadcast_to(first_reason(rows.reasons), n)
    good = words == ""
    columns = {
        name: np.broadcast_to(column, (n, *np.shape(column)[1:]))[good]
        for name, column in rows.columns.items()
    }
    used = [table_of(raw, rows.kind, good, columns, rows.fixed)] if good.any() else []
    return unused_table(raw, words) + used


def first_reason(reasons: Mapping[str, Any]) -> Any:
    """Return the first reason that applies to each message, or empty, from masks, shape (n,)."""
    found = np.full(np.broadcast_shapes(*map(np.shape, reasons.values())), "")
    for word, holds in [*reasons.items()][::-1]:
        if np.any(holds):
            found = np.where(holds, word, found)
    return found


def read_each(
    kind: Kind, names: str, payloads: Sequence[Payload], read: Callable[[Payload], Any]
) -> Rows:
    """Return rows of payloads read one by one.

    Args:
        kind: Kind of the rows.
        names: Names of the columns.
        payloads: Payloads.
        read: Returns the values of a row, a single value, or the reason for exclusion.
    """
    found, named = [result_or_reason(read, payload) for payload in payloads], names.split()
    words = [row if isinstance(row, str) else "" for row in found]
    values = np.empty((len(found), len(named)), object)
    values[:] = [row if isinstance(row, tuple) else (row,) * len(named) for row in found]
    reasons = {word: np.equal(words, word) for word in {*words}}
    return Rows(kind, dict(zip(named, values.T, strict=True)), reasons)


def result_or_reason(read: Callable[[Payload], Any], payload: Payload) -> Any:
    """Return the result of reading a payload, or the reason of a failure, without values so that equal reasons are counted together."""
    try:
        return read(payload)
    except MeasurementError as error:
        return str(error)
    except MALFORMED as error:
        return f"malformed: a field is missing or of the wrong kind ({type(error).__name__})"


def field(payloads: Sequence[Any], path: str) -> Sequence[Any]:
    """Return the values of a field given by a dotted path (``pose.position``); None if missing."""
    values = payloads
    for name in path.split("."):
        try:
            values = [*map(dict.get, values, repeat(name))]
        except TypeError:
            values = [
                None if one is None or not hasattr(one, "get") else one.get(name) for one in values
            ]
    return values


def stated_numbers(payloads: Sequence[Payload], names: str, part: str = "") -> list[Array]:
    """Return numeric fields of a part of messages as columns, shape (n,); NaN if missing."""
    return [numbers(field(payloads, part + name)) for name in names.split()]


def regular_array(values: Sequence[Any]) -> Array:
    """Return nested lists as an array, NaN where not finite; a single NaN for ragged or other contents."""
    try:
        plain = np.array(values, np.float64)
    except MALFORMED:
        return np.array(np.nan)
    plain[~np.isfinite(plain)] = np.nan
    return plain


def numbers(values: Sequence[Any]) -> Array:
    """Return values as numbers, shape (n,); NaN for others and infinities."""
    plain = regular_array(values)
    return plain if plain.ndim == 1 else np.array([*map(number, values)], np.float64)


def number(value: Any) -> float:
    """Return a payload's number; NaN for None, other values and infinities."""
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return result if math.isfinite(result) else math.nan


def padded_rows(values: Sequence[Any], least: int = 0) -> Array:
    """Return rows of any lengths, shape (n, longest, or at least ``least``); NaN where missing or no number."""
    plain = regular_array(values)
    if plain.ndim == 1:
        plain = plain[:, None]
    if plain.ndim != 2:
        found = [numbers(row if isinstance(row, list | tuple) else [row]) for row in values]
        plain = np.array([*zip_longest(*found, fillvalue=np.nan)]).reshape(-1, len(found)).T
    return _padded(plain, least)


def _padded(values: Array, least: int) -> Array:
    """Return values, shape (..., k), padded with NaN to at least ``least`` per row."""
    missing = np.full((*values.shape[:-1], max(least - values.shape[-1], 0)), np.nan)
    return np.concatenate([values, missing], axis=-1)


def whole_number(value: Any) -> int | None:
    """Return an integer, also from a float; None for anything else."""
    known = isinstance(value, int | float) and not isinstance(value, bool)
    return int(value) if known and value % 1 == 0 else None


def dive_number(value: Any) -> int:
    """Return the dive number in a message; -1 if invalid."""
    return value if type(value) is int and 0 <= value <= _LARGEST_DIVE else -1


def known_word(value: Any, known: Sequence[str]) -> str:
    """Return a known word, given as text or number; other values as shortened text."""
    code = whole_number(value)
    if code is not None and 0 <= code < len(known):
        return known[code]
    return value if value in known else shorten(value)


def velocity_cells(payloads: Sequence[Payload], systems: Sequence[str]) -> Array:
    """Return the velocity components of the cells of pings, shape (n, m, at least 3) [m/s], also from flat protobuf lists.

    In earth coordinates a cell has east and north, or is missing.

    Args:
        payloads: Pings with ``velocity``, and ``n_cells`` and ``coordinate_system`` of the first.
        systems: Known coordinate systems.

    Raises:
        MeasurementError: The number of cells is not ``n_cells``, or a cell lacks components.
        ValueError: The pings differ in form.
    """
    values, said = field(payloads, "velocity"), payloads[0].get("n_cells")
    m = whole_number(said) or 0
    if m < 1 or not isinstance(values[0], list | tuple):
        raise MeasurementError(
            "ping: expected n_cells >= 1 and a list of velocities, "
            f"got n_cells {shorten(said)} and velocity {type(values[0]).__name__}"
        )
    plain = by_cell(regular_array(values), m)
    if plain is None or plain.shape[2] < 2:
        earth = known_word(payloads[0].get("coordinate_system"), systems) == "earth"
        plain = np.array([_cells_of(value, m, earth) for value in values])
    return _padded(plain, 3)


def by_cell(values: Array, m: int) -> Array | None:
    """Return numbers listed by cell or flat, shape (n, m, b); None if they do not fit m cells."""
    if values.ndim == 2 and values.shape[1] % m == 0:
        values = values.reshape(len(values), m, -1)
    return values if values.ndim == 3 and values.shape[1] == m and values.size else None


def _cells_of(cells: Sequence[Any], m: int, earth: bool) -> Array:
    """Return the velocities of a ping with flat, missing or ragged cells, shape (m, k).

    Raises:
        MeasurementError: See ``velocity_cells``.
    """
    if len(cells) > m and not any(isinstance(item, list | tuple | Mapping) for item in cells):
        width = len(cells) // m
        cells = [cells[i : i + width] for i in range(0, len(cells), width)]
    if len(cells) != m:
        raise MeasurementError(
            f"ping: expected {m} cells of east, north[, up], got {len(cells)} cells"
        )
    return padded_rows([_components(cell, earth) for cell in cells])


def _components(cell: Any, earth: bool) -> Sequence[Any]:
    """Return the components of a cell: a list, a message with ``value`` or with ``east`` and ``north``, or null."""
    found = cell
    if isinstance(cell, Mapping):
        both = "east" in cell and "north" in cell
        found = cell.get("value", [cell["east"], cell["north"], cell.get("up")] if both else [])
    if isinstance(found, list | tuple) and (len(found) >= 2 or not earth):
        return found
    # null, NaN or "NaN" in the place of a cell
    if not earth or (not isinstance(cell, list | tuple | Mapping) and np.isnan(number(cell))):
        return ()
    raise MeasurementError(f"ping: expected cells of east, north[, up], got {shorten(cell)}")
