"""Glider files opened, and those of one mission put together."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replay_kit.logs.glider.dialect import Dialect
from replay_kit.logs.glider.dialects import dialect_of
from replay_kit.logs.glider.missions import mission_of
from replay_kit.logs.glider.netcdf import NetcdfFile, open_netcdf
from replay_kit.logs.glider.recognise import is_seaexplorer
from replay_kit.logs.glider.seaexplorer import open_seaexplorer

_HEAD = 1 << 12


@dataclass(frozen=True, slots=True, eq=False)
class GliderFile:
    """A file of a known dialect.

    Attributes:
        content: The variables that the dialect's reader uses.
        dialect: How it is written.
    """

    content: NetcdfFile
    dialect: Dialect


def open_glider_file(path: Path) -> GliderFile | None:
    """Return a file with its dialect; None for a NetCDF file of no known dialect.

    Raises:
        LogError: The file cannot be read.
    """
    found: list[Dialect | None] = []

    def choose(names: Collection[str], attributes: Mapping[str, Any]) -> Collection[str]:
        dialect = dialect_of(names, attributes)
        found.append(dialect)
        return [] if dialect is None else dialect.wanted(names)

    with open(path, "rb") as file:
        text = is_seaexplorer(file.read(_HEAD))
    content = (open_seaexplorer if text else open_netcdf)(path, choose)
    return None if found[0] is None else GliderFile(content, found[0])


def grouped(paths: Sequence[Path]) -> list[list[int]]:
    """Return the positions of files in groups, each one log: all profiles of a GliderDAC mission, all parts of a SeaExplorer's, else one.

    Raises:
        LogError: A file cannot be read.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for place, path in enumerate(paths):
        groups.setdefault(_mission(path) or (str(place),), []).append(place)
    return list(groups.values())


def _mission(path: Path) -> tuple[str, ...]:
    """Return the names of a file's dialect and missions; none where a mission is one file, or the dialect is not known."""
    found: list[Dialect | None] = []

    def choose(names: Collection[str], attributes: Mapping[str, Any]) -> Collection[str]:
        found.append(dialect_of(names, attributes))
        return [name for name in names if name.lower() in ("trajectory", "mission_name")]

    with open(path, "rb") as file:
        if is_seaexplorer(file.read(_HEAD)):
            return "seaexplorer", *mission_of(NetcdfFile(path, {}, {}, ()), "seaexplorer")
    content, dialect = open_netcdf(path, choose), found[0]
    return (
        (dialect.name, *mission_of(content, dialect.name))
        if dialect is not None and dialect.in_parts
        else ()
    )
