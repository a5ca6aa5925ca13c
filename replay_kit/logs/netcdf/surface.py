"""Surface currents in columns: total vectors of HF radars, a message per time, and drifter tracks, a message per fix."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.observation import Flag
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.columns import profile_sizes, read_values
from replay_kit.logs.netcdf.dialects import Dialect, Entries, Told
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored, open_netcdf
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import number, numbers, stamp

RADAR, _TOTALS = "replay_kit.RadarCurrents", "/radar/totals"
_FIX, _DRIFTERS = "replay_kit.DrifterFix", "/drifters"
_MHZ = re.compile(r"(\d+(?:\.\d+)?)\s*MHz", re.IGNORECASE)
#: Length of a wave of 1 MHz [m]: light goes so far in a microsecond.
LIGHT = 299.792458
# MHz of the radars that see farthest, and are taken where no frequency is stated
_LONG_RANGE = 5.0
_HOUR = 3600.0
# flags that sum up all tests, or are an operator's; and those of single tests
_SUMS = r"prim|(qc_?)?primary(_?flag)?|qc|qc_?flag|quality_flag|.*aggregate.*|.*operator.*"
_TESTS = r"q(c_?)?\d{2,3}(_.*)?|.*_qc|.*qartod_.*"
_MEANINGS = (
    (re.compile(r"suspect|question|interest", re.I), Flag.SUSPECT),
    (units.UNUSABLE, Flag.FAIL),
    (re.compile(r"unknown|not_", re.I), Flag.NOT_EVALUATED),
)
_PARAMETER = re.compile(r"(\d+)\)\s*([^\n]+)")
# where the parameters of MARACOOS's product stand when nothing describes them: variance [cm2/s2] and decorrelation length [km]
_VARIANCE, _LENGTH = 7, 5
# times of a file that are read together: a month of a file is 200 MB
_ROWS = 48
# of normalised errors; values above are of questionable quality, as the files say
_MOST_NORMALISED = 0.6
# m: depth of the middle of the programme's drogue; and of a degree of latitude
_DROGUE, _DEGREE = 15.0, 111_200.0


def depth_of(frequency: float) -> float:
    """Return the approximate measuring depth of a radar of a frequency [MHz]: its wavelength over 8 pi [m].

    Source: Stewart and Joy (1974), Deep-Sea Research 21.
    """
    return LIGHT / frequency / (8.0 * np.pi)


def _totals(
    files: Sequence[NetcdfFile], dialect: Dialect, config: LogConfig, told: Told
) -> Entries:
    """Return the vectors of each time in SI units and degrees, without missing errors or failed flags.

    Raises:
        LogError: A file has no time.
    """
    del config
    notes = told.notes
    times: list[tuple[int, int, int]] = []
    for number_of, file in enumerate(files):
        name = dialect.chosen(file.variables)["time"]
        time_ns, known = units.time_ns(name, file.variables[name], file.path, notes)
        found = zip(time_ns.ravel().tolist(), known.ravel().tolist(), strict=True)
        times += [(at, number_of, k) for k, (at, is_known) in enumerate(found) if is_known]
    times.sort()
    begun = len(notes)

    def entries() -> Iterator[Entry]:
        del notes[begun:]
        opened: tuple[int, int] | None = None
        failed = 0
        for time_ns, number_of, k in times:
            begin = k - k % _ROWS
            if opened != (number_of, begin):
                opened, said = (number_of, begin), list[str]()
                vectors = _vectors(files[number_of].path, begin, dialect, said)
                notes.extend(note for note in said if note not in notes)
            payload, lost = vectors(k - begin)
            failed += lost
            yield time_ns, _TOTALS, RADAR, {"stamp": stamp(time_ns), **payload}
        if failed:
            notes.append(f"{failed} vectors failed by their quality flags, not used")

    return lambda: [(), entries()]


def _vectors(
    path: Path, begin: int, dialect: Dialect, notes: list[str]
) -> Callable[[int], tuple[dict[str, Any], int]]:
    """Return a function of a time index that returns the vectors and the number of failed ones."""
    file = open_netcdf(path, lambda held, _: dialect.wanted(held), slice(begin, begin + _ROWS))
    chosen = dialect.chosen(file.variables)
    values = read_values(file, dialect, chosen, notes)
    places = [values[key].ravel() for key in ("longitude", "latitude")]
    shape = (len(values["east"]), places[1].size, places[0].size)
    if values["east"].size != math.prod(shape):
        raise LogError(
            f"{path}: {chosen['east']}: expected {shape[1]} x {shape[2]} values, as lat and lon have, got {values['east'][0].size}"
        )
    longitude, latitude = np.meshgrid(*places)
    east, north = (values[key].reshape(shape) for key in ("east", "north"))
    variance, length = _parameters(file, chosen.get("parameters", ""))
    errors = [
        _error(file.variables[chosen[f"{key}_error"]], variance, dialect, notes).reshape(shape)
        for key in ("east", "north")
    ]
    quality = _quality(file, shape)
    measured = np.isfinite(east + north)
    failed = measured & is_failed(quality)
    known = measured & ~failed & np.isfinite(errors[0] + errors[1])
    depth, how = _depth(file.attributes)
    notes.append(
        f"{dialect.title}: {how}; vectors without an error, or with one of questionable quality, are not used"
    )
    fixed = {"depth": depth, "averaged": _HOUR, "error_length": 1e3 * length}

    def at(k: int) -> tuple[dict[str, Any], int]:
        columns = {
            "longitude": longitude,
            "latitude": latitude,
            "east": east[k],
            "north": north[k],
            "flag": quality[k],
            "east_error": errors[0][k],
            "north_error": errors[1][k],
        }
        held = {name: numbers(column[known[k]]) for name, column in columns.items()}
        return fixed | held, int(failed[k].sum())

    return at


def is_failed(flags: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return whether QARTOD flags are fail or missing."""
    return np.asarray((flags == Flag.FAIL) | (flags == Flag.MISSING))


