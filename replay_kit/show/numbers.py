"""Numbers, durations and places as people write them."""

from datetime import UTC, datetime
from math import isfinite


def fixed(value: float, digits: int, signed: bool = False) -> str:
    """Return a number with some decimals, without a sign where it is 0 after rounding; ``unknown`` where it is none."""
    if not isfinite(value):
        return "unknown"
    # the addition of 0 turns -0 into 0
    rounded = round(value, digits) + 0.0
    return f"{rounded:{'+' if signed and rounded else ''},.{digits}f}"


def error_text(value: float) -> str:
    """Return a standard error [m/s] to a millimetre a second where it is that small, else to a centimetre."""
    if value < 0.0005:
        return "0.001 or less"
    return fixed(value, 2 if value >= 0.01 else 3)


def clock_text(time_ns: int) -> str:
    """Return a time [ns, UTC] as day and minute, such as ``18 Nov 19:16``."""
    text = datetime.fromtimestamp(time_ns // 10**9, UTC)
    return f"{text.day} {text:%b %H:%M}"


def hours_text(seconds: float) -> str:
    """Return a duration, such as ``35 min``, ``4.2 h`` or ``3.1 days``."""
    far = abs(seconds)
    if far < 7200.0:
        return f"{far / 60.0:.0f} min"
    return f"{far / 3600.0:.1f} h" if far < 172_800.0 else f"{far / 86_400.0:.1f} days"


def minutes_text(longitude: float, latitude: float) -> str:
    """Return a place [degrees] in degrees and minutes, such as ``40° 24.2′ S, 152° 21.9′ E``."""
    parts = []
    for value, letters in ((latitude, "NS"), ((longitude + 180.0) % 360.0 - 180.0, "EW")):
        tenths = round(abs(value) * 600.0)
        minutes = f"{tenths % 600 / 10.0:04.1f}"
        parts.append(f"{tenths // 600}° {minutes}′ {letters[value < 0.0]}")
    return ", ".join(parts)
