"""Cycles of a Slocum file: the sensors written in each, and their values.

A cycle is a tag, two bits per sensor (0 not written, 1 unchanged, 2 new value), and the new values. The start of a cycle follows from the
previous one; all else is read for many cycles at once.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.logs.slocum.header import Sensor

# the cycle that fixes the order of bytes: "sa", then the numbers 0x1234, 123.456 and 123456789.12345
_KNOWN = {
    order: b"sa"
    + b"".join(
        np.array(value, f"{order}{kind}").tobytes()
        for value, kind in ((0x1234, "i2"), (123.456, "f4"), (123456789.12345, "f8"))
    )
    for order in "<>"
}
_CYCLE, _END = b"dX"
_TAG = re.compile(rb"d")
_KINDS = {1: "i1", 2: "i2", 4: "f4", 8: "f8"}
# places tried to find a whole cycle after damage, whole cycles in a row that it takes, and cells of one block of cycles
_TRIES, _IN_A_ROW, _CELLS = 20_000, 4, 1 << 21
_PATTERNS = 1 << 14


class Lost(NamedTuple):
    """Bytes outside cycles.

    Attributes:
        offset: Offset of the first.
        size: Number of bytes.
        what: Description of the expected contents.
    """

    offset: int
    size: int
    what: str


class Cycles(NamedTuple):
    """Cycles of a file.

    Attributes:
        written: State of each sensor by cycle, shape (n,): 0 not written, 1 unchanged, 2 new value.
        values: Last value of each sensor by cycle, shape (n,); NaN before the first, and after damage until the next.
        lost: Damaged parts.
    """

    written: Mapping[str, NDArray[np.uint8]]
    values: Mapping[str, Array]
    lost: tuple[Lost, ...]


def read_cycles(data: bytes, at: int, sensors: Sequence[Sensor], wanted: Collection[str]) -> Cycles:
    """Return the cycles of a file.

    Args:
        data: Decompressed file.
        at: Offset of the first cycle, after the list of sensors.
        sensors: Sensors in the order of their values.
        wanted: Names of the sensors to return.
    """
    known = data[at : at + 16]
    order = next((order for order, expected in _KNOWN.items() if known == expected), None)
    if order is None:
        what = "expected the 16 known bytes before the first cycle"
        return Cycles({}, {}, (Lost(at, len(data) - at, what),))
    starts, runs, lost = _find_cycles(data, at + 16, sensors)
    n, rows = starts.size, max(1, _CELLS // max(len(sensors), 1))
    columns = {
        k: (np.zeros(n, np.uint8), np.full(n, np.nan))
        for k, sensor in enumerate(sensors)
        if sensor.name in wanted
    }
    for first in range(0, n, rows):
        block = slice(first, first + rows)
        part = {k: (written[block], values[block]) for k, (written, values) in columns.items()}
        _read_block(data, order, starts[block], sensors, part)
    return Cycles(
        {sensors[k].name: written for k, (written, _) in columns.items()},
        {
            sensors[k].name: _last_values(values, written == 2, runs)
            for k, (written, values) in columns.items()
        },
        lost,
    )


class _Lengths(dict[bytes, int]):
    """Length of the new values of a cycle by its states; -1 for invalid states."""

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        n = (len(sensors) + 3) // 4
        sizes = np.zeros(4 * n, np.int64)
        sizes[: len(sensors)] = [sensor.size for sensor in sensors]
        bits = np.arange(256)[:, None] >> _SHIFTS & 3
        self._table = ((bits == 2) * sizes.reshape(n, 1, 4)).sum(axis=2)
        self._table[:, (bits == 3).any(axis=1)] = -(1 << 20)
        self._rows = np.arange(n)

    def __missing__(self, states: bytes) -> int:
        if len(self) >= _PATTERNS:
            self.clear()
        length = int(self._table[self._rows, np.frombuffer(states, np.uint8)].sum())
        self[states] = max(length, -1)
        return self[states]


_SHIFTS = np.array([6, 4, 2, 0], np.uint8)


def _find_cycles(
    data: bytes, at: int, sensors: Sequence[Sensor]
) -> tuple[NDArray[np.int64], NDArray[np.int64], tuple[Lost, ...]]:
    """Return the starts of the cycles, the first cycle of each intact run, and the damage between runs."""
    lengths, states, size = _Lengths(sensors), (len(sensors) + 3) // 4, len(data)
    # newer firmware writes no mark of the end; what fills the last block of a transfer is no cycle either
    last = len(data.rstrip(b"\0\x1a"))
    starts: list[int] = []
    runs, lost = [0], []
    tries = iter(range(_TRIES))

    def end_of(start: int) -> int:
        """Return the end of a cycle; -1 without a cycle or a tag after it."""
        body = start + 1 + states
        if data[start] != _CYCLE or body > size or (length := lengths[data[start + 1 : body]]) < 0:
            return -1
        end = body + length
        ends = end >= last if end <= size else False
        return end if ends or (end < size and data[end] in (_CYCLE, _END)) else -1

    def next_run(start: int) -> int:
        """Return the start of the next consecutive cycles after damage; the end of the file without any."""
        for tag, _ in zip(_TAG.finditer(data, start), tries, strict=False):
            end = tag.start()
            for _ in range(_IN_A_ROW):
                end = end_of(end)
                if end < 0 or end >= size - 1:
                    break
            if end >= 0:
                return tag.start()
        return size

    while at < last and not (data[at] == _END and at + 1 == last):
        end = end_of(at)
        if end >= 0:
            starts.append(at)
        else:
            end = next_run(at + 1)
            lost.append(Lost(at, end - at, "expected a whole cycle"))
            runs.append(len(starts))
        at = end
    return np.array(starts, np.int64), np.array(runs, np.int64), tuple(lost)


def _read_block(
    data: bytes,
    order: str,
    starts: NDArray[np.int64],
    sensors: Sequence[Sensor],
    wanted: Mapping[int, tuple[NDArray[np.uint8], Array]],
) -> None:
    """Write the states and new values of some cycles into the arrays of the wanted sensors, by sensor index."""
    raw, states = np.frombuffer(data, np.uint8), (len(sensors) + 3) // 4
    bits = raw[starts[:, None] + 1 + np.arange(states)][:, :, None] >> _SHIFTS & 3
    bits = bits.reshape(starts.size, 4 * states)[:, : len(sensors)]
    sizes = np.where(bits == 2, np.array([s.size for s in sensors], np.int32), np.int32(0))
    offsets = np.cumsum(sizes, axis=1, dtype=np.int32) - sizes
    for k, (written, values) in wanted.items():
        written[:] = bits[:, k]
        new = np.flatnonzero(written == 2)
        at = starts[new] + 1 + states + offsets[new, k]
        size = sensors[k].size
        with np.errstate(invalid="ignore"):
            values[new] = raw[at[:, None] + np.arange(size)].view(order + _KINDS[size])[:, 0]


def _last_values(values: Array, new: NDArray[np.bool_], runs: NDArray[np.int64]) -> Array:
    """Return the last new value at each cycle; NaN before the first one of each run."""
    cycle = np.arange(values.size)
    last = np.maximum.accumulate(np.where(new, cycle, -1)) if values.size else cycle
    first = runs[np.searchsorted(runs, cycle, side="right") - 1]
    return np.where(last >= first, values[last], np.nan)
