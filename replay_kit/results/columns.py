"""Messages as columns of numbers, filled as they are read: rows of Python values of a million messages do not fit into memory."""

from array import array
from collections.abc import Iterable, Mapping
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.results.schemas import MESSAGES, TIME, Field

if TYPE_CHECKING:
    import pandas as pd

_PACKAGE = ".replay_kit."
# where a column's numbers are kept until all are read: those of lists as doubles, which hold NaN where a message has none
_CODES = {"double": "d", "int32": "q", "uint32": "q", "uint64": "Q", "bool": "b", TIME: "q"}
_LIST_TYPES: dict[str, np.dtype[Any]] = {
    "double": np.dtype(np.float64),
    "int32": np.dtype(np.int32),
    "uint32": np.dtype(np.uint32),
}


class SingleValues:
    """The single values of messages of one type: a column for each, and for each part of a place and the like."""

    def __init__(self, name: str) -> None:
        """Begin without rows; ``name`` is the message's, without the package."""
        single = [field for field in MESSAGES[name] if not field.repeated]
        self._fields = [(field.name, field.type, _parts_of(field)) for field in single]
        self._columns: dict[str, Any] = {}
        for own, kind, parts in self._fields:
            for column in [f"{own}_{part}" for part in parts] or [own]:
                self._columns[column] = array(_CODES[kind]) if kind in _CODES else []
        self._known: dict[str, str] = {}

    def add(self, value: Any) -> None:
        """Add a message."""
        columns = iter(self._columns.values())
        for name, kind, parts in self._fields:
            held = getattr(value, name)
            if parts:
                known = value.HasField(name)
                for part in parts:
                    next(columns).append(getattr(held, part) if known else np.nan)
            elif kind == TIME:
                next(columns).append(held.ToNanoseconds())
            else:
                # one text for all rows that have it
                own = self._known.setdefault(held, held) if kind == "string" else held
                next(columns).append(own)

    def columns(self) -> dict[str, Any]:
        """Return the columns in the order of the message's fields; times as ``datetime64[ns]``, parts that a message lacks as NaN."""
        kinds = {name: kind for name, kind, _ in self._fields}
        return {name: _typed(each, kinds.get(name, "")) for name, each in self._columns.items()}


class ListValues:
    """The lists of messages of one type, one behind the other: a column for each."""

    def __init__(self, name: str, length: str) -> None:
        """Begin without rows.

        Args:
            name: Message, without the package.
            length: List whose length all lists of a message have that are not empty.
        """
        self._fields = [field for field in MESSAGES[name] if field.repeated]
        self._length, self._counts, self._total = length, array("q"), 0
        self._numbers = {field.name: array("d") for field in self._fields}

    def add(self, value: Any) -> None:
        """Add a message; a list of another length is NaN."""
        count = len(getattr(value, self._length))
        self._counts.append(count)
        for name, numbers in self._numbers.items():
            each = getattr(value, name)
            if len(each) == count:
                # what messages before lacked, of which the last ones may never be needed
                numbers.extend(repeat(np.nan, self._total - len(numbers)))
                numbers.extend(each)
        self._total += count

    def columns(self) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]]:
        """Return how many values each message has, shape (n,), and the columns."""
        found = {
            field.name: self._filled(self._numbers[field.name]).astype(
                _LIST_TYPES[field.type], copy=False
            )
            for field in self._fields
        }
        return shared(self._counts), found

    def _filled(self, numbers: "array[float]") -> NDArray[Any]:
        """Return a list with what its last messages lacked; of one that no message has, a NaN that takes no memory."""
        if not numbers:
            return np.broadcast_to(np.nan, self._total)
        numbers.extend(repeat(np.nan, self._total - len(numbers)))
        return shared(numbers)


def single_columns(values: Iterable[Any], name: str) -> dict[str, Any]:
    """Return the single values of messages of one type, as ``SingleValues.columns``."""
    found = SingleValues(name)
    for value in values:
        found.add(value)
    return found.columns()


def _parts_of(field: Field) -> list[str]:
    return (
        [part.name for part in MESSAGES[field.type.removeprefix(_PACKAGE)]]
        if field.type.startswith(_PACKAGE)
        else []
    )


def shared(numbers: "array[Any]") -> NDArray[Any]:
    """Return an array over the same memory."""
    return (
        np.frombuffer(numbers, dtype=numbers.typecode)
        if len(numbers)
        else np.empty(0, dtype=numbers.typecode)
    )


def _typed(column: Any, kind: str) -> Any:
    if not isinstance(column, array):
        return column
    found = shared(column)
    if kind == TIME:
        return found.view("datetime64[ns]")
    if kind == "bool":
        return found.view(np.bool_)
    # as pandas would: signed where that holds the largest
    return (
        found.astype(np.int64)
        if kind == "uint64" and (not found.size or found.max() < 1 << 63)
        else found
    )


def table_of(columns: Mapping[str, Any]) -> "pd.DataFrame":
    """Return columns as a table over the same memory, with the first, times, as its index ``time``."""
    import pandas as pd

    (_, times), *others = columns.items()
    return pd.DataFrame(dict(others), index=pd.DatetimeIndex(times, name="time"), copy=False)
