"""Surface currents in columns: total vectors of HF radars, a message per time, and drifter tracks, a message per fix."""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.errors import LogError
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.columns import (
    FLAGS,
    Table,
    are_known,
    as_qartod,
    deciding_flags,
    is_failed,
    read_values,
    worst_flag,
)
from replay_kit.logs.netcdf.dialect import Dialect
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored, open_netcdf
from replay_kit.logs.payloads import Entry, entries, numbers, stamp
from replay_kit.logs.reader import Entries

RADAR, _TOTALS = "replay_kit.RadarCurrents", "/radar/totals"
_FIX, _DRIFTERS = "replay_kit.DrifterFix", "/drifters"
_MHZ = re.compile(r"(\d+(?:\.\d+)?)\s*MHz", re.IGNORECASE)
#: Length of a wave of 1 MHz [m]: light goes so far in a microsecond.
LIGHT = 299.792458
# MHz of the radars that see farthest, and are taken where no frequency is stated
_LONG_RANGE = 5.0
_HOUR = 3600.0
_PARAMETER = re.compile(r"(\d+)\)\s*([^\n]+)")
# where the parameters of MARACOOS's product stand when nothing describes them: variance [cm2/s2] and decorrelation length [km]
_VARIANCE, _LENGTH = 7, 5
# times of a file that are read together: a month of a file is 200 MB
_ROWS = 48
#: Standard error of a radial, taken where none is stated [cm/s].
USUAL_ERROR = 10.0
# of normalised errors; values above are of questionable quality, as the files say
_MOST_NORMALISED = 0.6
# m: depth of the middle of the programme's drogue; and of a degree of latitude
_DROGUE, _DEGREE = 15.0, 111_200.0


def depth_of(frequency: float) -> float:
    """Return the approximate measuring depth of a radar of a frequency [MHz]: its wavelength over 8 pi [m].

    Source: Stewart and Joy (1974), Deep-Sea Research 21.
    """
    return LIGHT / frequency / (8.0 * np.pi)


