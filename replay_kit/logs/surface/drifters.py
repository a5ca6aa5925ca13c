"""Tracks of drifters as of the Global Drifter Program, each fix a message.

In NetCDF, of one drifter or of several as a ragged array, or as a table of ERDDAP (``.csv``): names, units, then a row a fix.
"""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.glider import units
from replay_kit.logs.glider.netcdf import NetcdfFile, Stored, open_netcdf
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import number, stamp
from replay_kit.logs.table import LONGEST_LINE, TableReader, in_text, read_csv

SCHEMA, TOPIC = "replay_kit.DrifterFix", "/drifters"
#: By quantity the names of its variable, the preferred first.
_NAMES = {
    "time": ("time",),
    "longitude": ("longitude", "lon"),
    "latitude": ("latitude", "lat"),
    "lost": ("drogue_lost_date",),
    "drogued": ("drogue_status",),
    "depth": ("drogue_center_depth", "drogue_depth"),
    "error": ("err_lat",),
    "id": ("ID", "id", "ids"),
    "rowsize": ("rowsize", "rowSize"),
}
# m: depth of the middle of the programme's drogue; and of a degree of latitude
_DROGUE, _DEGREE = 15.0, 111_200.0


def is_table(head: bytes) -> bool:
    """Return whether a file that begins so is such a table."""
    return is_drifters(head.split(b"\n", 1)[0].decode("latin-1").strip().split(","))


def is_drifters(names: Collection[str]) -> bool:
    """Return whether a NetCDF file with these variables holds tracks of drifters that say whether they have their drogues."""
    found = _chosen(names)
    return {"time", "longitude", "latitude"} <= set(found) and bool(
        {"lost", "drogued"} & set(found)
    )


def _chosen(names: Collection[str]) -> dict[str, str]:
    found = {
        key: next((name for name in each if name in names), "") for key, each in _NAMES.items()
    }
    return {key: name for key, name in found.items() if name}


class DrifterReader(LogFile):
    """Files of drifters that are one log, read whole."""

    format = "drifters"

    def _prepare(self) -> None:
        """Read the files.

        Raises:
            LogError: A file cannot be read, or its columns are of unlike lengths.
        """
        notes: list[str] = []
        self._columns = [_columns(path, notes) for path in self.files]
        self._notes = tuple(dict.fromkeys(notes))
        self.statistics.notes = self._notes

    def messages(self) -> Iterator[Message]:
        """Yield each fix as a message on ``/drifters``, in order of time."""
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        yield from self._by_time((), *map(_fixes, self._columns))


def _fixes(columns: dict[str, NDArray[Any]]) -> Iterator[Entry]:
    """Yield the fixes in order of time, each made as it is needed."""
    times = columns["time"]
    known = np.isfinite(columns["longitude"] + columns["latitude"]) & (times > 0)
    found = np.flatnonzero(known)
    for k in found[np.argsort(times[found], kind="stable")].tolist():
        yield (
            int(times[k]),
            TOPIC,
            SCHEMA,
            {
                "stamp": stamp(int(times[k])),
                "id": str(columns["id"][k]),
                "longitude": float(columns["longitude"][k]),
                "latitude": float(columns["latitude"][k]),
                "depth": float(columns["depth"][k]),
                "drogued": bool(columns["drogued"][k]),
                "error": number(float(columns["error"][k])),
            },
        )