def worst_flag(flags: Sequence[NDArray[np.int8]], shape: tuple[int, ...]) -> NDArray[np.int8]:
    """Return the worst QARTOD flag of each value; not evaluated without flags."""
    ranked = np.stack([np.full(shape, Flag.NOT_EVALUATED, np.float64), *flags])
    # a test that was passed is more than one that was not made
    passed = Flag.NOT_EVALUATED + 0.5
    ranked[ranked == Flag.GOOD] = passed
    worst = ranked.max(axis=0)
    return np.where(worst == passed, Flag.GOOD, worst).astype(np.int8)


def _quality(file: NetcdfFile, shape: tuple[int, ...]) -> NDArray[np.int8]:
    """Return the QARTOD flag of each vector: the summary flag if any, else the worst of the tests."""
    by_pattern = [
        [
            _as_qartod(stored).reshape(shape)
            for name, stored in file.variables.items()
            if re.fullmatch(pattern, name, re.I) and stored.values.size == math.prod(shape)
        ]
        for pattern in (_SUMS, _TESTS)
    ]
    return worst_flag(by_pattern[0] or by_pattern[1], shape)


def _as_qartod(stored: Stored) -> NDArray[np.int8]:
    """Return flags as QARTOD flags, by their stated meanings or else by number."""
    found = np.nan_to_num(stored.unpacked(), nan=Flag.NOT_EVALUATED).astype(np.int8)
    flags = found.copy()
    for value, words in units.stated_meanings(stored).items():
        flags[found == value] = next(
            (flag for pattern, flag in _MEANINGS if pattern.search(words)), Flag.GOOD
        )
    return flags


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

    def stated(words: str, place: int) -> float:
        found = [n for n, text in described.items() if re.search(words, text, re.I)]
        return values.get(found[0] if found else place, math.nan)

    length = stated("decorrelation", _LENGTH)
    return stated("signal variance", _VARIANCE), length if length > 0.0 else 0.0


def _error(stored: Stored, variance: float, dialect: Dialect, notes: list[str]) -> Array:
    """Return standard errors [m/s], NaN if not stated or of questionable quality."""
    if stored.units not in ("", "1"):
        return units.in_si("error", stored, units.SPEED, notes)
    values = stored.unpacked()
    if not variance > 0.0:
        raise LogError(
            f"{dialect.title}: expected the signal's variance in {dialect.names['parameters']}, by which errors are normalised, got none"
        )
    notes.append(
        f"errors: normalised variances, times the signal's stated variance of {variance:g} cm2/s2"
    )
    good = (values >= 0.0) & (values <= _MOST_NORMALISED)
    return np.where(good, np.sqrt(np.where(good, values, 0.0) * (1e-4 * variance)), np.nan)


