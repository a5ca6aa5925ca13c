"""Total vectors of HF radars: hourly currents on a grid in NetCDF, each time a message of vectors in SI units.

To add a dialect, write its ``TotalsDialect`` and add it to ``DIALECTS``, or offer it as an entry point ``radar_totals``.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.extensions import additions
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag
from replay_kit.logs.glider import units
from replay_kit.logs.glider.netcdf import NetcdfFile, Stored, open_netcdf
from replay_kit.logs.reader import LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import numbers, stamp

SCHEMA, TOPIC = "replay_kit.RadarCurrents", "/radar/totals"
_MHZ = re.compile(r"(\d+(?:\.\d+)?)\s*MHz", re.IGNORECASE)
# m/s; light goes so far in a microsecond as a wave of 1 MHz is long
_LIGHT = 299.792458
# MHz of the radars that see farthest, and are taken where no frequency is stated
_LONG_RANGE = 5.0
_HOUR = 3600.0
# flags that sum up all tests, or are an operator's; and those of single tests
_SUMS = re.compile(
    r"prim|(qc_?)?primary(_?flag)?|qc|qc_?flag|quality_flag|.*aggregate.*|.*operator.*", re.I
)
_TESTS = re.compile(r"q(c_?)?\d{2,3}(_.*)?|.*_qc|.*qartod_.*", re.I)
_MEANINGS = (
    (re.compile(r"suspect|question|interest", re.I), Flag.SUSPECT),
    (units.UNUSABLE, Flag.FAIL),
    (re.compile(r"unknown|not_", re.I), Flag.NOT_EVALUATED),
)
_PARAMETER = re.compile(r"(\d+)\)\s*([^\n]+)")
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
        parameters: Variable that lists how the vectors were made, as values with their descriptions in its comment, or as numbered
            attributes (``parameter6``, ``parameter6_description``); empty for none.
        variance: Where in it the signal's variance stands when nothing is described [cm2/s2].
        length: Where in it the decorrelation length stands then [km].
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
        self._failed = 0
        opened: tuple[Path, int, NetcdfFile] | None = None
        topic = self._topic(TOPIC)
        for position, (time_ns, path, k) in enumerate(self._times):
            begin = k - k % _ROWS
            if opened is None or opened[:2] != (path, begin):
                opened = path, begin, open_netcdf(path, _wanted, slice(begin, begin + _ROWS))
            payload = self._payload(opened[2], k - begin)
            failed = f"{self._failed} vectors failed by their quality flags, not used"
            self.statistics.notes = (*self._notes, *([failed] if self._failed else []))
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
        variance, length = _parameters(file, dialect)
        stds = [_error(each, variance, dialect, notes) for each in errors]
        quality = _quality(file, dialect, k).reshape(u.shape)
        measured = np.isfinite(u + v)
        failed = measured & ~usable_or_untested(quality)
        self._failed += int(failed.sum())
        known = measured & ~failed & np.isfinite(stds[0] + stds[1]).reshape(u.shape)
        depth, how = _depth(file.attributes)
        notes.append(
            f"{dialect.name}: {how}; vectors without an error, or with one of questionable quality, are not used"
        )
        self._notes |= dict.fromkeys(notes)
        columns: dict[str, NDArray[Any]] = {
            "longitude": longitude,
            "latitude": latitude,
            "east": u,
            "north": v,
            "flag": quality,
        }
        columns |= {"east_error": stds[0].reshape(u.shape), "north_error": stds[1].reshape(u.shape)}
        return {
            "depth": depth,
            "averaged": _HOUR,
            "error_length": 1e3 * length,
            **{name: numbers(values[known]) for name, values in columns.items()},
        }


def _wanted(names: Collection[str], attributes: Mapping[str, Any]) -> list[str]:
    dialect = dialect_of(names)
    if dialect is None:
        return []
    own = (dialect.east, dialect.north, dialect.east_error, dialect.north_error)
    flags = [name for name in names if _SUMS.fullmatch(name) or _TESTS.fullmatch(name)]
    return [
        name for name in (*own, dialect.parameters, "time", "lat", "lon", *flags) if name in names
    ]


def _at(stored: Stored, k: int) -> Stored:
    """Return a variable at one time, the first dimension."""
    return Stored(stored.values[k], stored.attributes, stored.dims[1:])


def usable_or_untested(flags: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return which values QARTOD flags do not call failed or missing."""
    return np.asarray((flags != Flag.FAIL) & (flags != Flag.MISSING))


