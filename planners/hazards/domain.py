"""Water of a plan: the wet region of the forecast's grid, and the depth limits of the bottom.

The bottom's limits are the greatest allowed depth by grid cell, shallow cells as rings, and the check of paths.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import NoGo, Ring, joined_rings, no_go_rings
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import border, inside_grid, outline, to_local, wet_above
from replay_kit.core.grid import Grid
from replay_kit.core.plan import Place

#: Depths of dives at most, in those of the deepest level.
BEYOND = 2.0


@dataclass(frozen=True, eq=False)
class Region:
    """Water covered by a grid.

    Attributes:
        grid: Grid.
        limit: Greatest depth of the vehicle [m].
    """

    grid: Grid
    limit: float = inf

    @property
    def known(self) -> float:
        """Greatest depth of a start or goal [m]: the deepest level or the vehicle's limit."""
        return min(float(self.grid.levels[-1]), self.limit)

    @property
    def deepest(self) -> float:
        """Greatest depth of a dive [m]: at most twice the deepest level, with the current extrapolated as constant."""
        return min(BEYOND * float(self.grid.levels[-1]), self.limit)

    def floor(self, depth: float) -> str:
        """Return the description of a greatest depth for messages."""
        if depth == self.limit:
            return f"the vehicle's limit, {depth:g} m"
        twice = "" if depth == self.known else "twice "
        return f"{twice}the deepest level, {self.grid.levels[-1]:g} m"


