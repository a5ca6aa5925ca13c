"""Files of this program that state their checksum: saved estimates, built bases, states of a run, what a followed mission remembers.

The seal is a last line with the SHA-256 of all bytes before it. NetCDF files may have it too, since readers of NetCDF ignore what follows
their own end. A store file is, before its seal, a line with its kind and version, a line of JSON, and parts that begin at multiples of 64
bytes, so that arrays can be mapped into memory.
"""

import hashlib
import json
import mmap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import LogError
from replay_kit.core.inputs import open_input

_SEAL = b"\nreplay-kit sha256 "
_SEAL_BYTES = len(_SEAL) + 65
_BOUNDARY = 64
# A line of JSON is no longer.
_LONGEST = 1 << 16


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of store file.

    Attributes:
        name: In its first line and in errors, as ``checkpoint``.
        version: Of the form of its parts.
        remedy: What to do with a file that cannot be used.
    """

    name: str
    version: int
    remedy: str

    @property
    def line(self) -> bytes:
        """The first line."""
        return f"replay-kit {self.name} {self.version}\n".encode()


def _seal(digest: "hashlib._Hash") -> bytes:
    return _SEAL + digest.hexdigest().encode() + b"\n"


def sealed(data: bytes) -> bytes:
    """Return bytes with their seal."""
    return data + _seal(hashlib.sha256(data))


def unsealed(data: bytes | memoryview) -> memoryview | None:
    """Return sealed bytes without their seal; None when they end without one.

    Raises:
        ValueError: They are not the bytes that were sealed.
    """
    content, seal = memoryview(data)[:-_SEAL_BYTES], bytes(memoryview(data)[-_SEAL_BYTES:])
    if not seal.startswith(_SEAL):
        return None
    if _seal(hashlib.sha256(content)) != seal:
        raise ValueError("it is damaged: its checksum does not match")
    return content


def write_store(
    path: Path, kind: Kind, head: Mapping[str, Any], parts: Sequence[bytes | memoryview]
) -> None:
    """Write a store file, whole or not at all.

    Args:
        path: The file; one that exists is replaced.
        kind: What it is.
        head: What can be read without the parts, for JSON.
        parts: Their bytes.

    Raises:
        ConfigError, ReplayKitError: As of ``atomic_file``.
    """
    sizes = [memoryview(part).nbytes for part in parts]
    digest = hashlib.sha256()
    with atomic_file(path) as file:

        def put(data: bytes | memoryview) -> None:
            file.write(data)
            digest.update(data)

        put(kind.line + json.dumps({**head, "bytes": sizes}).encode() + b"\n")
        for part in parts:
            put(bytes(-file.tell() % _BOUNDARY))
            put(part)
        file.write(_seal(digest))


def read_head(path: Path, kind: Kind) -> dict[str, Any] | None:
    """Return the head of a store file, whose checksum is not looked at; None where it cannot be read or is of another kind or version."""
    with suppress(OSError, ValueError, RecursionError), open_input(path) as file:
        if file.read(len(kind.line)) == kind.line:
            head = json.loads(file.readline(_LONGEST))
            return head if isinstance(head, dict) else None
    return None


def read_store(path: Path, kind: Kind) -> tuple[dict[str, Any], tuple[memoryview, ...]]:
    """Return the head and the parts of a store file, which are mapped into memory, after its checksum was compared.

    Raises:
        LogError: The file cannot be read, is damaged, none of this program's, or of another kind or version.
    """
    try:
        with open_input(path) as file:
            mapped = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except OSError as error:
        raise LogError(
            f"{path}: the {kind.name} cannot be read: {error.strerror}; {kind.remedy}"
        ) from error
    except ValueError:
        mapped = memoryview(b"")
    try:
        content = unsealed(mapped)
        if content is None and not bytes(mapped[:10]) == kind.line[:10]:
            raise LogError(f"{path}: exists and is no {kind.name}; choose another name")
        if bytes(mapped[: len(kind.line)]) != kind.line:
            raise ValueError("it is of another kind or version, or damaged")
        if content is None:
            raise ValueError("it is cut short or damaged: its checksum is missing")
        text, _, _ = bytes(content[len(kind.line) :][:_LONGEST]).partition(b"\n")
        head = json.loads(text)
        return head, tuple(_parts(content, head["bytes"], len(kind.line) + len(text) + 1))
    except (ValueError, LookupError, TypeError) as error:
        raise unusable(path, kind, str(error)) from error


def unusable(path: Path, kind: Kind, error: Exception | str) -> LogError:
    """Return the error that names a store file, what is wrong with it and what to do."""
    what = error if isinstance(error, str) else f"{type(error).__name__}: {error}"
    words = " ".join(what.split())[:200]
    return LogError(f"{path}: the {kind.name} cannot be used: {words}; {kind.remedy}")


def _parts(content: memoryview, sizes: Sequence[int], end: int) -> Iterator[memoryview]:
    for size in sizes:
        start = end + -end % _BOUNDARY
        end = start + size
        yield content[start:end]
