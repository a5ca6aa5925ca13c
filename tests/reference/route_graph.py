"""The quickest path's slow twin: a front that spreads over a fine grid in many directions."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate


def graph_time(
    flow: FlowEstimate,
    depth: float,
    begin: Array,
    end: Array,
    speed: float,
    points: int,
    reach: int,
) -> float:
    """Return when a front of a vehicle's speed [m/s] that starts at ``begin`` (2,) reaches ``end`` (2,) [s]; infinity when it does not.

    The grid is turned so that both places are points of it; an edge leads at most ``reach`` points away along either axis.

    Args:
        flow: The current.
        depth: Where the vehicle stays [m].
        begin: [m].
        end: [m].
        speed: Through water.
        points: Grid intervals between begin and end.
        reach: See above; the error of direction falls with its square.
    """
    unit = (end - begin) / points
    grid = np.arange(-points, 2 * points + 1), np.arange(-points, points + 1)
    i, j = np.meshgrid(*grid, indexing="ij")
    place = begin + i[..., None] * unit + j[..., None] * np.array([-unit[1], unit[0]])
    low, high = (np.array([f(flow.grid.east), f(flow.grid.north)]) for f in (np.min, np.max))
    inside = np.all((place >= low) & (place <= high), axis=-1)
    current = flow.velocity(place[..., 0], place[..., 1], depth)
    number = np.arange(i.size).reshape(i.shape)
    parts = []
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            if np.gcd(a, b) != 1:
                continue
            here = np.s_[max(-a, 0) : i.shape[0] - max(a, 0), max(-b, 0) : i.shape[1] - max(b, 0)]
            there = np.s_[max(a, 0) : i.shape[0] - max(-a, 0), max(b, 0) : i.shape[1] - max(-b, 0)]
            way = a * unit + b * np.array([-unit[1], unit[0]])
            length = np.hypot(*way)
            mean = 0.5 * (current[here] + current[there])
            along, across = (
                mean @ way / length,
                (mean[..., 0] * way[1] - mean[..., 1] * way[0]) / length,
            )
            made_good = along + np.sqrt(np.maximum(speed**2 - across**2, 0.0))
            usable = inside[here] & inside[there] & (made_good > 1e-3) & (np.abs(across) < speed)
            parts.append((length / made_good[usable], number[here][usable], number[there][usable]))
    seconds, first, last = (np.concatenate(values) for values in zip(*parts, strict=True))
    graph = csr_array((seconds, (first, last)), shape=(i.size, i.size))
    return float(dijkstra(graph, indices=number[points, points])[number[2 * points, points]])