def _totals(files: Sequence[NetcdfFile], dialect: Dialect) -> Entries:
    """Return the vectors of each time in SI units and degrees, without missing errors or failed flags.

    Raises:
        LogError: A file has no time.
    """
    notes = files[0].told.notes
    times: list[tuple[int, int, int]] = []
    for number_of, file in enumerate(files):
        time_ns = units.times_of(file, dialect.chosen(file.variables)["time"])
        times += [(at, number_of, k) for k, at in enumerate(time_ns.ravel().tolist()) if at]
    times.sort()
    begun = len(notes)

    def messages() -> Iterator[Entry]:
        del notes[begun:]
        failed = 0
        for (number_of, part), rows in groupby(times, lambda each: (each[1], each[2] // _ROWS)):
            found = _vectors(files[number_of].path, part * _ROWS, dialect)
            notes.extend(note for note in found.notes if note not in notes)
            for time_ns, _, row in rows:
                k = row % _ROWS
                failed += int(found.failed[k].sum())
                held = {key: numbers(of[k][found.known[k]]) for key, of in found.columns.items()}
                yield time_ns, _TOTALS, RADAR, {"stamp": stamp(time_ns), **found.fixed, **held}
        if failed:
            notes.append(f"{failed} vectors failed by their quality flags, not used")

    return lambda: [(), messages()]


class _Vectors(NamedTuple):
    """Vectors of some times of a file.

    Attributes:
        columns: Fields of the vectors, shape (t, y, x).
        known: Mask of those that are used.
        failed: Mask of those that their flags fail.
        fixed: Fields of each message.
        notes: What was assumed.
    """

    columns: Table
    known: Mask
    failed: Mask
    fixed: dict[str, float]
    notes: list[str]


def _vectors(path: Path, begin: int, dialect: Dialect) -> _Vectors:
    """Return the vectors of some times of a file, from a time's index on."""
    file = open_netcdf(path, lambda held, _: dialect.wanted(held), slice(begin, begin + _ROWS))
    chosen = dialect.chosen(file.variables)
    values = read_values(file, dialect, chosen)
    longitude, latitude = (np.squeeze(values[key]) for key in ("longitude", "latitude"))
    if longitude.ndim < 2:
        longitude, latitude = np.meshgrid(longitude, latitude, sparse=True)
    shape = (len(values["east"]), len(latitude), longitude.shape[-1])
    fits = latitude.shape in (longitude.shape, (shape[1], 1))
    if not fits or values["east"].size != math.prod(shape):
        raise LogError(
            f"{path}: {chosen['east']}: expected {shape[1]} x {shape[2]} values, as lat and lon have, got {values['east'][0].size}"
        )
    variance, length = _parameters(file, chosen.get("parameters", ""))
    for key in ("east_error", "north_error"):
        values[key] = _error(file, chosen[key], variance, dialect)
    held = {n: v for n, v in file.variables.items() if v.values.size == math.prod(shape)}
    flags = [as_qartod(held[name]).reshape(shape) for name in deciding_flags(held)]
    columns = {
        "longitude": np.broadcast_to(longitude, shape),
        "latitude": np.broadcast_to(latitude, shape),
        **{
            key: values[key].reshape(shape)
            for key in ("east", "north", "east_error", "north_error")
        },
        "flag": worst_flag(flags, shape),
    }
    measured = np.isfinite(columns["east"] + columns["north"])
    failed = measured & is_failed(columns["flag"])
    known = measured & ~failed & np.isfinite(columns["east_error"] + columns["north_error"])
    mhz = [match for text in file.attributes.values() if (match := _MHZ.search(str(text)))]
    frequency, how = (float(mhz[0][1]), "as stated") if mhz else (_LONG_RANGE, "assumed")
    depth = depth_of(frequency)
    file.note(
        f"{dialect.title}: at {depth:.1f} m, a wavelength over 8 pi of {frequency:g} MHz ({how}); "
        "vectors without a good error are not used"
    )
    fixed = {"depth": depth, "averaged": _HOUR, "error_length": 1e3 * length}
    return _Vectors(columns, known, failed, fixed, file.told.notes)


def _parameters(file: NetcdfFile, name: str) -> tuple[float, float]:
    """Return the signal variance [cm2/s2] and the decorrelation length [km]; NaN and 0 if not stated.

    They are processing parameters of the vectors, described in a comment or as numbered attributes (``parameter6``,
    ``parameter6_description``).
    """
    stored = file.variables.get(name, Stored(np.empty(0), {}))
    values = dict(enumerate(stored.unpacked().ravel().tolist(), 1))
    described = {int(n): words for n, words in _PARAMETER.findall(stored.text("comment"))}
    for key, value in {**file.attributes, **stored.attributes}.items():
        if match := re.fullmatch(r"parameter(\d+)(_description)?", key):
            if match[2]:
                described[int(match[1])] = str(value)
            else:
                values[int(match[1])] = float(np.ravel(value)[0])
    variance, length = (
        values.get(
            next((n for n, text in described.items() if re.search(words, text, re.I)), usual),
            math.nan,
        )
        for words, usual in (("signal variance", _VARIANCE), ("decorrelation", _LENGTH))
    )
    return variance, length if length > 0.0 else 0.0


def _error(file: NetcdfFile, name: str, variance: float, dialect: Dialect) -> Array:
    """Return standard errors [m/s], NaN if not stated or of questionable quality."""
    if file.variables[name].units not in ("", "1"):
        return units.in_si(file, name, units.SPEED)
    values = file.array(name)
    if name.lower() in ("dopx", "dopy"):
        usual = f"{USUAL_ERROR:g} cm/s, assumed for each radial"
        file.note(f"errors: dilutions of precision, times {usual}")
        return np.where(values > 0.0, 1e-2 * USUAL_ERROR * values, np.nan)
    if not variance > 0.0:
        raise LogError(
            f"{dialect.title}: expected the signal's variance in {dialect.names['parameters']}, by which errors are normalised, got none"
        )
    file.note(
        f"errors: normalised variances, times the signal's stated variance of {variance:g} cm2/s2"
    )
    good = (values >= 0.0) & (values <= _MOST_NORMALISED)
    return np.where(good, np.sqrt(np.where(good, values, 0.0) * (1e-4 * variance)), np.nan)


#: Totals; errors are standard errors, variances over that of the signal (optimal interpolation, MARACOOS), or dilutions of precision.
TOTALS = Dialect(
    "radar-totals",
    "totals of HF radars",
    "time lat|latitude lon|longitude u|ewct|ucur v|nsct|vcur u_err|dopx|ewcs|ucur_sd v_err|dopy|nscs|vcur_sd",
    {
        "time": "time",
        "longitude": "lon longitude",
        "latitude": "lat latitude",
        "east": "u ewct ucur",
        "north": "v nsct vcur",
        "east_error": "u_err dopx ewcs ucur_sd",
        "north_error": "v_err dopy nscs vcur_sd",
        "parameters": "processing_parameters",
    },
    beside=FLAGS,
    log_of="all",
    read=_totals,
    by_times=True,
)


def _drifters(files: Sequence[NetcdfFile], dialect: Dialect) -> Entries:
    """Return the fixes of drifters with their drogue status.

    Raises:
        LogError: Columns have different lengths.
    """
    tables = [_drifter_fixes(file, dialect) for file in files]
    return lambda: [(), *map(_fixes, tables)]


def _drifter_fixes(file: NetcdfFile, dialect: Dialect) -> Table:
    """Return the columns of the fixes."""
    chosen = dialect.chosen(file.variables)
    values = {"id": np.array(file.path.stem)} | read_values(file, dialect, chosen)
    n = values["time"].size
    if "depth" not in values:
        file.note(f"depth of the drogues is not stated: {_DROGUE:g} m taken")
        values["depth"] = np.array(_DROGUE)
    for key, found in values.items():
        if found.size not in (1, n):
            raise LogError(
                f"{file.path}: {chosen[key]}: expected a value for each of {n} fixes or each drifter, got {found.size}; "
                "write the file again"
            )
        values[key] = np.broadcast_to(found.ravel(), n)
    lost = values.get("lost_time", np.zeros(n))
    # a drifter whose drogue was not lost has no date, or that of the epoch
    with_drogue = (lost == 0) | (values["time"] < lost)
    return {
        **{key: values[key] for key in ("time", "id", "longitude", "latitude", "depth")},
        "drogued": values["drogued"] == 1.0 if "drogued" in values else with_drogue,
        "error": _DEGREE * values.get("latitude_error", np.full(n, np.nan)),
    }


def _fixes(table: Table) -> Iterator[Entry]:
    """Yield the fixes in order of time."""
    order = np.argsort(table["time"], kind="stable")
    return entries((_DRIFTERS, _FIX), table["time"], table, order[are_known(table)[order]], {})


#: The Global Drifter Program, of one drifter or of several as a ragged array, or as a table of ERDDAP.
DRIFTERS = Dialect(
    "drifters",
    "Global Drifter Program",
    "time longitude|lon latitude|lat drogue_lost_date|drogue_status",
    {
        "time": "time",
        "longitude": "longitude lon",
        "latitude": "latitude lat",
        "lost_time": "drogue_lost_date",
        "drogued": "drogue_status",
        "depth": "drogue_center_depth drogue_depth",
        "latitude_error": "err_lat",
        "id": "id ids",
    },
    units={"depth": "m", "latitude_error": "degrees"},
    log_of="all",
    read=_drifters,
)
