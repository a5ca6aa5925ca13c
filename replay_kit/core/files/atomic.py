"""Files written completely or not at all, and seals that show damage."""

import errno
import fcntl
import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from replay_kit.core.errors import ConfigError, ReplayKitError

# Of a disk, of a user's share of it, of the largest file.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


# Before the digest in a seal.
_SEAL = b"\nreplay-kit sha256 "
_SEAL_BYTES = len(_SEAL) + 65


def sealed(data: bytes) -> bytes:
    """Return bytes with their seal: a last line with their SHA-256."""
    return data + _SEAL + hashlib.sha256(data).hexdigest().encode() + b"\n"


def unsealed(data: bytes) -> bytes | None:
    """Return sealed bytes without their seal; None without a seal.

    Raises:
        ValueError: The checksum does not match.
    """
    content, seal = data[:-_SEAL_BYTES], data[-_SEAL_BYTES:]
    if not seal.startswith(_SEAL):
        return None
    if sealed(content) != data:
        raise ValueError("it is damaged: its checksum does not match")
    return content


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file completely or not at all, text as UTF-8; raises the errors of ``atomic_file``."""
    with atomic_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_file(path: Path, check: Callable[[Path], None] | None = None) -> Iterator[BinaryIO]:
    """Yield a binary file named ``PATH.part`` that is renamed to PATH when the block ends.

    An error or interrupt leaves the part; on a full disk it is removed, which makes room.

    Args:
        path: Final name; an existing file is replaced.
        check: Called with the complete part; if it raises, the part is not renamed.

    Raises:
        ConfigError: See ``open_part``.
        ReplayKitError: Writing fails, for example on a full disk.
    """
    part = part_of(path)
    with stored(part), open_part(path) as file:
        try:
            yield file
            file.flush()
            os.fsync(file.fileno())
        except OSError as error:
            if error.errno in _FULL:
                part.unlink(missing_ok=True)
            raise
        if check is not None:
            check(part)
        # before the file is closed, which lets another writer have the part
        with stored(path):
            os.replace(part, path)
            sync(path.parent)


@contextmanager
def stored(path: Path) -> Iterator[None]:
    """Convert an OSError in the block into an error that names the file, unless it names another one.

    Args:
        path: File being written.

    Raises:
        ReplayKitError: It cannot be written.
    """
    try:
        yield
    except OSError as error:
        if error.filename not in (None, str(path)):
            raise
        advice = (
            "is the disk full? Make room, and run again"
            if error.errno in _FULL
            else "choose another place"
        )
        raise ReplayKitError(
            f"{path}: cannot be written: {error.strerror or error}; {advice}"
        ) from error


def part_of(path: Path) -> Path:
    """Return the name of an incomplete output."""
    return path.with_name(path.name + ".part")


def claim(file: BinaryIO, path: Path) -> None:
    """Lock an open file until it is closed or the process ends; no effect on file systems without locks.

    Args:
        file: File open for writing.
        path: Output named in the error.

    Raises:
        ConfigError: Another process holds the lock.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ConfigError(
            f"{path}: another process is writing it; wait for its end, or choose another name"
        ) from error
    except OSError:
        return


@contextmanager
def claimed(lock: Path, path: Path) -> Iterator[None]:
    """Hold the lock of an output that one process at a time may write.

    Args:
        lock: Lock file.
        path: Output named in the error.

    Raises:
        ConfigError: See ``claim``.
    """
    with lock.open("wb") as file:
        claim(file, path)
        yield


def open_part(path: Path, kept: bool = False) -> BinaryIO:
    """Return the part file of an output, new, open for writing and locked; a part of an interrupted run is replaced.

    Symbolic links are not followed and only regular files are written, so that other users of the folder cannot redirect the output.

    Args:
        path: The output.
        kept: Whether an existing part is overwritten from its beginning instead.

    Raises:
        ConfigError: The output or its part exists and is no file, cannot be created, or is being written by another process.
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
            with part.open("rb") as left:
                claim(left, path)
                if not kept:
                    part.unlink()
        flags = os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC
        flags |= 0 if kept else os.O_CREAT | os.O_EXCL
        file = os.fdopen(os.open(part, flags, 0o666), "wb")
        claim(file, path)
        # one that began at the same time may have taken it for a part left over
        if not os.path.samestat(os.fstat(file.fileno()), part.stat()):
            raise FileNotFoundError(errno.ENOENT, f"another process took {part}")
        return file
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}; choose another place"
        ) from error


def sync(path: Path) -> None:
    """Flush a file or folder to disk, so that a rename survives a power cut only with its content."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
