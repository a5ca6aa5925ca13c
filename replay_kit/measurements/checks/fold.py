"""Elements of the checks: rows of a block, memory between blocks, and the first row that meets a criterion.

A check is a fold: from its memory, arrays by name, and the rows of a block to the memory afterwards and findings. A criterion is evaluated
at every row by ``running_sums`` and ``latest_rows``, which continue from the memory, so that results do not depend on the division into
blocks. Both have one row more, the first: that of the memory.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Indices, Mask, Times
from replay_kit.core.errors import Finding, Severity
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.observation.table import Block, chosen_rows

#: A criterion for each row.
Holds = Mask | np.bool_
#: What a check remembers: arrays by name, whose shapes its docstring states.
Memory = Mapping[str, NDArray[Any]]


class Found(NamedTuple):
    """Finding of a check.

    Attributes:
        event: Index in ``Block.events`` of the event that established it.
        finding: Finding.
        unless: Names of findings that explain it; it is dropped after any of them.
    """

    event: int
    finding: Finding
    unless: Iterable[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows of one kind, in order of their events.

    Attributes:
        topic: Topic of pings; empty for positions and means.
        event: shape (n,), index of each in ``Block.events``; -1 from memory.
        columns: Columns as in ``Block``; and ``row``, the index of each in the block.
        instrument: Name of the instrument; empty for positions and means.
    """

    topic: str
    event: Times
    columns: Mapping[str, NDArray[Any]]
    instrument: str = ""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.event)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]

    def take(self, at: Holds | Indices | slice) -> "Rows":
        """Return a subset of the rows."""
        return replace(self, event=self.event[at], columns=chosen_rows(self.columns, at))

    def having(self, **columns: NDArray[Any]) -> "Rows":
        """Return the rows with columns added or replaced."""
        return replace(self, columns={**self.columns, **columns})

    def until(self, event: int, most: int) -> "Rows":
        """Return the latest ``most`` rows up to an event."""
        end = int(np.searchsorted(self.event, event, side="right"))
        return self.take(slice(max(end - most, 0), end))

    def due(self, each: int) -> list[int]:
        """Return the events at which all rows so far are evaluated: every ``each`` rows at first, later four times as rarely."""
        number = self["number"]
        due = number % np.where(number <= 8 * each, each, 4 * each) == 0
        return list(self.event[due & (self.event >= 0)].tolist())

    def first(
        self,
        holds: Any,
        name: str,
        evidence: Callable[[int], str],
        cause: str,
        advice: str,
        severity: Severity = "inconsistent",
        distrusts: bool = False,
        unless: Iterable[str] = (),
        since: Callable[[int], int] | None = None,
    ) -> list[Found]:
        """Return the finding at the first row that meets a criterion; empty if none does.

        Args:
            holds: shape (n,), or (n + 1,) with the ignored row of the memory first.
            name: See ``Finding``, as for the next arguments.
            evidence: Returns the evidence for an index in ``holds``; the topic is prepended.
            cause: Likely cause.
            advice: What to check.
            severity: Severity.
            distrusts: Whether profiles are excluded.
            unless: See ``Found``.
            since: Returns the time for an index in ``holds`` [ns, UTC]; by default that of the row.
        """
        before = len(holds) - len(self)
        for row in np.flatnonzero(holds[before:])[:1].tolist():
            time = since(row + before) if since else self["time"][row]
            words = f"{self.topic}: " * bool(self.topic) + evidence(row + before)
            finding = Finding(name, int(time), words, cause, advice, severity, distrusts)
            return [Found(int(self.event[row]), finding, unless)]
        return []


class Context(NamedTuple):
    """Further inputs of a check of pings.

    Attributes:
        ensemble: Speeds of the ensemble's currents; None for no comparison.
        through_water: Whether dead reckoning assumes no current.
        vehicle: Depths and positions of the vehicle.
        means: Mean currents of the block.
        known: Names of earlier findings on the instrument.
    """

    ensemble: Any
    through_water: bool
    vehicle: Rows
    means: Rows
    known: frozenset[str] = frozenset()


#: What is remembered after rows, and what was found.
Judged = tuple[Memory, list[Found]]
#: A check of pings: memory, pings of one instrument in order, and what it is told, to memory and what it found.
Fold = Callable[[Memory, Rows, Context], Judged]


