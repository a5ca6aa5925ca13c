"""The coast of a map, for orientation alone: it masks no estimate and bounds no plan.

``coast.npz`` holds the rings of Natural Earth's land at 1:10 million (public domain), of the npm package ``world-atlas`` 2.0.2,
``land-10m.json``: the first point of each ring and its steps, as multiples of ``scale`` from ``origin`` [degrees].
"""

from importlib.resources import files

import numpy as np
import shapely

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection

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
