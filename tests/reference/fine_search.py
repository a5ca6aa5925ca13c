"""The front's slow twin: Dijkstra's search of a fine grid, every edge made beforehand, each compared with every obstacle near it."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from replay_kit.core.arrays import Array


def search_time(
    velocity: Callable[[Array], Array],
    speed: float,
    begin: Array,
    end: Array,
    box: Array,
    size: tuple[float, int],
    walls: Sequence[Any],
) -> float:
    """Return when a vehicle that begins at a place, shape (2,) [m], is at another first [s]; infinity when it never is.

    Args:
        velocity: The current [m/s], shape (2, n), at places, shape (n, 2) [m]; it does not change.
        speed: Through water [m/s].
        begin: Where it begins.
        end: Where it goes.
        box: shape (2, 2) [m], least and largest east and north of the grid.
        size: Spacing of the grid [m], and over how many points an edge reaches along either axis.
        walls: Polygons of shapely that no edge may touch.
    """
    spacing, reach = size
    east, north = (np.arange(box[0, axis], box[1, axis] + spacing, spacing) for axis in (0, 1))
    place = np.stack(np.meshgrid(east, north), axis=-1)
    number = np.arange(place[..., 0].size).reshape(place.shape[:2])
    current = velocity(place.reshape(-1, 2)).T.reshape(place.shape)
    first, last, way = [], [], []
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            if np.gcd(a, b) == 1:
                here = np.s_[
                    max(-a, 0) : north.size - max(a, 0), max(-b, 0) : east.size - max(b, 0)
                ]
                there = np.s_[
                    max(a, 0) : north.size - max(-a, 0), max(b, 0) : east.size - max(-b, 0)
                ]
                first.append(number[here].ravel())
                last.append(number[there].ravel())
                way.append(np.tile([b * spacing, a * spacing], (first[-1].size, 1)))
    begins, ends, ways = np.concatenate(first), np.concatenate(last), np.concatenate(way)
    points, water = place.reshape(-1, 2), current.reshape(-1, 2)
    # start and goal are joined to all grid points near them
    for point in (begin, end):
        near = np.flatnonzero(np.hypot(*(points - point).T) < reach * spacing)
        points, water = np.vstack([points, point]), np.vstack([water, velocity(point[None]).T])
        own = np.full(near.size, len(points) - 1)
        begins, ends = np.concatenate([begins, own, near]), np.concatenate([ends, near, own])
        ways = np.vstack([ways, points[near] - point, point - points[near]])
    length, mean = np.hypot(*ways.T), 0.5 * (water[begins] + water[ends])
    along = np.sum(mean * ways, axis=1) / length
    across = (mean[:, 0] * ways[:, 1] - mean[:, 1] * ways[:, 0]) / length
    made_good = along + np.sqrt(np.maximum(speed**2 - across**2, 0.0))
    usable = (made_good > 1e-3) & (np.abs(across) < speed)
    if walls:
        tree = shapely.STRtree(walls)
        close = np.zeros(len(points), dtype=bool)
        close[
            tree.query(shapely.points(points), predicate="dwithin", distance=1.5 * reach * spacing)[
                0
            ]
        ] = True
        asked = np.flatnonzero(usable & close[begins])
        lines = shapely.linestrings(np.stack([points[begins[asked]], points[ends[asked]]], axis=1))
        usable[asked[np.unique(tree.query(lines, predicate="intersects")[0])]] = False
    graph = csr_array(
        (length[usable] / made_good[usable], (begins[usable], ends[usable])),
        shape=(len(points),) * 2,
    )
    return float(dijkstra(graph, indices=len(points) - 2)[len(points) - 1])
