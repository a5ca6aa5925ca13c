"""An open result: its readers share one file, each with a place of its own in it."""

import io
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, cast

from replay_kit.core.inputs import open_input


class Opened:
    """A result that is open for as long as anything refers to it.

    Attributes:
        number: Its file descriptor.
    """

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            OSError: It cannot be opened, or can be no input.
        """
        with open_input(path) as file:
            self.number = os.dup(file.fileno())
        weakref.finalize(self, os.close, self.number)


_OPEN: weakref.WeakValueDictionary[Path, Opened] = weakref.WeakValueDictionary()


def opened(path: Path) -> Opened:
    """Return a result that is open; one that was replaced, or has grown, is opened anew.

    Raises:
        OSError: As of ``Opened``.
    """
    held = _OPEN.get(path)
    if held is None or _identity(os.fstat(held.number)) != _identity(os.stat(path)):
        held = _OPEN[path] = Opened(path)
    return held


@contextmanager
def shared(path: Path) -> Iterator[None]:
    """Keep a result open for all its readers within a block; one that cannot be opened they refuse."""
    held = None
    with suppress(OSError):
        held = opened(path)
    yield
    del held


def _identity(found: os.stat_result) -> tuple[int, ...]:
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class _Place(io.RawIOBase):
    """A place in an open file."""

    def __init__(self, of: Opened) -> None:
        super().__init__()
        self._of, self._at = of, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._of.number

    def readinto(self, buffer: "memoryview[int]") -> int:  # type: ignore[override]
        data = os.pread(self._of.number, len(buffer), self._at)
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        begins = (0, self._at, os.fstat(self._of.number).st_size)
        self._at = begins[whence] + offset
        return self._at


def stream(path: Path) -> BinaryIO:
    """Return a result from its beginning on, to be read and closed as a file of its own.

    Raises:
        OSError: As of ``Opened``.
    """
    return cast(BinaryIO, io.BufferedReader(_Place(opened(path))))