def widened_mask(mask: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Return a mask, shape (J, I), dilated by a number of rows and columns."""
    # as scipy's maximum_filter, which loads slowly
    for axis in (0, 1):
        around = [(by + 1, by) if axis == side else (0, 0) for side in (0, 1)]
        count = np.cumsum(np.pad(mask, around), axis=axis, dtype=np.int32)
        count = count.swapaxes(0, axis)
        mask = (count[2 * by + 1 :] > count[: -2 * by - 1]).swapaxes(0, axis)
    return mask


def locate(region: Region, place: Place, role: str) -> Array:
    """Return a position in the local frame, shape (3,) [m]: east, north, depth.

    Args:
        region: Region that must contain it.
        place: Position.
        role: Role in the message, ``start`` or ``goal``.

    Raises:
        PlanError: The position is outside the region, above the surface, too deep, or on land.
    """
    where = f"{role} at {place.longitude:.5f}, {place.latitude:.5f}, {place.depth:g} m"
    if not np.all(np.isfinite([place.longitude, place.latitude, place.depth])):
        raise PlanError(f"{where}: expected three finite numbers, longitude, latitude and depth")
    east, north = to_local(region.grid.projection, place.longitude, place.latitude)
    point = np.array([float(east), float(north), place.depth])
    # Checked for finiteness as well: the projection answers infinity for places on the far side of the Earth.
    if not np.all(np.isfinite(point)) or not inside_grid(region.grid, point[0], point[1]):
        raise PlanError(
            f"{where} is outside the forecast's region {_bounds(region.grid)}; "
            + (
                _swapped(region.grid, place)
                or "choose a place inside it or a forecast that covers it"
            )
        )
    if not 0.0 <= place.depth <= region.known:
        raise PlanError(
            f"{where} is not between the surface and {region.floor(region.known)}; choose a depth within them"
        )
    if not wet_above(region.grid, point):
        raise PlanError(
            f"{where} is on land in the forecast: the nearest grid point is dry there; choose a place in water {_bounds(region.grid)}"
        )
    return point


def locate_all(region: Region, start: Place, goals: Sequence[Place]) -> dict[str, Array]:
    """Return the start and the goals in the local frame, shape (3,) [m] each, by role.

    Raises:
        PlanError: One of them is not in the region's water, see ``locate``.
    """
    names = [f"goal {k + 1}" for k in range(len(goals))] if len(goals) > 1 else ["goal"]
    places = zip(["start", *names], [start, *goals], strict=True)
    return {name: locate(region, place, name) for name, place in places}


def _swapped(grid: Grid, place: Place) -> str:
    """Return a hint that longitude and latitude are swapped; empty if the swapped position is outside too."""
    east, north = to_local(grid.projection, place.latitude, place.longitude)
    if (
        abs(place.longitude) > 90.0
        or not np.isfinite([east, north]).all()
        or not inside_grid(grid, float(east), float(north))
    ):
        return ""
    return f"did you mean {place.latitude:g},{place.longitude:g},{place.depth:g}? Longitude is the first number"


def _bounds(grid: Grid) -> str:
    west = grid.longitude.min()
    south = grid.latitude.min()
    east = grid.longitude.max()
    north = grid.latitude.max()
    return f"(west, south, east, north: {west:.3f}, {south:.3f}, {east:.3f}, {north:.3f})"


# Water beside a path whose depth counts where dives turn above the bottom [m].
_BESIDE = 60.0
# Depths are compared to this [m].
DEPTH_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Bathymetry:
    """Bathymetry on a grid.

    Attributes:
        longitude: Longitude, shape (J, I) [degrees east].
        latitude: Latitude, shape (J, I) [degrees north].
        depth: Bottom depth, shape (J, I) [m], positive down; 0 or less, or NaN, for land.
    """

    longitude: Array
    latitude: Array
    depth: Array


@dataclass(frozen=True, slots=True, eq=False)
class DepthCells:
    """Grid cells with their greatest allowed depth.

    Attributes:
        corners: Cell corners, shape (J + 1, I + 1, 2) [m], local east and north.
        limit: Greatest allowed depth, shape (J, I) [m]; infinite without a limit, negative if the surface is forbidden.
        name: Name of too shallow cells in messages; None to state their depth.
    """

    corners: Array
    limit: Array
    name: str | None

    def polygons(self, cells: NDArray[np.intp]) -> Array:
        """Return the corners of cells, shape (n, 4, 2) [m], from rows and columns, shape (n, 2)."""
        around = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
        return np.asarray(self.corners[tuple((cells[:, None] + around).transpose(2, 0, 1))])


# Not slotted: the tree is made when it is first needed.
@dataclass(frozen=True, eq=False)
class Bottom:
    """Depth limits of a path.

    Attributes:
        grids: Cells of the forecast's mask and of the bathymetry, if any.
        clearance: Minimum height above the bathymetry, included in the limits [m].
        edge: Outline of the bathymetry; None if it covers the region.
    """

    grids: tuple[DepthCells, ...]
    clearance: float
    edge: Ring | None = None

    @cached_property
    def _cells(self) -> tuple[Any, Array]:
        """Search tree of all cells with a limit, and the limits [m]."""
        limited = [np.argwhere(np.isfinite(grid.limit) | (grid.limit < 0.0)) for grid in self.grids]
        corners = np.concatenate(
            [grid.polygons(cells) for grid, cells in zip(self.grids, limited, strict=True)]
        )
        limits = np.concatenate(
            [grid.limit[tuple(cells.T)] for grid, cells in zip(self.grids, limited, strict=True)]
        )
        return shapely.STRtree(shapely.polygons(corners)), limits

    @property
    def shallowest(self) -> float:
        """Smallest limit of the cells open at the surface [m]; infinite without any."""
        return min(
            float(np.min(grid.limit, where=grid.limit >= 0.0, initial=np.inf))
            for grid in self.grids
        )

    @property
    def deepest(self) -> float:
        """Greatest allowed depth of all cells [m]."""
        return min(float(np.max(grid.limit)) for grid in self.grids)

    def limit_at(self, points: Array, within: float = 0.0) -> Array:
        """Return the greatest allowed depth, shape (n,) [m], within a distance [m] of points, shape (n, 2) [m]."""
        found, (tree, limits) = np.full(len(points), np.inf), self._cells
        point, cell = tree.query(shapely.points(points), predicate="dwithin", distance=within)
        np.minimum.at(found, point, limits[cell])
        return found

    def limit_beside(self, points: Array, least: float) -> Array:
        """Return the greatest allowed depth around points [m]; at the points only if the surroundings allow less than a depth."""
        beside = self.limit_at(points, _BESIDE)
        close = np.flatnonzero(beside < least)
        beside[close] = self.limit_at(points[close])
        return beside

    def check(self, name: str, point: Array) -> None:
        """Raise PlanError if a point of a path is deeper than allowed.

        Args:
            name: Role in the message, ``start`` or ``goal``.
            point: Local east, north and depth, shape (3,) [m].
        """
        if self.limit_at(point[None, :2])[0] < point[2]:
            raise PlanError(
                f"{name} at {point[2]:g} m is below the bottom less the clearance of {self.clearance:g} m; move it up"
            )

    def is_below(self, segments: Array, depths: Array, skin: Array) -> NDArray[np.bool_]:
        """Return a mask of the segments that exceed the allowed depth, shape (n,).

        Args:
            segments: Ends of the segments, shape (n, 2, 2) [m], local east and north.
            depths: Depths of both ends, shape (n, 2) [m], linear between them.
            skin: Largest deviation of the path from each segment, shape (n,) [m].
        """
        tree, limits = self._cells
        if not np.any(limits < np.max(depths, initial=-np.inf)):
            return np.zeros(len(segments), dtype=bool)
        lines = shapely.linestrings(segments)
        line, cell = tree.query(lines, predicate="dwithin", distance=skin)
        deep = depths.max(axis=1)[line] > limits[cell] + DEPTH_TOLERANCE
        line, cell = line[deep], cell[deep]
        # only the part of the segment that lies over the cell has to be above its bottom
        over = shapely.intersection(lines[line], shapely.buffer(tree.geometries[cell], skin[line]))
        at, pair = shapely.get_coordinates(over, return_index=True)
        begin, way = segments[line[pair], 0], np.diff(segments[line[pair]], axis=1)[:, 0]
        length = np.sum(way**2, axis=1)
        share = np.clip(np.sum((at - begin) * way, axis=1) / np.maximum(length, 1e-12), 0.0, 1.0)
        first, last = depths[line[pair]].T
        # a vertical segment is over the cell with all of its depths
        depth = np.where(length < 1e-6, np.maximum(first, last), first + share * (last - first))
        below = np.zeros(len(segments), dtype=bool)
        below[line[pair][depth > limits[cell[pair]] + DEPTH_TOLERANCE]] = True
        upright = np.sum(np.diff(segments[line], axis=1)[:, 0] ** 2, axis=1) < 1e-6
        below[line[upright]] = True
        return below

    @cached_property
    def _rings(self) -> dict[float, tuple[Ring, ...]]:
        """Cache of the rings by depth."""
        return {}

    def name_at(self, segment: Array) -> str:
        """Return the name of the limit that a too deep segment, shape (2, 2) [m], exceeds: land, or the allowed depth."""
        limit = float(np.min(self.limit_at(np.linspace(segment[0], segment[1], 9), within=1.0)))
        return "land" if limit < 0.0 else f"the bottom, which allows {limit:.0f} m there"

    def rings(self, depth: float) -> tuple[Ring, ...]:
        """Return the rings around water too shallow for a depth [m], from the cells at its edge."""
        if depth not in self._rings:
            self._rings[depth] = self._rings_of(depth)
        return self._rings[depth]

    def _rings_of(self, depth: float) -> tuple[Ring, ...]:
        rings = list[Ring]()
        for grid in self.grids:
            shallow = grid.limit < depth
            cells = np.argwhere(shallow & widened_mask(~shallow, 1))
            name = grid.name or f"shallower than {depth + self.clearance:g} m"
            rings += joined_rings([Ring(corners, False, name) for corners in grid.polygons(cells)])
        return tuple(rings)


def bottom_of(region: Region, bathymetry: Bathymetry | None, clearance: float) -> Bottom:
    """Return the depth limits of paths in a region.

    Without a bathymetry, the deepest wet level above a dry one is the limit. With one, its depths are, and dry levels of the forecast above
    the path. Between points of the bathymetry the shallowest of the four applies.

    Args:
        region: Region of the forecast.
        bathymetry: Bathymetry.
        clearance: Minimum height above it [m].

    Raises:
        PlanError: The bathymetry's arrays differ in shape or are too small, or it lies outside the region.
    """
    grid = region.grid
    count = np.where(grid.wet.all(axis=0), grid.levels.size, np.argmin(grid.wet, axis=0))
    allowed = np.append(grid.levels[1:] if bathymetry is not None else grid.levels[:-1], np.inf)
    around = np.stack([_cell_corners(grid.east), _cell_corners(grid.north)], axis=-1)
    mask = DepthCells(around, np.where(count > 0, allowed[count - 1], -np.inf), "land")
    if bathymetry is None:
        return Bottom((mask,), clearance)
    cells, covered = _cells_of(region, bathymetry, clearance)
    if shapely.covers(shapely.Polygon(covered), shapely.Polygon(outline(grid))):
        return Bottom((mask, cells), clearance)
    return Bottom((mask, cells), clearance, Ring(covered, True, "the edge of the bathymetry"))


def fixed_rings(region: Region, no_go: tuple[NoGo, ...], bottom: Bottom) -> tuple[Ring, ...]:
    """Return the constraints at any depth: no-go areas and the edges of the region and the bathymetry.

    Args:
        region: Region of the forecast.
        no_go: No-go areas.
        bottom: Depth limits of the region.

    Raises:
        PlanError: See ``no_go_rings``.
    """
    edges = (
        Ring(outline(region.grid), True, "the edge of the region that the forecast covers"),
        bottom.edge,
    )
    areas = [ring for area in no_go for ring in no_go_rings(region.grid.projection, area)]
    return (*(edge for edge in edges if edge is not None), *areas)


def _cells_of(region: Region, bathymetry: Bathymetry, clearance: float) -> tuple[DepthCells, Array]:
    """Return the cells of a bathymetry within a region, and the whole outline, shape (n, 2) [m]."""
    longitude, latitude, bottom = bathymetry.longitude, bathymetry.latitude, bathymetry.depth
    if (
        not longitude.shape == latitude.shape == bottom.shape
        or bottom.ndim != 2
        or min(bottom.shape) < 2
    ):
        raise PlanError(
            f"a bathymetry has longitudes {longitude.shape}, latitudes {latitude.shape}, depths {bottom.shape}; expected one shape of "
            "two rows and columns or more"
        )
    points = np.stack(to_local(region.grid.projection, longitude, latitude), axis=-1)
    low, high = region.grid.ends
    inside = widened_mask(np.all((points >= low) & (points <= high), axis=-1), 1)
    # a bathymetry coarser than the region has no point in it, and is kept whole
    rows, columns = (
        (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
        if inside.any()
        else map(np.arange, bottom.shape)
    )
    cut = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    near, depths = points[cut], np.nan_to_num(bottom[cut], nan=-np.inf)
    limit = (
        np.min([depths[:-1, :-1], depths[:-1, 1:], depths[1:, 1:], depths[1:, :-1]], axis=0)
        - clearance
    )
    return DepthCells(near, limit, None), border(points)


def _cell_corners(values: Array) -> Array:
    """Return the cell corners of a grid, halfway between its points and extrapolated at the edges."""
    for axis in (0, 1):
        first = (
            2.0 * np.take(values, [0], axis) - np.take(values, [1], axis)
            if values.shape[axis] > 1
            else values - 1.0
        )
        last = (
            2.0 * np.take(values, [-1], axis) - np.take(values, [-2], axis)
            if values.shape[axis] > 1
            else values + 1.0
        )
        longer = np.concatenate([first, values, last], axis)
        values = 0.5 * (
            np.take(longer, range(longer.shape[axis] - 1), axis)
            + np.take(longer, range(1, longer.shape[axis]), axis)
        )
    return values
