"""Files that are written completely or not at all."""

import os
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
        ConfigError: The file cannot be created.
        ReplayKitError: It cannot be written to its end, as on a full disk.
    """
    part = path.with_name(path.name + ".part")
    try:
        file = open(part, "wb")  # noqa: SIM115 - closed below, before the rename
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another place") from error
    with stored(part), file:
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
        raise ReplayKitError(f"{path}: cannot be written: {error.strerror or error}; is the disk full? Make room, and run again") from error


def sync(path: Path) -> None:
    """Force a file or folder to the disk, so that a rename never outlives its content after a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
