"""Small map of a status, as SVG."""

from collections.abc import Mapping, Sequence

import numpy as np

from replay_kit.core.colors import SYMBOLS
from replay_kit.show.figures.draw import panels_svg
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel

Points = Sequence[tuple[float, float]]
# Of the way only some fixes are known here.
_LOOKS = {
    "ellipse": ("ring", SYMBOLS["plan"][0], "circle", "solid", 6.0),
    "track": ("line", SYMBOLS["track"][0], "circle", "dot", 6.0),
    "plan": ("joined", SYMBOLS["plan"][0], "circle", "solid", 5.0),
    "goal": ("points", *SYMBOLS["goal"], "solid", 18.0),
    "vehicle": ("points", *SYMBOLS["vehicle"], "solid", 11.0),
}


def small_map(places: Mapping[str, Points]) -> str:
    """Return a map of track, plan, goal and the ellipse of the next surfacing; empty with fewer than two points.

    Args:
        places: Points (east, north) [m] of ``track``, ``plan``, ``goal`` and ``ellipse``, if known.
    """
    every = np.array([point for points in places.values() for point in points]) / 1e3
    if len(np.unique(every, axis=0)) < 2:
        return ""
    vehicle = list(places.get("track", ())[-1:])
    drawn = {**places, "plan": [*vehicle, *places.get("plan", ())], "vehicle": vehicle}
    marks = []
    for name, (kind, color, symbol, dash, size) in _LOOKS.items():
        if drawn.get(name):
            x, y = np.array(drawn[name]).T / 1e3
            marks.append(Mark(kind, x, y, name, color, symbol, dash, size=size))  # type: ignore[arg-type]
    least, most = every.min(axis=0), every.max(axis=0)
    shape = np.array([1.5, 1.0])
    half = 0.6 * shape * max(((most - least) / shape).max(), 0.1)
    ends = [*zip(*(0.5 * (least + most) + side * half for side in (-1.0, 1.0)), strict=True)]
    axes = Axis("east", "km", ends[0]), Axis("north", "km", ends[1])
    (svg, _), *_ = panels_svg(Figure("small", "", [Panel("", *axes, marks, 1.0 / 1.5)]), 320.0)
    wide, high = most - least
    what = f"Map, north up, {wide:.0f} by {high:.0f} km: {', '.join(places)}"
    return f'<div class="map" role="img" aria-label="{what}">{svg}</div>'
