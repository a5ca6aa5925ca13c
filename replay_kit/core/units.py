"""Units by the names that files give them: lengths, times, speeds and pressures."""

import re

# Symbols as UDUNITS has them: there "M" and "K" begin other units. A foot is the international one.
_SYMBOLS = {"m": 1.0, "km": 1e3, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
_METRES = {"metre": 1.0, "kilometre": 1e3, "centimetre": 1e-2, "foot": 0.3048, "feet": 0.3048}
_SECONDS = {
    **dict.fromkeys(("s", "sec", "second"), 1.0),
    **dict.fromkeys(("min", "minute"), 60.0),
    **dict.fromkeys(("h", "hr", "hour"), 3600.0),
    **dict.fromkeys(("d", "day"), 86_400.0),
    **dict.fromkeys(("ms", "msec", "millisecond"), 1e-3),
    **dict.fromkeys(("us", "microsecond"), 1e-6),
    **dict.fromkeys(("ns", "nanosecond"), 1e-9),
}
_DECIBARS = {"dbar": 1.0, "decibar": 1.0, "bar": 10.0, "mbar": 0.01}
_DECIBARS |= {"pa": 1e-4, "hpa": 0.01, "kpa": 0.1}
_KNOTS = ("knot", "knots", "kt", "kn")
# A length over a second, without spaces, dots and signs of powers.
_SPEED = re.compile(r"([a-z]+?)(?:(?:/|per)(?:s|sec|second)|(?:s|second)-1)")


def metres(unit: str) -> float | None:
    """Return the metres of a unit of length, a symbol or a name in any case; None for others."""
    name = unit.lower().replace("meter", "metre")
    return _SYMBOLS.get(unit, _METRES.get(name, _METRES.get(name.removesuffix("s"))))


def seconds(unit: str) -> float | None:
    """Return the seconds of a unit of time, in any case; None for others."""
    name = unit.lower()
    return _SECONDS.get(name, _SECONDS.get(name.removesuffix("s")))


def metres_per_second(unit: str) -> float | None:
    """Return the metres per second of a unit of speed, in any case; None for others."""
    name = re.sub(r"\s|\*\*|[.^]", "", unit.lower())
    if name in _KNOTS:
        return 1852.0 / 3600.0
    found = _SPEED.fullmatch(name)
    return metres(found[1]) if found else None


def decibars(unit: str) -> float | None:
    """Return the decibars of a unit of pressure, in any case; None for others."""
    name = unit.lower()
    return _DECIBARS.get(name, _DECIBARS.get(name.removesuffix("s")))
