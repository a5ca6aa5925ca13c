"""Tables of pings, a row a depth, as CSV and NetCDF files or in memory: columns by a mapping, by CF standard name, or by name.

Rows of one time and place are a profile.
"""

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation, usable
from replay_kit.core.quantities import measured_at, metres_per_second
from replay_kit.core.text import some_text
from replay_kit.logs.glider import units
from replay_kit.logs.glider.netcdf import NetcdfFile, Stored, as_number, open_netcdf
from replay_kit.logs.reader import LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import PING, numbers, stamp

TOPIC = "/observations"
#: By quantity its names, the standard name first.
_NAMES: Mapping[str, tuple[str, ...]] = {
    "time": ("time", "date", "datetime"),
    "longitude": ("longitude", "lon"),
    "latitude": ("latitude", "lat"),
    "depth": ("depth",),
    "u": ("eastward_sea_water_velocity", "u", "east", "eastward"),
    "v": ("northward_sea_water_velocity", "v", "north", "northward"),
    "error": (
        *("eastward_sea_water_velocity standard_error", "error", "error_std", "standard_error"),
    ),
}
# what is too fast or too deep is flagged later, and counted
_SPEED = units.Quantity("m/s", metres_per_second, -np.inf, np.inf)
_QUANTITIES = {
    "longitude": units.LONGITUDE,
    "latitude": units.LATITUDE,
    "depth": replace(units.LENGTH, low=-np.inf, high=np.inf),
    **dict.fromkeys(("u", "v", "error"), _SPEED),
}
_EXPECTED = "expected a table with the columns time, longitude, latitude, depth [m], u, v and error [m/s], a row a depth"
# Rows of a file that are read at once, and letters of a value and of a line.
_ROWS, _LONGEST, LONGEST_LINE = 50_000, 128, 1 << 14

