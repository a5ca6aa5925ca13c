"""Whether outputs may be written where they are asked for, without harm to an input."""

from collections.abc import Iterable
from pathlib import Path

from replay_kit.core.errors import ConfigError


def check_paths(
    inputs: Iterable[Path | None], outputs: Iterable[Path | None], overwrite: bool, may_exist: Iterable[Path | None] = ()
) -> None:
    """Raise ConfigError when an output cannot or may not be written; nothing is read, so this comes before all work.

    Args:
        inputs: Files and stores (folders) that are read; None and names that do not exist are none.
        outputs: Files that will be written, each as ``NAME.part`` first; None and ``-``, standard output, are none.
        overwrite: Whether an existing output is replaced; an input never is.
        may_exist: Outputs that a run goes on with when they exist.
    """
    kept = [path for path in may_exist if path is not None]
    read = [path for path in inputs if path is not None]
    wanted = [path for path in outputs if path is not None and str(path) != "-"] + kept
    for position, path in enumerate(wanted):
        part = path.with_name(path.name + ".part") if path.name else path
        if any(_touches(name, source) for name in (path, part) for source in read):
            raise ConfigError(f"{path}: is an input of this run; an input is never overwritten: choose another name")
        if any(_same(name, other) for name in (path, part) for other in wanted[:position]) or any(
            _same(path, other.with_name(other.name + ".part")) for other in wanted[:position]
        ):
            raise ConfigError(f"{path}: two outputs have this name; choose another for one of them")
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; give the name of a file")
        if not path.parent.is_dir():
            raise ConfigError(f"{path}: there is no folder {path.parent}; make it, or choose another place")
        if path.exists() and not overwrite and path not in kept and not is_stream(path):
            raise ConfigError(f"{path}: exists; choose another name or give --overwrite")


def is_stream(path: Path) -> bool:
    """Return whether a path is a pipe or a device, which is written to and not replaced."""
    return path.is_fifo() or path.is_char_device()


def truth_path(spec: str | None) -> Path | None:
    """Return the file of a truth given as ``PATH`` or ``PATH#MEMBER``."""
    return None if spec is None else Path(spec.partition("#")[0])


def _same(path: Path, other: Path) -> bool:
    """Return whether two names are one file, also by links or by a file system that ignores case."""
    return path.resolve() == other.resolve() or (path.exists() and other.exists() and path.samefile(other))


def _touches(path: Path, source: Path) -> bool:
    """Return whether writing a path changes an input: it is the input, or lies in it, as in a Zarr store."""
    return _same(path, source) or (source.is_dir() and path.resolve().is_relative_to(source.resolve()))
