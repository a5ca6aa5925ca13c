"""Parsing of times (ns since 1970, UTC), durations and unit names."""

import re
from datetime import UTC, date, datetime, timedelta
from typing import TYPE_CHECKING, Any

from replay_kit.core.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_NS = 2**63 - 1
_OUTSIDE = "is outside 1970..2262; write a time of the mission such as 2018-11-16T00:00:00Z"
#: 1990 [ns]: no recorder of these formats is older; and 2100.
EARLIEST_NS, _TO_NS = 631_152_000 * 10**9, 4_102_444_800 * 10**9
#: Units of clocks that may be taken for nanoseconds, and how many of these they have.
CLOCKS = {"seconds": 10**9, "milliseconds": 10**6, "microseconds": 10**3}
# Symbols as UDUNITS has them: there "M" and "K" begin other units. A foot is the international one.
_SYMBOLS = {"m": 1.0, "km": 1e3, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
_METRES = {"metre": 1.0, "kilometre": 1e3, "centimetre": 1e-2, "foot": 0.3048, "feet": 0.3048}
_SECONDS = {
    name: factor
    for names, factor in (
        ("s sec second", 1.0),
        ("min minute", 60.0),
        ("h hr hour", 3600.0),
        ("d day", 86_400.0),
        ("ms msec millisecond", 1e-3),
        ("us microsecond", 1e-6),
        ("ns nanosecond", 1e-9),
    )
    for name in names.split()
}
_DECIBARS = {"dbar": 1.0, "decibar": 1.0, "bar": 10.0, "mbar": 0.01}
_DECIBARS |= {"pa": 1e-4, "hpa": 0.01, "kpa": 0.1}
_KNOTS = ("knot", "knots", "kt", "kn")
# A length over a second, without spaces, dots and signs of powers.
_SPEED = re.compile(r"([a-z]+?)(?:(?:/|per)(?:s|sec|second)|(?:s|second)-1)")


def parse_time(text: str) -> int:
    """Return a time [ns, UTC] from ISO 8601 text; UTC without an offset.

    Raises:
        ConfigError: The text is no such time, or lies outside 1970..2262, the range of 64-bit nanoseconds.
    """
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError as error:
        raise ConfigError(
            f"'{text}' is no time; write ISO 8601 UTC such as 2018-11-16T00:00:00Z"
        ) from error
    # a time with an offset is moved by hand, as datetime itself fails on those that leave its years 1..9999
    offset = moment.utcoffset() or timedelta(0)
    since = moment.replace(tzinfo=UTC) - _EPOCH - offset
    # datetime ends at microseconds; logs are stamped in nanoseconds
    digits = re.search(r"[.,]\d{6}(\d{1,3})", text)
    time_ns = since // timedelta(microseconds=1) * 1000 + (
        int(digits[1].ljust(3, "0")) if digits else 0
    )
    if not 0 <= time_ns <= _LAST_NS:
        raise ConfigError(f"'{text}' {_OUTSIDE}")
    return time_ns


def parse_duration(text: str) -> float:
    """Return a duration [s] from a number and its unit: ``90s``, ``30min``, ``6h`` or ``3d``.

    Raises:
        ConfigError: The text is no such duration.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(s|min|h|d)\s*", text)
    if found is None:
        raise ConfigError(
            f"'{text}' is no duration; write a number and its unit, such as 90s, 30min, 6h or 3d"
        )
    return float(found[1]) * _SECONDS[found[2]]


def to_time_ns(time: Any) -> "NDArray[np.int64]":
    """Return times [ns, UTC] in the shape given.

    Args:
        time: ISO 8601 text, ``datetime64``, ``datetime``, pandas' times, or integer nanoseconds since 1970; one or an array of them.
            Text and times without a zone are UTC.

    Raises:
        ConfigError: A value is none of these, or lies outside 1970..2262.
    """
    # the configuration needs ``parse_time`` alone, before numpy
    import numpy as np

    values = np.asarray(time)
    if values.dtype.kind in "iu" or (values.dtype.kind == "M" and not np.isnat(values).any()):
        # by seconds, as a date that nanoseconds cannot hold becomes another one
        dates = values.dtype.kind == "M"
        about = (
            values.astype("datetime64[s]").astype(float) * 1e9 if dates else values.astype(float)
        )
        if (outside := (about < 0.0) | (about >= _LAST_NS)).any():
            raise ConfigError(f"time: '{values[outside][0]}' {_OUTSIDE}")
        return (values.astype("datetime64[ns]") if dates else values).astype(np.int64)
    texts = [
        each.isoformat() if isinstance(each, date) else each for each in values.ravel().tolist()
    ]
    if not all(isinstance(text, str) for text in texts):
        raise ConfigError(
            "time: expected ISO 8601 text, datetime64 or integer nanoseconds since 1970 (UTC), "
            f"got {'a missing time (NaT)' if values.dtype.kind == 'M' else repr(time)[:60]}"
        )
    return np.array([parse_time(text) for text in texts], dtype=np.int64).reshape(values.shape)


def measured_at(time: Any, what: str, least_ns: int = 0) -> "NDArray[np.int64]":
    """Return times of measurements as ``to_time_ns``, with a check of their unit.

    Args:
        time: See ``to_time_ns``.
        what: Name of the times in errors.
        least_ns: Least whole number that is a time; smaller ones count something else, as rows.

    Raises:
        ConfigError: A value is no time or seems to be in another unit; the message begins with ``what``.
    """
    try:
        time_ns = to_time_ns(time)
    except ConfigError as error:
        raise ConfigError(f"{what}: {error}") from error
    import numpy as np

    unit = unit_of_clock(time_ns)
    if unit or (np.asarray(time).dtype.kind in "iu" and (time_ns < least_ns).any()):
        got = f"what would be {unit}" if unit else time_ns.min()
        raise ConfigError(
            f"{what}: expected nanoseconds since 1970 (UTC), got {got}; give text, datetime64 or nanoseconds"
        )
    return time_ns


def unit_of_clock(time_ns: "NDArray[np.int64]") -> str:
    """Return the unit in which times [ns, UTC] would lie in 1990..2100 if not in nanoseconds; empty without one."""
    return next(
        (
            unit
            for unit, factor in CLOCKS.items()
            if ((time_ns >= EARLIEST_NS // factor) & (time_ns < _TO_NS // factor)).any()
        ),
        "",
    )


def metres(unit: str) -> float | None:
    """Return the length of a unit [m], by symbol or name in any case; None if unknown."""
    return _SYMBOLS.get(unit, _factor_of(unit.lower().replace("meter", "metre"), _METRES))


def seconds(unit: str) -> float | None:
    """Return the duration of a unit [s], in any case; None if unknown."""
    return _factor_of(unit, _SECONDS)


def metres_per_second(unit: str) -> float | None:
    """Return a unit of speed [m/s], in any case; None if unknown."""
    name = re.sub(r"\s|\*\*|[.^]", "", unit.lower())
    if name in _KNOTS:
        return 1852.0 / 3600.0
    found = _SPEED.fullmatch(name)
    return metres(found[1]) if found else None


def decibars(unit: str) -> float | None:
    """Return a unit of pressure [dbar], in any case; None if unknown."""
    return _factor_of(unit, _DECIBARS)


def _factor_of(unit: str, factors: dict[str, float]) -> float | None:
    """Return the factor of a unit, in any case, singular or plural; None if unknown."""
    name = unit.lower()
    return factors.get(name, factors.get(name.removesuffix("s")))
