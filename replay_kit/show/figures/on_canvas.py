"""Layers of a map as values for the page's canvas: marks, the frame of degrees around them, what may lie behind them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
import shapely

from replay_kit.core.arrays import Array
from replay_kit.core.colors import scale
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.show.figures.values import Layer, Mark, Tables, Values, values_of
from replay_kit.show.page.section import column

# Most points along the longer side of a map that a screen tells apart.
_POINTS = 1500


def coast_near(projection: Projection, longitude: Array, latitude: Array) -> list[Array]:
    """Return the rings of land in a box, each shape (n, 2) [m], local frame; cut at the box.

    Args:
        projection: The local frame.
        longitude: Least and greatest of the box [degrees], continuous: they may lie beyond 180.
        latitude: Least and greatest [degrees].
    """
    (west, east), (south, north) = longitude, latitude
    least = float(max(east - west, north - south)) / _POINTS
    near = []
    for ring in _rings():
        (left, low), (right, high) = ring.min(axis=0), ring.max(axis=0)
        if high < south or low > north:
            continue
        for turn in (-360.0, 0.0, 360.0):
            if left + turn <= east and right + turn >= west:
                near.append(shapely.Polygon(ring + np.array([turn, 0.0])))
    cut = shapely.clip_by_rect(near, west, south, east, north)
    parts = shapely.get_parts(shapely.simplify(cut, 0.5 * least))
    # what of a ring beside the box is cut to a line has no area
    return [
        np.column_stack(to_local(projection, *part.exterior.coords.xy))
        for part in parts
        if part.area > least**2
    ]


def _rings() -> list[Array]:
    """Return all rings of land, each shape (n, 2), longitude and latitude [degrees]."""
    path = files("replay_kit.show.figures").joinpath("coast.npz")
    with path.open("rb") as file, np.load(file) as kept:
        steps = np.column_stack([kept["east"], kept["north"]]).astype(np.int64)
        each = zip(kept["starts"], np.split(steps, np.cumsum(kept["counts"])[:-1]), strict=True)
        scale, origin = kept["scale"], kept["origin"]
    return [
        origin + scale * np.concatenate([start[None], start + np.cumsum(part, axis=0)])
        for start, part in each
    ]


# Nodes along a side of the table of degrees: between them the script interpolates, within some metres over some hundred kilometres.
_NODES = 33
#: The least width of a map [km]: one position alone has none.
_LEAST = 4.0


@dataclass(frozen=True, slots=True)
class Extent:
    """What a map shows [km], local frame."""

    west: float
    east: float
    south: float
    north: float

    @classmethod
    def around(cls, east: Array, north: Array, beyond: float = 0.03) -> "Extent":
        """Return the extent around points [km], wider than they reach by a share of their longer side."""
        known = np.isfinite(east) & np.isfinite(north)
        ends = [(float(each[known].min()), float(each[known].max())) for each in (east, north)]
        more = beyond * max(most - least for least, most in ends)
        grown = [
            (least - half, most + half)
            for least, most in ends
            for half in [max(more, 0.5 * (_LEAST - (most - least)))]
        ]
        return cls(*(float(f"{end:.5g}") for pair in grown for end in pair))

    @property
    def ends(self) -> list[float]:
        """West, east, south, north."""
        return [self.west, self.east, self.south, self.north]


def marks_of(layers: Iterable[Layer]) -> list[dict[str, Any]]:
    """Return the marks of layers as the page's canvas draws them: places [km], looks, what is said of points, times [ms since 1970]."""
    return [_mark(mark, layer.tables) for layer in layers for mark in layer.marks]


def _mark(mark: Mark, tables: Tables) -> dict[str, Any]:
    look = (
        "kind",
        "name",
        "color",
        "symbol",
        "dash",
        "width",
        "size",
        "edge",
        "halo",
        "shown",
        "label",
    )
    said = {"hover": mark.hover, "text": mark.text, "detail": mark.detail}
    if mark.hover in ("", "skip"):
        said = {"hover": "", "text": None, "detail": None}
    return {
        **{name: getattr(mark, name) for name in look},
        **{name: _column(tables, getattr(mark, name)) for name in ("x", "y")},
        "hover": said["hover"],
        **{name: _column(tables, said[name]) for name in ("text", "detail")},
        "when": None if mark.when is None else _milliseconds(values_of(tables, mark.when)),
    }


def _column(tables: Tables, values: Values | None) -> Any:
    if values is None:
        return None
    array = np.asarray(values_of(tables, values))
    if array.dtype.kind == "M":
        return [str(each)[:16].replace("T", " ") for each in array.astype("datetime64[s]")]
    return column(array, 7) if array.dtype.kind == "f" else array.tolist()


def _milliseconds(times: Any) -> Any:
    """Return times in ms since 1970; one number where all are equal."""
    each = np.asarray(times).astype("datetime64[ms]").astype(np.int64)
    return int(each[0]) if each.size and (each == each[0]).all() else each.tolist()


def frame_of(projection: Projection, extent: Extent) -> dict[str, Any]:
    """Return degrees at nodes of a map, from which the script takes those of all places, and land near it [km].

    Args:
        projection: The local frame.
        extent: Of all that is drawn; the frame reaches half of it farther.
    """
    half = 0.5 * max(extent.east - extent.west, extent.north - extent.south)
    east = np.linspace(extent.west - half, extent.east + half, _NODES)
    north = np.linspace(extent.south - half, extent.north + half, _NODES)
    places = np.meshgrid(1e3 * east, 1e3 * north)
    longitude, latitude = to_geographic(projection, *places)
    longitude = unwrap_longitude(longitude, projection.longitude)
    ends = [np.array([each.min(), each.max()]) for each in (longitude, latitude)]
    # around a pole every longitude is near
    rings = coast_near(projection, *ends) if np.ptp(ends[0]) < 300.0 else []
    return {
        "ends": [float(east[0]), float(east[-1]), float(north[0]), float(north[-1])],
        "nodes": _NODES,
        "longitude": column(longitude, 9),
        "latitude": column(latitude, 9),
        "land": [np.round(ring / 1e3, 2).ravel().tolist() for ring in rings],
    }


def scales_of(limits: tuple[float, float]) -> Mapping[str, Any]:
    """Return the colour scales of a map, by quantity, with the value at their end [m/s].

    Args:
        limits: Of speed and standard error.
    """
    colors = {name: [color for _, color in scale(name)] for name in ("speed", "speed-dark", "amp")}
    return {
        "speed": {"most": limits[0], "light": colors["speed"], "dark": colors["speed-dark"]},
        "error": {"most": limits[1], "light": colors["amp"], "dark": colors["amp"]},
    }
