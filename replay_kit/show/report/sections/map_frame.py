"""What surrounds a map in a local frame: its extent, the coastline of the land mask, meridians and parallels."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.show.page.section import column

#: Steps between lines of longitude or latitude [degrees].
_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
_LINES = 4
#: Arrows along the longer side of a map.
_ARROWS = 24
#: Lines of the hatching along a map's longer side.
_STROKES = 60
#: The least width of a map [km]: one position alone has none.
_LEAST = 2.0


@dataclass(frozen=True, slots=True)
class Extent:
    """What a map shows [km], local frame."""

    west: float
    east: float
    south: float
    north: float

    @classmethod
    def around(cls, east: Array, north: Array) -> "Extent":
        """Return the extent around points [km], a little wider than they reach."""
        ends = []
        for values in (east, north):
            least, most = float(np.nanmin(values)), float(np.nanmax(values))
            beyond = max(0.03 * (most - least), 0.5 * (_LEAST - (most - least)))
            ends += [least - beyond, most + beyond]
        return cls(*(float(f"{end:.5g}") for end in ends))


def map_layout(east: Any, north: Any) -> dict[str, Any]:
    """Return plotly's layout of a map that shows ranges [km] in the local frame."""
    bare = {"constrain": "domain", "showgrid": False, "zeroline": False}
    return {
        "xaxis": {"title": {"text": "local east [km]"}, "range": east, **bare},
        "yaxis": {
            "title": {"text": "local north [km]"},
            "range": north,
            "scaleanchor": "x",
            **bare,
        },
    }


def arrows(
    packed: str,
    axes: tuple[Array, Array],
    length: float,
    first: int | str = 0,
    second: int | str = 0,
) -> dict[str, Any]:
    """Return arrows along a packed current, which the page's script draws; their line is not stated.

    Args:
        packed: Name of the packed array.
        axes: Cell centres in east and in north [m].
        length: Of an arrow, in steps between arrows per m/s.
        first: Index of the array's first axis, or the control that chooses it.
        second: Of its second axis.
    """
    step = -(-max(axis.size for axis in axes) // _ARROWS)
    cell = step * float(min(axis[1] - axis[0] for axis in axes)) / 1e3
    u, v = ({"$field": packed, "at": [first, second, k]} for k in (0, 1))
    x, y = (column(axis / 1e3) for axis in axes)
    shown = {"step": step, "length": length * cell, "showlegend": False}
    return {"type": "arrows", "x": x, "y": y, "u": u, "v": v, **shown}


def hatching(extent: Extent) -> dict[str, Any]:
    """Return diagonal lines behind a map, which are seen where no cell is drawn: that is outside the forecast."""
    width, height = extent.east - extent.west, extent.north - extent.south
    step = max(width, height) / _STROKES
    strokes = []
    for at in np.arange(step, width + height, step):
        # from the left or the upper side to the lower or the right one, inside the map
        x0, y0, x1, y1 = (
            max(at - height, 0.0),
            min(at, height),
            min(at, width),
            max(at - width, 0.0),
        )
        strokes.append(
            f"M{extent.west + x0:.5g},{extent.south + y0:.5g}L{extent.west + x1:.5g},{extent.south + y1:.5g}"
        )
    line = {"color": {"$color": "soft"}, "width": 0.8}
    return {
        "type": "path",
        "path": "".join(strokes),
        "layer": "below",
        "line": line,
        "name": "outside the forecast",
        "showlegend": True,
    }


def graticule(
    projection: Projection, extent: Extent
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return meridians and parallels as one trace of lines in a list, and a trace of their labels.

    Args:
        projection: The local frame.
        extent: What the map shows.
    """
    grid = np.meshgrid(
        np.linspace(extent.west, extent.east, 41) * 1e3,
        np.linspace(extent.south, extent.north, 41) * 1e3,
    )
    longitude, latitude = to_geographic(projection, *grid)
    longitude = unwrap_longitude(longitude, projection.longitude)
    x: list[float | None] = []
    y: list[float | None] = []
    labels: list[tuple[float, float, str, str]] = []
    for values, others, is_meridian in ((longitude, latitude, True), (latitude, longitude, False)):
        along = np.linspace(others.min(), others.max(), 121)
        for value in _between(float(values.min()), float(values.max())):
            places = (
                (np.full_like(along, value), along)
                if is_meridian
                else (along, np.full_like(along, value))
            )
            east, north = (each / 1e3 for each in to_local(projection, *places))
            inside = (
                (east >= extent.west)
                & (east <= extent.east)
                & (north >= extent.south)
                & (north <= extent.north)
            )
            if inside.sum() < 2:
                continue
            x += [*column(np.where(inside, east, np.nan)), None]
            y += [*column(np.where(inside, north, np.nan)), None]
            at = np.flatnonzero(inside)[np.argmin((north if is_meridian else east)[inside])]
            labels.append(
                (
                    float(east[at]),
                    float(north[at]),
                    _degrees(value, "EW" if is_meridian else "NS"),
                    _beside(extent, east[at], north[at]),
                )
            )
    line = {"color": {"$color": "soft"}, "width": 0.6, "dash": "dot"}
    common = {"type": "scatter", "hoverinfo": "skip", "showlegend": False}
    lines = {**common, "mode": "lines", "x": x, "y": y, "line": line}
    text = {
        **common,
        "mode": "text",
        "x": column([label[0] for label in labels]),
        "y": column([label[1] for label in labels]),
        "text": [label[2] for label in labels],
        "textposition": [label[3] for label in labels],
        "textfont": {
            "size": 11,
            "color": "rgba(20,30,40,0.95)",
            "shadow": "0 0 3px white, 0 0 3px white",
        },
    }
    return [lines], text


def _beside(extent: Extent, east: float, north: float) -> str:
    """Return on which side of its point a label stays inside the map."""
    above = north < extent.south + 0.93 * (extent.north - extent.south)
    right = east < extent.west + 0.9 * (extent.east - extent.west)
    return f"{'top' if above else 'bottom'} {'right' if right else 'left'}"


def _between(least: float, most: float) -> list[float]:
    step = next((step for step in _STEPS if (most - least) / step <= _LINES), _STEPS[-1])
    return [
        round(k * step, 6)
        for k in range(int(np.ceil(least / step)), int(np.floor(most / step)) + 1)
    ]


def _degrees(value: float, letters: str) -> str:
    if letters == "EW":
        value = (value + 180.0) % 360.0 - 180.0
    return f"{abs(value):g}° {letters[0] if value >= 0.0 else letters[1]}"
