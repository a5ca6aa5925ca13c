"""Style of figures: colour scales, symbols, dashes, sizes, fonts, and map features."""

from typing import Any

from replay_kit.core.words.colors import LIGHT, SYMBOLS

#: Width of a figure over one and over two columns of a page of a paper [inches].
WIDTHS = {1: 3.35, 2: 6.9}
#: Points of a printed figure for a pixel of a page, of the width of lines and of the size of marks.
THIN, SMALL = 0.55, 0.45
MARKERS = {
    "diamond": "D",
    "square": "s",
    "triangle-up": "^",
    "triangle-down": "v",
    "x": "x",
    "cross": "+",
    "star": "*",
    "pentagon": "p",
}
DASHES: dict[str, Any] = {"dash": "--", "dot": ":", "dashdot": "-.", "longdash": (0, (8, 3))}


def _look(kind: str, name: str, symbol: str, **more: Any) -> dict[str, Any]:
    """Return the look of a mark, with the colour and, of points, the symbol of what it stands for."""
    color, shape = SYMBOLS.get(symbol, (symbol, ""))
    own = {"symbol": shape} if kind == "points" else {"width": 1.2} if kind == "ring" else {}
    return {"kind": kind, "name": name, "color": color, **own, **more}


#: What is drawn of a feature of a role on a map, on a page and in print: a mark's look, its name in the legend, and whether it is drawn
#: only when it is asked for.
ON_MAP: dict[str, dict[str, Any]] = {
    "bottom": _look("line", "", "soft", width=0.8),
    "no_go": _look("ring", "no-go area", "no_go"),
    "between": _look("ring", "90 % of the legs between", "plan", off=True),
    "ellipse": _look("ring", "90 % of the next and the last leg", "plan"),
    "past": _look("ring", "90 % of past surfacings", "predicted", off=True),
    "track": _look("line", "track", "track", halo=True),
    "apart": _look("line", "", "actual", width=1.2, dash="dot"),
    "fix": _look("points", "fixes", "fix", size=6.0),
    "begin": _look("points", "begin", "vehicle", size=6.0, edge="paper"),
    "predicted": _look("points", "surfacing, predicted", "predicted"),
    "actual": _look("points", "surfacing, actual", "actual"),
    "plan": _look("line", "last plan", "plan", width=2.5, halo=True),
    "planned": _look("points", "planned surfacings", "plan", size=7.0, edge="paper"),
    "start": _look("points", "start", "vehicle", size=8.0, edge="paper"),
    "vehicle": _look("points", "vehicle", "vehicle", size=11.0, edge="paper"),
    "goal": _look("points", "goal", "goal", size=18.0, width=2.5),
}

_LETTERS: Any = {
    "font.family": "DejaVu Sans",  # matplotlib brings it along: the same letters on every machine
    "axes.titlelocation": "left",
    "legend.frameon": False,
    # ids in an SVG are salted hashes, and letters stay letters in every form, so that they can be searched
    "svg.hashsalt": "replay-kit",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}
#: Of a paper.
PAPER = _LETTERS | {
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 6.0,
    "lines.linewidth": 1.1,
    "savefig.dpi": 300.0,
}
#: Colour of the grid of a page, and of that behind charts, which stand for variables of its style as the roles of ``LIGHT`` do.
GRID, BEHIND = "#e3e8ec", "#f5f7f9"
#: Of a page.
PAGE = _LETTERS | {
    "font.size": 12.0,
    "axes.titlesize": 12.0,
    "axes.labelsize": 12.0,
    "legend.fontsize": 11.0,
    "xtick.labelsize": 11.0,
    "ytick.labelsize": 11.0,
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.titlecolor"), LIGHT["ink"]),
    **dict.fromkeys(("xtick.color", "ytick.color", "axes.edgecolor"), LIGHT["soft"]),
    **{"xtick.labelcolor": LIGHT["ink"], "ytick.labelcolor": LIGHT["ink"]},
    "axes.grid": True,
    "grid.color": GRID,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "axes.linewidth": 0.8,
}
