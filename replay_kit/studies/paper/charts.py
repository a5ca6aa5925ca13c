"""Charts of the page: error against the number of pings, and miss distances of the glides."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from replay_kit.core.words.colors import LINES
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.studies.paper.text import grouped, to_text

_COLORS = (*LINES[:3], "ink", *LINES[3:], "#8C8C8C")
_SYMBOLS = (
    "circle",
    "square",
    "diamond",
    "triangle-up",
    "x",
    "star",
    "triangle-down",
    "cross",
    "pentagon",
)
_DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
# Shorter miss distances [m] are drawn at this one.
_LEAST_MISS = 1.0


def lines_by(points: Iterable[tuple[str, float, float]]) -> list[Mark]:
    """Return a line per label of points (label, x and y), in order of first occurrence."""
    each = grouped(points, lambda point: point[0]).items()
    values = [
        (label, np.array([point[1:] for point in alike], np.float64)) for label, alike in each
    ]
    return [Mark("joined", at[:, 0], at[:, 1], label) for label, at in values]


def one_figure(
    key: str,
    title: str,
    caption: str,
    axes: tuple[Axis, Axis],
    lines: Sequence[Mark],
    level: float,
) -> Figure:
    """Return a figure of one panel.

    Args:
        key: Unique in the page.
        title: Title.
        caption: Caption as HTML.
        axes: Horizontal and vertical axis.
        lines: Lines with names.
        level: Reference value of y.
    """
    marks = []
    for number, mark in enumerate(lines):
        color, symbol, dash = (each[number % len(each)] for each in (_COLORS, _SYMBOLS, _DASHES))
        marks.append(mark._replace(color=color, symbol=symbol, dash=dash, size=7.0))
    words = f"{title}: {axes[1].label} against {axes[0].label}. {' '.join(map(_in_words, lines))}"
    panels = [Panel(title, *axes, marks, level=level)]
    return Figure(key, title, panels, caption, words)


def _in_words(mark: Mark) -> str:
    """Return the first and the last value of a mark as text."""
    known = [(x, y) for x, y in zip(mark.x, mark.y, strict=True) if np.isfinite(x + y)]
    if not known:
        return f"{mark.name}: no values."
    ends = [f"{to_text(float(y))} at {to_text(float(x))}" for x, y in (known[0], known[-1])]
    return f"{mark.name}: {' to '.join(dict.fromkeys(ends))}."


def misses_figure(key: str, title: str, misses: Mapping[str, Sequence[float]]) -> Figure:
    """Return the distribution of miss distances, one line per planning flow.

    Args:
        key: Unique in the page.
        title: Title.
        misses: Miss distances [m] by label of the flow; those below 1 m are drawn at 1 m.
    """
    marks = []
    for label, values in misses.items():
        ordered = np.sort(np.maximum(np.asarray(values, dtype=np.float64), _LEAST_MISS))
        # a step at each: the share rises where a plan misses by so much
        shares = np.repeat(np.arange(ordered.size + 1) / ordered.size, 2)[1:-1]
        marks.append(Mark("line", np.repeat(ordered, 2), shares, label))
    caption = (
        "Share of the plans whose miss distance in the truth is no larger. The farther up and left a line lies, the better the plans; "
        f"distances below {_LEAST_MISS:g} m are drawn at {_LEAST_MISS:g} m."
    )
    axes = Axis("miss distance in the truth [m]", log=True), Axis("share of the plans [1]")
    return one_figure(key, title, caption, axes, marks, 0.5)