def worst_flag(flags: Sequence[NDArray[np.int8]], n: int) -> NDArray[np.int8]:
    """Return the worst of each value's QARTOD flags, shape (n,); not evaluated where there are none."""
    ranked = np.stack([np.full(n, Flag.NOT_EVALUATED, np.float64), *flags])
    # a test that was passed is more than one that was not made
    ranked[ranked == Flag.GOOD] = Flag.NOT_EVALUATED + 0.5
    return np.where(ranked.max(axis=0) == 2.5, Flag.GOOD, ranked.max(axis=0)).astype(np.int8)


def _quality(file: NetcdfFile, dialect: TotalsDialect, k: int) -> NDArray[np.int8]:
    """Return the QARTOD flag of each vector at one time: that which sums up all tests, else the worst of the tests."""
    size = file.variables[dialect.east].values[k].size
    held = {
        name: _at(stored, k)
        for name, stored in file.variables.items()
        if (_SUMS.fullmatch(name) or _TESTS.fullmatch(name))
        and stored.values.ndim > 1
        and stored.values[0].size == size
    }
    sums = [stored for name, stored in held.items() if _SUMS.fullmatch(name)]
    return worst_flag([_as_qartod(stored) for stored in sums or held.values()], size)


def _as_qartod(stored: Stored) -> NDArray[np.int8]:
    """Return flags as QARTOD's, by their stated meanings; else by their numbers."""
    numbers = np.nan_to_num(stored.unpacked().ravel(), nan=Flag.NOT_EVALUATED).astype(np.int8)
    found = numbers.copy()
    for value, words in units.stated_meanings(stored).items():
        found[numbers == value] = next(
            (flag for pattern, flag in _MEANINGS if pattern.search(words)), Flag.GOOD
        )
    return found


def _parameters(file: NetcdfFile, dialect: TotalsDialect) -> tuple[float, float]:
    """Return the signal's variance [cm2/s2] and the decorrelation length [km], by their descriptions; NaN and 0 where not stated."""
    stored = file.variables.get(dialect.parameters, Stored(np.empty(0), {}))
    values = dict(enumerate(stored.unpacked().ravel().tolist(), 1))
    described = {int(n): words for n, words in _PARAMETER.findall(stored.text("comment"))}
    for key, value in {**file.attributes, **stored.attributes}.items():
        if match := re.fullmatch(r"parameter(\d+)(_description)?", key):
            if match[2]:
                described[int(match[1])] = str(value)
            else:
                values[int(match[1])] = float(np.ravel(value)[0])

    def stated(words: str, place: int) -> float:
        found = [n for n, text in described.items() if re.search(words, text, re.I)]
        return values.get(found[0] if found else place + 1, math.nan)

    length = stated("decorrelation", dialect.length)
    return stated("signal variance", dialect.variance), length if length > 0.0 else 0.0


def _error(stored: Stored, variance: float, dialect: TotalsDialect, notes: list[str]) -> Array:
    """Return standard errors [m/s], NaN where none is stated or it is of questionable quality."""
    if stored.units not in ("", "1"):
        return units.in_si("error", stored, units.SPEED, notes)
    values = stored.unpacked()
    if not variance > 0.0:
        raise LogError(
            f"{dialect.name}: expected the signal's variance in {dialect.parameters}, by which errors are normalised, got none"
        )
    variance = 1e-4 * variance
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
