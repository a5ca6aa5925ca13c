"""Figures as data: panels of marks with labels, units and colour roles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import NDArray

#: Numbers, times or texts of a mark.
Values = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Axis:
    """Axis of a panel.

    Attributes:
        label: Label.
        unit: Unit of its values; may be empty.
        ends: Limits, the larger one first for an axis that points down; None to fit the data.
        from_zero: Whether the axis starts at 0 without ``ends``.
        log: Whether the axis is logarithmic.
    """

    label: str
    unit: str = ""
    ends: tuple[Any, Any] | None = None
    from_zero: bool = False
    log: bool = False

    def __str__(self) -> str:
        """Return the label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """Data series in one style; sizes in pixels of a page, colours by role.

    Attributes:
        kind: Kind of drawing.
        x: Horizontal coordinates; NaN leaves a gap.
        y: Vertical coordinates.
        name: Name in the legend.
        color: Colour.
        symbol: Symbol of points.
        dash: Style of lines.
        width: Width of lines.
        size: Size of points.
        edge: Colour of their edge.
        halo: Whether on a light line.
        error: Standard errors of y.
        base: Lower limit of filled ground.
        text: Tooltips.
        z: Values of a mesh, shape (rows, columns), or of arrows.
        scale: Colours of a mesh, limits, label.
    """

    # joined: points on a line; band: a filled outline; ring: a filled closed line; mesh: cells coloured by z, of which x and y are edges or
    # corners, row by row; arrows: their components are z, shape (2, n)
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
    error: Values | None = None
    base: Values | None = None
    text: Values | None = None
    z: Values | None = None
    scale: tuple[str, float, float, str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Panel of marks on common axes.

    Attributes:
        title: Title.
        x: Horizontal axis.
        y: Vertical axis.
        marks: Marks in drawing order.
        height: Ratio of height to width.
        level: Reference value of y, or None.
        band: Reference interval of y and its name.
        note: Text in a corner.
        equal: Whether both axes have equal scales.
        degrees: Whether the axes are longitude and latitude.
        labels: Labels (x, y, text).
        shares_legend: Whether its legend is part of a common one below the figure.
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
    """Figure of panels in rows.

    Attributes:
        key: Unique key in a page.
        title: Title.
        panels: Panels in reading order.
        caption: Caption as HTML.
        alternative: Text alternative.
        across: Number of panels in a row if space allows.
        notes: Sentences on data not shown, with reasons.
    """

    key: str
    title: str
    panels: Sequence[Panel]
    caption: str = ""
    alternative: str = ""
    across: int = 2
    notes: Sequence[str] = ()


def missing(title: str, why: str) -> Panel:
    """Return a panel without marks that states the missing data."""
    return Panel(title, Axis(""), Axis(""), (), 0.45, note=why)
