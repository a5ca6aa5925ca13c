"""What every check is made of: rows of a block, what is remembered between blocks, and the first row at which a criterion holds.

A check is a fold: from what it remembers, arrays by name, and the rows of a block, to what it remembers after them and what it found. A
criterion is evaluated at every row, by ``sums`` and ``windows`` that go on from what was remembered, so that neither a finding nor a mark
depends on where a log is cut into blocks. Both have one row more, the first: that of what was remembered.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Indices, Mask, Times
from replay_kit.core.block import Block
from replay_kit.core.errors import Finding, Severity
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.table import chosen

#: A criterion for each row.
Holds = Mask | np.bool_
#: What a check remembers: arrays by name, whose shapes its docstring states.
Memory = Mapping[str, NDArray[Any]]


class Found(NamedTuple):
    """A finding.

    Attributes:
        event: With which it was established: its place in ``Block.events``.
        finding: The finding.
        unless: Names of findings that explain it, or say more: after any of them it is none.
    """

    event: int
    finding: Finding
    unless: Iterable[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows of one kind, in the order of their events.

    Attributes:
        topic: Of the pings; empty of positions and means.
        event: shape (n,), place of each in ``Block.events``; -1 of one that is remembered.
        columns: As of ``Block``, of these rows; and ``row``, the place of each in these columns.
        instrument: By which the pings of one are known; empty of positions and means.
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
        """Return some of the rows."""
        return replace(self, event=self.event[at], columns=chosen(self.columns, at))

    def having(self, **columns: NDArray[Any]) -> "Rows":
        """Return the rows with columns more, or others."""
        return replace(self, columns={**self.columns, **columns})

    def until(self, event: int, most: int) -> "Rows":
        """Return the latest rows up to an event."""
        end = int(np.searchsorted(self.event, event, side="right"))
        return self.take(slice(max(end - most, 0), end))

    def due(self, each: int) -> list[int]:
        """Return the events with which all rows so far are judged: after every so many, at first, and then after four times as many."""
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
        """Return the finding that the first row establishes at which a criterion holds; none where it holds at none.

        Args:
            holds: shape (n,), or (n + 1,) with what was remembered, of which it is not asked, first.
            name: As of ``Finding``.
            evidence: Of a place in ``holds``; the topic of the pings begins it.
            cause: As of ``Finding``.
            advice: As of ``Finding``.
            severity: As of ``Finding``.
            distrusts: As of ``Finding``.
            unless: As of ``Found``.
            since: Time of a place in ``holds`` [ns, UTC]; that of the row without.
        """
        before = len(holds) - len(self)
        for row in np.flatnonzero(holds[before:])[:1].tolist():
            time = since(row + before) if since else self["time"][row]
            words = f"{self.topic}: " * bool(self.topic) + evidence(row + before)
            finding = Finding(name, int(time), words, cause, advice, severity, distrusts)
            return [Found(int(self.event[row]), finding, unless)]
        return []


class Context(NamedTuple):
    """What a check of pings is told beside them.

    Attributes:
        ensemble: Speeds of the ensemble's currents; None where nothing is compared.
        through_water: Whether positions under water are dead-reckoned without a current.
        vehicle: Depths and places of the vehicle.
        means: Mean currents of the block.
        known: Names of what was found of the instrument before the block.
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
    """Return the rows of a kind: of positions, pings or mean currents."""
    columns = (block.position, block.ping, block.mean)[kind]
    event = np.flatnonzero(block.events[:, 1] == kind)
    row = block.events[event, 2]
    return Rows("", event, {**chosen(columns, row), "row": row})


def windows(memory: Memory, name: str, new: NDArray[Any], most: int) -> NDArray[Any]:
    """Return the latest rows up to each new one, shape (n + 1, most, ...); NaN, of whole numbers 0, where there were none.

    What is remembered of other shapes counts as none. The last window is what is to be remembered.
    """
    old = memory.get(name)
    if old is None or old.shape[1:] != new.shape[1:]:
        old = np.full((most, *new.shape[1:]), np.nan if new.dtype.kind == "f" else 0, new.dtype)
    both = np.concatenate([old, new])
    shape, strides = (len(both) - most + 1, most, *both.shape[1:]), (both.strides[0], *both.strides)
    return np.lib.stride_tricks.as_strided(both, shape, strides, writeable=False)


