"""Total vectors of HF radars: hourly currents on a grid in NetCDF, each time a message of vectors in SI units.

To add a dialect, write its ``TotalsDialect`` and add it to ``DIALECTS``, or offer it as an entry point ``radar_totals``.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.extensions import additions
from replay_kit.core.message import Message
from replay_kit.logs.glider import units
from replay_kit.logs.glider.netcdf import NetcdfFile, Stored, open_netcdf
from replay_kit.logs.reader import VALUES, LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import numbers, stamp

SCHEMA, TOPIC = "replay_kit.RadarCurrents", "/radar/totals"
_MHZ = re.compile(r"(\d+(?:\.\d+)?)\s*MHz", re.IGNORECASE)
# m/s; light goes so far in a microsecond as a wave of 1 MHz is long
_LIGHT = 299.792458
# MHz of the radars that see farthest, and are taken where no frequency is stated
_LONG_RANGE = 5.0
_HOUR = 3600.0
# times of a file that are read together: a month of a file is 200 MB
_ROWS = 48
# of normalised errors; values above are of questionable quality, as the files say
_MOST_NORMALISED = 0.6


@dataclass(frozen=True, slots=True)
class TotalsDialect:
    """One convention of files with total vectors.

    Attributes:
        name: For notes.
        east: Variable of the eastward current, and so on.
        north: Northward.
        east_error: Standard error, or the error variance over that of the signal, which has no unit.
        north_error: Of the northward current.
        parameters: Variable that lists how the vectors were made; empty for none.
        variance: Where in it the signal's variance stands [cm2/s2].
        length: Where in it the decorrelation length stands [km].
    """

    name: str
    east: str
    north: str
    east_error: str
    north_error: str
    parameters: str = ""
    variance: int = 0
    length: int = 0

    def recognises(self, names: Collection[str]) -> bool:
        """Return whether a file with these variables is of the dialect."""
        wanted = {self.east, self.north, self.east_error, self.north_error, "time", "lat", "lon"}
        return wanted <= set(names)


#: Tried in this order.
DIALECTS = (
    TotalsDialect(
        "optimally interpolated totals (Rutgers, MARACOOS)",
        "u",
        "v",
        "u_err",
        "v_err",
        "processing_parameters",
        variance=6,
        length=4,
    ),
)


def depth_of(frequency: float) -> float:
    """Return the depth that a radar of a frequency [MHz] sees, about [m]: its wavelength over 8 pi.

    Source: Stewart and Joy (1974), Deep-Sea Research 21.
    """
    return _LIGHT / frequency / (8.0 * np.pi)


def dialect_of(names: Collection[str]) -> TotalsDialect | None:
    """Return the dialect of a file with these variables; None for a file that holds no totals."""
    added = additions(
        "radar_totals", lambda value: isinstance(value, TotalsDialect), "a TotalsDialect"
    )
    found = (*DIALECTS, *added.values())
    return next((dialect for dialect in found if dialect.recognises(names)), None)


class TotalsReader(LogFile):
    """Files of total vectors that are one log."""

    format = "radar-totals"
    without_checksum = VALUES

    def _prepare(self) -> None:
        """Read the files' times.

        Raises:
            LogError: A file cannot be read, or holds no time.
        """
        self._notes = dict[str, None]()
        times = []
        for path in self.files:
            notes: list[str] = []
            file = open_netcdf(path, lambda names, attributes: ["time"])
            time_ns, known = units.time_ns("time", file.variables["time"], file, notes)
            self._notes |= dict.fromkeys(notes)
            times += [
                (int(at), path, k)
                for k, at in enumerate(time_ns.ravel().tolist())
                if known.ravel()[k]
            ]
        self._times = sorted(times)
        self.statistics.notes = tuple(self._notes)

    def messages(self) -> Iterator[Message]:
        """Yield the vectors of each time as a message on ``/radar/totals``: SI units, degrees; those without an error are left out."""
        self.statistics = ReadStatistics()
        opened: tuple[Path, int, NetcdfFile] | None = None
        topic = self._topic(TOPIC)
        for position, (time_ns, path, k) in enumerate(self._times):
            begin = k - k % _ROWS
            if opened is None or opened[:2] != (path, begin):
                opened = path, begin, open_netcdf(path, _wanted, slice(begin, begin + _ROWS))
            payload = self._payload(opened[2], k - begin)
            self.statistics.notes = tuple(self._notes)
            self.statistics.read[topic] += 1
            message = {"stamp": stamp(time_ns), **payload}
            yield Message(time_ns, topic, SCHEMA, message, self.input, position)

    def _payload(self, file: NetcdfFile, k: int) -> dict[str, Any]:
        dialect = dialect_of(file.names)
        assert dialect is not None, "its times were read"
        notes: list[str] = []
        places = [file.array(name).ravel() for name in ("lon", "lat")]
        per_time, grid = (
            file.variables[dialect.east].values[k].size,
            (places[1].size, places[0].size),
        )
        if per_time != np.prod(grid):
            raise LogError(
                f"{file.path}: {dialect.east}: expected {grid[0]} x {grid[1]} values, as lat and lon have, got {per_time}"
            )
        longitude, latitude = np.meshgrid(*places)
        east, north, *errors = (
            _at(file.variables[name], k)
            for name in (dialect.east, dialect.north, dialect.east_error, dialect.north_error)
        )
        u, v = (
            units.in_si(name, stored, units.SPEED, notes).reshape(longitude.shape)
            for name, stored in ((dialect.east, east), (dialect.north, north))
        )
        parameters = file.array(dialect.parameters) if file.has(dialect.parameters) else np.empty(0)
        stds = [_error(each, parameters, dialect, notes) for each in errors]
        known = np.isfinite(u + v) & np.isfinite(stds[0] + stds[1]).reshape(u.shape)
        depth, how = _depth(file.attributes)
        notes.append(
            f"{dialect.name}: {how}; vectors without an error, or with one of questionable quality, are not used"
        )
        self._notes |= dict.fromkeys(notes)
        length = (
            1e3 * float(parameters[dialect.length]) if parameters.size > dialect.length else 0.0
        )
        columns = {"longitude": longitude, "latitude": latitude, "east": u, "north": v}
        columns |= {"east_error": stds[0].reshape(u.shape), "north_error": stds[1].reshape(u.shape)}
        return {
            "depth": depth,
            "averaged": _HOUR,
            "error_length": length,
            **{name: numbers(values[known]) for name, values in columns.items()},
        }


def _wanted(names: Collection[str], attributes: Mapping[str, Any]) -> list[str]:
    dialect = dialect_of(names)
    if dialect is None:
        return []
    own = (dialect.east, dialect.north, dialect.east_error, dialect.north_error)
    return [name for name in (*own, dialect.parameters, "time", "lat", "lon") if name in names]


def _at(stored: Stored, k: int) -> Stored:
    """Return a variable at one time, the first dimension."""
    return Stored(stored.values[k], stored.attributes, stored.dims[1:])


def _error(stored: Stored, parameters: Array, dialect: TotalsDialect, notes: list[str]) -> Array:
    """Return standard errors [m/s], NaN where none is stated or it is of questionable quality."""
    if stored.units not in ("", "1"):
        return units.in_si("error", stored, units.SPEED, notes)
    values = stored.unpacked()
    if parameters.size <= dialect.variance or not parameters[dialect.variance] > 0.0:
        raise LogError(
            f"{dialect.name}: expected the signal's variance in {dialect.parameters}, by which errors are normalised, got none"
        )
    variance = 1e-4 * float(parameters[dialect.variance])
    notes.append(
        f"errors: normalised variances, times the signal's stated variance of {1e4 * variance:g} cm2/s2"
    )
    good = (values >= 0.0) & (values <= _MOST_NORMALISED)
    return np.where(good, np.sqrt(np.where(good, values, 0.0) * variance), np.nan)


def _depth(attributes: Mapping[str, Any]) -> tuple[float, str]:
    """Return the depth that the radars see [m], and where it is from."""
    stated = [match for text in attributes.values() if (match := _MHZ.search(str(text)))]
    frequency = float(stated[0][1]) if stated else _LONG_RANGE
    how = "as stated" if stated else "assumed"
    depth = depth_of(frequency)
    return depth, f"at {depth:.1f} m, a wavelength over 8 pi of {frequency:g} MHz ({how})"
