"""Checks of input files: kind, changes while they are read, and claimed size."""

import errno
import os
import stat
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    import h5py
if sys.platform == "linux":
    import resource

from replay_kit.core.errors import LogError

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISBLK, "a disk"),
    (stat.S_ISCHR, "a device"),
)


def why_no_input(path: Path) -> str:
    """Return why a path cannot be an input; empty for a file or folder, also by a link, and for a missing one.

    Inputs are read several times from any offset, which pipes and devices do not allow.
    """
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        if error.errno not in (errno.ELOOP, errno.ENAMETOOLONG):
            return ""
        return f"{error.strerror}; give the name of a file"
    kind = next((name for holds, name in _KINDS if holds(mode)), "")
    return f"it is {kind}, not a file; save its output to a file, and give that" if kind else ""


def open_input(path: str | Path) -> BinaryIO:
    """Return a file opened for reading; pipes and devices are refused without waiting.

    Raises:
        OSError: The file cannot be opened or is no regular file.
    """
    if why := why_no_input(Path(path)):
        raise OSError(errno.EINVAL, why, str(path))
    return open(path, "rb")


#: Size that any file may declare [bytes], and per byte of the file; forecasts in use have five to twelve.
_FREE, _RATIO = 1 << 25, 100


def exceeds_claim(path: Path, size: int) -> str:
    """Return why a file cannot hold arrays of a size; empty if it can.

    Args:
        path: File or folder of a store.
        size: Size of its arrays in memory [bytes].
    """
    needed = (size - _FREE) / _RATIO
    # what is on a server has limits of its own
    return "" if needed <= 0.0 or not path.exists() else claim_text(size, held_bytes(path, needed))


def claim_text(size: int, held: int) -> str:
    """Return why a file of ``held`` bytes cannot hold arrays of ``size`` bytes; empty if it can."""
    if size <= _FREE + _RATIO * held:
        return ""
    return f"it claims {size / 1e6:.0f} MB of values in a file of {held / 1e6:.3f} MB, more than {_RATIO} times its bytes"


def held_bytes(path: str | os.PathLike[str], enough: float) -> int:
    """Return the bytes of a file, or of the files below a folder, counted up to ``enough``."""
    if not os.path.isdir(path):
        status = os.stat(path)
        # of a file whose bytes were never written all; a file system that says nothing of it says zero
        return min(status.st_size, 512 * status.st_blocks or status.st_size)
    total = 0
    with os.scandir(path) as entries:
        for entry in entries:
            total += held_bytes(entry.path, enough - total)
            if total >= enough:
                break
    return total


# what NetCDF names a dataset that holds a dimension's length alone
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"


def plain_attribute(value: Any) -> Any:
    """Return an HDF5 attribute as NetCDF means it: arrays of length one as scalars, bytes as text."""
    import numpy as np

    value = np.ravel(value)[0] if np.size(value) == 1 else value
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(value) if isinstance(value, str) else value


def packed_fill(fill: Any, dtype: Any, factor: float, offset: float) -> Any:
    """Return a fill value in packed form, also where the writer states it unpacked.

    CF states it packed. A number in another type than the values' counts as unpacked if it is no integer, or if its packed form fits in 16
    bits.

    Args:
        fill: Stated fill value.
        dtype: Type of the packed values.
        factor: Scale factor of the packed values.
        offset: Offset added after scaling.
    """
    import numpy as np

    dtype, stated = np.dtype(dtype), np.ravel(fill)
    if dtype.kind not in "iu" or stated.size != 1 or stated.dtype.kind != "f" or factor == 0.0:
        return fill
    packed = (float(stated[0]) - offset) / factor
    limits = np.iinfo(dtype)
    if not (np.isfinite(packed) and limits.min <= round(packed) <= limits.max):
        return fill
    if dtype.itemsize > 2 and float(stated[0]).is_integer():
        return fill
    return dtype.type(round(packed))


def is_dimension(item: "h5py.Dataset") -> bool:
    """Return whether an HDF5 dataset is a NetCDF dimension without a variable."""
    return str(plain_attribute(item.attrs.get("NAME", ""))).startswith(_NO_VARIABLE)


# What a decoder may take beside what it is to return, and a thread for its stack [bytes].
_ROOM, _STACK = 3 << 23, 1 << 23
# s
_LINGERS = 5.0
# The limits that held before any reader began who has not ended, once for each of them.
_before, _changing = list[tuple[int, int]](), threading.Lock()


@contextmanager
def unpacking(size: int = 0, threads: int = 0) -> Iterator[None]:
    """Limit the growth of this process's memory to the needs of a decoder, as no header states the size of unpacked data.

    Beyond the limit an ``OSError`` or a ``MemoryError`` is raised. No effect except on Linux.

    Args:
        size: Size of the data in memory [bytes].
        threads: Number of threads that may be started.
    """
    if sys.platform != "linux":
        yield
        return
    with _changing:
        now = resource.getrlimit(resource.RLIMIT_DATA)
        has = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
        most, hard = _before[0] if _before else now
        limit = (now[0] if _before else has) + _ROOM + 4 * size + threads * _STACK
        resource.setrlimit(resource.RLIMIT_DATA, (limit if most < 0 else min(limit, most), hard))
        _before.append((most, hard))
    lasts = 0.0
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        # also of a thread for which there was no room: so that others, which nothing stops, end by the limit too
        lasts = _LINGERS if threads else 0.0
        if "start new thread" in str(error):
            raise MemoryError("it needs more memory than its size allows") from error
        raise
    finally:
        if lasts:
            later = threading.Timer(lasts, _unlimited)
            later.daemon = True
            later.start()
        else:
            _unlimited()


def _unlimited() -> None:
    """Remove a reader's limit; those of other readers remain."""
    with _changing:
        before = _before.pop()
        if not _before:
            resource.setrlimit(resource.RLIMIT_DATA, before)


#: Device, number on it, size [bytes], time of the last change [ns].
Stamp = tuple[int, int, int, int]


def stamps_of(paths: Iterable[Path]) -> dict[Path, Stamp]:
    """Return stamps that identify unchanged files; folders and missing files are skipped."""
    return {path: _stamp(path.stat()) for path in paths if path.is_file()}


def check_unchanged(before: Mapping[Path, Stamp], may_grow: bool = False) -> None:
    """Raise LogError if a file has changed.

    Args:
        before: Result of ``stamps_of`` before the files were read.
        may_grow: Whether files may have grown, as a log being recorded.
    """
    for path, stamp in before.items():
        if not path.is_file():
            raise LogError(
                f"{path}: changed while it was read: it is gone; keep it until the run ends, and run again"
            )
        now = _stamp(path.stat())
        if now == stamp or (may_grow and now[:2] == stamp[:2] and now[2] > stamp[2]):
            continue
        if now[:2] != stamp[:2]:
            what = "was replaced by another file"
        elif now[2] != stamp[2]:
            what = f"{'grew' if now[2] > stamp[2] else 'shrank'} from {stamp[2]} to {now[2]} bytes"
        else:
            what = "was written to"
        raise LogError(
            f"{path}: changed while it was read: it {what}; "
            "if it is still being recorded, give a copy of it, and run again"
        )


def _stamp(status: os.stat_result) -> Stamp:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
