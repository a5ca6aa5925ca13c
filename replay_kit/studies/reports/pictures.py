"""matplotlib figures to bytes; the same figure gives the same bytes. matplotlib itself is loaded only when something is drawn."""

import io
from collections.abc import Callable
from typing import Any

from replay_kit.studies.reports.tables import Picture

_STYLE: Any = {
    "font.size": 12.0,
    "axes.titlesize": 12.0,
    "figure.dpi": 110.0,
    # ids in an SVG are salted hashes; words stay words, so that they can be searched and read aloud
    "svg.hashsalt": "replay-kit",
    "svg.fonttype": "none",
}


def drawn(picture: Picture) -> bytes:
    """Return a picture as PNG."""
    from matplotlib.figure import Figure

    def make() -> Figure:
        figure = Figure(figsize=picture.size, layout="constrained")
        picture.draw(figure)
        return figure

    return saved(make, "png")["png"]


def saved(make: Callable[[], Any], *endings: str) -> dict[str, bytes]:
    """Return a figure in some formats by their file endings.

    Args:
        make: Makes the figure; called under the style of all studies.
        endings: ``png`` or ``svg``.
    """
    # matplotlib takes half a second to load, and nothing but pictures needs it
    import matplotlib

    contents = {}
    with matplotlib.rc_context(_STYLE):
        figure = make()
        for ending in endings:
            content = io.BytesIO()
            # an SVG states when it was made unless told otherwise
            figure.savefig(content, format=ending, metadata={"Date": None} if ending == "svg" else {})
            contents[ending] = content.getvalue()
    return contents
