"""Headers, sensor lists and compression of Slocum binary files.

A file begins with lines ``key: value``. The list of sensors follows, or is in a cache named after its checksum (``sensor_list_factored``).
Compressed files and caches are LZ4 blocks, each after its length as two bytes, big-endian.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import lz4.block  # type: ignore[import-untyped]

from replay_kit.core.errors import LogError
from replay_kit.core.inputs import open_input

#: Endings of the files, in lower case: flight computer, then science computer; all sensors before subsets, raw before compressed.
FLIGHT = (".dbd", ".mbd", ".sbd", ".dcd", ".mcd", ".scd")
SCIENCE = (".ebd", ".nbd", ".tbd", ".ecd", ".ncd", ".tcd")
#: Endings of the caches.
CACHES = (".cac", ".ccc")
# LZ4 writes the first bytes of a block as they are, after the block's length and their number
_COMPRESSED = re.compile(rb".{3,5}dbd_label:", re.DOTALL)
_COMPRESSED_LIST = re.compile(rb".{3,5}s: [TF] ", re.DOTALL)
_BLOCK = 1 << 16
# a list of sensors has some 120 kB; a file is compressed to a fifth of its size
_LARGEST_LIST, _LARGEST_RATIO, _LARGEST_HEADER = 1 << 21, 32, 1 << 14
_MOST_TAGS, _MOST_SENSORS = 64, 8192
_SEGMENT = re.compile(r"(.+)-\d{4}-\d{1,3}-\d+-\d+")
_SENSOR = re.compile(rb"s: ([TF]) +(\d{1,5}) +(-?\d{1,5}) +([1248]) (\S+) (\S*)[^\n]*\n")


class Unpacked(NamedTuple):
    """Decompressed bytes of a file.

    Attributes:
        data: Bytes, unchanged for an uncompressed file.
        lost_at: Offset of the first damaged block in the compressed file; -1 without one.
    """

    data: bytes
    lost_at: int


def unpacked(stored: bytes, most: int = 1 << 40) -> Unpacked:
    """Return the bytes of a file, decompressed up to the first damaged block.

    Args:
        stored: Bytes of the file.
        most: Number of bytes after which no further block is decompressed.
    """
    if not (_COMPRESSED.match(stored) or _COMPRESSED_LIST.match(stored)):
        return Unpacked(stored, -1)
    most = min(most, len(stored) * _LARGEST_RATIO + _BLOCK)
    blocks, at, size = [], 0, 0
    while at < len(stored) and size < most:
        length = int.from_bytes(stored[at : at + 2], "big")
        block = stored[at + 2 : at + 2 + length]
        try:
            blocks.append(lz4.block.decompress(block, uncompressed_size=_BLOCK))
        except (lz4.block.LZ4BlockError, ValueError):
            return Unpacked(b"".join(blocks), at)
        if len(block) < length:
            return Unpacked(b"".join(blocks[:-1]), at)
        size += len(blocks[-1])
        at += 2 + length
    return Unpacked(b"".join(blocks), -1)


class Sensor(NamedTuple):
    """Sensor of a file: name, bytes per value, unit."""

    name: str
    size: int
    unit: str


@dataclass(frozen=True)
class Header:
    """Header of a file.

    Attributes:
        path: The file.
        tags: Lines, key to value.
        size: Length in the decompressed file [bytes].
    """

    path: Path
    tags: Mapping[str, str]
    size: int

    @cached_property
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
    def cache(self) -> str:
        """Name of the cache of the sensor list, in lower case without ending; empty if the list is in the file."""
        return self.tags["sensor_list_crc"].lower() if self.tags["factored"] == "1" else ""

    @property
    def number(self) -> tuple[int, ...]:
        """Numbers in the segment's name, which order segments in time."""
        return tuple(map(int, re.findall(r"\d{1,9}", self.segment.removeprefix(self.vehicle))))


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
    for _ in range(_MOST_TAGS):
        end = data.find(b"\n", at, at + 512)
        if end < 0:
            break
        key, _, value = data[at:end].decode("ascii", "replace").partition(":")
        tags[key.strip()] = value.strip()
        at = end + 1
        if tags.get("num_ascii_tags") == str(len(tags)):
            break
    lacking = [key for key in _NEEDED if not tags.get(key)]
    factored = tags.get("sensor_list_factored", "0")
    if factored == "1" and not re.fullmatch(r"[0-9A-Fa-f]{1,8}", tags.get("sensor_list_crc", "")):
        lacking.append("sensor_list_crc")
    if lacking or tags.get("num_ascii_tags") != str(len(tags)):
        raise LogError(
            f"{path}: expected the header of a Slocum's file, got {len(tags)} lines of it, without {', '.join(lacking) or 'its end'}; "
            "copy the file from the glider again"
        )
    return Header(path, MappingProxyType(tags | {"factored": factored}), at)