def rows_of(block: Block, kind: int) -> Rows:
    """Return the rows of a kind: positions, pings or mean currents."""
    columns = (block.position, block.ping, block.mean)[kind]
    event = np.flatnonzero(block.events[:, 1] == kind)
    row = block.events[event, 2]
    return Rows("", event, {**chosen_rows(columns, row), "row": row})


def latest_rows(memory: Memory, name: str, new: NDArray[Any], most: int) -> NDArray[Any]:
    """Return the latest rows up to each new one, shape (n + 1, most, ...); missing ones are NaN, or 0 for integers.

    Memory of another shape is ignored. The last window is the new memory.
    """
    old = memory.get(name)
    if old is None or old.shape[1:] != new.shape[1:]:
        old = np.full((most, *new.shape[1:]), np.nan if new.dtype.kind == "f" else 0, new.dtype)
    both = np.concatenate([old, new])
    shape, strides = (len(both) - most + 1, most, *both.shape[1:]), (both.strides[0], *both.strides)
    return np.lib.stride_tricks.as_strided(both, shape, strides, writeable=False)


def running_sums(memory: Memory, name: str, new: NDArray[Any]) -> NDArray[Any]:
    """Return the sums of all rows up to each new one, shape (n + 1, c); the last row is the new memory."""
    start = memory.get(name, np.zeros((1, new.shape[1]), new.dtype))
    return np.cumsum(np.concatenate([start, new]), axis=0)


def spaced(
    values: Iterable[Any], before: Sequence[Any], apart: Callable[[Any, Any], bool]
) -> Indices:
    """Return the indices of values apart from the last chosen one, beginning with that of ``before``, or the first value."""
    last, chosen = before[-1:], list[int]()
    for i, value in enumerate(values):
        if not last or apart(last[0], value):
            chosen.append(i)
            last = [value]
    return np.array(chosen, np.intp)


def history(
    memory: Memory, rows: Rows, names: Iterable[str], seconds: float, most: int, prefix: str = ""
) -> tuple[Rows, dict[str, NDArray[Any]]]:
    """Return remembered and new rows at a minimum spacing in time, and the new memory.

    ``number`` counts the rows up to each.

    Args:
        memory: Columns of up to ``most`` rows by name with prefix ``prefix``.
        rows: New rows.
        names: Names of the columns to remember, including ``time``.
        seconds: Minimum spacing [s].
        most: Number of rows to remember.
        prefix: Prefix that distinguishes histories in one memory.
    """
    new = replace(rows, columns={"number": rows.event, **{name: rows[name] for name in names}})
    old = {name: memory.get(prefix + name, values[:0]) for name, values in new.columns.items()}
    times, least = old["time"].tolist(), seconds * 1e9
    at = spaced(new["time"].tolist(), times, lambda last, time: not -least < time - last < least)
    new = new.take(at)
    new = new.having(number=old["number"][-1:].sum() + np.arange(1, len(new) + 1))
    columns = {name: np.concatenate([old[name], new[name]]) for name in old}
    event = np.concatenate([np.full(len(times), -1), new.event])
    after = {prefix + name: values[-most:] for name, values in columns.items()}
    return replace(rows, event=event, columns=columns), after


def displacements(places: Memory | Rows) -> tuple[NDArray[np.complex128], Array]:
    """Return the displacements between consecutive positions, east + i north [m], and their durations [s], shapes (n - 1,)."""
    latitude, longitude = places["latitude"], places["longitude"]
    scale = [metres_per_degree(one) for one in latitude[:-1].tolist()]
    east, north = np.reshape(scale, (-1, 2)).T
    degrees = (np.diff(longitude) + 180.0) % 360.0 - 180.0
    return east * degrees + 1j * north * np.diff(latitude), np.diff(places["time"]) * 1e-9


def ordered_sum(values: Array) -> Array:
    """Return sums along the second axis in order, so that zero padding does not change the last bit."""
    return np.asarray(np.cumsum(values, axis=1)[:, -1:].sum(axis=1))


def upper_median(values: Array, known: Mask) -> Array:
    """Return the upper median of the known values of each row, shape (n,); infinity without any."""
    none = np.full((len(values), 1), np.inf)
    ordered = np.sort(np.hstack([np.where(known, values, np.inf), none]), axis=1)
    return np.asarray(ordered[np.arange(len(ordered)), known.sum(axis=1) // 2])


def mean_of(values: Array, known: Holds) -> Array:
    """Return the mean of the known values of each row, shape (n,); 0 without any."""
    return np.asarray(ordered_sum(np.where(known, values, 0.0)) / np.maximum(known.sum(axis=1), 1))
