"""Radials of HF radar stations as LLUV text (CODAR, ``*.ruv``): currents along bearings, a message per file in SI units."""

import io
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.inputs import open_input
from replay_kit.core.message import Message
from replay_kit.core.text import count_text
from replay_kit.logs.netcdf.quality import is_failed, worst_flag
from replay_kit.logs.netcdf.surface import LIGHT, RADAR, depth_of
from replay_kit.logs.reader import LogFile, unreadable
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import numbers, stamp

#: First part of the topic, before the station's name.
TOPIC = "/radar/radials"
_COLUMNS = ("LOND", "LATD", "VELO", "HEAD", "RNGE", "BEAR")
# spatial and temporal standard deviation, and the accuracy that phased arrays state
_ERRORS = ("ESPC", "ETMP", "EACC")
# QARTOD: the primary flag sums up the tests
_PRIMARY, _TEST = "PRIM", re.compile(r"Q\d{3}|QC\d{2}")
_KEYS = ("TimeStamp", "Origin", "TransmitCenterFreqMHz", "TableColumnTypes")
# cm/s: what stands for no error, the least, and the one taken where a file states none; of flags the one of radials over land
_NO_ERROR, _LEAST_ERROR, _USUAL_ERROR, _OVER_LAND = 900.0, 3.0, 10.0, 128
_NO_STATED_ERROR = f"radials state no error; {_USUAL_ERROR:g} cm/s is assumed for each"
_OTHER_UNITS = re.compile(r"\((?:knots?|kn|kts?|m/s)\)", re.IGNORECASE)
# km by which places may depart from range and bearing
_NEAR = 3.0
_MOST = 1 << 24


class RadialsReader(LogFile):
    """Reader of the radial files of one station as one log."""

    format = "radar-radials"

    def _prepare(self) -> None:
        """Read the files' headers.

        Raises:
            LogError: A file cannot be read, or lacks its time, origin, frequency or a column.
        """
        self._times = sorted((_time_ns(path, header(path)), path) for path in self.files)

    def messages(self) -> Iterator[Message]:
        """Yield the radials of each file as a message on ``/radar/radials/STATION``.

        Raises:
            LogError: The radials of a file do not fit its station or are not in cm/s.
        """
        self.statistics = ReadStatistics()
        lost: Counter[str] = Counter()
        for position, (time_ns, path) in enumerate(self._times):
            head = header(path)
            columns, dropped = _radials(path, head)
            name = self._topic(f"{TOPIC}/{station(head)}")
            lost.update(dropped)
            unstated = not set(_ERRORS) & set(head["TableColumnTypes"].split())
            self.statistics.notes = (
                *(
                    f"{station(head)}: {count} radials {what}, not used"
                    for what, count in lost.items()
                ),
                *([f"{station(head)}: {_NO_STATED_ERROR}"] if unstated else []),
            )
            self.statistics.read[name] += 1
            payload = {
                "stamp": stamp(time_ns),
                "depth": depth_of(*_numbers(path, head, "TransmitCenterFreqMHz")),
                "averaged": 60.0 * _numbers(path, head, "TimeCoverage", "60")[0],
                "error_length": 0.0,
                **{key: numbers(values) for key, values in columns.items()},
            }
            yield Message(time_ns, name, RADAR, payload, self.input, position)


def header(path: Path) -> Mapping[str, str]:
    """Return the keys of a file's header, and its line of units as ``units``.

    Raises:
        LogError: The file cannot be read or lacks a required key.
    """
    found: dict[str, str] = {}
    for line in _lines(path):
        if not line.startswith("%"):
            break
        if line.startswith("%%"):
            found["units"] = line if "(" in line and "deg" in line else found.get("units", "")
        elif ":" in line:
            key, _, value = line[1:].partition(":")
            found.setdefault(key.strip(), value.strip())
    names = found.get("TableColumnTypes", "").split()
    missing = [key for key in _KEYS if key not in found]
    missing += [name for name in _COLUMNS if name not in names]
    if missing:
        raise LogError(
            f"{path}: expected radials of a station as LLUV text, it lacks {', '.join(missing)}; give the original file"
        )
    if not _numbers(path, found, "TransmitCenterFreqMHz")[0] > 0.0:
        raise LogError(
            f"{path}: TransmitCenterFreqMHz: expected a frequency above 0, got {found['TransmitCenterFreqMHz']}"
        )
    return found


def station_of(path: Path) -> tuple[str]:
    """Return the name of a file's station, common to the files of one log."""
    return (station(header(path)),)


def station(head: Mapping[str, str]) -> str:
    """Return the name of the station in a header."""
    return (head.get("Site", "").split() or ["unnamed"])[0]


