"""Formatting of numbers, durations and positions, and sentences whose numbers keep their fields."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from math import floor, isfinite, log10
from string import Formatter
from typing import Any, NamedTuple

from replay_kit.core.words.quantities import parse_time


class Shown(NamedTuple):
    """Formatted number of a field.

    Attributes:
        key: Path in an outcome or a status, such as ``rms_innovation.before``.
        value: Value of the field.
        text: Rounded value with its unit.
    """

    key: str
    value: float | int
    text: str

    @property
    def html(self) -> str:
        """Text as HTML with the field and its exact value."""
        return f'<data data-key="{escape(self.key)}" value="{escape(repr(self.value))}">{escape(self.text)}</data>'


class Sentence(NamedTuple):
    """Sentence of texts and numbers, for terminals and pages."""

    parts: Sequence[str | Shown]

    def __str__(self) -> str:
        """Return the sentence as text."""
        return "".join(part if isinstance(part, str) else part.text for part in self.parts)

    @property
    def html(self) -> str:
        """Sentence as HTML."""
        return "".join(escape(part) if isinstance(part, str) else part.html for part in self.parts)


def joined_sentences(begin: str, sentences: Iterable[Sentence]) -> Sentence:
    """Return sentences joined by semicolons."""
    parts: list[str | Shown] = [begin]
    for k, one in enumerate(sentences):
        parts += [*(["; "] if k else []), *one.parts]
    return Sentence(parts)


def sentence(template: str, fields: Mapping[str, Any], at: str = "") -> Sentence:
    """Return a sentence with formatted fields.

    Args:
        template: Text with field paths in braces, and formats: ``cm`` and ``cm/s`` for a speed [m/s], ``share`` and ``%``, ``min``,
            ``hours``, ``span`` and ``days`` for a duration [s, days], ``size`` for an amount without its sign, ``km`` and ``far`` for a
            distance [m], ``course`` for a direction [degrees], ``kJ`` and ``MJ`` for an energy [J], ``clock`` for a time as text, or
            Python's; ``{place}`` is the position of the fields. What is in brackets is left out where a value in it is unknown.
        fields: Values, nested in mappings and sequences; None if unknown.
        at: Path prefix of the fields, ending with a dot.
    """
    parts: list[str | Shown] = []
    for number, part in enumerate(re.split(r"\[(.*?)\]", template)):
        found: list[str | Shown | None] = []
        for text, name, form, _ in Formatter().parse(part):
            found.append(text)
            if name is not None:
                found.append(_part(f"{at}{name}", _value(fields, name), form or ""))
        if number % 2 == 0 or None not in found:
            parts += ["-" if one is None else one for one in found]
    return Sentence(parts)


def _value(fields: Mapping[str, Any], name: str) -> Any:
    """Return the value at a path; None if a step of it is unknown."""
    if name == "place":
        east, north = fields.get("longitude"), fields.get("latitude")
        return None if east is None or north is None else minutes_text(east, north)
    held: Any = fields
    for step in name.split("."):
        if held is not None:
            held = held.get(step) if isinstance(held, Mapping) else held[int(step)]
    return held


# Forms of numbers: factor, Python's format, unit.
_TABLE = """
cm 100/1 .2f cm/s
cm/s 100/1 .1f
share 100/1 .0f %
% 100/1 .0f
min 1/60 +.0f min
hours 1/3600 .1f
far 1/1000 .1f
kJ 1/1000 ,.0f kJ
MJ 1/1000000 g MJ
"""
_FORMS = {name: form for name, *form in (row.split() for row in _TABLE.strip().split("\n"))}


def _part(key: str, value: Any, form: str) -> str | Shown | None:
    if value is None or isinstance(value, str):
        return clock(value) if value and form == "clock" else value or None
    if form in _FORMS:
        factor, spec, *unit = _FORMS[form]
        times, over = map(float, factor.split("/"))
        return Shown(key, value, " ".join([f"{times * value / over:{spec}}", *unit]))
    special = {
        "span": lambda: hours_text(value),
        "days": lambda: hours_text(86_400.0 * value),
        "size": lambda: f"{abs(value):,.1f}",
        "km": lambda: f"{value / 1e3:,.1f} km" if value >= 1e3 else f"{value:.0f} m",
        "course": lambda: f"{round(value) % 360:03d}",
    }
    return Shown(key, value, special[form]() if form in special else f"{value:{form or ','}}")


def number(key: str, value: float | int | None, text: str) -> str:
    """Return a number as HTML, see ``Shown``; ``unknown`` for None."""
    return "unknown" if value is None else Shown(key, value, text).html


def nice_number(value: float, least: bool = False) -> float:
    """Return 1, 2 or 5 times a power of ten: the largest at most a positive value or, with ``least``, the smallest at least it."""
    power = 10.0 ** floor(log10(value))
    steps = [factor * power for factor in (1.0, 2.0, 5.0, 10.0)]
    near = 1e-9 * value
    if least:
        return float(f"{min(step for step in steps if step >= value - near):.3g}")
    return float(f"{max(step for step in steps if step <= value + near):.3g}")


def fixed(value: float, digits: int, signed: bool = False) -> str:
    """Return a number with fixed decimals, without a sign if rounded to 0; ``unknown`` if not finite."""
    if not isfinite(value):
        return "unknown"
    # the addition of 0 turns -0 into 0
    rounded = round(value, digits) + 0.0
    return f"{rounded:{'+' if signed and rounded else ''},.{digits}f}"


def error_text(value: float) -> str:
    """Return a standard error [m/s] in cm/s, to 1 mm/s."""
    return "0.1 or less" if value < 0.0005 else fixed(100.0 * value, 1)


def clock_text(time_ns: int) -> str:
    """Return a time [ns, UTC] as day and minute, such as ``18 Nov 19:16``."""
    text = datetime.fromtimestamp(time_ns // 10**9, UTC)
    return f"{text.day} {text:%b %H:%M}"


def clock(text: str, beside: str = "") -> str:
    """Return a time in the form of ``time_text`` as by ``clock_text``, without the day if a time beside it has the same."""
    shown = clock_text(parse_time(text))
    return shown.rpartition(" ")[2] if text[:10] == beside[:10] else shown


def hours_text(seconds: float) -> str:
    """Return a duration, such as ``35 min``, ``4.2 h`` or ``3.1 days``."""
    far = abs(seconds)
    if far < 7200.0:
        return f"{far / 60.0:.0f} min"
    return f"{far / 3600.0:.1f} h" if far < 172_800.0 else f"{far / 86_400.0:.1f} days"


def minutes_text(longitude: float, latitude: float) -> str:
    """Return a position [degrees] in degrees and minutes, such as ``40°24.2′S 152°21.9′E``."""
    parts = []
    for value, letters in ((latitude, "NS"), ((longitude + 180.0) % 360.0 - 180.0, "EW")):
        tenths = round(abs(value) * 600.0)
        minutes = f"{tenths % 600 / 10.0:04.1f}"
        parts.append(f"{tenths // 600}°{minutes}′{letters[value < 0.0]}")
    return " ".join(parts)
