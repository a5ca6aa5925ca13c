"""Options of settings and parsing of numbers in texts; without pydantic, for fast help."""

import math
import re
from dataclasses import dataclass

from replay_kit.core.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Option:
    """Mark of a setting that is also an option, ``Annotated[type, Option(...)]``; pydantic ignores it.

    Attributes:
        metavar: Form of the value in the help, such as ``W,S,E,N``; None for that of the type.
        heading: Heading above it in the help.
        repeats: Whether the option may be repeated, with one value each time.
        name: Name of the option; None for the key.
    """

    metavar: str | None = None
    heading: str = "Settings"
    repeats: bool = False
    name: str | None = None


@dataclass(frozen=True, slots=True)
class Numbers:
    """Mark of an annotation: names of the comma-separated numbers in a text, such as ``LON,LAT,DEPTH``."""

    form: str

    def check(self, name: str, text: str) -> None:
        """Raise ConfigError unless a value holds these numbers and, for a position, lies on the Earth."""
        values = numbers(text, name, self.form)
        if self.form.startswith("LON,LAT,") and abs(values[1]) > 90.0:
            swapped = ",".join(f"{value:g}" for value in (values[1], values[0], *values[2:]))
            meant = (
                f"did you mean {name}={swapped}?"
                if abs(values[0]) <= 90.0
                else "give a place on the Earth"
            )
            raise ConfigError(
                f"{name}: expected {self.form}, got '{text}': the latitude {values[1]:g} is outside -90..90; {meant}"
            )


PLACE = Numbers("LON,LAT,DEPTH")


@dataclass(frozen=True, slots=True)
class NumbersOfVehicles(Numbers):
    """Mark of numbers that may be preceded by ``NAME=``, for one vehicle."""

    def check(self, name: str, text: str) -> None:
        """Raise ConfigError as ``Numbers.check`` does."""
        Numbers.check(self, name, text.rpartition("=")[2])


PLACES = NumbersOfVehicles("LON,LAT,DEPTH")


def numbers(text: str, name: str, form: str | None = None) -> tuple[float, ...]:
    """Return the finite comma-separated numbers of an option.

    Args:
        text: Value of the option.
        name: Name of the option.
        form: Comma-separated names of the numbers; None for any count.

    Raises:
        ConfigError: A part is not a number, or the count differs from ``form``.
    """
    parts, labels = text.split(","), [] if form is None else form.split(",")
    expected = f"{name}: expected {form or 'numbers with commas between them'}, got '{text}'"
    if labels and len(parts) < len(labels):
        missing = labels[len(parts) :]
        raise ConfigError(
            f"{expected}: {' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        )
    if labels and len(parts) > len(labels):
        raise ConfigError(f"{expected}: {len(parts)} numbers instead of {len(labels)}")
    return tuple(_number(part.strip(), expected) for part in parts)


def _number(part: str, expected: str) -> float:
    """Return a finite number; ``expected`` begins the error message otherwise."""
    if hemisphere := re.fullmatch(r"([\d.]+)\s*°?\s*([NSEWnsew])", part):
        sign = "-" if hemisphere[2] in "SWsw" else ""
        raise ConfigError(
            f"{expected}: write {sign}{hemisphere[1]} for {part}; west and south are negative"
        )
    try:
        value = float(part)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{expected}: '{part}' is no finite number")
    return value
