"""Where the letters of a figure are as it is drawn: which texts lie over each other, and which leave the figure."""

from itertools import combinations

import pytest
import shapely
from matplotlib.figure import Figure
from matplotlib.text import Text


def complaints(figure: Figure) -> list[str]:
    """Return which texts overlap by more than a square pixel, and which leave the figure by more than a pixel."""
    texts = drawn_texts(figure)
    page = shapely.box(0.0, 0.0, *figure.bbox.size).buffer(1.0)
    over = [
        f"'{a}' lies over '{b}'"
        for (a, one), (b, other) in combinations(texts, 2)
        if one.intersection(other).area > 1.0
    ]
    return over + [f"'{text}' leaves the figure" for text, box in texts if not page.contains(box)]


def drawn_texts(figure: Figure) -> list[tuple[str, shapely.Polygon]]:
    """Return each text that is drawn, with the rectangle around its letters [pixels]."""
    found: list[Text] = []
    with pytest.MonkeyPatch.context() as patch:
        # an axis makes labels that it does not draw
        patch.setattr(
            Text,
            "draw",
            lambda self, renderer, draw=Text.draw: (found.append(self), draw(self, renderer)),
        )
        figure.draw_without_rendering()
    return [
        (text.get_text(), _rectangle(text))
        for text in found
        if text.get_visible() and text.get_text().strip()
    ]


def _rectangle(text: Text) -> shapely.Polygon:
    """Return the rectangle around letters, turned as they are."""
    angle, around = text.get_rotation(), text.get_window_extent()
    text.set_rotation(0.0)
    upright = text.get_window_extent()
    text.set_rotation(angle)
    x, y = 0.5 * (around.x0 + around.x1), 0.5 * (around.y0 + around.y1)
    box = shapely.box(
        x - 0.5 * upright.width,
        y - 0.5 * upright.height,
        x + 0.5 * upright.width,
        y + 0.5 * upright.height,
    )
    return shapely.affinity.rotate(box, angle)


def words(figure: Figure) -> str:
    """Return all text of a figure as one line."""
    texts = [
        text.get_text()
        for axes in figure.axes
        for text in [*axes.texts, axes.title, axes._left_title]
    ]
    return " ".join(" ".join([*texts, notes_of(figure)]).split())


def notes_of(figure: Figure) -> str:
    """Return what is said below a figure, as one line."""
    titles = [legend.get_title().get_text() for legend in figure.legends]
    return " ".join(" ".join([*titles, figure.get_supxlabel()]).split())
