"""Files that appear whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from replay_kit.errors import ConfigError


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Give a binary file named ``PATH.part`` that takes its name when the block ends; an error or interrupt leaves the part.

    Args:
        path: The final name; a file of that name is replaced.

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
    os.replace(part, path)
