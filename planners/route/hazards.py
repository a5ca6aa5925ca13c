"""Where a path may not go: rings in the local frame, half-planes that keep a path clear of them, the check of a path against them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from planners.route.region import Region
from planners.solver import KM
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import outline, to_local
from replay_kit.core.grid import Projection

# Offset of a half-plane that forbids nothing [m].
_FAR = 1e9
# Largest distance between the points of a path that are checked [m].
SPACING = 10.0


@dataclass(frozen=True, slots=True)
class NoGo:
    """An area that must not be entered.

    Attributes:
        polygon: Its corners, longitude and latitude [degrees].
        name: Its name in messages.
        surface_only: Whether only surfacing is forbidden in it; it may be passed under water.
    """

    polygon: tuple[tuple[float, float], ...]
    name: str
    surface_only: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Bathymetry:
    """Bottom depth on a grid.

    Attributes:
        longitude: shape (J, I) [degrees east].
        latitude: shape (J, I) [degrees north].
        depth: shape (J, I) [m], positive down; land is 0 or less, NaN (unknown) counts as land.
        clearance: Least height above the bottom [m].
    """

    longitude: Array
    latitude: Array
    depth: Array
    clearance: float = 20.0


# Not slotted: the geometries are made when they are first needed.
@dataclass(frozen=True, eq=False)
class Ring:
    """A closed line that must not be crossed.

    Attributes:
        corners: shape (n, 2) [m], local east and north, the first not repeated.
        outside: Whether its outside is forbidden instead of its inside.
        name: Its name in messages.
        surface_only: Whether it only forbids surfacing.
        drawn: Whether it is a no-go area, not an edge of the water.
    """

    corners: Array
    outside: bool
    name: str
    surface_only: bool = False
    drawn: bool = False

    @cached_property
    def _area(self) -> Any:
        # a ring that crosses itself encloses what the even-odd rule gives
        area = shapely.make_valid(shapely.Polygon(self.corners))
        shapely.prepare(area)
        return area

    @cached_property
    def _line(self) -> Any:
        line = shapely.LinearRing(self.corners)
        shapely.prepare(line)
        return line

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return whether points, shape (n, 2) [m], lie within the ring, by the even-odd rule."""
        return np.asarray(shapely.contains_xy(self._area, *points.T))

    def forbids(self, points: Array) -> NDArray[np.bool_]:
        """Return which points, shape (n, 2) [m], the ring forbids."""
        return np.asarray(self.inside(points) != self.outside)

    def is_near(self, points: Array, distance: float) -> NDArray[np.bool_]:
        """Return which points, shape (n, 2) [m], the ring forbids or are no farther than a distance [m] from it."""
        return np.asarray(self.forbids(points) | shapely.dwithin(self._line, shapely.points(points), distance))

    def nearest(self, points: Array) -> Array:
        """Return the nearest point of the ring to each point, shape (n, 2) [m]."""
        lines = shapely.shortest_line(shapely.points(points), self._line)
        return np.asarray(shapely.get_coordinates(lines)[1::2], dtype=np.float64)

    def clearance(self, points: Array) -> Array:
        """Return the distance of points, shape (n, 2) [m], from the ring [m]: negative where it forbids them."""
        distance = shapely.distance(self._line, shapely.points(points))
        return np.asarray(np.where(self.forbids(points), -distance, distance))


def hazard_rings(region: Region, depth: float, no_go: Sequence[NoGo] = (), bathymetry: Bathymetry | None = None) -> tuple[Ring, ...]:
    """Return all that a vehicle at a depth must keep clear of: the edge of the region first, then land, no-go areas and shallows.

    Land and shallows are one ring for each grid cell beside water.

    Args:
        region: The water of the forecast.
        depth: Deepest of the path [m].
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth, beside the forecast's land.

    Raises:
        PlanError: An area has fewer than three corners or one that is not a number, or the arrays of the bathymetry differ in shape.
    """
    grid = region.grid
    edge = Ring(outline(grid), True, "the edge of the region that the forecast covers")
    level = int(region.level_at(np.array([depth]))[0])
    rings = (edge, *_cells_beside(grid.east, grid.north, grid.wet[level], "land"), *(no_go_ring(grid.projection, area) for area in no_go))
    return rings if bathymetry is None else (*rings, *_shallows(region, bathymetry, depth + bathymetry.clearance))


def no_go_ring(projection: Projection, area: NoGo) -> Ring:
    """Return an area as a ring in the local frame.

    Raises:
        PlanError: It has fewer than three corners, or one is not a number.
    """
    corners = np.array([corner for k, corner in enumerate(area.polygon) if k == 0 or corner != area.polygon[0]], dtype=np.float64)
    if corners.ndim != 2 or len(corners) < 3 or not np.all(np.isfinite(corners)):
        raise PlanError(
            f"{area.name} has {len(corners)} corners that are numbers; a no-go area needs three pairs of longitude and latitude"
        )
    local = np.column_stack(to_local(projection, corners[:, 0], corners[:, 1]))
    return Ring(local, False, area.name, area.surface_only, drawn=True)


