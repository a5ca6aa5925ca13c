"""Paths and addresses given by users, and checks of all files of a command before it starts."""

import os
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path, PosixPath
from typing import Any

from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.files.atomic import part_of
from replay_kit.core.files.inputs import why_no_input

#: One path, or several, of which those in a sequence of their own belong together.
Paths = str | Path | Sequence[str | Path | Sequence[str | Path]]

_ADDRESS = re.compile(r"(?:https?://|cmems:)[^/\s]\S*", re.IGNORECASE)
_SCHEME = re.compile(r"(?:[a-z][a-z0-9.+-]+::)?[a-z][a-z0-9.+-]+://", re.IGNORECASE)


class Address(PosixPath):
    """Address of a forecast on a server; checks of paths skip it.

    Its text in messages, logs and results has neither login nor query, which may hold a key.

    Attributes:
        url: Complete address.
    """

    url: str = ""

    def __new__(cls, url: str) -> "Address":
        """Return the address of a text."""
        made = super().__new__(cls, public(url))
        made.url = url
        return made

    def __init__(self, url: str) -> None:
        if sys.version_info >= (3, 12):
            super().__init__(public(url))

    def __str__(self) -> str:
        return public(self.url) if self.url else super().__str__()

    def __reduce__(self) -> Any:
        return Address, (self.url,)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Address) and self.url == other.url

    def __hash__(self) -> int:
        return hash(self.url)

    def resolve(self, strict: bool = False) -> "Address":
        """Return the address itself."""
        return self

    def absolute(self) -> "Address":
        """Return the address itself."""
        return self


def public(url: str) -> str:
    """Return an address without login, query and fragment."""
    whole = re.sub(r"(?<=//)[^/?#]*@", "", url)
    return re.split(r"[?#]", whole, maxsplit=1)[0]


def path_of(text: str) -> Path:
    """Return the path, or the ``Address``, that a text names; ``file://`` stands for a path.

    Raises:
        ConfigError: The scheme of the address is not supported.
    """
    if _ADDRESS.fullmatch(text):
        return Address(text)
    if text.startswith("file:///"):
        return Path(text.removeprefix("file://"))
    if _SCHEME.match(text):
        raise ConfigError(
            f"{public(text)}: expected https://, http:// or cmems:DATASET; give the https address of the same data"
        )
    return Path(text)


def check_paths(
    inputs: Iterable[Path | None],
    outputs: Iterable[Path | None],
    overwrite: bool,
    may_exist: Iterable[Path | None] = (),
) -> None:
    """Raise ConfigError if an input is no file or folder, or an output cannot or may not be written; no contents are read.

    Args:
        inputs: Files and stores (folders) to read; None and names that do not exist are ignored.
        outputs: Files to write, first as ``NAME.part``; None and ``-`` (standard output) are ignored.
        overwrite: Whether an existing output is replaced; an input never is.
        may_exist: Outputs from which a run continues.
    """
    kept = [path for path in may_exist if path is not None]
    read = [path for path in inputs if path is not None]
    for path in (*read, *kept):
        if why := why_no_input(path):
            raise ConfigError(f"{path}: cannot be read: {why}")
    wanted = [path for path in outputs if path is not None and str(path) != "-"] + kept
    for position, path in enumerate(wanted):
        names = (path, part_of(path)) if path.name else (path,)
        if any(_touches(name, source) for name in names for source in read):
            raise ConfigError(
                f"{path}: is an input of this run; an input is never overwritten: choose another name"
            )
        earlier = wanted[:position]
        if any(_same(name, other) for name in names for other in earlier) or any(
            _same(path, part_of(other)) for other in earlier
        ):
            raise ConfigError(f"{path}: two outputs have this name; choose another for one of them")
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; give the name of a file")
        if path.is_socket() or path.is_block_device():
            raise ConfigError(f"{path}: is a socket or a disk, not a file; choose another name")
        _check_parent(path)
        if path.exists() and not overwrite and path not in kept and not is_stream(path):
            raise ConfigError(f"{path}: exists; choose another name or give --overwrite")


def check_inputs(inputs: Iterable[Path | None]) -> None:
    """Raise PlanError for the first missing input of a plan; None is ignored."""
    for path in inputs:
        if path is not None and not path.exists():
            raise PlanError(
                f"{path}: expected an input of the plan, file not found; check the path"
            )


def as_path(value: object, what: str) -> Path:
    """Return a path given as text or ``Path``.

    Args:
        value: The path.
        what: Name of the argument in the error.

    Raises:
        ConfigError: The value is neither.
    """
    if isinstance(value, str):
        return path_of(value)
    if isinstance(value, Path):
        return value
    raise ConfigError(
        f"{what}: expected a path (str or Path), got {type(value).__name__}; give the name of the file"
    )


def as_paths(value: object, what: str) -> tuple[Path, ...]:
    """Return one or several paths given as in ``as_path``.

    Raises:
        ConfigError: See ``as_path``, or there is no path.
    """
    if isinstance(value, list | tuple):
        if not value:
            raise ConfigError(f"{what}: expected at least one path, got none")
        return tuple(as_path(each, what) for each in value)
    return (as_path(value, what),)


def as_groups(value: object, what: str) -> tuple[tuple[Path, ...], ...]:
    """Return groups of paths; each item is a path or a list of paths.

    Raises:
        ConfigError: See ``as_paths``.
    """
    each = value if isinstance(value, list | tuple) and value else as_paths(value, what)
    return tuple(as_paths(one, what) for one in each)


def addresses_in(given: Paths) -> tuple[Address, ...]:
    """Return the addresses among paths or groups of paths."""
    groups = as_groups(given, "ensemble")
    return tuple(path for group in groups for path in group if isinstance(path, Address))


def check_folder(out: Path) -> None:
    """Raise ConfigError if a folder for results cannot be created."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out}: is a file; give the name of a folder")
    _check_parent(out)


def _check_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise ConfigError(
            f"{path}: there is no folder {path.parent}; make it, or choose another place"
        )


def is_stream(path: Path) -> bool:
    """Return whether a path is a pipe or device, which is written in place."""
    return path.is_fifo() or path.is_char_device()


def truth_path(spec: str | None) -> Path | None:
    """Return the file of a truth given as ``PATH`` or ``PATH#MEMBER``."""
    return None if spec is None else Path(spec.partition("#")[0])


def _same(path: Path, other: Path) -> bool:
    """Return whether two names are one file, also through links or a file system that ignores case."""
    # unlike ``Path.resolve`` of a link that leads back to itself
    return os.path.realpath(path) == os.path.realpath(other) or (
        path.exists() and other.exists() and path.samefile(other)
    )


def _touches(path: Path, source: Path) -> bool:
    """Return whether writing a path changes an input: the path is the input or lies in it, as in a Zarr store."""
    return _same(path, source) or (
        source.is_dir() and path.resolve().is_relative_to(source.resolve())
    )
