"""Values of columnar files in SI units: quantities, unit names, epochs of times.

Functions add each assumption to the notes of the file.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.core.errors import LogError
from replay_kit.core.words.quantities import decibars, metres, metres_per_second, seconds
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored, as_number

_SINCE = re.compile(
    r"\s*(\w+)\s+since\s+(\d{4})-(\d{1,2})-(\d{1,2})(?:[T ]+(\d{1,2}):(\d{1,2})(?::(\d{1,2})(\.\d+)?)?)?.*",
    re.IGNORECASE,
)
_MONTH_FIRST = re.compile(r"\d\d/(1[3-9]|[2-3]\d)/\d{4}")
# 1971 and 2100: clocks that lost their time count from 1970
_FIRST_NS, _LAST_NS = 31_536_000 * 10**9, 4_102_444_800 * 10**9
# of any epoch; more is no time, and does not fit into 64 bits of nanoseconds
_MOST_MS = 9e12
_EPOCH_SECONDS = (3.5e8, 4.1e9)
# rad; a mission whose headings all lie below a turn, or whose tilts all lie below a right angle, is in radians
_TURN, _LEAST_ANGLES = 6.3, 20

# by the unit that others are converted to, factors of their names in lower case without spaces
_NAMES: Mapping[str, Mapping[float, str]] = MappingProxyType(
    {
        "degrees": {
            1.0: "deg degree degrees degrees_north degrees_east degree_north degree_east °",
            180.0 / np.pi: "rad radian radians",
        },
        "degrees Celsius": {
            1.0: "degc celsius degrees_celsius degree_celsius degree_c degrees_c °c"
        },
        "1": {1.0: "1 psu 1e-3 0.001 pss-78 pss g/kg"},
        "S/m": {1.0: "s/m sm-1", 0.1: "ms/cm mscm-1"},
        "V": {1.0: "volts v"},
        "A h": {1.0: "amp-hrs"},
    }
)
_FACTORS = MappingProxyType({"m": metres, "dbar": decibars, "m/s": metres_per_second})


def _factor(unit: str, stated: str) -> float | None:
    """Return the factor from a stated unit to that of a quantity; None if its name is unknown."""
    name = re.sub(r"\s+|\*\*", "", stated.lower())
    if unit in _FACTORS:
        return _FACTORS[unit](name)
    known = _NAMES.get(unit, {}).items()
    return next((factor for factor, names in known if name in names.split()), None)


class Quantity(NamedTuple):
    """Physical quantity: its unit, and its least and largest plausible value; others count as missing."""

    unit: str
    low: float
    high: float


LENGTH, _HEIGHT = Quantity("m", -12_000.0, 12_000.0), Quantity("m", 0.0, 12_000.0)
_ANGLE, SPEED = Quantity("degrees", -360.0, 720.0), Quantity("m/s", -5.0, 5.0)
_NUMBER = Quantity("", -1e9, 1e9)
_QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "longitude": Quantity("degrees", -180.0, 360.0),
        "latitude": Quantity("degrees", -90.0, 90.0),
        **dict.fromkeys(("depth", "gps_error", "radius"), LENGTH),
        **dict.fromkeys(("altitude", "water_depth"), _HEIGHT),
        **dict.fromkeys(("heading", "pitch", "roll", "declination", "latitude_error"), _ANGLE),
        **dict.fromkeys(("east", "north", "dac_error"), SPEED),
        **dict.fromkeys(("dive", "dead_reckoning", "nav_state", "drogued"), _NUMBER),
        "pressure": Quantity("dbar", -20.0, 12_000.0),
        "temperature": Quantity("degrees Celsius", -5.0, 60.0),
        "conductivity": Quantity("S/m", 0.0, 10.0),
        "salinity": Quantity("1", 0.0, 80.0),
        "voltage": Quantity("V", 0.0, 1000.0),
        "charge_used": Quantity("A h", 0.0, 1e6),
    }
)


def quantity_of(key: str) -> Quantity | None:
    """Return the quantity of a column, by its name or the last word of it; None for texts, flags and times."""
    return _QUANTITIES.get(key, _QUANTITIES.get(key.rpartition("_")[2]))


def in_si(file: NetcdfFile, name: str, quantity: Quantity, unit: str = "") -> Array:
    """Return a variable in its quantity's unit, NaN where missing or implausible.

    Args:
        file: The file.
        name: Name of the variable.
        quantity: Its quantity.
        unit: Unit if the file states none that is known; ``nmea``, degrees and minutes (ddmm.mmm), overrides the file. Empty for the stated
            one.
    """
    try:
        values, stated = file.array(name), file.variables[name].units
    except ValueError as error:
        raise LogError(f"{name}: expected numbers, got texts") from error
    if unit and (unit == "nmea" or _factor(quantity.unit, stated) is None):
        stated = unit
    factor = _factor(quantity.unit, stated)
    if stated == "nmea":
        file.note(f"{name}: degrees and minutes (ddmm.mmm) converted to degrees")
        values = from_minutes(values)
    elif factor is None and quantity.unit:
        what = f"unit {stated!r} is not known" if stated else "states no unit"
        file.note(f"{name}: {what}, taken as {quantity.unit}")
    elif factor not in (None, 1.0):
        file.note(f"{name}: converted from {stated} to {quantity.unit}")
        values = values * factor
    odd = (values < quantity.low) | (values > quantity.high)
    if odd.any():
        file.note(
            f"{name}: {int(odd.sum())} values outside {quantity.low:g}..{quantity.high:g} {quantity.unit} taken as missing"
        )
    return np.where(odd | ~np.isfinite(values), np.nan, values)


def from_minutes(values: Array) -> Array:
    """Return degrees from degrees and minutes (ddmm.mmm); marks of no fix, such as 69696969, exceed the valid range."""
    return np.sign(values) * (np.abs(values) // 100.0 + np.abs(values) % 100.0 / 60.0)


def in_minutes(places: Mapping[str, Array]) -> bool:
    """Return whether positions are degrees and minutes (ddmm.mmm): values exceed the range of degrees.

    Args:
        places: Stored latitudes and longitudes by names with these endings; near the equator only longitudes are conclusive.
    """
    # marks of no fix, such as 69696969, are more than degrees and minutes
    return any(
        ((np.abs(values) > _most_degrees(key)) & (np.abs(values) < 36_000.0)).any()
        for key, values in places.items()
    )


def _most_degrees(name: str) -> float:
    """Return the greatest latitude or longitude [degrees], by the end of a name."""
    return 90.0 if name.endswith("latitude") else 360.0


def attitude_degrees(file: NetcdfFile, name: str, values: Array, whole_turn: bool) -> Array:
    """Return angles in degrees from a variable in stated degrees that may hold radians.

    Args:
        file: The file.
        name: Name of the variable in notes.
        values: shape (n,), assumed degrees.
        whole_turn: Whether it is a heading, with a range of 360 degrees; else a tilt.
    """
    known = np.abs(values[np.isfinite(values)])
    most = _TURN if whole_turn else _TURN / 4.0
    if known.size < _LEAST_ANGLES or not 0.0 < known.max() <= most:
        return values
    file.note(
        f"{name}: no value above {known.max():.2f}: taken as radians, although its unit is degrees"
    )
    return np.rad2deg(values)


def times_of(file: NetcdfFile, name: str) -> Times:
    """Return a variable's times [ns, UTC], 0 where unknown; precise to 1 ms, ``datetime64`` to 1 ns.

    Raises:
        LogError: No value is plausible in the stated unit.
    """
    stored = file.variables[name]
    if stored.values.dtype.kind == "M":
        dated = stored.values.astype("M8[ns]").astype(np.int64)
        return np.where(np.isnat(stored.values), 0, dated)
    texts = stored.texts()
    if texts and not np.isfinite(as_number(next(filter(None, texts), ""))):
        file.note(f"{name}: texts, UTC unless they state an offset")
        seconds_of = _seconds_of(texts, f"{file.path}: {name}")
        stored = Stored(seconds_of, {"units": "seconds since 1970-01-01"}, stored.dims[:1])
    values, clock = stored.unpacked(), _clock(stored.units)
    finite = known = np.isfinite(values)
    if clock is None:
        clock = 1.0, 0
        known = (values > _EPOCH_SECONDS[0]) & (values < _EPOCH_SECONDS[1])
        if known.any():
            stated = f"unit {stored.units!r}" if stored.units else "no unit"
            file.note(f"{name}: {stated}, taken as seconds since 1970")
    unit, epoch_ms = clock
    with np.errstate(over="ignore"):
        since = values * (1000.0 * unit)
    known = known & (np.abs(since) < _MOST_MS)
    milliseconds = np.round(np.where(known, since, 0.0)).astype(np.int64) + epoch_ms
    found = milliseconds * 1_000_000
    known &= (found > _FIRST_NS) & (found < _LAST_NS)
    if finite.any() and not known.any():
        raise LogError(
            f"{file.path}: {name}: expected units such as 'seconds since 1970-01-01', "
            f"got '{stored.units}' and times from {np.nanmin(values):g} on; correct the units"
        )
    return np.where(known, found, 0)


def _seconds_of(texts: Sequence[str], where: str) -> Array:
    """Return times in seconds since 1970, UTC without an offset; NaN for other text.

    Args:
        texts: Times in ISO 8601 or as day/month/year of a SeaExplorer.
        where: File and variable in the error.

    Raises:
        LogError: One is as month/day/year: the others may be either.
    """
    if wrong := next(filter(_MONTH_FIRST.match, texts), ""):
        raise LogError(
            f"{where}: expected YYYY-MM-DD or day/month/year, got '{wrong}'; write them as YYYY-MM-DD"
        )
    iso = [
        f"{text[6:10]}-{text[3:5]}-{text[:2]}T{text[11:]}" if text[2:3] == "/" else text
        for text in texts
    ]
    # quicker, where all are times without an offset, of which NumPy only warns
    with suppress(ValueError, Warning), warnings.catch_warnings(action="error"):
        times = np.array([text.removesuffix("Z") for text in iso], "M8[us]")
        return np.where(np.isnat(times), np.nan, 1e-6 * times.astype(np.float64))
    return np.array([*map(_second_of, iso)])


def _second_of(text: str) -> float:
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        return float("nan")
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


def _clock(units: str) -> tuple[float, int] | None:
    """Return unit [s] and epoch [ms since 1970] of units such as ``days since 2000-01-01``; None if unknown."""
    match = _SINCE.fullmatch(units)
    unit = seconds(match[1]) if match else None
    if match is None or unit is None:
        return None
    parts = (int(part or 0) for part in match.groups()[1:7])
    try:
        whole = datetime(*parts, tzinfo=UTC)  # type: ignore[arg-type,misc]
    except ValueError:
        return None
    return unit, round(whole.timestamp()) * 1000 + round(float(match[8] or 0.0) * 1000.0)
