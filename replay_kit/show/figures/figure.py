"""A figure as a value: panels of marks on named columns, with labels, units and the roles of colours."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

#: A column of the tables as ``table.column``, or values of a mark alone.
Values = str | NDArray[Any]
#: Columns by the name of the table, then of the column.
Tables = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis.

    Attributes:
        label: What it shows.
        unit: Of its values; empty for none.
        ends: Values at its begin and end, the first the larger one for an axis that points down; None as the data need.
        from_zero: Whether it starts at 0 where ``ends`` are not stated.
        log: Whether it is logarithmic.
        labels: Names of the positions 0, 1, ...; empty for numbers.
    """

    label: str
    unit: str = ""
    ends: tuple[Any, Any] | None = None
    from_zero: bool = False
    log: bool = False
    labels: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """Values drawn in one look. Colours are roles of ``core.colors`` or ``#rrggbb``; sizes and widths are pixels of a page.

    Attributes:
        kind: ``line``; ``points``; ``joined``, points on a line; ``bars``; ``band``, a filled outline; ``ring``, a filled closed
            line; ``mesh``, cells coloured by ``z``; ``arrows``, whose components are ``z``.
        x: Along the horizontal axis; NaN leave a gap; of a mesh the edges or corners of its cells.
        y: Along the vertical axis.
        name: In the legend and beside the pointer; empty for none.
        color: Of all but a mesh.
        symbol: Of points, see ``core.colors``.
        dash: Of lines: ``solid``, ``dash``, ``dot``, ``dashdot``.
        width: Of lines.
        size: Of points.
        edge: Colour around points; empty for none.
        halo: Whether a light line lies below, for marks on a coloured field.
        step: Whether the line is a staircase.
        error: Standard deviations of y; None for none.
        base: Down to which the ground is filled below a line; None for others.
        text: What is said of each point beside the pointer; None for nothing.
        z: Values of the cells of a mesh, row by row; components of arrows, shape (2, n).
        scale: Colour scale of a mesh, the values at its ends, and the label of the colour bar.
    """

    kind: Literal["line", "points", "joined", "bars", "band", "ring", "mesh", "arrows"]
    x: Values
    y: Values
    name: str = ""
    color: str = "one"
    symbol: str = "circle"
    dash: str = "solid"
    width: float = 2.0
    size: float = 6.0
    edge: str = ""
    halo: bool = False
    step: bool = False
    error: Values | None = None
    base: Values | None = None
    text: Values | None = None
    z: Values | None = None
    scale: tuple[str, float, float, str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Marks over the same axes.

    Attributes:
        title: What it shows; a sentence of what is missing where there are no marks.
        x: The horizontal axis.
        y: The vertical axis.
        marks: From the lowest to the highest.
        height: Over its width.
        level: A value of y to compare with, drawn as a line; None for none.
        band: Least and largest of the values of y to compare with, and their name; None for none.
        note: Figures in a corner.
        equal: Whether both axes have the same scale.
        degrees: Whether the axes are longitude and latitude; what no mark covers is hatched.
        labels: Texts at places (x, y, text), of which those that would lie over another are left out.
        shares_legend: Whether its legend is below the figure, once for all such panels.
    """

    title: str
    x: Axis
    y: Axis
    marks: Sequence[Mark]
    height: float = 0.6
    level: float | None = None
    band: tuple[float, float, str] | None = None
    note: str = ""
    equal: bool = False
    degrees: bool = False
    labels: Sequence[tuple[float, float, str]] = ()
    shares_legend: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """Panels in rows.

    Attributes:
        key: Unique in a page.
        title: What it shows.
        panels: In reading order.
        tables: The columns, which a page offers.
        caption: What to see in it, as HTML.
        alternative: What it shows, in words for who does not see it.
        across: Panels beside each other where there is room.
        notes: What it does not show, and why, as sentences.
    """

    key: str
    title: str
    panels: Sequence[Panel]
    tables: Tables = field(default_factory=dict)
    caption: str = ""
    alternative: str = ""
    across: int = 2
    notes: Sequence[str] = ()


def missing(title: str, why: str) -> Panel:
    """Return a panel that says what there is not, in a sentence."""
    return Panel(title, Axis(""), Axis(""), (), 0.45, note=why)


def values_of(tables: Tables, values: Values) -> NDArray[Any]:
    """Return a column of the tables, or the values of a mark alone."""
    if not isinstance(values, str):
        return np.asarray(values)
    table, _, name = values.partition(".")
    return np.asarray(tables[table][name])
