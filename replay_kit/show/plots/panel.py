"""Panels of figures: each draws itself into axes; a figure puts them into rows, with letters."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from textwrap import fill
from typing import Any, TypeVar

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from replay_kit.core.colors import PRINT, scale

#: Width of a figure over one and over two columns of a page [inches].
WIDTHS = {1: 3.35, 2: 6.9}
#: Forms of a figure's file.
ENDINGS = (".png", ".svg", ".pdf")

_Made = TypeVar("_Made")
_STYLE: Any = {
    "font.family": "DejaVu Sans",  # matplotlib brings it along: the same letters on every machine
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 6.0,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "savefig.dpi": 300.0,
    # ids in an SVG are salted hashes, and letters stay letters in every form, so that they can be searched
    "svg.hashsalt": "replay-kit",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}
# what would state when a figure was made, so that the same result gives the same bytes
_NO_DATES: dict[str, dict[str, None]] = {
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
    "png": {},
}


def colormap(name: str) -> LinearSegmentedColormap:
    """Return one of cmocean's colour maps: ``speed``, ``balance`` or ``amp``."""
    return LinearSegmentedColormap.from_list(name, scale(name))


def colorbar(axes: Axes, mesh: Any, label: str, extend: str = "neither") -> None:
    """Draw a colour bar beside axes, as high as these are.

    Args:
        axes: The axes.
        mesh: What is coloured.
        label: With the unit.
        extend: Ends beyond which there are values: ``neither``, ``max`` or ``both``.
    """
    axes.figure.colorbar(
        mesh, cax=axes.inset_axes((1.03, 0.0, 0.03, 1.0)), label=label, extend=extend
    )


def styled(make: Callable[[], _Made]) -> _Made:
    """Return what is made in the style of print."""
    with rc_context(_STYLE):
        return make()


def saved(figure: Figure, ending: str) -> bytes:
    """Return a figure as a file: the same figure gives the same bytes.

    Args:
        figure: The figure.
        ending: One of ``ENDINGS``.
    """
    content, form = BytesIO(), ending.removeprefix(".")
    with rc_context(_STYLE):
        figure.savefig(content, format=form, metadata=_NO_DATES[form])
    return content.getvalue()


# Height of the notes and of the legend below a figure [inches a line], and the letters that fit into an inch.
_LINE, _LETTERS = 0.13, 17.0
# Of the legend: its letters that fit into an inch, as many as are as wide as the mark of an entry and the gap after it, and what is left
# beside it for labels of axes [inches].
_SMALL, _MARK, _BESIDE = 22.0, 9, 0.5
# Layouts of axes of a fixed shape, at most: the shape depends on their size, which depends on the layout.
_LAYOUTS = 5
#: Name of the labels of contours, of which some may be left out.
CONTOUR_LABEL = "contour label"


