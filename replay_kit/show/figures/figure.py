"""Figures as data, panels of marks with labels, units and colour roles; and their style: symbols, dashes, sizes, fonts, map features."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from numpy.typing import NDArray

from replay_kit.core.words.colors import LIGHT, SYMBOLS

#: Numbers, times or texts of a mark.
Values = NDArray[Any]


class Axis(NamedTuple):
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


class Mark(NamedTuple):
    """Data series in one style; sizes in pixels of a page, colours by role.

    Attributes:
        kind: Kind of drawing.
        x, y: Coordinates; NaN leaves a gap.
        name: Name in the legend.
        color: Colour.
        symbol, size: Of points.
        dash, width: Of lines.
        edge: Colour of the points' edge.
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


class Panel(NamedTuple):
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


def missing_panel(title: str, why: str) -> Panel:
    """Return a panel without marks that states the missing data."""
    return Panel(title, Axis(""), Axis(""), (), 0.45, note=why)


#: Width of a figure over one and over two columns of a page of a paper [inches].
WIDTHS = {1: 3.35, 2: 6.9}
#: Points of a printed figure for a pixel of a page, of the width of lines and of the size of marks.
THIN, SMALL = 0.55, 0.45
MARKERS = dict(
    pair.split(":")
    for pair in [
        "diamond:D",
        "square:s",
        "triangle-up:^",
        "triangle-down:v",
        "x:x",
        "cross:+",
        "star:*",
        "pentagon:p",
    ]
)
DASHES: dict[str, Any] = {"dash": "--", "dot": ":", "dashdot": "-.", "longdash": (0, (8, 3))}

# Role, kind of mark, and what it stands for (a role of colours, or one of ``SYMBOLS``); then other looks, and its name in the legend.
_LOOKS = """
bottom line soft width=0.8:
no_go ring no_go:no-go area
between ring plan off:90 % of the legs between
ellipse ring plan:90 % of the next and the last leg
past ring predicted off:90 % of past surfacings
track line track halo:track
apart line actual width=1.2 dash=dot:
fix points fix size=6.0:fixes
begin points vehicle size=6.0 edge=paper:begin
predicted points predicted:surfacing, predicted
actual points actual:surfacing, actual
plan line plan width=2.5 halo:last plan
planned points plan size=7.0 edge=paper:planned surfacings
start points vehicle size=8.0 edge=paper:start
vehicle points vehicle size=11.0 edge=paper:vehicle
goal points goal size=18.0 width=2.5:goal
"""


def _looks(table: str) -> dict[str, dict[str, Any]]:
    found = dict[str, dict[str, Any]]()
    for row in table.strip().splitlines():
        look, _, name = row.partition(":")
        role, kind, symbol, *more = look.split()
        color, shape = SYMBOLS.get(symbol, (symbol, ""))
        of_kind: Any = {"points": {"symbol": shape}, "ring": {"width": 1.2}}.get(kind, {})
        found[role] = {"kind": kind, "name": name, "color": color, **of_kind}
        for key, _, value in (each.partition("=") for each in more):
            found[role][key] = float(value) if "." in value else value or True
    return found


#: What is drawn of a feature of a role on a map, on a page and in print: a mark's look, its name in the legend, and whether it is drawn
#: only when it is asked for.
ON_MAP = _looks(_LOOKS)


def _settings(text: str) -> dict[str, Any]:
    """Return settings of matplotlib in the form of its style sheets."""
    return dict(line.split(": ", 1) for line in text.splitlines() if line)


# matplotlib brings the font along: the same letters on every machine. Ids in an SVG are salted hashes, and letters stay letters in every
# form, so that they can be searched.
_LETTERS = """
font.family: DejaVu Sans
axes.titlelocation: left
legend.frameon: False
svg.hashsalt: replay-kit
svg.fonttype: none
pdf.fonttype: 42
"""
#: Of a paper.
PAPER: Any = _settings(f"""{_LETTERS}
font.size: 7.0
axes.titlesize: 7.5
axes.labelsize: 7.0
axes.linewidth: 0.6
xtick.labelsize: 6.5
ytick.labelsize: 6.5
xtick.major.width: 0.6
ytick.major.width: 0.6
legend.fontsize: 6.0
lines.linewidth: 1.1
savefig.dpi: 300.0
""")
#: Colour of the grid of a page, and of that behind charts, which stand for variables of its style as the roles of ``LIGHT`` do.
GRID, BEHIND = "#e3e8ec", "#f5f7f9"
#: Of a page.
PAGE: Any = _settings(f"""{_LETTERS}
font.size: 12.0
axes.titlesize: 12.0
axes.labelsize: 12.0
legend.fontsize: 11.0
xtick.labelsize: 11.0
ytick.labelsize: 11.0
text.color: {LIGHT["ink"]}
axes.labelcolor: {LIGHT["ink"]}
axes.titlecolor: {LIGHT["ink"]}
xtick.labelcolor: {LIGHT["ink"]}
ytick.labelcolor: {LIGHT["ink"]}
xtick.color: {LIGHT["soft"]}
ytick.color: {LIGHT["soft"]}
axes.edgecolor: {LIGHT["soft"]}
axes.grid: True
grid.color: {GRID}
axes.facecolor: none
figure.facecolor: none
axes.spines.top: False
axes.spines.right: False
axes.axisbelow: True
xtick.major.size: 0.0
ytick.major.size: 0.0
axes.linewidth: 0.8
""")
