"""The bottom: how deep a vehicle may go in each cell of a grid, shallow cells as rings, and where a path goes too deep."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import NoGo, Ring, joined, no_go_rings
from planners.hazards.domain import Region, widened
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import outline, to_local

# Water beside a path whose depth counts where dives turn above the bottom [m].
_BESIDE = 60.0
# Depths are compared to this [m].
DEPTH_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Bathymetry:
    """Bottom depth on a grid.

    Attributes:
        longitude: shape (J, I) [degrees east].
        latitude: shape (J, I) [degrees north].
        depth: shape (J, I) [m], positive down; land is 0 or less, NaN (unknown) counts as land.
        lowest_water: Least and greatest of the water levels that the depths allow for [m]; None where they allow for none.
    """

    longitude: Array
    latitude: Array
    depth: Array
    lowest_water: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DepthCells:
    """Cells of a grid, each with the greatest depth allowed in it.

    Attributes:
        corners: shape (J + 1, I + 1, 2) [m], local east and north.
        limit: shape (J, I) [m]; infinite without a limit, below 0 where not even the surface is allowed.
        name: Of a cell that is too shallow, in messages; None for how shallow it is.
    """

    corners: Array
    limit: Array
    name: str | None

    def polygons(self, cells: NDArray[np.intp]) -> Array:
        """Return the corners, shape (n, 4, 2) [m], of cells given by row and column, shape (n, 2)."""
        around = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
        return np.asarray(self.corners[tuple((cells[:, None] + around).transpose(2, 0, 1))])


# Not slotted: the tree is made when it is first needed.
@dataclass(frozen=True, eq=False)
class Bottom:
    """What limits the depth of a path.

    Attributes:
        grids: Those of the forecast's mask and, where there is one, of the bathymetry.
        clearance: Least height above the bottom of the bathymetry, which its limits allow for [m].
        edge: What the bathymetry covers, when that is not all of the region.
    """

    grids: tuple[DepthCells, ...]
    clearance: float
    edge: Ring | None = None

    @cached_property
    def _cells(self) -> tuple[Any, Array]:
        """The polygons of all cells with a limit, in a tree, and their limits [m]."""
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
        """Least limit of a cell where a path may be at the surface [m]; infinite without any."""
        return min(
            float(np.min(grid.limit, where=grid.limit >= 0.0, initial=np.inf))
            for grid in self.grids
        )

    @property
    def deepest(self) -> float:
        """Greatest depth that is allowed anywhere [m]."""
        return min(float(np.max(grid.limit)) for grid in self.grids)

    def limit_at(self, points: Array, within: float = 0.0) -> Array:
        """Return the greatest depth allowed [m], shape (n,), at points, shape (n, 2) [m], and within a distance [m] of them."""
        found, (tree, limits) = np.full(len(points), np.inf), self._cells
        point, cell = tree.query(shapely.points(points), predicate="dwithin", distance=within)
        np.minimum.at(found, point, limits[cell])
        return found

    def limit_beside(self, points: Array, least: float) -> Array:
        """Return the greatest depth allowed at points and some way beside them [m]; at them alone where that is less than a depth."""
        beside = self.limit_at(points, _BESIDE)
        close = np.flatnonzero(beside < least)
        beside[close] = self.limit_at(points[close])
        return beside

    def check(self, name: str, point: Array) -> None:
        """Raise PlanError when a point, shape (3,) [m], of a path is deeper than allowed.

        Args:
            name: What it is called in the error: ``start`` or ``goal``.
            point: Local east, north, depth.
        """
        if self.limit_at(point[None, :2])[0] < point[2]:
            raise PlanError(
                f"{name} at {point[2]:g} m is below the bottom less the clearance of {self.clearance:g} m; move it up"
            )

    def is_below(self, segments: Array, depths: Array, skin: Array) -> NDArray[np.bool_]:
        """Return which segments of paths are deeper than allowed somewhere, shape (n,).

        Args:
            segments: shape (n, 2, 2) [m], local east and north of both ends.
            depths: shape (n, 2) [m], of both ends; between them the depth is linear.
            skin: shape (n,) [m], how far from a segment the path may bend.
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
        """The rings of the depths asked for: their geometries are made once."""
        return {}

    def name_at(self, segment: Array) -> str:
        """Return what lies below a segment, shape (2, 2) [m], that is too deep: land, or how deep a vehicle may be there."""
        limit = float(np.min(self.limit_at(np.linspace(segment[0], segment[1], 9), within=1.0)))
        return "land" if limit < 0.0 else f"the bottom, which allows {limit:.0f} m there"

    def rings(self, depth: float) -> tuple[Ring, ...]:
        """Return the cells that are too shallow for a depth [m] and beside one that is not, as few rings."""
        if depth not in self._rings:
            self._rings[depth] = self._rings_of(depth)
        return self._rings[depth]

    def _rings_of(self, depth: float) -> tuple[Ring, ...]:
        rings = list[Ring]()
        for grid in self.grids:
            shallow = grid.limit < depth
            cells = np.argwhere(shallow & widened(~shallow, 1))
            name = grid.name or f"shallower than {depth + self.clearance:g} m"
            rings += joined([Ring(corners, False, name) for corners in grid.polygons(cells)])
        return tuple(rings)


