"""Arrays of frozen values: read-only float64, large ones on disk; and a fast ``replace``."""

import dataclasses
import math
import mmap
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, reduce
from operator import and_, attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import ReplayKitError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Times = NDArray[np.int64]
#: Members of a forecast, in their file's precision.
Values = NDArray[np.floating]

#: Largest array that is kept in memory [bytes].
IN_MEMORY = 1 << 30


def all_along(holds: Any) -> Mask:
    """Return the logical and along a short last axis, faster than numpy's ``all``."""
    return np.asarray(reduce(and_, np.moveaxis(holds, -1, 0)))


def points_over(*axes: Array) -> Array:
    """Return the points of a regular grid, shape (n, 2), the first of two axes varying fastest."""
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def large_array(shape: tuple[int, ...], dtype: np.dtype[np.floating]) -> Values:
    """Return an array to be filled, in memory up to ``IN_MEMORY``, else in a temporary file that vanishes with it.

    Raises:
        ReplayKitError: The folder of temporary files has no room for it.
    """
    size = dtype.itemsize * math.prod(shape)
    if size <= IN_MEMORY:
        return np.empty(shape, dtype)
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
    return np.frombuffer(mapped, dtype).reshape(shape)


def one_by_one(array: Values) -> Iterator[Values]:
    """Yield the parts of an array along its first axis; releases each part of an array on disk before the next."""
    for part in array:
        yield part
        release(array)


def release(array: Values) -> None:
    """Release the memory of the parts of an array on disk that were read; no effect on an array in memory."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    mapped = base.obj if isinstance(base, memoryview) else base
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


if TYPE_CHECKING:
    # checks the names and types of changes
    from dataclasses import replace as replace
else:

    def replace(value, /, **changes):
        """Return a dataclass instance with some fields changed.

        Six times as fast as ``dataclasses.replace``: the fields are set in a mutable class of the same slots, whose instance then becomes
        one of the frozen class.

        Args:
            value: Instance; one of a class without slots takes as long as in the standard library.
            changes: New values by field.
        """
        kind = type(value)
        parts = _parts(kind)
        if parts is None:
            return dataclasses.replace(value, **changes)
        held, open_kind = parts
        new = open_kind(*held(value))
        for name, part in changes.items():
            setattr(new, name, part)
        new.__class__ = kind
        return new


@cache
def _parts(kind: type[Any]) -> tuple[Callable[[Any], tuple[Any, ...]], type[Any]] | None:
    """Return the getter of all fields of a class and its mutable twin; None where construction does more than store the fields."""
    names = tuple(field.name for field in dataclasses.fields(kind) if field.init)
    only_slots = kind.__bases__ == (object,) and vars(kind).get("__slots__") == names
    # of one name ``attrgetter`` returns no tuple
    if not only_slots or len(names) < 2 or hasattr(kind, "__post_init__"):
        return None
    opened = dataclasses.make_dataclass(kind.__name__, names, slots=True, repr=False, eq=False)
    opened.__init__.__defaults__ = kind.__init__.__defaults__  # type: ignore[misc]
    return attrgetter(*names), opened
