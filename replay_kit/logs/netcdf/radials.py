"""Radials of HF radar stations as LLUV text (CODAR, ``*.ruv``): currents along bearings, a message per file in SI units."""

import io
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.words.text import count_text
from replay_kit.logs.netcdf.columns import deciding_flags, is_failed, worst_flag
from replay_kit.logs.netcdf.surface import LIGHT, RADAR, USUAL_ERROR, depth_of
from replay_kit.logs.payloads import Entry, numbers, stamp
from replay_kit.logs.reader import LogFile, Told, WholeLog, read_bytes
from replay_kit.logs.tables.columns import first_reason

#: First part of the topic, before the station's name.
TOPIC = "/radar/radials"
_COLUMNS = ("LOND", "LATD", "VELO", "HEAD", "RNGE", "BEAR")
# spatial and temporal standard deviation, and the accuracy that phased arrays state
_ERRORS = ("ESPC", "ETMP", "EACC")
_KEYS = ("TimeStamp", "Origin", "TransmitCenterFreqMHz", "TableColumnTypes")
# cm/s: what stands for no error, and the least; of flags the one of radials over land
_NO_ERROR, _LEAST_ERROR, _OVER_LAND = 900.0, 3.0, 128
_NO_STATED_ERROR = f"radials state no error; {USUAL_ERROR:g} cm/s is assumed for each"
_OTHER_UNITS = re.compile(r"\((?:knots?|kn|kts?|m/s)\)", re.IGNORECASE)
# km by which places may depart from range and bearing
_NEAR = 3.0
_MOST = 1 << 24


class Header(NamedTuple):
    """Header of a file.

    Attributes:
        path: The file.
        station: Name of the station.
        time_ns: Middle of the time that the radials are averaged over [ns, UTC].
        names: Names of the columns.
        units: Line of the columns' units.
        origin: Latitude and longitude of the station [degrees].
        frequency: Of the radar [MHz].
        averaged: Time that the radials are averaged over [s].
        resolution: Of the Doppler spectrum [Hz]; NaN if not stated.
    """

    path: Path
    station: str
    time_ns: int
    names: list[str]
    units: str
    origin: list[float]
    frequency: float
    averaged: float
    resolution: float


def read_header(path: Path) -> Header:
    """Return the header of a file.

    Raises:
        LogError: The file cannot be read, lacks a required key, or one is invalid.
    """
    found: dict[str, str] = {}
    units = ""
    for line in _lines(path):
        if not line.startswith("%"):
            break
        if line.startswith("%%"):
            units = line if "(" in line and "deg" in line else units
        elif ":" in line:
            key, _, value = line[1:].partition(":")
            found.setdefault(key.strip(), value.strip())
    names = found.get("TableColumnTypes", "").split()
    if missing := [name for name in (*_KEYS, *_COLUMNS) if name not in (*found, *names)]:
        raise LogError(
            f"{path}: expected radials of a station as LLUV text, it lacks {', '.join(missing)}; give the original file"
        )

    def stated(key: str, count: int, usual: str = "") -> list[float]:
        parts = found.get(key, usual).split()[:count]
        try:
            values = [*map(float, parts)]
        except ValueError:
            values = []
        if len(values) != count:
            raise LogError(f"{path}: {key}: expected {count_text(count, 'number')}, got {parts}")
        return values

    moment = stated("TimeStamp", 6)
    try:
        time = datetime(*map(int, moment), tzinfo=UTC)  # type: ignore[arg-type,misc]
    except ValueError as error:
        raise LogError(f"{path}: TimeStamp: expected a date and a time, got {moment}") from error
    latitude, longitude = origin = stated("Origin", 2)
    if not (abs(latitude) <= 90.0 and -180.0 <= longitude <= 360.0):
        raise LogError(f"{path}: Origin: expected latitude and longitude [degrees], got {origin}")
    (frequency,) = stated("TransmitCenterFreqMHz", 1)
    if not frequency > 0.0:
        raise LogError(
            f"{path}: TransmitCenterFreqMHz: expected a frequency above 0, got {frequency:g}"
        )
    return Header(
        path,
        (found.get("Site", "").split() or ["unnamed"])[0],
        round(time.timestamp()) * 1_000_000_000,
        names,
        units,
        origin,
        frequency,
        60.0 * stated("TimeCoverage", 1, "60")[0],
        *stated("DopplerResolutionHzPerBin", 1, "nan"),
    )


def logs_of_radials(paths: Sequence[Path], config: LogConfig | None) -> list[LogFile]:
    """Return the reader of the files of each station.

    Args:
        paths: Files.
        config: Settings of log reading.

    Raises:
        LogError: A file cannot be read.
    """
    stations = defaultdict[str, list[Header]](list)
    for header in map(read_header, paths):
        stations[header.station].append(header)
    return [_log(headers, config) for headers in stations.values()]


