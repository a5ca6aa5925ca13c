"""Cycles of a Slocum file: the sensors written in each, and their values.

A cycle is a tag, two bits per sensor (0 not written, 1 unchanged, 2 new value), and the new values. The start of a cycle follows from the
previous one; all else is read for many cycles at once.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.logs.slocum.header import Sensor

# the cycle that fixes the order of bytes: "sa", then the numbers 0x1234, 123.456 and 123456789.12345
_NUMBERS = {"i2": 0x1234, "f4": 123.456, "f8": 123456789.12345}
_KNOWN = {
    b"sa" + b"".join(np.array(v, order + kind).tobytes() for kind, v in _NUMBERS.items()): order
    for order in "<>"
}
_CYCLE, _END = b"dX"
_KINDS = {1: "i1", 2: "i2", 4: "f4", 8: "f8"}
# places tried to find a whole cycle after damage, and whole cycles in a row that it takes
_TRIES, _IN_A_ROW = 20_000, 4
_PATTERNS = 1 << 14
_SHIFTS = np.array([6, 4, 2, 0], np.uint8)


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
    lost: Sequence[Lost]


def read_cycles(data: bytes, at: int, sensors: Sequence[Sensor], wanted: Collection[str]) -> Cycles:
    """Return the cycles of a file.

    Args:
        data: Decompressed file.
        at: Offset of the first cycle, after the list of sensors.
        sensors: Sensors in the order of their values.
        wanted: Names of the sensors to return.
    """
    order = _KNOWN.get(data[at : at + 16])
    if order is None:
        what = "expected the 16 known bytes before the first cycle"
        return Cycles({}, {}, [Lost(at, len(data) - at, what)])
    states, chosen = (
        (len(sensors) + 3) // 4,
        [k for k, one in enumerate(sensors) if one.name in wanted],
    )
    sizes = np.zeros(4 * states, np.int64)
    sizes[: len(sensors)] = [sensor.size for sensor in sensors]

    @lru_cache(_PATTERNS)
    def form(pattern: bytes) -> tuple[int, NDArray[np.uint8], NDArray[np.int64]]:
        """Return the bytes of the new values of a cycle by its states, -1 for invalid states; states and offsets of the wanted ones."""
        bits = _bits(np.frombuffer(pattern, np.uint8))
        new = np.where(bits == 2, sizes, 0)
        length = -1 if (bits == 3).any() else int(new.sum())
        return length, bits[chosen], (np.cumsum(new) - new)[chosen]

    starts, runs, lost = _find_cycles(data, at + 16, states, lambda pattern: form(pattern)[0])
    forms = [form(data[start + 1 : start + 1 + states]) for start in starts]
    shape, first = (len(starts), len(chosen)), np.array(starts, np.int64)[:, None] + 1 + states
    written = np.array([bits for _, bits, _ in forms], np.uint8).reshape(shape).T
    offsets = (first + np.array([begin for *_, begin in forms], np.int64).reshape(shape)).T
    raw, values = np.frombuffer(data, np.uint8), np.full(written.shape, np.nan)
    for row, sensor in enumerate(sensors[k] for k in chosen):
        new = written[row] == 2
        found = raw[offsets[row, new][:, None] + np.arange(sensor.size)]
        with np.errstate(invalid="ignore"):
            values[row, new] = found.view(order + _KINDS[sensor.size])[:, 0]
        values[row] = _last_values(values[row], new, np.array(runs))
    names = [sensors[k].name for k in chosen]
    return Cycles(
        dict(zip(names, written, strict=True)), dict(zip(names, values, strict=True)), lost
    )


def _bits(states: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the states of sensors, two bits each, along the last axis."""
    bits = states[..., None] >> _SHIFTS & 3
    return np.asarray(bits.reshape(*states.shape[:-1], 4 * states.shape[-1]))


def _find_cycles(
    data: bytes, at: int, states: int, length: Callable[[bytes], int]
) -> tuple[list[int], list[int], list[Lost]]:
    """Return the starts of the cycles, the first cycle of each intact run, and the damage between runs.

    Args:
        data: Decompressed file.
        at: Offset of the first cycle.
        states: Bytes of the states in a cycle.
        length: Returns the bytes of the new values of a cycle by its states; -1 for invalid states.
    """
    size = len(data)
    # newer firmware writes no mark of the end; what fills the last block of a transfer is no cycle either
    last = len(data.rstrip(b"\0\x1a"))
    starts: list[int] = []
    runs, lost = [0], list[Lost]()
    tries = iter(range(_TRIES))

    def end_of(start: int) -> int:
        """Return the end of a cycle; -1 without a cycle or a tag after it."""
        body = start + 1 + states
        if data[start] != _CYCLE or body > size or (new := length(data[start + 1 : body])) < 0:
            return -1
        end = body + new
        ends = last <= end <= size or (end < size and data[end] in (_CYCLE, _END))
        return end if ends else -1

    def next_run(start: int) -> int:
        """Return the start of the next consecutive cycles after damage; the end of the file without any."""
        for tag, _ in zip(re.compile(b"d").finditer(data, start), tries, strict=False):
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
    return starts, runs, lost


def _last_values(values: Array, new: NDArray[np.bool_], runs: NDArray[np.int64]) -> Array:
    """Return the last new value at each cycle; NaN before the first one of each run."""
    cycle = np.arange(values.size)
    last = np.maximum.accumulate(np.where(new, cycle, -1))
    first = runs[np.searchsorted(runs, cycle, side="right") - 1]
    return np.where(last >= first, values[last], np.nan)