def bottom_of(region: Region, bathymetry: Bathymetry | None, clearance: float) -> Bottom:
    """Return what limits the depth of paths in a region.

    Without a bathymetry the last level that is wet below a dry one limits it. With one, its depths do, and the forecast only where a level
    above the path is dry. Between points of the bathymetry the shallowest of four holds.

    Args:
        region: The water of the forecast.
        bathymetry: Bottom depth.
        clearance: Least height above it [m].

    Raises:
        PlanError: The bathymetry's shapes differ, are too small, or it lies outside.
    """
    grid = region.grid
    count = np.where(grid.wet.all(axis=0), grid.levels.size, np.argmin(grid.wet, axis=0))
    allowed = np.append(grid.levels[1:] if bathymetry is not None else grid.levels[:-1], np.inf)
    around = np.stack([_cell_corners(grid.east), _cell_corners(grid.north)], axis=-1)
    mask = DepthCells(around, np.where(count > 0, allowed[count - 1], -np.inf), "land")
    if bathymetry is None:
        return Bottom((mask,), clearance)
    cells, covered = _cells_of(region, bathymetry, clearance)
    edge = (
        None
        if shapely.covers(shapely.Polygon(covered), shapely.Polygon(outline(grid)))
        else covered
    )
    return Bottom(
        (mask, cells),
        clearance,
        None if edge is None else Ring(edge, True, "the edge of the bathymetry"),
    )


def fixed_rings(region: Region, no_go: tuple[NoGo, ...], bottom: Bottom) -> tuple[Ring, ...]:
    """Return what holds at any depth: the edge of the region and, where it ends before, of the bathymetry; and the no-go areas.

    Args:
        region: The water of the forecast.
        no_go: Areas that must not be entered.
        bottom: Of the region.

    Raises:
        PlanError: As for ``no_go_rings``.
    """
    edges = (
        Ring(outline(region.grid), True, "the edge of the region that the forecast covers"),
        bottom.edge,
    )
    areas = [ring for area in no_go for ring in no_go_rings(region.grid.projection, area)]
    return (*(edge for edge in edges if edge is not None), *areas)


def _cells_of(region: Region, bathymetry: Bathymetry, clearance: float) -> tuple[DepthCells, Array]:
    """Return the cells of a bathymetry that lie in a region, and the outline of all of it, shape (n, 2) [m]."""
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
    low, high = (
        np.array([pick(region.grid.east), pick(region.grid.north)]) for pick in (np.min, np.max)
    )
    inside = widened(np.all((points >= low) & (points <= high), axis=-1), 1)
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
    edges = points[0, :-1], points[:-1, -1], points[-1, :0:-1], points[:0:-1, 0]
    return DepthCells(near, limit, None), np.concatenate(edges)


def _cell_corners(values: Array) -> Array:
    """Return the corners of the cells around the points of a grid: halfway between them, and as far beyond its edge."""
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
