"""How figures look in print: widths of a journal's columns, fonts, files. The colours are those of ``replay_kit/core/colors.py``."""

import io
from collections.abc import Callable
from typing import Any, TypeVar

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from replay_kit.core.colors import scale

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
    content, form = io.BytesIO(), ending.removeprefix(".")
    with rc_context(_STYLE):
        figure.savefig(content, format=form, metadata=_NO_DATES[form])
    return content.getvalue()
