"""Slocum binary files: header, list of sensors, compression; cycles with the sensors written in each, and their values.

A file begins with lines ``key: value``. The list of sensors follows, or is in a cache named after its checksum (``sensor_list_factored``).
Compressed files and caches are LZ4 blocks, each after its length as two bytes, big-endian. A cycle is a tag, two bits per sensor (0 not
written, 1 unchanged, 2 new value), and the new values. Its start follows from the previous one; all else is read for many at once.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import lz4.block  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.errors import LogError
from replay_kit.logs.reader import read_bytes

#: Endings of the files of the flight and the science computer, in lower case: all sensors before subsets, raw before compressed.
FLIGHT = (".dbd", ".dcd", ".mbd", ".mcd", ".sbd", ".scd")
SCIENCE = (".ebd", ".ecd", ".nbd", ".ncd", ".tbd", ".tcd")
_CACHES = (".cac", ".CAC", ".ccc", ".CCC")
# LZ4 writes the first bytes of a block as they are, after the block's length and their number
_COMPRESSED = re.compile(rb".{3,5}(?:dbd_label:|s: [TF] )", re.DOTALL)
_BLOCK = 1 << 16
# a list of sensors has some 120 kB; a file is compressed to a fifth of its size
_LARGEST_LIST, _LARGEST_RATIO, _LARGEST_HEADER = 1 << 21, 32, 1 << 14
_MOST_TAGS, _MOST_SENSORS = 64, 8192
_SEGMENT = re.compile(r"(.+)-\d{4}-\d{1,3}-\d+-\d+")
_SENSOR = re.compile(rb"s: ([TF]) +(\d{1,5}) +(-?\d{1,5}) +([1248]) (\S+) (\S*)[^\n]*\n")


def unpacked_file(stored: bytes, most: int = 1 << 40) -> tuple[bytes, int]:
    """Return the bytes of a file, decompressed up to the first damaged block, and the offset of that; -1 without one.

    Args:
        stored: Bytes of the file.
        most: Number of bytes after which no further block is decompressed.
    """
    if not _COMPRESSED.match(stored):
        return stored, -1
    most = min(most, len(stored) * _LARGEST_RATIO + _BLOCK)
    found, at = bytearray(), 0
    while at < len(stored) and len(found) < most:
        end = at + 2 + int.from_bytes(stored[at : at + 2], "big")
        try:
            if end > len(stored):
                raise ValueError("cut off")
            found += lz4.block.decompress(stored[at + 2 : end], uncompressed_size=_BLOCK)
        except (lz4.block.LZ4BlockError, ValueError):
            return bytes(found), at
        at = end
    return bytes(found), -1


class Sensor(NamedTuple):
    """Sensor of a file: name, bytes per value, unit."""

    name: str
    size: int
    unit: str


class Header(NamedTuple):
    """Header of a file.

    Attributes:
        path: The file.
        tags: Lines, key to value.
        size: Length in the decompressed file [bytes].
    """

    path: Path
    tags: Mapping[str, str]
    size: int

    @property
    def segment(self) -> str:
        """Name of the segment, common to the files of both computers: ``vehicle-year-day-mission-segment``."""
        return self.tags["full_filename"]

    @property
    def vehicle(self) -> str:
        """Name of the glider."""
        match = _SEGMENT.fullmatch(self.segment)
        return match[1] if match else self.segment

    @property
    def is_science(self) -> bool:
        """Whether the science computer wrote the file."""
        return "." + self.tags["filename_extension"].lower() in SCIENCE

    @property
    def order(self) -> tuple[list[int], str]:
        """Sort key of segments in time: the numbers in the segment's name."""
        numbers = re.findall(r"\d{1,9}", self.segment.removeprefix(self.vehicle))
        return [*map(int, numbers)], self.segment


_NEEDED = ("full_filename", "filename_extension", "sensors_per_cycle", "state_bytes_per_cycle")


