"""Reader of columnar files, NetCDF and text tables, by dialect."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from replay_kit.config.run import LogConfig
from replay_kit.core.extensions import additions
from replay_kit.logs.netcdf.dialects import Dialect
from replay_kit.logs.netcdf.glider import glider, missions_of
from replay_kit.logs.netcdf.glider_dialects import GLIDERS
from replay_kit.logs.netcdf.surface import DRIFTERS, TOTALS
from replay_kit.logs.netcdf.unknown import NEEDED, PINGS, ROWS, require_no_grid
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored, open_netcdf, open_text
from replay_kit.logs.reader import LogFile, Told, WholeLog

Form = Literal["netcdf", "seaexplorer", "table"]
#: All dialects, in the order in which they are tried; a file of none is of ``PINGS`` or ``ROWS``.
DIALECTS: tuple[Dialect, ...] = (*GLIDERS, TOTALS, DRIFTERS)


def dialect_of(
    held: Mapping[str, Stored], attributes: Mapping[str, Any], text: bool = False
) -> Dialect | None:
    """Return the dialect of a file with these variables and attributes; None if unknown.

    Args:
        held: Variables of the file.
        attributes: Global attributes of the file.
        text: Whether it is a text table other than a SeaExplorer's, which excludes glider dialects and those read in parts.
    """
    added = additions("dialects", lambda value: isinstance(value, Dialect), "a Dialect").values()
    return next(
        (
            dialect
            for dialect in (*DIALECTS, *added)
            if (not text or (dialect.read is not None and not dialect.by_times))
            and dialect.recognises(held, attributes)
        ),
        None,
    )


def log_of_columns(
    files: Sequence[NetcdfFile],
    dialect: Dialect,
    told: Told,
    config: LogConfig | None,
) -> WholeLog:
    """Return the log of some files in one dialect.

    Args:
        files: Files of the log in order of time; the first gives its name.
        dialect: Dialect of the files.
        told: Findings when the files were opened.
        config: Settings of log reading.

    Raises:
        LogError: A file cannot be read, or the unit of a variable is unknown.
    """
    paths = [path for file in files for path in file.sources or (file.path,)]
    entries = (dialect.read or glider)(files, dialect, config or LogConfig(), told)
    return WholeLog(paths, dialect.name, told, entries, config, dialect.read is None)


def logs_of_columns(
    paths: Sequence[Path], config: LogConfig | None, form: Form = "netcdf"
) -> list[LogFile]:
    """Return the readers of files, of which those of one mission, or of one dialect, are one log.

    Args:
        paths: Files.
        config: Settings of log reading.
        form: NetCDF, text of a SeaExplorer, or another text table.

    Raises:
        LogError: A file cannot be read, or is a forecast.
    """
    groups: dict[Any, tuple[Dialect, list[NetcdfFile]]] = {}
    for number, path in enumerate(paths):
        file, dialect = _opened(path, form, config or LogConfig())
        missions = missions_of(file, dialect.name) if dialect.log_of == "mission" else ()
        key = number if dialect.log_of == "file" else (dialect.name, *missions)
        groups.setdefault(key, (dialect, []))[1].append(file)
    return [log_of_columns(files, dialect, Told(), config) for dialect, files in groups.values()]


def _opened(path: Path, form: Form, config: LogConfig) -> tuple[NetcdfFile, Dialect]:
    """Return the variables of a file that its dialect reads, and the dialect."""
    found: list[Dialect] = []

    def choose(held: Mapping[str, Stored], attributes: Mapping[str, Any]) -> list[str]:
        dialect = dialect_of(held, attributes, form == "table")
        if dialect is None:
            flat = {name: stored for name, stored in held.items() if stored.extents < 3}
            require_no_grid(path, held)
            asked = form != "netcdf" or config.columns or PINGS.chosen(flat).keys() >= NEEDED
            dialect, held = (PINGS, flat) if asked else (ROWS, held)
        found.append(dialect)
        if dialect.by_times:
            return [dialect.chosen(held)["time"]]
        return dialect.wanted(held)

    file = (
        open_netcdf(path, choose) if form == "netcdf" else open_text(path, choose, form == "table")
    )
    return file, found[0]


#: Readers of text.
logs_of_seaexplorers = partial(logs_of_columns, form="seaexplorer")
logs_of_tables = partial(logs_of_columns, form="table")