#: By quantity the name of its column, or its value in all rows.
Asked = Mapping[Any, str | float]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of pings.

    Attributes:
        name: What it is called in errors.
        columns: By name.
        in_file: Whether times without a unit are seconds since 1970, not nanoseconds.
    """

    name: str
    columns: Mapping[str, Stored]
    in_file: bool = False

    def chosen(self, asked: Asked) -> dict[str, str | float]:
        """Return by quantity the name of its column or its value; quantities that the table lacks are left out.

        Raises:
            ConfigError: A column that is asked for is not there.
        """
        own = {name.lower(): name for name in self.columns}
        found: dict[str, str | float] = {}
        for key, (standard, *names) in _NAMES.items():
            stated = [
                name
                for name, column in self.columns.items()
                if column.text("standard_name") == standard
            ]
            named = [own[name] for name in (standard, *names) if name in own]
            known = [asked[key]] if key in asked else stated if len(stated) == 1 else named
            if known:
                found[key] = known[0]
        for key, name in found.items():
            if isinstance(name, str) and name not in self.columns:
                raise ConfigError(
                    f"logs.columns.{key}: expected a column of {self.name}, one of {some_text(list(self.columns))}, got '{name}'"
                )
        return found

    def profiles(self, asked: Asked, notes: list[str]) -> tuple[list[Observation], int]:
        """Return the profiles in order of time, and the number of rows without a time or a place, which are left out.

        Args:
            asked: What is not to be found by standard name or name.
            notes: What was assumed is added here.

        Raises:
            ConfigError: A column is missing, or a time or an error is none.
        """
        chosen = self.chosen(asked)
        if lacking := [key for key in _NAMES if key not in chosen]:
            raise ConfigError(
                f"{self.name}: {_EXPECTED}; it lacks {', '.join(lacking)}"
                f"{'; state the standard error of each component, it is not guessed' if 'error' in lacking else ''}"
                f"; name it with --columns {lacking[0]}=COLUMN (logs.columns), or give one number for all rows"
            )
        rows, known = self._rows(chosen, notes)
        place, depth = ("time", "longitude", "latitude"), rows["depth"]
        good = np.isfinite(depth + rows["u"] + rows["v"])
        if (bad := known & good & ~(rows["error"] > 0.0)).any():
            raise ConfigError(
                f"{self._of(chosen['error'])}: expected the standard error of each component [m/s], above 0, got "
                f"{rows['error'][bad][0]:g}; it is not guessed"
            )
        error = np.where(good, rows["error"], 1.0)  # of a bin that is missing
        at = np.flatnonzero(known)
        at = at[np.lexsort([rows[name][at] for name in ("depth", *place[::-1])])]
        apart = np.any([np.diff(rows[name][at]) != 0 for name in place], axis=0)
        return [
            Observation.profile(
                *(rows[name][k[0]].item() for name in place),
                *(values[k] for values in (depth, rows["u"], rows["v"], error)),
            )
            for k in np.split(at, np.flatnonzero(apart) + 1)
            if k.size
        ], int((~known).sum())

    def _of(self, name: str | float) -> str:
        return f"{self.name}['{name}']"

    def _rows(
        self, chosen: Asked, notes: list[str]
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Return the quantities at each row in SI units, and which rows have a time and a place."""
        # takes half a second to load
        import xarray as xr

        held: dict[str, Any] = {}
        for key, name in chosen.items():
            stored = (
                self.columns[name] if isinstance(name, str) else Stored(np.array(float(name)), {})
            )
            if key == "time":
                time, dated = self._time(str(name), stored, notes)
                held |= {key: (stored.dims, time), "dated": (stored.dims, dated)}
                continue
            quantity = _QUANTITIES[key]
            unit = "" if stored.units else quantity.unit
            values = units.in_si(str(name), stored, quantity, notes, unit)
            held[key] = stored.dims, -values if stored.text("positive") == "up" else values
        try:
            spread = xr.broadcast(
                *(xr.DataArray(values, dims=dims) for dims, values in held.values())
            )
        except ValueError as error:
            raise ConfigError(f"{self.name}: {_EXPECTED}, of one length: {error}") from error
        # of a grid, or of columns that have no rows in common
        if len(spread[0].dims) > 2 or spread[0].size > max(np.size(v) for _, v in held.values()):
            over = some_text(list(map(str, spread[0].dims)))
            raise ConfigError(f"{self.name}: {_EXPECTED}, got columns over {over}")
        rows = dict(zip(held, (each.to_numpy().ravel() for each in spread), strict=True))
        return rows, rows.pop("dated") & np.isfinite(rows["longitude"] + rows["latitude"])

    def _time(
        self, name: str, stored: Stored, notes: list[str]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        if stored.values.dtype.kind == "S" or " since " in stored.units or self.in_file:
            return units.time_ns(name, stored, NetcdfFile(Path(self.name), {}, {}, ()), notes)
        time_ns = measured_at(stored.values, self._of(name))
        return time_ns, np.ones(time_ns.shape, np.bool_)


def ping_of(profile: Observation, ordinal: int) -> dict[str, Any]:
    """Return a profile as an ``AdcpPing`` with a place of its own."""
    good = usable(profile.flags)[:, None]
    velocity = np.where(good, profile.velocity, np.nan)
    std = np.hypot(profile.error_std, profile.common_std)
    return {
        "stamp": stamp(profile.time_ns),
        "ping": ordinal,
        **({"dive": profile.dive} if profile.dive else {}),
        "place": {"lon": profile.longitude, "lat": profile.latitude},
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "bin_mapped": True,
        "n_cells": profile.depth.size,
        "cell_distances": numbers(profile.depth),
        "transducer_depth": 0.0,
        "pressure": 0.0,
        "velocity": numbers(velocity),
        "velocity_std": numbers(std),
        "correlation_depth": profile.correlation_depth,
    }


class TableReader(LogFile):
    """A table of pings in a file, read whole."""

    format = "table"

    def _prepare(self) -> None:
        """Read the file.

        Raises:
            LogError: It cannot be read, or lacks a column.
        """
        notes: list[str] = []
        table = table_in(Path(self.path))
        try:
            self._profiles, self._left_out = table.profiles(self._config.columns, notes)
        except ConfigError as error:
            raise LogError(str(error)) from error
        self._notes = self.statistics.notes = tuple(notes)

    def messages(self) -> Iterator[Message]:
        """Yield each profile as a message on ``/observations``; rows without a time or a place are counted and left out."""
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        self._skip(TOPIC, "row without a time or a place", self._left_out)
        pings = enumerate(self._profiles)
        yield from self._by_time((), ((p.time_ns, TOPIC, PING, ping_of(p, k)) for k, p in pings))


def table_in(path: Path) -> Table:
    """Return the table in a file, CSV or NetCDF; variables on grids are left out.

    Raises:
        LogError: It cannot be read.
    """
    if not in_text(path):
        return Table(str(path), open_netcdf(path, _flat).variables, in_file=True)
    columns = dict(read_csv(path))
    for name, column in columns.items():
        # a time in numbers; without a unit it is in seconds since 1970, which is noted
        if name.lower() in _NAMES["time"] and np.isfinite(times := column.unpacked()).all():
            columns[name] = Stored(times, column.attributes, column.dims)
    return Table(str(path), columns, in_file=True)


def holds_pings(path: Path, asked: Asked) -> bool:
    """Return whether a NetCDF file is a table of pings: it has all columns, or some are asked for."""
    return bool(asked) or len(table_in(path).chosen({})) == len(_NAMES)


def _flat(held: Any, attributes: Mapping[str, Any]) -> list[str]:
    return [name for name, item in held.items() if len(item.shape) < 3]


def in_text(path: Path) -> bool:
    """Return whether a file is a table in text."""
    with open(path, "rb") as file:
        return not file.read(4).startswith((b"CDF", b"\x89HDF"))


def read_csv(path: Path) -> Mapping[str, Stored]:
    """Return the columns of a table in text: names, perhaps with units in brackets or in the next row, then a row each.

    Raises:
        LogError: It cannot be read, or its rows are of unlike lengths.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
            lines = (line for line in _lines(file) if not line.startswith("#"))
            first = next(lines, "")
            table = csv.reader(chain([first], lines), delimiter=max(",;\t", key=first.count))
            names, rows = next(table), filter(None, table)
            cells = np.hstack([_block(some) for some in iter(lambda: [*islice(rows, _ROWS)], [])])
        named = [*zip(names, cells, strict=True)]
    except (OSError, ValueError, csv.Error) as error:
        raise LogError(
            f"{path}: expected a table: names, perhaps units, rows as long; got: {error}; write it again as .csv"
        ) from error
    begin = [np.isfinite([as_number(text) for text in row]).sum() for row in cells.T[:2]]
    in_row = len(begin) == 2 and 2 * begin[0] < begin[1]
    return dict(_column(name, column, in_row) for name, column in named)


def _column(heading: str, cells: NDArray[np.bytes_], unit_first: bool) -> tuple[str, Stored]:
    """Return a column's name, and its values with its unit."""
    name, bracket, unit = heading.strip().partition("[" if "[" in heading else "(")
    stated = cells[0].decode() if unit_first else unit.rstrip("]) ") if bracket else ""
    attributes = {"units": stated} if stated not in ("", "UTC") else {}
    return name.strip(), Stored(cells[int(unit_first) :], attributes, ("row",))


def _lines(file: TextIO) -> Iterator[str]:
    """Yield the lines of a table; raise ValueError for one that hardly ends."""
    while line := file.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise ValueError(f"a line of {LONGEST_LINE} letters or more")
        yield line


def _block(rows: list[list[str]]) -> NDArray[np.bytes_]:
    """Return the columns of some rows of a table.

    Raises:
        ValueError: They are of unlike lengths, or hold what is no value.
    """
    if max(len(cell) for row in rows for cell in row) > _LONGEST:
        raise ValueError(f"a value of more than {_LONGEST} letters")
    return np.char.encode(np.array(rows).T, "utf-8")
