"""The quickest route through the mean current of the dives, by a search of a graph over the region.

Each edge costs its length over the speed made good along it (Zermelo: the vehicle heads off the current across the edge). The graph is
fine enough to find the way round land and eddies; the optimiser refines the route.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planners.route.hazards import Ring
from planners.route.table import FlowTable
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError

# Points along the longer side of the graph, and how many points an edge may reach over.
_POINTS, _REACH = 96, 3
# Edges along which the vehicle makes good less than this are left out [m/s].
_SLOWEST = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A route through the graph.

    Attributes:
        points: shape (n, 2) [m], local east and north.
        times: shape (n,) [s], earliest arrival at each.
        arrives: Whether it ends at its goal; otherwise at the point nearest to it that can be reached.
    """

    points: Array
    times: Array
    arrives: bool

    def at(self, times: Array) -> Array:
        """Return the points, shape (m, 2) [m], of times [s]."""
        return np.column_stack([np.interp(times, self.times, self.points[:, i]) for i in (0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class RouteGraph:
    """The graph of one mission: edges between grid points, with their travel times.

    Attributes:
        origin: shape (2,) [m].
        spacing: shape (2,) [m].
        current: shape (2, n_north, n_east) [m/s].
        free: shape (n_north, n_east), whether a path may be there.
        seconds: Travel time of each edge between two points, (n, n).
    """

    origin: Array
    spacing: Array
    current: Array
    free: NDArray[np.bool_]
    seconds: csr_array

    def current_at(self, points: Array) -> Array:
        """Return the mean current, shape (n, 2) [m/s], at points, shape (n, 2) [m]."""
        column, row = ((points - self.origin) / self.spacing).T
        return np.column_stack([map_coordinates(c, [row, column], order=1, mode="nearest") for c in self.current])

    def route(self, start: Array, goal: Array, longest: float) -> Route:
        """Return the quickest route between two points, shape (2,) [m].

        Args:
            start: Where it begins.
            goal: Where it should end.
            longest: Time after which points count as out of reach [s].
        """
        shape = self.free.shape
        nodes = np.array([self._nearest_free(start), self._nearest_free(goal)])
        seconds, before = dijkstra(self.seconds, indices=nodes[0], return_predecessors=True, limit=longest)
        last = int(nodes[1])
        arrives = bool(np.isfinite(seconds[last]))
        if not arrives:
            row, column = np.divmod(np.arange(seconds.size), shape[1])
            away = np.hypot(*(self.origin + np.column_stack([column, row]) * self.spacing - goal).T)
            last = int(np.argmin(np.where(np.isfinite(seconds), away, np.inf)))
        chain = [last]
        while chain[-1] != nodes[0]:
            chain.append(int(before[chain[-1]]))
        row, column = np.divmod(np.array(chain[::-1]), shape[1])
        points = self.origin + np.column_stack([column, row]) * self.spacing
        times = seconds[chain[::-1]]
        points[0] = start
        if arrives:
            points[-1] = goal
        if len(points) == 1:
            return Route(np.vstack([start, goal if arrives else start]), np.array([0.0, 1.0]), arrives)
        return Route(points, times, arrives)

    def _nearest_free(self, point: Array) -> int:
        rows, columns = np.nonzero(self.free)
        places = self.origin + np.column_stack([columns, rows]) * self.spacing
        best = int(np.argmin(np.sum((places - point) ** 2, axis=1)))
        return int(rows[best] * self.free.shape[1] + columns[best])


def build_route_graph(
    table: FlowTable, depth_shares: Array, rings: Sequence[Ring], wet: Callable[[Array], NDArray[np.bool_]], speed: float
) -> RouteGraph:
    """Return the graph of a flow.

    Args:
        table: The flow on a coarse grid.
        depth_shares: shape (D,), the share of its time that the vehicle spends at each depth of the table.
        rings: What is forbidden.
        wet: Returns which points, shape (n, 2) [m], are water deep enough.
        speed: Horizontal, through water [m/s].

    Raises:
        PlanError: No point of the graph is free.
    """
    coarse = np.tensordot(table.velocity, depth_shares, axes=(1, 0))
    extent = table.spacing * (np.array(coarse.shape[:0:-1]) - 1)
    size = np.maximum(np.ceil(extent / extent.max() * _POINTS).astype(int) + 1, 2)
    spacing = extent / (size - 1)
    row, column = np.meshgrid(np.arange(size[1]) * spacing[1], np.arange(size[0]) * spacing[0], indexing="ij")
    at = [row / table.spacing[1], column / table.spacing[0]]
    current = np.stack([map_coordinates(component, at, order=1, mode="nearest") for component in coarse])
    points = np.column_stack([column.ravel(), row.ravel()]) + table.origin
    areas = shapely.STRtree([ring.area for ring in rings if not ring.surface_only and not ring.outside])
    free = wet(points) & np.all([ring.inside(points) for ring in rings if ring.outside], axis=0)
    free[areas.query(shapely.points(points), predicate="intersects")[0]] = False
    free = free.reshape(row.shape)
    if not free.any():
        wide = float(np.max(spacing))
        raise PlanError(
            f"land, shallows and no-go areas leave no water that a search on {wide:.0f} m finds; allow a wider path, or dive less deep"
        )
    # only edges from points near an area can cross it
    near = np.full(free.size, False)
    near[areas.query(shapely.points(points), predicate="dwithin", distance=_REACH * float(np.linalg.norm(spacing)))[0]] = True

    def crosses(begin: NDArray[np.intp], end: NDArray[np.intp]) -> NDArray[np.bool_]:
        crossed = near[begin]
        lines = shapely.linestrings(np.stack([points[begin[crossed]], points[end[crossed]]], axis=1))
        crossed[crossed] = np.isin(np.arange(len(lines)), areas.query(lines, predicate="intersects")[0])
        return crossed

    return RouteGraph(table.origin, spacing, current, free, _edges(current, free, spacing, speed, crosses))


def _edges(
    current: Array,
    free: NDArray[np.bool_],
    spacing: Array,
    speed: float,
    crosses: Callable[[NDArray[np.intp], NDArray[np.intp]], NDArray[np.bool_]],
) -> csr_array:
    """Return the travel times [s] of the edges between free points that cross no area."""
    rows, columns = free.shape
    index = np.arange(free.size).reshape(free.shape)
    parts = []
    for up, right in ((j, i) for j in range(-_REACH, _REACH + 1) for i in range(-_REACH, _REACH + 1)):
        if np.gcd(up, right) != 1:
            continue
        here = np.s_[max(-up, 0) : rows - max(up, 0), max(-right, 0) : columns - max(right, 0)]
        there = np.s_[max(up, 0) : rows - max(-up, 0), max(right, 0) : columns - max(-right, 0)]
        way = np.array([right, up]) * spacing
        length = float(np.linalg.norm(way))
        mean = 0.5 * (current[(slice(None), *here)] + current[(slice(None), *there)])
        along = (mean[0] * way[0] + mean[1] * way[1]) / length
        across = (mean[1] * way[0] - mean[0] * way[1]) / length
        made_good = along + np.sqrt(np.maximum(speed**2 - across**2, 0.0))
        usable = (made_good > _SLOWEST) & (np.abs(across) < speed) & free[here] & free[there]
        begin, end = index[here][usable], index[there][usable]
        clear = ~crosses(begin, end)
        parts.append((length / made_good[usable][clear], begin[clear], end[clear]))
    seconds, begin, end = (np.concatenate(values) for values in zip(*parts, strict=True))
    return csr_array((seconds, (begin, end)), shape=(free.size, free.size))
