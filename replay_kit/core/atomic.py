"""Files that are written completely or not at all."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from replay_kit.core.errors import ConfigError


@contextmanager
def atomic_file(path: Path, check: Callable[[Path], None] | None = None) -> Iterator[BinaryIO]:
    """Yield a binary file named ``PATH.part`` that is renamed to PATH when the block ends; an error or interrupt leaves the part.

    Args:
        path: The final name; a file of that name is replaced.
        check: Called with the complete part on the disk; if it raises, the part is not renamed.

    Raises:
        ConfigError: The file cannot be created or written.
    """
    part = path.with_name(path.name + ".part")
    try:
        file = open(part, "wb")  # noqa: SIM115 - closed below, before the rename
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another place") from error
    with file:
        yield file
        file.flush()
        os.fsync(file.fileno())
    if check is not None:
        check(part)
    os.replace(part, path)
    sync(path.parent)


def sync(path: Path) -> None:
    """Force a file or folder to the disk, so that a rename never outlives its content after a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
