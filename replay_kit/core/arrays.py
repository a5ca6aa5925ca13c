"""The array that values hold: float64, never written to after it is made; large ones may lie on disk."""

import math
import mmap
import os
import tempfile
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import ReplayKitError

Array = NDArray[np.float64]

#: Largest array that is kept in memory [bytes].
IN_MEMORY = 1 << 30


def large_array(shape: tuple[int, ...]) -> Array:
    """Return an array to be filled, in memory up to ``IN_MEMORY``, else in a temporary file that vanishes with it.

    Raises:
        ReplayKitError: The folder of temporary files has no room for it.
    """
    size = 8 * math.prod(shape)
    if size <= IN_MEMORY:
        return np.empty(shape)
    try:
        with tempfile.TemporaryFile(prefix="replay-kit-") as file:
            if hasattr(os, "posix_fallocate"):
                # without room, writing to mapped memory would end the process
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            mapped = mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise ReplayKitError(
            f"{tempfile.gettempdir()}: needs {size / 1e9:.1f} GB for an ensemble larger than memory: {error.strerror}; set TMPDIR to a "
            "folder with room, or choose less with --region and --levels"
        ) from error
    return np.frombuffer(mapped).reshape(shape)


def one_by_one(array: Array) -> Iterator[Array]:
    """Yield the parts of an array along its first axis; of one on disk, each is let go before the next."""
    for part in array:
        yield part
        release(array)


def release(array: Array) -> None:
    """Let the memory go that holds parts of an array on disk; they are read again when needed. Of one in memory nothing changes."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    mapped = base.obj if isinstance(base, memoryview) else base
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)
