"""Files written completely or not at all."""

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from replay_kit.core.errors import ConfigError, ReplayKitError


@contextmanager
def atomic_file(path: Path, check: Callable[[Path], None] | None = None) -> Iterator[BinaryIO]:
    """Yield a binary file named ``PATH.part`` that is renamed to PATH when the block ends; an error or interrupt leaves the part.

    Args:
        path: The final name; a file of that name is replaced.
        check: Called with the complete part on the disk; if it raises, the part is not renamed.

    Raises:
        ConfigError: As of ``open_part``.
        ReplayKitError: It cannot be written to its end, as on a full disk.
    """
    part = part_of(path)
    with stored(part), open_part(path) as file:
        yield file
        file.flush()
        os.fsync(file.fileno())
    if check is not None:
        check(part)
    with stored(path):
        os.replace(part, path)
        sync(path.parent)


@contextmanager
def stored(path: Path) -> Iterator[None]:
    """Turn an error of the disk in the block into one that names the file; one that names another file passes through.

    Args:
        path: The file that is written.

    Raises:
        ReplayKitError: It cannot be written.
    """
    try:
        yield
    except OSError as error:
        if error.filename not in (None, str(path)):
            raise
        raise ReplayKitError(
            f"{path}: cannot be written: {error.strerror or error}; is the disk full? Make room, and run again"
        ) from error


def part_of(path: Path) -> Path:
    """Return the name that an output has until it is complete."""
    return path.with_name(path.name + ".part")


def open_part(path: Path) -> BinaryIO:
    """Return the part of an output, a new file that is open for writing; one left over by an interrupted run is replaced.

    Links are not followed, and what is no file is not written to: who may write in the folder may not choose what else is overwritten.

    Raises:
        ConfigError: The output, or its part, exists and is no file, or the part cannot be created.
    """
    part = part_of(path)
    if path.exists() and not path.is_file():
        raise ConfigError(
            f"{path}: is a folder, device, pipe or socket, not a file; choose another name"
        )
    try:
        if os.path.lexists(part):
            if not stat.S_ISREG(part.lstat().st_mode):
                raise ConfigError(
                    f"{part}: is a link, folder or device, not a file; remove it, or choose another name for {path.name}"
                )
            part.unlink()
        return os.fdopen(
            os.open(
                part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666
            ),
            "wb",
        )
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}; choose another place"
        ) from error


def sync(path: Path) -> None:
    """Force a file or folder to the disk, so that a rename never outlives its content after a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
