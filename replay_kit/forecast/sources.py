"""Arguments of ``--ensemble`` to files: single files, stores, folders and patterns."""

import glob
import re
from dataclasses import dataclass
from pathlib import Path

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Paths, as_groups
from replay_kit.core.text import count_text

_ENDINGS = (".nc", ".nc4", ".nc3", ".cdf", ".netcdf", ".zarr")
#: Names of files of which a Zarr store has one.
STORE_MARKS = (".zgroup", ".zmetadata", ".zattrs", "zarr.json")
# EnKF-C writes these beside the members that it read
_RESULTS = (".analysis", ".increment")


@dataclass(frozen=True, slots=True)
class Sources:
    """Files of an ensemble.

    Attributes:
        arguments: Files of each argument, numbers in their names in the order of counting.
        notes: What was left out, and why.
    """

    arguments: tuple[tuple[Path, ...], ...]
    notes: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """All files, argument by argument."""
        return tuple(path for argument in self.arguments for path in argument)


def find_sources(given: Paths) -> Sources:
    """Return the files that arguments stand for.

    A folder stands for the NetCDF files and Zarr stores below it. Results of an assimilation (``.analysis``, ``.increment``) are left out
    of folders and patterns, and said.

    Args:
        given: Files, Zarr stores, folders, and patterns with ``*``, ``?`` or ``[...]``; a sequence of several is one argument.

    Raises:
        ForecastError: A file is missing or given twice, or a pattern or folder holds nothing to read.
    """
    arguments, notes = [], []
    for argument in as_groups(given, "ensemble"):
        files: tuple[Path, ...] = ()
        for path in argument:
            found, left_out = _files_of(path)
            files += found
            if left_out:
                some = f"{count_text(len(left_out), 'file')} of results left out ({left_out[0].name} ...)"
                notes.append(f"{path}: {some}; give them by name if they are the members")
        arguments.append(files)
    seen: set[Path] = set()
    for file in (file for argument in arguments for file in argument):
        if file.resolve() in seen:
            raise ForecastError(
                f"{file}: given twice; a member given twice would count twice: leave one out"
            )
        seen.add(file.resolve())
    return Sources(tuple(arguments), tuple(notes))


def ensemble_files(given: Paths) -> tuple[Path, ...]:
    """Return the files that the arguments of ``--ensemble`` stand for, in the order in which they are read; see ``find_sources``.

    Raises:
        ForecastError: As in ``find_sources``.
    """
    return find_sources(given).files


def natural(path: Path) -> list[tuple[int, int | str]]:
    """Return the key that sorts names with numbers in them in the order of counting."""
    return [
        (0, int(part)) if part.isdigit() else (1, part)
        for part in re.split(r"(\d+)", str(path))
        if part
    ]


def _files_of(path: Path) -> tuple[tuple[Path, ...], list[Path]]:
    """Return the files of one argument, and the results left out."""
    if not path.exists() and glob.has_magic(str(path)):
        found = [Path(name) for name in glob.glob(str(path), recursive=True)]
        what = "no file matches this pattern; check the folder and the pattern, and quote it if the shell changes it"
    elif path.is_dir() and not is_store(path):
        found = _inside(path)
        what = f"the folder holds no NetCDF file and no Zarr store (names ending in {', '.join(_ENDINGS)})"
    else:
        return (path,), []
    results = [file for file in found if any(mark in file.name for mark in _RESULTS)]
    kept = sorted((file for file in found if file not in results), key=natural)
    if not kept and results:
        raise ForecastError(
            f"{path}: holds results alone, such as {results[0].name}; give the members, or name the results one by one"
        )
    if not kept:
        raise ForecastError(f"{path}: {what}")
    return tuple(kept), results


def is_store(path: Path) -> bool:
    """Return whether a folder is a Zarr store."""
    return path.suffix == ".zarr" or any((path / mark).exists() for mark in STORE_MARKS)


def _inside(folder: Path) -> list[Path]:
    found: list[Path] = []
    for path in folder.iterdir():
        if path.is_dir() and not is_store(path):
            found += _inside(path)
        elif path.name.startswith("."):
            continue
        elif path.is_dir() or any(ending in path.name.lower() for ending in _ENDINGS):
            found.append(path)
    return found