def _lines(path: Path) -> Iterator[str]:
    try:
        with open_input(path) as file:
            data = file.read(_MOST + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    if len(data) > _MOST:
        raise LogError(
            f"{path}: expected radials of a station of at most {_MOST >> 20} MB; is it the right file?"
        )
    return (line.decode("latin-1") for line in io.BytesIO(data))


def _numbers(
    path: Path, head: Mapping[str, str], key: str, default: str = "", count: int = 1
) -> list[float]:
    """Return the first numbers of a key in a header.

    Raises:
        LogError: They are not numbers.
    """
    parts = head.get(key, default).split()[:count]
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise LogError(f"{path}: {key}: expected {count_text(count, 'number')}, got {parts}")
    return numbers


def _time_ns(path: Path, head: Mapping[str, str]) -> int:
    parts = head["TimeStamp"].split()
    try:
        year, month, day, hour, minute, second = (int(part) for part in parts)
        time = np.datetime64(
            f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}", "ns"
        )
    except ValueError as error:
        raise LogError(f"{path}: TimeStamp: expected six numbers, got {parts}") from error
    return int(time.astype(np.int64))


def _radials(path: Path, head: Mapping[str, str]) -> tuple[dict[str, Array], Counter[str]]:
    """Return the columns of the usable radials, and counts of the excluded ones."""
    names = head["TableColumnTypes"].split()
    values, left_out = array("d"), 0
    for line in _lines(path):
        row = [] if line.startswith("%") else line.split()
        left_out += 0 < len(row) != len(names)
        if len(row) == len(names):
            try:
                values.extend(map(float, row))
            except ValueError as error:
                raise LogError(f"{path}: radials: expected numbers, got {error}") from error
    table = np.array(values).reshape(-1, len(names))
    of = {name: table[:, k] for k, name in enumerate(names)}
    east, north, speed, heading, distance, bearing = (of[name] for name in _COLUMNS)
    _check_station(path, head, (east, north), (distance, bearing))
    _check_unit(path, head, speed)
    errors = [of[name] for name in _ERRORS if name in of] or [np.full(len(table), _USUAL_ERROR)]
    std = np.fmax.reduce([np.where(each < _NO_ERROR, each, np.nan) for each in errors])
    flag = of.get("VFLG", np.zeros(len(table))).astype(np.int64)
    tests = [_PRIMARY] if _PRIMARY in of else [name for name in names if _TEST.fullmatch(name)]
    quality = worst_flag([of[name].astype(np.int8) for name in tests], (len(table),))
    known, over_land, failed = np.isfinite(std), flag & _OVER_LAND > 0, is_failed(quality)
    good = known & (flag == 0) & ~failed
    dropped = Counter(
        {
            "over land": int(over_land.sum()),
            "flagged otherwise": int(((flag != 0) & ~over_land).sum()),
            f"failed by their quality flags ({', '.join(tests)})": int(
                (failed & (flag == 0)).sum()
            ),
            "without an error": int((~known & (flag == 0) & ~failed).sum()),
            "in incomplete lines": left_out,
        }
    )
    columns = {"longitude": east, "latitude": north, "direction": heading, "flag": quality}
    columns |= {"speed": 1e-2 * speed, "error": 1e-2 * np.fmax(std, _LEAST_ERROR)}
    return {key: values[good] for key, values in columns.items()}, +dropped


def _check_station(
    path: Path,
    head: Mapping[str, str],
    places: tuple[Array, Array],
    polar: tuple[Array, Array],
) -> None:
    """Raise LogError if radials do not lie at their range and bearing from the station in the header."""
    latitude, longitude = _numbers(path, head, "Origin", count=2)
    x, y = to_local(Projection(longitude, latitude), *places)
    distance, angle = 1e3 * polar[0], np.deg2rad(polar[1])
    away = np.hypot(x - distance * np.sin(angle), y - distance * np.cos(angle))
    if away.size and float(np.median(away)) > 1e3 * _NEAR:
        raise LogError(
            f"{path}: radials of another station: they lie {np.median(away) / 1e3:.0f} km from their range and bearing about "
            f"{station(head)} at {latitude:.4f} N, {longitude:.4f} E; give the original file"
        )


def _check_unit(path: Path, head: Mapping[str, str], speed: Array) -> None:
    """Raise LogError if speeds are not in cm/s, by the stated unit or the resolution of the Doppler spectrum."""
    if _OTHER_UNITS.search(head.get("units", "")):
        raise LogError(
            f"{path}: radials: expected speeds in cm/s, the file states {head['units'].strip('% ')}; convert them first"
        )
    (resolved,) = _numbers(path, head, "DopplerResolutionHzPerBin", "nan")
    # half a radar's wavelength a cycle, in cm
    (frequency,) = _numbers(path, head, "TransmitCenterFreqMHz")
    resolution = 50.0 * LIGHT / frequency * resolved
    rms = float(np.sqrt(np.mean(speed**2))) if speed.size else np.nan
    if rms < resolution:
        raise LogError(
            f"{path}: radials: expected speeds in cm/s, got {rms:.2f} RMS, less than the {resolution:.1f} cm/s that the radar resolves: "
            "they look like knots or m/s; convert them first"
        )
