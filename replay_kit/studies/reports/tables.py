"""Tables, figures beside the limits required of them, and pictures, before they are written."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array

NAN = math.nan

Cell = str | int | float | bool | tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of the same columns.

    Attributes:
        name: Of its CSV.
        title: What it shows.
        columns: Names with units.
        rows: A cell for each column; NaN where a figure is undefined.
        shown: Whether it is printed and part of the report, not only a CSV.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    shown: bool = True

    def column(self, name: str) -> Array:
        """Return the numbers of a column, shape (rows,)."""
        return np.array([row[self.columns.index(name)] for row in self.rows], dtype=np.float64)


def named_columns(
    name: str, title: str, rows: Sequence[Mapping[str, Cell]], shown: bool = True
) -> Table:
    """Return the table of at least one row, each a cell for each column by its name."""
    return Table(name, title, tuple(rows[0]), tuple(tuple(row.values()) for row in rows), shown)


def is_within(value: float, at_least: float, at_most: float) -> bool:
    """Return whether a value keeps to its limits, of which NaN sets none; an undefined value does not."""
    return not math.isnan(value) and not value < at_least and not value > at_most


@dataclass(frozen=True, slots=True)
class Criterion:
    """A figure beside the limit that it should keep to.

    Attributes:
        what: The figure, with its unit.
        value: Its value.
        at_least: Lower limit; NaN for none.
        at_most: Upper limit; NaN for none.
        low: Lower end of its 90 % interval; NaN without one.
        high: Upper end.
    """

    what: str
    value: float
    at_least: float = NAN
    at_most: float = NAN
    low: float = NAN
    high: float = NAN

    @property
    def met(self) -> bool:
        """Whether the value keeps to its limits."""
        return is_within(self.value, self.at_least, self.at_most)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture to be drawn.

    Attributes:
        name: Of its file.
        caption: What it shows.
        size: Width and height [inches].
        draw: Draws it on a matplotlib figure.
    """

    name: str
    caption: str
    size: tuple[float, float]
    draw: Callable[[Any], None]