def _depth(attributes: Mapping[str, Any]) -> tuple[float, str]:
    """Return the measuring depth of the radars [m] and its derivation."""
    stated = [match for text in attributes.values() if (match := _MHZ.search(str(text)))]
    frequency = float(stated[0][1]) if stated else _LONG_RANGE
    how = "as stated" if stated else "assumed"
    depth = depth_of(frequency)
    return depth, f"at {depth:.1f} m, a wavelength over 8 pi of {frequency:g} MHz ({how})"


#: Optimally interpolated totals; errors are standard errors, or variances over that of the signal, which have no unit.
TOTALS = Dialect(
    "radar-totals",
    "optimally interpolated totals (Rutgers, MARACOOS)",
    "u v u_err v_err time lat lon",
    {
        "time": "time",
        "longitude": "lon",
        "latitude": "lat",
        "east": "u",
        "north": "v",
        "east_error": "u_err",
        "north_error": "v_err",
        "parameters": "processing_parameters",
    },
    quantities={
        "longitude": units.LONGITUDE,
        "latitude": units.LATITUDE,
        **dict.fromkeys(("east", "north"), units.SPEED),
    },
    beside=f"{_SUMS}|{_TESTS}",
    log_of="all",
    read=_totals,
    by_times=True,
)


def _drifters(
    files: Sequence[NetcdfFile], dialect: Dialect, config: LogConfig, told: Told
) -> Entries:
    """Return the fixes of drifters with their drogue status.

    Raises:
        LogError: Columns have different lengths.
    """
    del config
    columns = [_columns(file, dialect, told.notes) for file in files]
    return lambda: [(), *map(_fixes, columns)]


def _fixes(columns: Mapping[str, NDArray[Any]]) -> Iterator[Entry]:
    """Yield the fixes in order of time."""
    times = columns["time"]
    known = np.isfinite(columns["longitude"] + columns["latitude"]) & (times > 0)
    found = np.flatnonzero(known)
    for k in found[np.argsort(times[found], kind="stable")].tolist():
        time_ns = int(times[k])
        said = {name: column[k].item() for name, column in columns.items() if name != "time"}
        said["error"] = number(said["error"])
        yield time_ns, _DRIFTERS, _FIX, {"stamp": stamp(time_ns), **said}


def _columns(file: NetcdfFile, dialect: Dialect, notes: list[str]) -> dict[str, NDArray[Any]]:
    chosen = dialect.chosen(file.variables)
    values = read_values(file, dialect, chosen, notes)
    time = values["time"].ravel()
    sizes, _ = profile_sizes(file)

    def spread(key: str, found: Any) -> NDArray[Any]:
        """Return values at each fix; values per drifter are repeated."""
        found = np.ravel(found)
        if found.size == sizes.size and sizes.sum() == time.size:
            found = np.repeat(found, sizes)
        if found.size not in (1, time.size):
            raise LogError(
                f"{file.path}: {chosen[key]}: expected a value for each of {time.size} fixes or each drifter, got {found.size}; "
                "write the file again"
            )
        return np.broadcast_to(found, time.shape)

    if "depth" not in chosen:
        notes.append(f"depth of the drogues is not stated: {_DROGUE:g} m taken")
    if "drogued" in chosen:
        drogued = spread("drogued", values["drogued"]) == 1.0
    else:
        # a drifter whose drogue was not lost has no date, or that of the epoch
        lost = spread("lost_time", values["lost_time"]) if "lost_time" in values else 0
        drogued = (lost == 0) | (time < lost)
    names = [file.path.stem]
    if "id" in chosen:
        stored = file.variables[chosen["id"]]
        names = stored.texts() or [f"{value:.0f}" for value in np.ravel(stored.unpacked())]
    return {
        "time": time,
        "id": spread("id", names),
        "longitude": spread("longitude", values["longitude"]),
        "latitude": spread("latitude", values["latitude"]),
        "depth": spread("depth", values.get("depth", _DROGUE)),
        "drogued": drogued,
        "error": spread("error", _DEGREE * values.get("error", np.float64(np.nan))),
    }


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
        "error": "err_lat",
        "id": "id ids",
    },
    quantities={
        "longitude": units.LONGITUDE,
        "latitude": units.LATITUDE,
        "drogued": units.NUMBER,
        "depth": units.LENGTH,
        "error": units.ANGLE,
    },
    units={"depth": "m", "error": "degrees"},
    log_of="all",
    read=_drifters,
)
