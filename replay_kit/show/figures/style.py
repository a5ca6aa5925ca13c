"""Style of figures: colour scales, symbols, dashes, sizes, fonts, and map features."""

from typing import Any

from replay_kit.core.colors import LIGHT, SYMBOLS

#: Width of a figure over one and over two columns of a page of a paper [inches].
WIDTHS = {1: 3.35, 2: 6.9}
#: Points of a printed figure for a pixel of a page, of the width of lines and of the size of marks.
THIN, SMALL = 0.55, 0.45
MARKERS = {
    **{"diamond": "D", "square": "s", "triangle-up": "^", "triangle-down": "v", "x": "x"},
    **{"cross": "+", "star": "*", "pentagon": "p"},
}
DASHES: dict[str, Any] = {"dash": "--", "dot": ":", "dashdot": "-.", "longdash": (0, (8, 3))}
#: What is drawn of a feature of a role on a map, on a page and in print: a mark's look, its name in the legend, and whether it is drawn
#: only when it is asked for.
ON_MAP: dict[str, dict[str, Any]] = {
    "bottom": {"kind": "line", "color": "soft", "width": 0.8},
    "no_go": {"kind": "ring", "name": "no-go area", "color": SYMBOLS["no_go"][0], "width": 1.2},
    "between": {
        "kind": "ring",
        "name": "90 % of the legs between",
        "color": SYMBOLS["plan"][0],
        "width": 1.2,
        "off": True,
    },
    "ellipse": {
        "kind": "ring",
        "name": "90 % of the next and the last leg",
        "color": SYMBOLS["plan"][0],
        "width": 1.2,
    },
    "past": {
        "kind": "ring",
        "name": "90 % of past surfacings",
        "color": SYMBOLS["predicted"][0],
        "width": 1.2,
        "off": True,
    },
    "track": {"kind": "line", "name": "track", "color": SYMBOLS["track"][0], "halo": True},
    "apart": {"kind": "line", "color": SYMBOLS["actual"][0], "width": 1.2, "dash": "dot"},
    "fix": {"name": "fixes", "size": 6.0},
    "begin": {"name": "begin", "size": 6.0, "edge": "paper"},
    "predicted": {"name": "surfacing, predicted"},
    "actual": {"name": "surfacing, actual"},
    "plan": {
        "kind": "line",
        "name": "last plan",
        "color": SYMBOLS["plan"][0],
        "width": 2.5,
        "halo": True,
    },
    "planned": {"name": "planned surfacings", "size": 7.0, "edge": "paper"},
    "start": {"name": "start", "size": 8.0, "edge": "paper"},
    "vehicle": {"name": "vehicle", "size": 11.0, "edge": "paper"},
    "goal": {"name": "goal", "size": 18.0, "width": 2.5},
}
_POINTS = {"begin": "vehicle", "start": "vehicle", "planned": "plan"}
for _role, _look in ON_MAP.items():
    if "kind" not in _look:
        _color, _symbol = SYMBOLS[_POINTS.get(_role, _role)]
        _look |= {"kind": "points", "color": _color, "symbol": _symbol}

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
    **{"font.size": 12.0, "axes.titlesize": 12.0, "axes.labelsize": 12.0, "legend.fontsize": 11.0},
    **{"xtick.labelsize": 11.0, "ytick.labelsize": 11.0},
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.titlecolor"), LIGHT["ink"]),
    **dict.fromkeys(("xtick.color", "ytick.color", "axes.edgecolor"), LIGHT["soft"]),
    **{"xtick.labelcolor": LIGHT["ink"], "ytick.labelcolor": LIGHT["ink"]},
    **{"axes.grid": True, "grid.color": GRID, "axes.facecolor": "none", "figure.facecolor": "none"},
    **{"axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True},
    **{"xtick.major.size": 0.0, "ytick.major.size": 0.0, "axes.linewidth": 0.8},
}
