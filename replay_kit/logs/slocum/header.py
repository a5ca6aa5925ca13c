"""Headers, sensor lists and compression of Slocum binary files.

A file begins with lines ``key: value``. The list of sensors follows, or is in a cache named after its checksum (``sensor_list_factored``).
Compressed files and caches are LZ4 blocks, each after its length as two bytes, big-endian.
"""

import re
from collections.abc import Callable, Mapping
from itertools import product
from pathlib import Path
from typing import NamedTuple

import lz4.block  # type: ignore[import-untyped]

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


def unpacked(stored: bytes, most: int = 1 << 40) -> tuple[bytes, int]:
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
        return read_header(path, unpacked(read_bytes(path, _BLOCK + 2), 1)[0][:_LARGEST_HEADER])
    except LogError:
        return None


def sensor_list(path: Path) -> bytes:
    """Return the contents of a cache, decompressed."""
    return unpacked(read_bytes(path, _LARGEST_LIST), _LARGEST_LIST)[0]


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