def _shallows(region: Region, bathymetry: Bathymetry, needed: float) -> tuple[Ring, ...]:
    """Return the cells of a bathymetry that are shallower than needed [m] and beside one that is not."""
    longitude, latitude, bottom = bathymetry.longitude, bathymetry.latitude, bathymetry.depth
    if not longitude.shape == latitude.shape == bottom.shape or bottom.ndim != 2:
        raise PlanError(
            f"a bathymetry has longitudes {longitude.shape}, latitudes {latitude.shape}, depths {bottom.shape}; expected one shape"
        )
    east, north = to_local(region.grid.projection, longitude, latitude)
    return _cells_beside(east, north, np.nan_to_num(bottom, nan=0.0) >= needed, f"shallower than {needed:g} m")


def _cells_beside(east: Array, north: Array, free: NDArray[np.bool_], name: str) -> tuple[Ring, ...]:
    """Return the cells that are not free and beside one that is, each as a ring."""
    corners = np.stack([_cell_corners(east), _cell_corners(north)], axis=-1)
    around = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    cells = np.argwhere(~free & maximum_filter(free, size=3, mode="constant"))
    return tuple(Ring(corners[tuple((cell + around).T)], False, name) for cell in cells)


def _cell_corners(values: Array) -> Array:
    """Return the corners of the cells around the points of a grid: halfway between them, and as far beyond its edge."""
    for axis in (0, 1):
        first = 2.0 * np.take(values, [0], axis) - np.take(values, [1], axis) if values.shape[axis] > 1 else values - 1.0
        last = 2.0 * np.take(values, [-1], axis) - np.take(values, [-2], axis) if values.shape[axis] > 1 else values + 1.0
        longer = np.concatenate([first, values, last], axis)
        values = 0.5 * (np.take(longer, range(longer.shape[axis] - 1), axis) + np.take(longer, range(1, longer.shape[axis]), axis))
    return values


def first_violation(rings: Sequence[Ring], points: Array, surfacing: bool) -> tuple[str, int] | None:
    """Return the name of the ring that forbids a point of a path first and the number of the point; None when none is forbidden.

    Args:
        rings: What is forbidden.
        points: shape (n, 2) [m], along the path.
        surfacing: Whether the points are at the surface.
    """
    first = [
        (int(np.argmax(bad)), ring.name) for ring in rings if surfacing or not ring.surface_only if (bad := ring.forbids(points)).any()
    ]
    return min(first)[::-1] if first else None


def densified(track: Array) -> tuple[Array, Array]:
    """Return a track with points between its own, no farther apart than ten metres, and which of its own points each is or follows.

    Args:
        track: shape (n, 3) [m].

    Returns:
        Numbers, shape (m,), fractional between two points of the track; points, shape (m, 3) [m].
    """
    pieces = np.maximum(np.ceil(np.linalg.norm(np.diff(track, axis=0), axis=1) / SPACING).astype(int), 1)
    number = np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(pieces))])
    return number, np.column_stack([np.interp(number, np.arange(len(track)), axis) for axis in track.T])


def half_planes(rings: Sequence[Ring], points: Array, surfacing: NDArray[np.bool_], count: int, margin: float) -> Array:
    """Return half-planes in which each point may move freely, shape (n, count, 3): normal (east, north) and offset [m].

    Each touches, less the margin, the point of a ring that is nearest; those of the nearest rings are taken. A forbidden point gets the
    half-plane that leads out.

    Args:
        rings: What is forbidden.
        points: shape (n, 2) [m].
        surfacing: shape (n,), whether the point is at the surface.
        count: Half-planes for each point.
        margin: Distance kept [m].
    """
    # the last ones forbid nothing: they fill up where there are fewer rings than planes
    planes = np.tile([0.0, 0.0, _FAR], (len(points), len(rings) + count, 1))
    distances = np.full(planes.shape[:2], np.inf)
    for k, ring in enumerate(rings):
        nearest, signed = ring.nearest(points), ring.clearance(points)
        counts = (surfacing | (not ring.surface_only)) & (signed != 0.0)
        normal = (nearest - points)[counts] / signed[counts, None]
        planes[counts, k] = np.column_stack([normal, np.sum(normal * nearest[counts], axis=1) - margin])
        distances[counts, k] = signed[counts]
    order = np.argsort(distances, axis=1, kind="stable")[:, :count]
    return np.take_along_axis(planes, order[..., None], axis=1)


def plane_violations(places: Any, planes: Any, n_planes: int) -> Any:
    """Return how far each place [km], a CasADi expression, is beyond each of its half-planes [km]; negative inside."""
    repeated = ca.kron(places, ca.MX.ones(1, n_planes))
    return (ca.sum1(planes[:2, :] * repeated) - planes[2, :] / KM).T