def read_header(path: Path, data: bytes) -> Header:
    """Return the header of a file.

    Args:
        path: File named in errors.
        data: Its first bytes, decompressed.

    Raises:
        LogError: The header is incomplete, or a line is missing or invalid.
    """
    tags: dict[str, str] = {}
    at = 0
    while len(tags) < _MOST_TAGS and (end := data.find(b"\n", at, at + 512)) >= 0:
        key, _, value = data[at:end].decode("ascii", "replace").partition(":")
        tags[key.strip()] = value.strip()
        at = end + 1
        if tags.get("num_ascii_tags") == str(len(tags)):
            break
    lacking = [key for key in _NEEDED if not tags.get(key)]
    checksum = re.fullmatch(r"[0-9A-Fa-f]{1,8}", tags.get("sensor_list_crc", ""))
    if tags.get("sensor_list_factored") == "1" and not checksum:
        lacking.append("sensor_list_crc")
    if lacking or tags.get("num_ascii_tags") != str(len(tags)):
        raise LogError(
            f"{path}: expected the header of a Slocum's file, got {len(tags)} lines of it, without {', '.join(lacking) or 'its end'}; "
            "copy it again"
        )
    return Header(path, tags, at)


def first_header(path: Path) -> Header | None:
    """Return the header of a file, reading only its first bytes; None if that cannot be read."""
    try:
        return read_header(
            path, unpacked_file(read_bytes(path, _BLOCK + 2), 1)[0][:_LARGEST_HEADER]
        )
    except LogError:
        return None


def sensor_list(path: Path) -> bytes:
    """Return the contents of a cache, decompressed."""
    return unpacked_file(read_bytes(path, _LARGEST_LIST), _LARGEST_LIST)[0]


def sensors_of(
    header: Header,
    data: bytes,
    caches: Path | None = None,
    list_of: Callable[[Path], bytes] = sensor_list,
) -> tuple[list[Sensor], int]:
    """Return the sensors of a file in the order of their values, and the offset of its first cycle.

    Args:
        header: Header of the file.
        data: The file, decompressed.
        caches: Folder of the lists of sensors; None to search the file's folder, ``cac`` and ``cache`` in it, and the three folders above.
        list_of: ``sensor_list``, or what remembers it.

    Raises:
        LogError: The list is missing, incomplete or does not match the header.
    """
    if header.tags.get("sensor_list_factored") == "1":
        path = _cache_of(header, caches)
        return _parsed(header, list_of(path), path)[0], header.size
    sensors, length = _parsed(header, data[header.size :], header.path)
    return sensors, header.size + length


def _cache_of(header: Header, caches: Path | None) -> Path:
    """Return the path of the cache of a file, whose name may be in capitals."""
    name, near = header.tags["sensor_list_crc"], header.path.resolve().parents
    folders = [near[0], *(up / part for up in near[:4] for part in ("cac", "cache"))]
    names = [spelt + ending for spelt in (name.lower(), name.upper()) for ending in _CACHES]
    for folder, held in product(folders if caches is None else [caches], names):
        if (path := folder / held).is_file():
            return path
    raise LogError(
        f"{header.path}: expected its list of sensors in {name.lower()}.cac, there is none in {caches or header.path.parent / 'cac'}; "
        "copy it from the glider (state/cache), or set logs.caches"
    )


def _parsed(header: Header, text: bytes, where: Path) -> tuple[list[Sensor], int]:
    """Return the sensors of a list and its length [bytes].

    Raises:
        LogError: The list is incomplete or does not match the header.
    """
    held: dict[int, Sensor] = {}
    at, count = 0, 0
    while match := _SENSOR.match(text, at):
        at, count = match.end(), count + 1
        if match[1] == b"T":
            name, unit = (match[k].decode("ascii", "replace") for k in (5, 6))
            held[int(match[3])] = Sensor(name, int(match[4]), unit)
    n = len(held)
    expected = header.tags["sensors_per_cycle"], header.tags["state_bytes_per_cycle"]
    whole = n <= _MOST_SENSORS and sorted(held) == list(range(n))
    if not whole or (str(n), str((n + 3) // 4)) != expected:
        raise LogError(
            f"{where}: expected {expected[0][:12]} sensors in {expected[1][:12]} bytes of states a cycle, as {header.path.name} states, "
            f"got {n} in {count} lines; copy it again"
        )
    return [held[k] for k in range(n)], at


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
    states = (len(sensors) + 3) // 4
    chosen = [k for k, one in enumerate(sensors) if one.name in wanted]
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


def _last_values(values: Array, new: Mask, runs: NDArray[np.int64]) -> Array:
    """Return the last new value at each cycle; NaN before the first one of each run."""
    cycle = np.arange(values.size)
    last = np.maximum.accumulate(np.where(new, cycle, -1))
    first = runs[np.searchsorted(runs, cycle, side="right") - 1]
    return np.where(last >= first, values[last], np.nan)
