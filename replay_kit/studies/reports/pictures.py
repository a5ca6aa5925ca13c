"""Pictures to PNG and SVG with matplotlib, and what is drawn in them as columns."""

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.studies.reports.tables import Picture

_STYLE: Any = {
    "font.size": 12.0,
    "axes.titlesize": 12.0,
    "figure.dpi": 110.0,
    # ids in an SVG are salted hashes; words stay words, so that they can be searched and read aloud
    "svg.hashsalt": "replay-kit",
    "svg.fonttype": "none",
}
#: Of what is drawn: where, under which name, coordinates along the axes, and what colours or arrows show.
_COLUMNS = ("panel", "series", "x", "y", "z", "value", "u", "v")


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A picture that is drawn.

    Attributes:
        files: The picture by file ending, ``png`` or ``svg``.
        data: Columns of equal length: panel, series, coordinates, values; without rows where only surfaces in 3D are drawn.
    """

    files: Mapping[str, bytes]
    data: Mapping[str, list[Any]]


def drawn(picture: Picture) -> Drawn:
    """Return a picture as PNG."""
    from matplotlib.figure import Figure

    def make() -> Figure:
        figure = Figure(figsize=picture.size, layout="constrained")
        picture.draw(figure)
        return figure

    return saved(make, "png")


def saved(make: Callable[[], Any], *endings: str) -> Drawn:
    """Return a figure in some formats.

    Args:
        make: Makes the figure; called under the style of all studies.
        endings: ``png`` or ``svg``.
    """
    # matplotlib takes half a second to load, and nothing but pictures needs it
    import matplotlib

    files = {}
    with matplotlib.rc_context(_STYLE):
        figure = make()
        for ending in endings:
            content = io.BytesIO()
            # an SVG states when it was made unless asked not to
            figure.savefig(
                content, format=ending, metadata={"Date": None} if ending == "svg" else {}
            )
            files[ending] = content.getvalue()
    # the cells of a colour bar are no data
    rows = [row for axes in figure.axes if axes.get_label() != "<colorbar>" for row in _rows(axes)]
    return Drawn(
        files,
        {
            name: [row[k] for row in rows]
            for k, name in enumerate(_COLUMNS)
            if any(row[k] not in ("", None) for row in rows)
        },
    )


def _rows(axes: Any) -> Iterator[tuple[Any, ...]]:
    """Yield what is drawn in axes, a row a point: lines, markers, cells and arrows."""
    panel = axes.get_title().replace("\n", " ")
    for line in axes.lines:
        label = "" if line.get_label().startswith("_") else line.get_label()
        # those in 3D have a third coordinate
        points = line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data()
        for point in np.column_stack([np.asarray(each, dtype=np.float64) for each in points]):
            yield (panel, label, *_numbers(point), *[None] * (6 - point.size))
    for each in axes.collections:
        label = "" if each.get_label().startswith("_") else each.get_label()
        kind = type(each).__name__
        if kind == "PathCollection":
            for x, y in np.asarray(each.get_offsets()):
                yield (panel, label, *_numbers(np.array([x, y])), None, None, None, None)
        elif kind == "QuadMesh":
            corners = each.get_coordinates()
            centres = (
                corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]
            ).reshape(-1, 2) / 4.0
            values = np.ma.filled(np.ma.masked_invalid(each.get_array()), np.nan).ravel()
            for (x, y), value in zip(
                centres[np.isfinite(values)], values[np.isfinite(values)], strict=True
            ):
                yield (
                    panel,
                    "colours",
                    *_numbers(np.array([x, y])),
                    None,
                    *_numbers(np.array([value])),
                    None,
                    None,
                )
        elif kind == "Quiver":
            for x, y, u, v in np.ma.column_stack([each.X, each.Y, each.U, each.V]).filled(np.nan):
                yield (
                    panel,
                    "arrows",
                    *_numbers(np.array([x, y])),
                    None,
                    None,
                    *_numbers(np.array([u, v])),
                )


def _numbers(values: Array) -> list[float | None]:
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values.tolist()]
