"""What frozen values are made of: arrays of float64, never written to after they are made, large ones on disk; and a value changed."""

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


def every(holds: Any) -> Mask:
    """Return where something holds of all along the last axis, which are few; numpy's own ``all`` takes far longer of few."""
    return np.asarray(reduce(and_, np.moveaxis(holds, -1, 0)))


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
    """Yield the parts of an array along its first axis; of one on disk, each is let go before the next."""
    for part in array:
        yield part
        release(array)


def release(array: Values) -> None:
    """Let the memory go that holds parts of an array on disk; they are read again when needed. Of one in memory nothing changes."""
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
        """Return a dataclass' value with other values of some fields.

        In a sixth of the time of ``dataclasses.replace``, as a log's loop makes many a ping: a frozen class sets its fields one by one past
        its own refusal; here they are set in an open class of the same slots, whose instance then becomes one of the frozen class.

        Args:
            value: Of a class with slots, or of any other at the standard library's pace.
            changes: By name.
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
    """Return what reads all fields of a class, and its open class; None where constructing a value does more than hold them."""
    names = tuple(field.name for field in dataclasses.fields(kind) if field.init)
    own = kind.__bases__ == (object,) and vars(kind).get("__slots__") == names
    # of one name ``attrgetter`` returns no tuple
    if not own or len(names) < 2 or hasattr(kind, "__post_init__"):
        return None
    opened = dataclasses.make_dataclass(kind.__name__, names, slots=True, repr=False, eq=False)
    opened.__init__.__defaults__ = kind.__init__.__defaults__  # type: ignore[misc]
    return attrgetter(*names), opened