def first_header(path: Path) -> Header:
    """Return the header of a file, reading only its first bytes.

    Raises:
        LogError: See ``read_header``; or the file cannot be read.
    """
    with open_input(path) as file:
        head = file.read(_BLOCK + 2)
    return read_header(path, unpacked(head, 1).data[:_LARGEST_HEADER])


def read_sensors(header: Header, text: bytes, where: str) -> tuple[tuple[Sensor, ...], int]:
    """Return the sensors of a file in the order of their values, and the length of the list [bytes].

    Args:
        header: Header of the file.
        text: Bytes that begin with the list.
        where: Source of the list in errors.

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
    expected, states = header.tags["sensors_per_cycle"], header.tags["state_bytes_per_cycle"]
    if (
        len(held) > _MOST_SENSORS
        or str(len(held)) != expected
        or sorted(held) != list(range(len(held)))
        or str((len(held) + 3) // 4) != states
    ):
        raise LogError(
            f"{where}: expected {expected[:12]} sensors in {states[:12]} bytes of states a cycle, as {header.path.name} states, "
            f"got {len(held)} in {count} lines; copy the list from the glider again"
        )
    return tuple(held[k] for k in sorted(held)), at


class SensorLists:
    """Caches of sensor lists near the files of a log; each folder is listed and each list read once."""

    def __init__(self, folder: Path | None = None) -> None:
        """Create an empty collection.

        Args:
            folder: Folder of the caches; None to search the file's folder, ``cac`` and ``cache`` in it, and the three folders above.
        """
        self._folder = folder
        self._listed: dict[Path, dict[str, Path]] = {}
        self._texts: dict[Path, bytes] = {}

    def find(self, header: Header) -> tuple[Path, bytes]:
        """Return the path and contents of the cache of a file.

        Raises:
            LogError: The cache is missing.
        """
        near = header.path.resolve().parents
        folders = (
            [self._folder]
            if self._folder is not None
            else [near[0], *(up / name for up in near[:4] for name in ("cac", "cache"))]
        )
        for folder in folders:
            path = self._list(folder).get(header.cache)
            if path is not None:
                return path, self._text(path)
        place = self._folder or header.path.parent / "cac"
        raise LogError(
            f"{header.path}: expected its list of sensors in {header.cache}.cac, there is none in {place}; copy it from the glider "
            "(state/cache) or from the shore server, or set logs.caches"
        )

    def _list(self, folder: Path) -> dict[str, Path]:
        if folder not in self._listed:
            try:
                held = sorted(folder.iterdir(), reverse=True)
            except OSError:
                held = []
            self._listed[folder] = {
                path.stem.lower(): path for path in held if path.suffix.lower() in CACHES
            }
        return self._listed[folder]

    def _text(self, path: Path) -> bytes:
        if path not in self._texts:
            try:
                with open_input(path) as file:
                    self._texts[path] = unpacked(file.read(_LARGEST_LIST), _LARGEST_LIST).data
            except OSError as error:
                raise LogError(
                    f"{path}: cannot be read: {error.strerror}; check its permissions"
                ) from error
        return self._texts[path]
