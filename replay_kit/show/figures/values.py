"""A figure as a value: panels of marks on named columns, with labels, units and the roles of colours."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
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
        log: Whether it is logarithmic, on a page; values that are not above 0 are then not drawn.
        labels: Names of the positions 0, 1, ..., which stand beside the axis on a page; empty for numbers.
    """

    label: str
    unit: str = ""
    ends: tuple[float, float] | None = None
    from_zero: bool = False
    log: bool = False
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """Values drawn in one look. Colours are roles of ``core.colors`` or ``#rrggbb``, sizes and widths pixels of a page.

    Attributes:
        kind: ``line``; ``points``; ``joined``, points on a line; ``bars``; ``area`` between y and ``base``; ``ring``, a filled closed line.
        x: Along the horizontal axis; NaN leave a gap.
        y: Along the vertical axis.
        name: In the legend; empty for none.
        color: Of all but what ``shade`` colours.
        symbol: plotly's name of the symbol of points.
        dash: plotly's name of the dash of lines.
        width: Of lines.
        size: Of points.
        edge: Colour around points; empty for none.
        halo: Whether a white line lies below, for marks on a coloured field.
        step: Whether the line is a staircase.
        error: Standard deviations of y; None for none.
        base: Where an area ends; None for others.
        shade: Column that colours the points on a page, its colour scale, and the label of the colour bar, empty for no bar.
        hover: plotly's template of what a page shows beside the pointer; empty for plotly's own, ``skip`` for nothing.
        text: Column or texts that the template calls ``text``.
        detail: Column that the template calls ``customdata``.
        shown: Whether it is drawn before its entry of the legend is chosen.
        label: Beside the last point of a map.
        when: Times of the points: a map with a time draws none that is later; None for what holds at all times.
    """

    kind: Literal["line", "points", "joined", "bars", "area", "ring"]
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
    shade: tuple[str, str, str] | None = None
    hover: str = ""
    text: Values | None = None
    detail: Values | None = None
    shown: bool = True
    label: str = ""
    when: Values | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Marks over the same axes.

    Attributes:
        title: What it shows; a page has the title of the chart alone.
        y: The vertical axis.
        marks: From the lowest to the highest.
        level: A value of y to compare with, drawn as a line; None for none.
        band: Least and largest of the values of y to compare with, and their name; None for none.
        note: Figures in a corner in print; on a page the caption has them.
        share: Of the height of the chart.
    """

    title: str
    y: Axis
    marks: Sequence[Mark]
    level: float | None = None
    band: tuple[float, float, str] | None = None
    note: str = ""
    share: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Panels below each other over the same horizontal axis.

    Attributes:
        key: Unique in a page.
        title: What it shows.
        x: The horizontal axis.
        panels: From top to bottom.
        caption: What to see in it, as HTML.
        alternative: What it shows, in words for who does not see it.
        tables: The columns.
        height: On a page [px].
        equal: Whether both axes have the same scale: the vertical axis over the horizontal one, as 1 for lengths; 0 for none.
    """

    key: str
    title: str
    x: Axis
    panels: Sequence[Panel]
    caption: str = ""
    alternative: str = ""
    tables: Tables = field(default_factory=dict)
    height: int = 380
    equal: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Marks that lie on a map, with their columns; kilometres along the local frame."""

    marks: Sequence[Mark] = ()
    tables: Tables = field(default_factory=dict)


def until(layer: Layer, time_ns: int | None) -> Layer:
    """Return a layer without the points that are later than a time [ns, UTC]; as it is for None."""
    if time_ns is None:
        return layer
    end, marks = np.datetime64(time_ns, "ns"), []
    for mark in layer.marks:
        if mark.when is None:
            marks.append(mark)
            continue
        earlier = values_of(layer.tables, mark.when) <= end
        if earlier.any():
            x, y = (
                np.where(earlier, values_of(layer.tables, each), np.nan)
                for each in (mark.x, mark.y)
            )
            marks.append(replace(mark, x=x, y=y))
    return replace(layer, marks=marks)


def values_of(tables: Tables, values: Values) -> NDArray[Any]:
    """Return a column of the tables, or the values of a mark alone."""
    if not isinstance(values, str):
        return values
    table, _, name = values.partition(".")
    return np.asarray(tables[table][name])
