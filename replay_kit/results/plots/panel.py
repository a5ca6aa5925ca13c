"""Panels of figures: each draws itself into axes; a figure puts them into rows, with letters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from replay_kit.results.plots.style import SOFT, WIDTHS, styled

# Height of the notes below a figure [inches a line], and the letters that fit into an inch.
_LINE, _LETTERS = 0.13, 17.0


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel of a figure.

    Attributes:
        title: What it shows.
        draw: Draws it into axes.
        height: Over its width.
    """

    title: str
    draw: Callable[[Axes], None]
    height: float = 0.7


@dataclass(frozen=True, slots=True)
class Panels:
    """The panels of a figure.

    Attributes:
        panels: In reading order.
        across: Number beside each other in a figure over two columns; over one column they are below each other.
        notes: What the figure does not show, and why, as sentences.
    """

    panels: Sequence[Panel]
    across: int = 2
    notes: Sequence[str] = ()


def missing(title: str, why: str) -> Panel:
    """Return a panel that says what there is not.

    Args:
        title: What it would show.
        why: A sentence.
    """

    def draw(axes: Axes) -> None:
        axes.set(xticks=[], yticks=[])
        axes.text(
            0.5, 0.5, fill(why, 34), transform=axes.transAxes, ha="center", va="center", color=SOFT
        )

    return Panel(title, draw, 0.45)


def compose(contents: Panels, columns: int) -> Figure:
    """Return a figure of panels with letters, and the notes below them.

    Args:
        contents: The panels.
        columns: 1 or 2, of a page.
    """

    def make() -> Figure:
        width = WIDTHS[columns]
        across = min(contents.across if columns == 2 else 1, len(contents.panels))
        rows = [contents.panels[k : k + across] for k in range(0, len(contents.panels), across)]
        heights = [max(panel.height for panel in row) * width / across for row in rows]
        notes = fill(" ".join(contents.notes), int(_LETTERS * width)) if contents.notes else ""
        below = _LINE * (notes.count("\n") + 2) if notes else 0.0
        figure = Figure(figsize=(width, sum(heights) + below), layout="constrained")
        grid = figure.add_gridspec(len(rows), across, height_ratios=heights)
        for r, row in enumerate(rows):
            for c, panel in enumerate(row):
                axes = figure.add_subplot(grid[r, c])
                panel.draw(axes)
                letter = f"({chr(ord('a') + r * across + c)}) " if len(contents.panels) > 1 else ""
                axes.set_title(f"{letter}{panel.title}")
        if notes:
            figure.supxlabel(notes, fontsize=6.0, color=SOFT, x=0.01, ha="left")
        return figure

    return styled(make)