def _columns(path: Path, notes: list[str]) -> dict[str, NDArray[Any]]:
    file = _opened(path)
    chosen = _chosen(file.names)
    time_ns, known = units.time_ns("time", file.variables[chosen["time"]], file, notes)
    n = time_ns.size
    sizes = file.array(chosen["rowsize"]).astype(np.int64).ravel() if "rowsize" in chosen else None

    def column(key: str, default: float) -> Array:
        if key not in chosen:
            return np.full(n, default)
        return _spread(path, chosen[key], file.array(chosen[key]).ravel(), n, sizes)

    def degrees(key: str, quantity: units.Quantity) -> Array:
        name = chosen[key]
        return _spread(
            path, name, units.in_si(name, file.variables[name], quantity, notes).ravel(), n, sizes
        )

    if "depth" not in chosen:
        notes.append(f"depth of the drogues is not stated: {_DROGUE:g} m taken")
    return {
        "time": np.where(known.ravel(), time_ns.ravel(), 0),
        "longitude": degrees("longitude", units.LONGITUDE),
        "latitude": degrees("latitude", units.LATITUDE),
        "depth": column("depth", _DROGUE),
        "error": _DEGREE * column("error", np.nan),
        "id": _names_of(file, chosen, n, sizes),
        "drogued": _drogued(file, chosen, time_ns.ravel(), sizes),
    }


def _opened(path: Path) -> NetcdfFile:
    """Return the columns of a file that are used.

    Raises:
        LogError: It cannot be read, or a table's rows are of unlike lengths.
    """
    if not in_text(path):
        return open_netcdf(path, lambda names, attributes: list(_chosen(names).values()))
    columns = read_csv(path)
    return NetcdfFile(path, {}, columns, tuple(columns))


def _drogued(
    file: NetcdfFile,
    chosen: dict[str, str],
    time_ns: NDArray[np.int64],
    sizes: NDArray[np.int64] | None,
) -> NDArray[np.bool_]:
    """Return at which fixes a drifter has its drogue: where that is not stated, it has none."""
    n = time_ns.size
    if "drogued" in chosen:
        name = chosen["drogued"]
        return np.asarray(_spread(file.path, name, file.array(name).ravel(), n, sizes) == 1.0)
    stored = file.variables[chosen["lost"]]
    # a drifter whose drogue was not lost has no date, or that of the epoch
    texts, epoch = stored.texts(), "1970-01-01" in stored.units
    dated = (
        [text for text in texts if "1970-01-02" < text < "9"]
        if texts
        else stored.unpacked() > (0.0 if epoch else -np.inf)
    )
    if not np.any(dated):
        return np.ones(n, dtype=bool)
    lost, known = units.time_ns(chosen["lost"], stored, file, [])
    dates = np.where(known.ravel(), lost.ravel(), np.iinfo(np.int64).max).astype(np.float64)
    return np.asarray(time_ns < _spread(file.path, chosen["lost"], dates, n, sizes))


def _names_of(
    file: NetcdfFile, chosen: dict[str, str], n: int, sizes: NDArray[np.int64] | None
) -> NDArray[Any]:
    if "id" not in chosen:
        return np.full(n, file.path.stem)
    stored: Stored = file.variables[chosen["id"]]
    names = np.array(stored.texts() or [f"{value:.0f}" for value in stored.unpacked().ravel()])
    return _spread(file.path, chosen["id"], names, n, sizes)


def _spread(
    path: Path, name: str, values: NDArray[Any], n: int, sizes: NDArray[np.int64] | None
) -> NDArray[Any]:
    """Return values at each fix: those of a drifter are repeated at its fixes.

    Raises:
        LogError: They are neither as many as fixes nor as drifters.
    """
    if values.size == n:
        return values
    if values.size == 1:
        return np.repeat(values, n)
    if sizes is not None and values.size == sizes.size and sizes.sum() == n and (sizes >= 0).all():
        return np.repeat(values, sizes)
    raise LogError(
        f"{path}: {name}: expected a value for each of {n} fixes or each drifter, got {values.size}; write the file again"
    )


def open_table(
    paths: Sequence[Path],
    input: int = 0,
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
) -> LogFile:
    """Return the reader of a table in text: of drifters by its names, or of pings; as ``open_glider``."""
    del wanted
    with open(paths[0], "rb") as file:
        kind = DrifterReader if is_table(file.read(LONGEST_LINE)) else TableReader
    return kind(paths, input, config)
