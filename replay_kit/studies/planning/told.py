"""What a study has to say: tables, figures beside what is asked of them, words and pictures."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_NAN = float("nan")

Cell = str | int | float | bool


@dataclass(frozen=True, slots=True)
class Table:
    """Rows alike.

    Attributes:
        name: Of its CSV, beginning with the study's name.
        title: What it shows.
        columns: Names with units.
        rows: A cell for each column; NaN is not known.
        shown: Whether it is printed, not only written.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    shown: bool = True


@dataclass(frozen=True, slots=True)
class Asked:
    """A figure beside what is asked of it.

    Attributes:
        what: It is.
        value: Its value.
        at_least: What is asked; NaN for nothing.
        at_most: What is asked; NaN for nothing.
        low: Lower end of its 90 % interval; NaN without one.
        high: Upper end.
    """

    what: str
    value: float
    at_least: float = _NAN
    at_most: float = _NAN
    low: float = _NAN
    high: float = _NAN

    @property
    def met(self) -> bool:
        """Whether the value is as asked; one that is no number is not."""
        return not math.isnan(self.value) and not self.value < self.at_least and not self.value > self.at_most


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture to be drawn.

    Attributes:
        name: Of its file, beginning with the study's name.
        caption: What it shows.
        size: Width and height [inches].
        draw: Draws it on a matplotlib figure.
    """

    name: str
    caption: str
    size: tuple[float, float]
    draw: Callable[[Any], None]


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """A study's outcome.

    Attributes:
        study: Its name.
        title: What it is about.
        tables: Its tables.
        asked: Its figures beside what is asked of them.
        words: What the tables show, a paragraph each.
        pictures: To be drawn.
        failed: Why the study has no outcome; empty when it has.
    """

    study: str
    title: str
    tables: tuple[Table, ...]
    asked: tuple[Asked, ...] = ()
    words: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    failed: str = ""
