"""Headers, sensor lists and compression of a Slocum's binary files.

A file begins with lines ``key: value``. The list of its sensors follows, or lies in a cache that is named after the list's checksum
(``sensor_list_factored``). Compressed files and caches are LZ4 blocks, each after its length as two bytes, high byte first.
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
    """A file's bytes.

    Attributes:
        data: Decompressed; as they are of a file that is not compressed.
        lost_at: Byte of the compressed file at which the first block that cannot be decompressed begins; -1 when there is none.
    """

    data: bytes
    lost_at: int


def unpacked(stored: bytes, most: int = 1 << 40) -> Unpacked:
    """Return the bytes of a file, decompressed up to the first damaged block where they are compressed.

    Args:
        stored: The file.
        most: Enough bytes; blocks after them are left out.
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
    """A sensor whose values a file holds: its name, the bytes of a value, its unit."""

    name: str
    size: int
    unit: str


@dataclass(frozen=True)
class Header:
    """The header of a file.

    Attributes:
        path: The file.
        tags: Its lines, key to value.
        size: Its length [bytes], in the decompressed file.
    """

    path: Path
    tags: Mapping[str, str]
    size: int

    @cached_property
    def segment(self) -> str:
        """Name of the segment, which the files of both computers share: ``vehicle-year-day-mission-segment``."""
        return self.tags["full_filename"]

    @property
    def vehicle(self) -> str:
        """Name of the glider."""
        match = _SEGMENT.fullmatch(self.segment)
        return match[1] if match else self.segment

    @property
    def is_science(self) -> bool:
        """Whether the science computer wrote it."""
        return "." + self.tags["filename_extension"].lower() in SCIENCE

    @property
    def cache(self) -> str:
        """Name of its list of sensors, in lower case and without an ending; empty where the list is in the file."""
        return self.tags["sensor_list_crc"].lower() if self.tags["factored"] == "1" else ""

    @property
    def number(self) -> tuple[int, ...]:
        """The numbers in the segment's name, by which segments are in order of time."""
        return tuple(map(int, re.findall(r"\d{1,9}", self.segment.removeprefix(self.vehicle))))


_NEEDED = ("full_filename", "filename_extension", "sensors_per_cycle", "state_bytes_per_cycle")


def read_header(path: Path, data: bytes) -> Header:
    """Return the header of a file.

    Args:
        path: The file, for errors.
        data: Its first bytes, decompressed.

    Raises:
        LogError: The header is not whole, or a line of it is missing or not understood.
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
    """Return the header of a file of which only the first bytes are read.

    Raises:
        LogError: As of ``read_header``; or the file cannot be read.
    """
    with open_input(path) as file:
        head = file.read(_BLOCK + 2)
    return read_header(path, unpacked(head, 1).data[:_LARGEST_HEADER])


def read_sensors(header: Header, text: bytes, where: str) -> tuple[tuple[Sensor, ...], int]:
    """Return the sensors of a file in the order of their values, and the length of the list [bytes].

    Args:
        header: Of the file.
        text: Begins with the list.
        where: What holds the list, for errors.

    Raises:
        LogError: The list is not whole, or does not fit the header.
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
    """The caches of sensor lists near the files of a log; each folder is listed once, each list read once."""

    def __init__(self, folder: Path | None = None) -> None:
        """Begin with none.

        Args:
            folder: Holds the caches; None to look beside the files and in ``cac`` and ``cache`` there and in the three folders above.
        """
        self._folder = folder
        self._listed: dict[Path, dict[str, Path]] = {}
        self._texts: dict[Path, bytes] = {}

    def find(self, header: Header) -> tuple[Path, bytes]:
        """Return the cache of a file and its text.

        Raises:
            LogError: There is none.
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
