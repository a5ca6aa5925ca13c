"""The coast of a map, for orientation alone: it masks no estimate and bounds no plan.

``coast.npz`` holds the rings of Natural Earth's land at 1:10 million (public domain), of the npm package ``world-atlas`` 2.0.2,
``land-10m.json``: the first point of each ring and its steps, as multiples of ``scale`` from ``origin`` [degrees].
"""

from importlib.resources import files

import numpy as np

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
    wanted = np.array([longitude, latitude], dtype=np.float64)
    least = float(np.ptp(wanted, axis=1).max()) / _POINTS
    found = []
    for ring in _rings():
        low, high = ring.min(axis=0), ring.max(axis=0)
        if high[1] < wanted[1, 0] or low[1] > wanted[1, 1]:
            continue
        for turn in (-360.0, 0.0, 360.0):
            if low[0] + turn > wanted[0, 1] or high[0] + turn < wanted[0, 0]:
                continue
            cut = _cut(ring + np.array([turn, 0.0]), wanted)
            if len(cut) > 2:
                found.append(_thinned(cut, least))
    # what of a ring beside the box is cut to a line has no area
    return [
        np.column_stack(to_local(projection, *ring.T)) for ring in found if _area(ring) > least**2
    ]


def _area(ring: Array) -> float:
    """Return the area within a closed ring, in the square of its unit."""
    x, y = ring.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


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


def _cut(ring: Array, box: Array) -> Array:
    """Return the part of a closed ring inside a box, shape (2, 2), by Sutherland and Hodgman (1974), side by side."""
    for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1)):
        limit, sign = box[axis, side], 1.0 if side == 0 else -1.0
        if len(ring) == 0:
            break
        after = np.roll(ring, -1, axis=0)
        inside, follows = (sign * (points[:, axis] - limit) >= 0.0 for points in (ring, after))
        crosses = inside != follows
        over = np.where(crosses, after[:, axis] - ring[:, axis], 1.0)
        edge = ring + ((limit - ring[:, axis]) / over)[:, None] * (after - ring)
        # each point that is inside, then where the line to the next one crosses
        both = np.stack([ring, edge], axis=1).reshape(-1, 2)
        ring = both[np.stack([inside, crosses], axis=1).reshape(-1)]
    return ring


def _thinned(ring: Array, least: float) -> Array:
    """Return a ring without points nearer to the last one kept than a distance [degrees]."""
    kept, last = [0], ring[0]
    for k, point in enumerate(ring):
        if abs(point[0] - last[0]) + abs(point[1] - last[1]) >= least:
            kept.append(k)
            last = point
    return ring[kept]
