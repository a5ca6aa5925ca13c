"""What every check is made of: rows of a block, what is remembered between blocks, and the first row at which a criterion holds.

A check is a fold: from what it remembers, arrays by name, and the rows of a block, to what it remembers after them and what it found. A
criterion is evaluated at every row, by sums and windows that go on from what was remembered, so that neither a finding nor a mark depends
on where a log is cut into blocks.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.block import Block
from replay_kit.core.errors import Finding, Severity

#: What a check remembers: arrays by name, whose shapes its docstring states.
Memory = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Found:
    """A finding.

    Attributes:
        event: With which it was established: its place in ``Block.events``.
        finding: The finding.
        unless: Names of findings that explain it, or say more: after any of them it is none.
        of_believed: Whether it is one only of an instrument whose profiles are used.
    """

    event: int
    finding: Finding
    unless: frozenset[str] = frozenset()
    of_believed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows of one kind, in the order of their events.

    Attributes:
        topic: Of the pings; empty of positions and means.
        instrument: By which the pings of one are known; alike.
        event: shape (n,), place of each in ``Block.events``.
        row: shape (n,), place of each in the columns of its kind.
        columns: As of ``Block``, of these rows.
    """

    topic: str
    event: NDArray[np.int64]
    row: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]
    instrument: str = ""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.event)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]

    def take(self, at: NDArray[Any] | slice) -> "Rows":
        """Return some of the rows."""
        columns = {name: values[at] for name, values in self.columns.items()}
        return Rows(self.topic, self.event[at], self.row[at], columns, self.instrument)

    def having(self, **columns: NDArray[Any]) -> "Rows":
        """Return the rows with columns more, or others."""
        return Rows(self.topic, self.event, self.row, {**self.columns, **columns}, self.instrument)

    def until(self, event: int, most: int) -> "Rows":
        """Return the latest rows up to an event."""
        end = int(np.searchsorted(self.event, event, side="right"))
        return self.take(slice(max(end - most, 0), end))

    def time(self, at: int) -> int:
        """Return the time of a row [ns, UTC]."""
        return int(self.columns["time"][at])

    def found(
        self,
        at: int,
        name: str,
        words: tuple[str, str, str],
        severity: Severity = "inconsistent",
        distrusts: bool = False,
        unless: Iterable[str] = (),
    ) -> Found:
        """Return the finding that a row establishes.

        Args:
            at: The row.
            name: As of ``Finding``.
            words: Evidence, cause and advice; the topic of the pings begins the first.
            severity: As of ``Finding``.
            distrusts: As of ``Finding``.
            unless: As of ``Found``.
        """
        evidence, cause, advice = words
        evidence = f"{self.topic}: {evidence}" if self.topic else evidence
        finding = Finding(name, self.time(at), evidence, cause, advice, severity, distrusts)
        return Found(int(self.event[at]), finding, frozenset(unless))


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What a check of pings is told beside them.

    Attributes:
        ensemble: Speeds of the ensemble's currents; None where nothing is compared.
        through_water: Whether positions under water are dead-reckoned without a current.
        vehicle: Depths and places of the vehicle.
        means: Mean currents of the block.
        named: Names of what was found before the block, by instrument.
    """

    ensemble: Any
    through_water: bool
    vehicle: tuple[Rows, Rows]
    means: Rows
    named: Mapping[str, frozenset[str]]

    def known(self, instrument: str) -> frozenset[str]:
        """Return what was found of an instrument before."""
        return self.named.get(instrument, frozenset())


#: A check of pings: memory, pings of one instrument in order, and what it is told, to memory and what it found.
Fold = Callable[[Memory, Rows, Context], tuple[Memory, list[Found]]]


def rows_of(block: Block, kind: int, topic: int | None = None) -> Rows:
    """Return the rows of a kind, or the pings of the topic of a number."""
    columns = (block.position, block.ping, block.mean)[kind]
    event = np.flatnonzero(block.events[:, 1] == kind)
    if topic is not None:
        event = event[columns["topic"][block.events[event, 2]] == topic]
    row = block.events[event, 2]
    name = "" if topic is None else block.topics[topic]
    return Rows(name, event, row, {key: values[row] for key, values in columns.items()})


def carried(memory: Memory, name: str, new: NDArray[Any], most: int) -> NDArray[Any]:
    """Return the rows that are remembered, ``most`` at most, and the new ones after them; only new ones where the shapes differ."""
    old = memory.get(name)
    if old is None or old.shape[1:] != new.shape[1:]:
        return new
    return np.concatenate([old[len(old) - min(most, len(old)) :], new])


def recalled(memory: Memory, rows: Rows, *names: str) -> Rows:
    """Return the rows that are remembered by some columns, whose event is -1, and new ones after them."""
    old = memory.get(names[0])
    n = 0 if old is None else len(old)
    columns = {
        name: np.concatenate([memory[name], rows[name]]) if n else rows[name] for name in names
    }
    events = np.concatenate([np.full(n, -1), rows.event])
    return Rows(
        rows.topic, events, np.concatenate([np.full(n, -1), rows.row]), columns, rows.instrument
    )


def first(holds: NDArray[Any]) -> int | None:
    """Return the first row at which a criterion holds; None where it does at none."""
    at = np.flatnonzero(holds)
    return int(at[0]) if at.size else None


def total(values: Array) -> Array:
    """Return sums along the second axis, one value after the other: what is padded with zeros has the same sum to the last bit."""
    return np.asarray(np.cumsum(values, axis=1)[:, -1])


def upper_median(values: Array, known: NDArray[np.bool_]) -> Array:
    """Return the upper median of the known values of each row, shape (n,); infinity of a row without any."""
    ordered, number = np.sort(np.where(known, values, np.inf), axis=1), known.sum(axis=1)
    return np.asarray(
        ordered[np.arange(len(ordered)), np.minimum(number // 2, values.shape[1] - 1)]
    )


def mean_of(values: Array, known: NDArray[np.bool_]) -> Array:
    """Return the mean of the known values of each row, shape (n,); 0 of a row without any."""
    return np.asarray(total(np.where(known, values, 0.0)) / np.maximum(known.sum(axis=1), 1))