def sums(memory: Memory, name: str, new: NDArray[Any]) -> NDArray[Any]:
    """Return the sums of all rows up to each new one, shape (n + 1, c). The last row is what is to be remembered, with its axis."""
    start = memory.get(name, np.zeros((1, new.shape[1]), new.dtype))
    return np.cumsum(np.concatenate([start, new]), axis=0)


def spaced(
    values: Iterable[Any], before: Sequence[Any], apart: Callable[[Any, Any], bool]
) -> Indices:
    """Return the places of values that are apart from the last one chosen, of those before at first; where none is, the first is."""
    last, chosen = before[-1:], list[int]()
    for i, value in enumerate(values):
        if not last or apart(last[0], value):
            chosen.append(i)
            last = [value]
    return np.array(chosen, np.intp)


def history(
    memory: Memory, rows: Rows, names: Iterable[str], seconds: float, most: int, of: str = ""
) -> tuple[Rows, dict[str, NDArray[Any]]]:
    """Return the rows that are remembered and new ones, so many seconds apart at least, and what is remembered after them.

    ``number`` is how many there have been with each.

    Args:
        memory: Columns, up to ``most`` rows, by their names with ``of`` before them.
        rows: The new ones.
        names: Of the columns that are remembered, ``time`` among them.
        seconds: Between two of them.
        most: Number of rows that are remembered.
        of: Tells histories in one memory apart.
    """
    new = replace(rows, columns={"number": rows.event, **{name: rows[name] for name in names}})
    old = {name: memory.get(of + name, values[:0]) for name, values in new.columns.items()}
    times, least, at = old["time"].tolist(), seconds * 1e9, list[int]()
    last = times[-1] if times else -math.inf
    for i, time in enumerate(new["time"].tolist()):
        if not -least < time - last < least:
            at.append(i)
            last = time
    new = new.take(np.array(at, np.intp))
    new = new.having(number=old["number"][-1:].sum() + np.arange(1, len(new) + 1))
    columns = {name: np.concatenate([old[name], new[name]]) for name in old}
    event = np.concatenate([np.full(len(times), -1), new.event])
    after = {of + name: values[-most:] for name, values in columns.items()}
    return replace(rows, event=event, columns=columns), after


def steps(places: Memory | Rows) -> tuple[NDArray[np.complex128], Array]:
    """Return the way from each place to the next, east + i north [m], and the time from one to the other [s], shapes (n - 1,)."""
    latitude, longitude = places["latitude"], places["longitude"]
    scale = [metres_per_degree(one) for one in latitude[:-1].tolist()]
    east, north = np.reshape(scale, (-1, 2)).T
    degrees = (np.diff(longitude) + 180.0) % 360.0 - 180.0
    return east * degrees + 1j * north * np.diff(latitude), np.diff(places["time"]) * 1e-9


def total(values: Array) -> Array:
    """Return sums along the second axis, one value after the other: what is padded with zeros has the same sum to the last bit."""
    return np.asarray(np.cumsum(values, axis=1)[:, -1:].sum(axis=1))


def upper_median(values: Array, known: Mask) -> Array:
    """Return the upper median of the known values of each row, shape (n,); infinity of a row without any."""
    none = np.full((len(values), 1), np.inf)
    ordered = np.sort(np.hstack([np.where(known, values, np.inf), none]), axis=1)
    return np.asarray(ordered[np.arange(len(ordered)), known.sum(axis=1) // 2])


def mean_of(values: Array, known: Holds) -> Array:
    """Return the mean of the known values of each row, shape (n,); 0 of a row without any."""
    return np.asarray(total(np.where(known, values, 0.0)) / np.maximum(known.sum(axis=1), 1))
