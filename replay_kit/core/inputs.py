"""Inputs: what may be one, whether it stays as it was while it is read, and how large it claims to be."""

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
    """Return why a path can be no input; empty for a file or folder, that a link leads to too, and where there is nothing.

    Inputs are read several times and from any place on. Nobody may ever write to a pipe, and a device need not end.
    """
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        if error.errno not in (errno.ELOOP, errno.ENAMETOOLONG):
            return ""
        return f"{error.strerror}; give the name of a file"
    kind = next((name for holds, name in _KINDS if holds(mode)), "")
    return (
        f"it is {kind}, not a file; write what comes from it to a file, and give that"
        if kind
        else ""
    )


def open_input(path: str | Path) -> BinaryIO:
    """Return a file opened to be read; what is no file is not waited for.

    Raises:
        OSError: It cannot be opened, or can be no input.
    """
    if why := why_no_input(Path(path)):
        raise OSError(errno.EINVAL, why, str(path))
    return open(path, "rb")


#: Size that any file may declare [bytes], and per byte of the file; forecasts in use have five to twelve.
_FREE, _RATIO = 1 << 25, 100


def exceeds_claim(path: Path, size: int) -> str:
    """Return why arrays of that many bytes cannot be what a file is meant to hold; empty where they can.

    Args:
        path: The file, or the folder of a store.
        size: What its arrays take in memory [bytes].
    """
    needed = (size - _FREE) / _RATIO
    # what is on a server has limits of its own
    return "" if needed <= 0.0 or not path.exists() else claim_text(size, held(path, needed))


def claim_text(size: int, held: int) -> str:
    """Return why arrays of that many bytes cannot be held by so many of a file; empty where they can."""
    if size <= _FREE + _RATIO * held:
        return ""
    return f"it claims {size / 1e6:.0f} MB of values in a file of {held / 1e6:.3f} MB, more than {_RATIO} times its bytes"


def held(path: str | os.PathLike[str], enough: float) -> int:
    """Return the bytes of a file, or of the files below a folder, of which no more are counted than are enough."""
    if not os.path.isdir(path):
        status = os.stat(path)
        # of a file whose bytes were never written all; a file system that says nothing of it says zero
        return min(status.st_size, 512 * status.st_blocks or status.st_size)
    total = 0
    with os.scandir(path) as entries:
        for entry in entries:
            total += held(entry.path, enough - total)
            if total >= enough:
                break
    return total


# what NetCDF names a dataset that holds a dimension's length alone
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"


def plain_attribute(value: Any) -> Any:
    """Return an attribute of HDF5 as NetCDF means it: an array of one is that one, and bytes are text."""
    import numpy as np

    value = np.ravel(value)[0] if np.size(value) == 1 else value
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(value) if isinstance(value, str) else value


def packed_fill(fill: Any, dtype: Any, factor: float, offset: float) -> Any:
    """Return a missing value as packed values have it; some writers state it as it is unpacked.

    CF has it packed. A number that is not stated in the type of the values is taken as unpacked where it is no integer, or where its packed
    form is one of the few values that 16 bits can hold.

    Args:
        fill: As stated.
        dtype: Of the packed values.
        factor: By which they are multiplied.
        offset: Which is added then.
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
    """Return whether a dataset of HDF5 is a dimension of NetCDF without a variable."""
    return str(plain_attribute(item.attrs.get("NAME", ""))).startswith(_NO_VARIABLE)


# What a decoder may take beside what it is to return, and a thread for its stack [bytes].
_ROOM, _STACK = 3 << 23, 1 << 23
# s
_LINGERS = 5.0
# The limits that held before any reader began who has not ended, once for each of them.
_before, _changing = list[tuple[int, int]](), threading.Lock()


@contextmanager
def unpacking(size: int = 0, threads: int = 0) -> Iterator[None]:
    """Let this process grow by no more than a decoder needs, since no header says what compressed bytes become.

    One that needs more ends with an ``OSError`` or a ``MemoryError``. Only Linux tells what a process has; elsewhere nothing is limited.

    Args:
        size: What is read takes in memory [bytes].
        threads: How many may be started for it.
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
    """Let a reader's limit go; what another one still needs stays."""
    with _changing:
        before = _before.pop()
        if not _before:
            resource.setrlimit(resource.RLIMIT_DATA, before)


#: Device, number on it, size [bytes], time of the last change [ns].
Stamp = tuple[int, int, int, int]


def stamps_of(paths: Iterable[Path]) -> dict[Path, Stamp]:
    """Return what tells each file from a changed one; folders, and names that are no file, are left out."""
    return {path: _stamp(path.stat()) for path in paths if path.is_file()}


def check_unchanged(before: Mapping[Path, Stamp], may_grow: bool = False) -> None:
    """Raise LogError when a file is no longer what it was.

    Args:
        before: What ``stamps_of`` returned before the files were read.
        may_grow: Whether a file may have become longer, as a log that is being recorded.
    """
    for path, stamp in before.items():
        if not path.is_file():
            raise LogError(
                f"{path}: expected to stay as it was while it is read, but it is gone; keep it until the run ends, and run again"
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
            f"{path}: expected to stay as it was while it is read, but it {what}; "
            "if it is still being recorded, give a copy of it, and run again"
        )


def _stamp(status: os.stat_result) -> Stamp:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