def _log(files: Sequence[Header], config: LogConfig | None) -> WholeLog:
    """Return a message per file on ``/radar/radials/STATION``, without radials that are over land or fail their flags."""
    told, station = Told(), files[0].station

    def entries() -> Iterator[Entry]:
        told.notes.clear()
        lost: Counter[str] = Counter()
        for file in sorted(files, key=lambda each: (each.time_ns, each.path)):
            columns, dropped = _radials(file)
            lost.update(dropped)
            payload = {
                "stamp": stamp(file.time_ns),
                "depth": depth_of(file.frequency),
                "averaged": file.averaged,
                "error_length": 0.0,
                **{key: numbers(values) for key, values in columns.items()},
            }
            yield file.time_ns, f"{TOPIC}/{station}", RADAR, payload
        told.notes.extend(f"{station}: {n} radials {what}, not used" for what, n in lost.items())
        if not {*_ERRORS} & {*files[-1].names}:
            told.notes.append(f"{station}: {_NO_STATED_ERROR}")

    paths = [file.path for file in files]
    return WholeLog(paths, "radar-radials", told, lambda: [(), entries()], config)


def _lines(path: Path) -> Iterator[str]:
    data = read_bytes(path, _MOST + 1)
    if len(data) > _MOST:
        raise LogError(
            f"{path}: expected radials of a station of at most {_MOST >> 20} MB; is it the right file?"
        )
    return (line.decode("latin-1") for line in io.BytesIO(data))


def _radials(file: Header) -> tuple[dict[str, Array], Counter[str]]:
    """Return the columns of the usable radials, and counts of the excluded ones."""
    names = file.names
    lines = [line.split() for line in _lines(file.path) if not line.startswith("%")]
    whole = [row for row in lines if len(row) == len(names)]
    left_out = sum(map(bool, lines)) - len(whole)
    try:
        values = np.array(whole, np.float64).reshape(-1, len(names))
    except ValueError as error:
        raise LogError(f"{file.path}: radials: expected numbers, got {error}") from error
    held = dict(zip(names, values.T, strict=True))
    _check_station(file, held)
    _check_unit(file, held["VELO"])
    n = held["VELO"].size
    errors = [held[name] for name in _ERRORS if name in held] or [np.full(n, USUAL_ERROR)]
    std = np.fmax.reduce([np.where(each < _NO_ERROR, each, np.nan) for each in errors])
    flag = held.get("VFLG", np.zeros(n)).astype(np.int64)
    tests = deciding_flags(names)
    quality = worst_flag([held[name].astype(np.int8) for name in tests], (n,))
    dropped = {
        "over land": flag & _OVER_LAND > 0,
        "flagged otherwise": flag != 0,
        f"failed by their quality flags ({', '.join(tests)})": is_failed(quality),
        "without an error": np.isnan(std),
    }
    reasons = first_reason(dropped)
    counts = Counter({what: int((reasons == what).sum()) for what in dropped})
    good = reasons == ""
    columns = {
        "longitude": held["LOND"],
        "latitude": held["LATD"],
        "direction": held["HEAD"],
        "flag": quality,
        "speed": 1e-2 * held["VELO"],
        "error": 1e-2 * np.fmax(std, _LEAST_ERROR),
    }
    used = {key: column[good] for key, column in columns.items()}
    return used, +counts + Counter({"in incomplete lines": left_out})


def _check_station(file: Header, columns: Mapping[str, Array]) -> None:
    """Raise LogError if radials do not lie at their range and bearing from the station in the header."""
    latitude, longitude = file.origin
    x, y = to_local(Projection(longitude, latitude), columns["LOND"], columns["LATD"])
    distance, angle = 1e3 * columns["RNGE"], np.deg2rad(columns["BEAR"])
    away = np.hypot(x - distance * np.sin(angle), y - distance * np.cos(angle))
    if away.size and float(np.median(away)) > 1e3 * _NEAR:
        raise LogError(
            f"{file.path}: radials of another station: they lie {np.median(away) / 1e3:.0f} km from their range and bearing about "
            f"{file.station}; give the original file"
        )


def _check_unit(file: Header, speed: Array) -> None:
    """Raise LogError if speeds are not in cm/s, by the stated unit or the resolution of the Doppler spectrum."""
    if _OTHER_UNITS.search(file.units):
        raise LogError(
            f"{file.path}: radials: expected speeds in cm/s, the file states {file.units.strip('% ')}; convert them first"
        )
    # half a radar's wavelength a cycle, in cm
    resolution = 50.0 * LIGHT / file.frequency * file.resolution
    rms = float(np.sqrt(np.mean(speed**2))) if speed.size else np.nan
    if rms < resolution:
        raise LogError(
            f"{file.path}: radials: expected speeds in cm/s, got {rms:.2f} RMS, less than the {resolution:.1f} cm/s that the radar "
            "resolves: they look like knots or m/s; convert them first"
        )