#: A place: longitude, latitude [degrees] and depth [m].
At = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Chosen:
    """What of a result a figure shows; None leaves the choice to the figure.

    Attributes:
        at: The place of a series, marked on a map, whose depth it states.
        depth: Of a map without a place [m].
        time_ns: Of a map [ns, UTC]: it shows the current published last before it, and nothing later.
    """

    at: At | None = None
    depth: float | None = None
    time_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel of a figure.

    Attributes:
        title: What it shows.
        draw: Draws it into axes.
        height: Over its width.
        shares_legend: Whether its legend is below the figure, once for all such panels.
        above: Between the axes and the title [points].
    """

    title: str
    draw: Callable[[Axes], None]
    height: float = 0.7
    shares_legend: bool = False
    above: float = 6.0

    def draw_into(self, axes: Axes, letter: str = "", legend: bool = True) -> None:
        """Draw into axes, with the title and, if it has entries, a legend."""
        self.draw(axes)
        if legend and axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best")
        axes.set_title(f"{letter}{self.title}", pad=self.above)


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
            0.5,
            0.5,
            fill(why, 34),
            transform=axes.transAxes,
            ha="center",
            va="center",
            color=PRINT["soft"],
        )

    return Panel(title, draw, 0.45)


class ShownFigure(Figure):
    """A figure that a notebook shows without pyplot."""

    def draw(self, renderer: Any) -> None:
        """Draw in the style of print wherever it is drawn: a layout may add ticks, whose labels were larger."""
        styled(partial(super().draw, renderer))

    def _repr_png_(self) -> bytes:
        self.savefig(file := BytesIO(), format="png", dpi=120)
        return file.getvalue()


def compose(contents: Panels, columns: int) -> Figure:
    """Return a figure of panels with letters, their common legend and the notes below them.

    Args:
        contents: The panels.
        columns: 1 or 2, of a page.
    """

    def make() -> Figure:
        width = WIDTHS[columns]
        across = min(contents.across if columns == 2 else 1, len(contents.panels))
        rows = [contents.panels[k : k + across] for k in range(0, len(contents.panels), across)]
        heights = [max(panel.height for panel in row) * width / across for row in rows]
        shares = any(panel.shares_legend for panel in contents.panels)
        figure = ShownFigure(figsize=(width, sum(heights)), layout="constrained")
        grid = figure.add_gridspec(
            len(rows) + shares, across, height_ratios=[*heights, *[_LINE] * shares]
        )
        entries: dict[str, Any] = {}
        for k, panel in enumerate(contents.panels):
            axes = figure.add_subplot(grid[divmod(k, across)])
            letter = f"({chr(ord('a') + k)}) " if len(contents.panels) > 1 else ""
            panel.draw_into(axes, letter, not panel.shares_legend)
            if panel.shares_legend:
                marks, labels = axes.get_legend_handles_labels()
                entries |= dict(zip(labels, marks, strict=True))
        if shares:
            heights.append(_draw_legend(figure.add_subplot(grid[len(rows), :]), entries, width))
        grid.set_height_ratios(heights)
        notes = fill(" ".join(contents.notes), int(_LETTERS * width)) if contents.notes else ""
        if notes:
            figure.supxlabel(notes, fontsize=6.0, color=PRINT["soft"], x=0.01, ha="left")
        figure.set_size_inches(
            width, sum(heights) + (_LINE * (notes.count("\n") + 2) if notes else 0.0)
        )
        if shares:
            _settle(figure)
        return figure

    return styled(make)


def _settle(figure: Figure) -> None:
    """Lay a figure out until its axes stay where they are; of the labels of contours those that lie over another go."""
    before = None
    for _ in range(_LAYOUTS):
        figure.draw_without_rendering()
        places = np.array([axes.get_position().bounds for axes in figure.axes])
        if before is not None and np.abs(places - before).max() < 1e-3:
            break
        before = places
    for axes in figure.axes:
        kept: list[Any] = []
        for text in [text for text in axes.texts if text.get_gid() == CONTOUR_LABEL]:
            box = text.get_window_extent()
            if any(box.overlaps(other) for other in kept):
                text.remove()
            else:
                kept.append(box)


def _draw_legend(axes: Axes, entries: Mapping[str, Any], width: float) -> float:
    """Draw a legend into axes of its own, as wide as a figure [inches], and return its height [inches]."""
    axes.set_axis_off()
    if not entries:
        # a height nevertheless: axes without one are not laid out
        return 0.1 * _LINE
    room = (width - _BESIDE) * _SMALL
    beside = next(
        (n for n in range(len(entries), 1, -1) if _letters_across(list(entries), n) <= room), 1
    )
    axes.legend(
        list(entries.values()),
        list(entries),
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.0,
        ncols=beside,
    )
    return _LINE * -(-len(entries) // beside)


def _letters_across(labels: Sequence[str], columns: int) -> int:
    """Return how many letters wide a legend with so many columns is, as matplotlib fills them."""
    each = np.array_split(np.array([len(label) for label in labels]), columns)
    return int(sum(lengths.max() + _MARK for lengths in each))
