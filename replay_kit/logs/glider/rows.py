"""NetCDF files of no known dialect: each time is a message, for ``[[measurements.map]]``."""

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.inputs import open_input
from replay_kit.core.message import Message
from replay_kit.core.text import some_text
from replay_kit.logs.glider import units
from replay_kit.logs.glider.netcdf import NetcdfFile, open_netcdf, ranks_of
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import numbers

#: First part of the topic, before the name of the time variable.
TOPIC = "netcdf/"
_VELOCITY = (
    "eastward_sea_water_velocity",
    "northward_sea_water_velocity",
    "sea_water_x_velocity",
    "sea_water_y_velocity",
)
# names of currents in forecasts, and bytes from which a file is asked for them before it is read
_USUAL = ("u", "uo", "water_u", "vozocrtx", "uvel", "u_eastward", "ucur", "vxo")
_LARGE = 1 << 24
# Rows of which messages are made at once.
_ROWS = 4096
_NOT_A_LOG = "; a forecast is given with --ensemble, not as a log"
_EXPECTED = "expected a Seaglider basestation file or a glider file of another known dialect"


def refuse_forecast(path: Path) -> None:
    """Raise LogError for a large file of currents on a grid, by its header: to read it as a log takes long, and says no more."""
    with open_input(path) as file:
        is_netcdf = file.read(4).startswith((b"CDF", b"\x89HDF"))
    if not is_netcdf or path.stat().st_size < _LARGE:
        return
    from replay_kit.logs.surface.totals import dialect_of as totals_of

    ranks = ranks_of(path)
    if totals_of(ranks) is None and any(
        rank > 2 and name.lower() in _USUAL for name, rank in ranks.items()
    ):
        raise on_a_grid(path, ranks)


def on_a_grid(path: str | Path, names: Collection[str]) -> LogError:
    """Return the error for a forecast that is given as a log."""
    return LogError(
        f"{path}: {_EXPECTED}, got currents on a grid: {some_text(list(names))}{_NOT_A_LOG}"
    )


class NetcdfRows(LogFile):
    """A file whose variables are rows over one time; ``[[measurements.map]]`` maps them."""

    format = "netcdf"

    def _prepare(self) -> None:
        """Read the file.

        Raises:
            LogError: The file cannot be read, holds no time, or is a forecast.
        """
        file = open_netcdf(Path(self.path), lambda names, attributes: names)
        if any(
            stored.text("standard_name") in _VELOCITY and stored.values.ndim > 2
            for stored in file.variables.values()
        ):
            raise on_a_grid(self.path, file.variables)
        self._name = _time_name(file)
        notes: list[str] = []
        self._time_ns, self._known = units.time_ns(
            self._name, file.variables[self._name], file, notes
        )
        self._time_ns, self._known = self._time_ns.ravel(), self._known.ravel()
        self._rows, self._fixed = _split(file, self._name, self._time_ns.size)
        if not self._rows:
            raise LogError(
                f"{self.path}: {_EXPECTED}, got no variable along {self._name} alone: {', '.join(file.variables)}{_NOT_A_LOG}"
            )
        self._notes = (
            f"of no known glider dialect: each row over {self._name} is a message on {TOPIC}{self._name}, with {', '.join(self._rows)}"
            + (f", and at each row {', '.join(self._fixed)}" if self._fixed else ""),
            *notes,
        )
        self.statistics.notes = self._notes

    def messages(self) -> Iterator[Message]:
        """Yield a message a row, in order of time; rows without a time are counted and left out."""
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        topic = f"{TOPIC}{self._name}"
        self._skip(topic, "row without a time", int((~self._known).sum()))
        known = np.flatnonzero(self._known)
        in_time = known[np.argsort(self._time_ns[known], kind="stable")]
        yield from self._by_time((), self._entries(topic, in_time))

    def _entries(self, topic: str, rows: NDArray[np.intp]) -> Iterator[Entry]:
        """Yield the entries of rows, some at a time: those of a long file would take many times its memory."""
        fixed = {
            name: numbers(values) if values.ndim else float(values)
            for name, values in self._fixed.items()
        }
        for some in np.split(rows, range(_ROWS, rows.size, _ROWS)):
            columns = [
                numbers(values[some]) if values.ndim > 1 else values[some].astype(float).tolist()
                for values in self._rows.values()
            ]
            for time_ns, *row in zip(self._time_ns[some].tolist(), *columns, strict=True):
                yield time_ns, topic, "netcdf", dict(zip(self._rows, row, strict=True)) | fixed


def _time_name(file: NetcdfFile) -> str:
    """Return the name of the variable of time: the longest of those with an epoch, then of those with the name."""
    sized = {
        name: stored
        for name, stored in file.variables.items()
        if stored.values.size and stored.values.dtype.kind in "iuf" and stored.values.ndim < 2
    }
    stated = [name for name, stored in sized.items() if " since " in stored.units]
    named = [name for name in sized if "time" in name.lower() and sized[name].values.ndim]
    found = stated or named
    if not found:
        raise LogError(
            f"{file.path}: {_EXPECTED}, or any NetCDF with a variable of time (units 'seconds since 1970-01-01'); got variables "
            f"{', '.join(file.variables) or 'none'}{_NOT_A_LOG}"
        )
    return max(
        found,
        key=lambda name: (sized[name].values.size, sized[name].text("standard_name") == "time"),
    )


def _split(file: NetcdfFile, time: str, n: int) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the variables with a row for each time, and those that hold for all, such as levels; names with dots can be in no path."""
    rows: dict[str, Array] = {}
    fixed: dict[str, Array] = {}
    for name, stored in file.variables.items():
        if (
            name == time
            or "." in name
            or stored.values.dtype.kind not in "iufb"
            or stored.values.ndim > 2
        ):
            continue
        values = stored.unpacked()
        if values.ndim and values.shape[0] == n:
            rows[name] = values
        elif values.ndim == 2 and values.shape[1] == n:
            rows[name] = values.T
        elif values.ndim < 2 and values.size < n:
            fixed[name] = values
    return rows, fixed
