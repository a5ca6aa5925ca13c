"""The journal of a result: from it the result of an interrupted run is written again, byte for byte.

The library that writes results cannot continue an unfinished file, but the same calls in the same order give the same bytes; the journal
records these calls. An entry is the lengths of its head (JSON) and its data, the CRC-32 of all heads and data so far, then both.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, BinaryIO

import orjson

from replay_kit.core.atomic import claim, stored
from replay_kit.core.errors import ConfigError, LogError

_MAGIC = b"replay-kit journal 2\n"
# One of an earlier version is of no use, and is replaced.
_ANY_MAGIC = _MAGIC[:-2]
_ENTRY = struct.Struct("<III")

#: A place between two entries: bytes before it, CRC-32 of all heads and data before it.
Place = tuple[int, int]
#: Where a run begins.
BEGIN: Place = (0, 0)


class Journal:
    """An append-only file of heads and data."""

    def __init__(self, path: Path, place: Place = BEGIN) -> None:
        """Open the file and cut off what follows its first bytes, which the interrupted run had not confirmed.

        Args:
            path: The file; it is created when it does not exist.
            place: Up to where it is kept.

        Raises:
            ConfigError: It cannot be opened or written, or is another kind of file.
            LogError: It holds fewer bytes.
        """
        self.path, (length, self._crc) = path, place
        try:
            with ExitStack() as stack:
                self._file: BinaryIO = stack.enter_context(path.open("a+b"))
                claim(self._file, path)
                self._file.seek(0)
                if (head := self._file.read(len(_MAGIC))) and not head.startswith(_ANY_MAGIC):
                    raise ConfigError(
                        f"{path}: exists and is no journal of a checkpoint; choose another name for the checkpoint"
                    )
                if (size := os.fstat(self._file.fileno()).st_size) < length:
                    raise LogError(
                        f"{path}: expected at least {length} bytes, got {size}; delete the checkpoint to begin anew"
                    )
                stack.pop_all()
            self._file.truncate(length)
            if not length:
                self._file.write(_MAGIC)
            self._length = length or len(_MAGIC)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be written: {error.strerror}; choose another place for the checkpoint"
            ) from error

    def append(self, head: dict[str, Any], data: bytes) -> None:
        """Append an entry; it is safe on the disk after ``flushed``."""
        text = orjson.dumps(head)
        self._crc = zlib.crc32(data, zlib.crc32(text, self._crc))
        with stored(self.path):
            self._length += self._file.write(
                _ENTRY.pack(len(text), len(data), self._crc) + text + data
            )

    @property
    def place(self) -> Place:
        """Where the last entry ends."""
        return self._length, self._crc

    def flushed(self) -> Place:
        """Force everything to the disk and return where it ends."""
        with stored(self.path):
            self._file.flush()
            os.fsync(self._file.fileno())
        return self.place

    def close(self) -> None:
        """Close the file; it stays. What was not confirmed by ``flushed`` may be missing, as on a full disk."""
        with suppress(OSError):
            self._file.close()


def read_journal(path: Path, end: Place) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Yield the entries of a journal before a place.

    Raises:
        LogError: It is shorter, or damaged.
    """
    (length, last), crc = end, 0
    try:
        with path.open("rb") as file:
            file.seek(len(_MAGIC))
            while (start := file.tell()) < length:
                head_size, data_size, stated = _ENTRY.unpack(file.read(_ENTRY.size))
                if start + _ENTRY.size + head_size + data_size > length:
                    raise ValueError("an entry is longer than the journal")
                text, data = file.read(head_size), file.read(data_size)
                crc = zlib.crc32(data, zlib.crc32(text, crc))
                if crc != stated:
                    raise ValueError("a checksum does not match")
                yield orjson.loads(text), data
        if crc != last:
            raise ValueError("it is of another run than the checkpoint")
    except (OSError, struct.error, ValueError) as error:
        raise LogError(
            f"{path}: the journal of the interrupted run is damaged: {error}; delete the checkpoint to begin anew"
        ) from error
