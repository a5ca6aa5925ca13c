"""Where a mission may not go: rings in the local frame, and the half-planes that keep a path clear of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planners.route.region import Region
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection

# Offset of a half-plane that forbids nothing [m].
_FAR = 1e9
# Points whose distances to all edges are computed at once.
_CHUNK = 2048


@dataclass(frozen=True, slots=True)
class NoGo:
    """An area that is not to be entered.

    Attributes:
        polygon: Its corners, longitude and latitude [degrees].
        name: What messages call it.
        surface_only: It may be passed under water.
    """

    polygon: tuple[tuple[float, float], ...]
    name: str
    surface_only: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Bathymetry:
    """Depth of the bottom on a grid.

    Attributes:
        longitude: shape (J, I) [degrees east].
        latitude: shape (J, I) [degrees north].
        depth: shape (J, I) [m], positive down; land is 0 or less, NaN is not known and counts as land.
        clearance: Kept above the bottom [m].
    """

    longitude: Array
    latitude: Array
    depth: Array
    clearance: float = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A closed line that is not to be crossed.

    Attributes:
        corners: shape (n, 2) [m], local east and north, the first not repeated.
        outside: Whether its outside is forbidden instead of its inside.
        name: What it is called in a message.
        surface_only: Whether it only forbids surfacing.
        drawn: Whether it is an area that someone drew, not an edge of the water.
    """

    corners: Array
    outside: bool
    name: str
    surface_only: bool = False
    drawn: bool = False

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return whether points, shape (n, 2) [m], lie within the ring, by the even-odd rule."""
        begin, end = self.corners, np.roll(self.corners, -1, axis=0)
        found = np.zeros(len(points), dtype=bool)
        near = np.flatnonzero(self.from_box(points) == 0.0)
        for part in range(0, len(near), _CHUNK):
            x, y = points[near[part : part + _CHUNK]].T[:, :, None]
            straddles = (begin[:, 1] <= y) != (end[:, 1] <= y)
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = begin[:, 0] + (y - begin[:, 1]) / (end[:, 1] - begin[:, 1]) * (end[:, 0] - begin[:, 0])
            found[near[part : part + _CHUNK]] = np.sum(straddles & (x < crossing), axis=1) % 2 == 1
        return found

    def forbids(self, points: Array) -> NDArray[np.bool_]:
        """Return which points, shape (n, 2) [m], the ring forbids."""
        return np.asarray(self.inside(points) != self.outside)

    def from_box(self, points: Array) -> Array:
        """Return how far points, shape (n, 2) [m], are outside of the box around the ring [m]; 0 inside of it."""
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        return np.asarray(np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1))

    def nearest(self, points: Array) -> Array:
        """Return the nearest point of the ring to each point, shape (n, 2) [m]."""
        edges, found = np.roll(self.corners, -1, axis=0) - self.corners, np.empty((len(points), 2))
        for part in range(0, len(points), _CHUNK):
            here = points[part : part + _CHUNK]
            away = here[:, None] - self.corners
            share = np.clip(np.sum(away * edges, axis=2) / np.maximum(np.sum(edges**2, axis=1), 1e-12), 0.0, 1.0)
            on_edges = self.corners + share[..., None] * edges
            best = np.argmin(np.sum((here[:, None] - on_edges) ** 2, axis=2), axis=1)
            found[part : part + _CHUNK] = on_edges[np.arange(len(here)), best]
        return found

    def clearance(self, points: Array) -> Array:
        """Return the distance from the ring of points, shape (n, 2) [m]: negative where it forbids them."""
        distance = np.linalg.norm(self.nearest(points) - points, axis=1)
        return np.asarray(np.where(self.forbids(points), -distance, distance))


def no_go_ring(projection: Projection, polygon: Sequence[tuple[float, float]], name: str, surface_only: bool = False) -> Ring:
    """Return a polygon of longitudes and latitudes [degrees] as a ring.

    Raises:
        PlanError: It has fewer than three corners, or one is not a number.
    """
    corners = np.array([corner for k, corner in enumerate(polygon) if k == 0 or corner != polygon[0]], dtype=np.float64)
    if corners.ndim != 2 or len(corners) < 3 or not np.all(np.isfinite(corners)):
        raise PlanError(f"{name} has {len(corners)} corners that are numbers; a no-go area needs three pairs of longitude and latitude")
    return Ring(np.column_stack(to_local(projection, corners[:, 0], corners[:, 1])), False, name, surface_only, drawn=True)


def region_rings(region: Region, depth: float) -> tuple[Ring, ...]:
    """Return the outline of the forecast's grid, and the edge of what is dry at a depth [m] as one ring for each dry cell beside water."""
    grid = region.grid
    outline = np.column_stack([_around(grid.east), _around(grid.north)])
    level = int(np.clip(np.searchsorted(grid.levels, depth, side="right") - 1, 0, grid.levels.size - 1))
    edge = Ring(outline, True, "the edge of the region that the forecast covers")
    return (edge, *_cells_beside(grid.east, grid.north, grid.wet[level], "land"))


def _cells_beside(east: Array, north: Array, free: NDArray[np.bool_], name: str) -> tuple[Ring, ...]:
    """Return the cells that are not free and beside one that is, each as a ring."""
    beside = np.zeros_like(free)
    padded = np.pad(free, 1, constant_values=False)
    for j, i in np.ndindex(3, 3):
        beside |= padded[j : j + free.shape[0], i : i + free.shape[1]]
    x, y = _cell_corners(east), _cell_corners(north)
    around = ((0, 0), (0, 1), (1, 1), (1, 0))
    return tuple(
        Ring(np.array([[x[j + a, i + b], y[j + a, i + b]] for a, b in around]), False, name) for j, i in np.argwhere(~free & beside)
    )


def trespassed(rings: Sequence[Ring], points: Array, surfacing: bool) -> tuple[str, int] | None:
    """Return the name of the ring that is trespassed on first and the number of the point; None when none is.

    Args:
        rings: What is forbidden.
        points: shape (n, 2) [m], along the path.
        surfacing: Whether the points are at the surface.
    """
    first = [
        (int(np.argmax(bad)), ring.name) for ring in rings if surfacing or not ring.surface_only if (bad := ring.forbids(points)).any()
    ]
    return min(first)[::-1] if first else None


def half_planes(rings: Sequence[Ring], points: Array, surfacing: NDArray[np.bool_], count: int, margin: float) -> Array:
    """Return half-planes in which each point may move freely, shape (n, count, 3): normal (east, north) and offset [m].

    Each touches, less the margin, the point of a ring that is nearest; those of the nearest rings are taken. A point that is already
    where it may not be gets the half-plane that leads out.

    Args:
        rings: What is forbidden.
        points: shape (n, 2) [m].
        surfacing: shape (n,), whether the point is at the surface.
        count: Half-planes for each point.
        margin: Distance kept [m].
    """
    planes = np.zeros((len(points), len(rings), 3))
    distances = np.full((len(points), len(rings)), np.inf)
    for k, ring in enumerate(rings):
        nearest = ring.nearest(points)
        away = nearest - points
        distance = np.linalg.norm(away, axis=1)
        signed = np.where(ring.forbids(points), -distance, distance)
        normal = away / np.where(distance > 0.0, signed, 1.0)[:, None]
        planes[:, k, :2], planes[:, k, 2] = normal, np.sum(normal * nearest, axis=1) - margin
        counts = (surfacing | (not ring.surface_only)) & (distance > 0.0)
        distances[:, k] = np.where(counts, signed, np.inf)
        planes[~counts, k] = [0.0, 0.0, _FAR]
    order = np.argsort(distances, axis=1, kind="stable")[:, :count]
    chosen = np.take_along_axis(planes, order[..., None], axis=1)
    missing = np.tile([0.0, 0.0, _FAR], (len(points), count - chosen.shape[1], 1))
    return np.concatenate([chosen, missing], axis=1)


def _around(values: Array) -> Array:
    return np.concatenate([values[0, :-1], values[:-1, -1], values[-1, :0:-1], values[:0:-1, 0]])


def _cell_corners(values: Array) -> Array:
    """Return the corners of the cells around the points of a grid: halfway between them, and as far beyond its edge."""
    for axis in (0, 1):
        first = 2.0 * np.take(values, [0], axis) - np.take(values, [1], axis) if values.shape[axis] > 1 else values - 1.0
        last = 2.0 * np.take(values, [-1], axis) - np.take(values, [-2], axis) if values.shape[axis] > 1 else values + 1.0
        longer = np.concatenate([first, values, last], axis)
        values = 0.5 * (np.take(longer, range(longer.shape[axis] - 1), axis) + np.take(longer, range(1, longer.shape[axis]), axis))
    return values


def bathymetry_rings(projection: Projection, longitude: Array, latitude: Array, bottom: Array, needed: float) -> tuple[Ring, ...]:
    """Return the cells of a bathymetry that are shallower than needed [m] and beside one that is not, each as a ring.

    Args:
        projection: The local frame.
        longitude: shape (J, I) [degrees east].
        latitude: shape (J, I) [degrees north].
        bottom: shape (J, I) [m], positive down; NaN counts as land.
        needed: Depth that the vehicle needs [m].

    Raises:
        PlanError: The arrays have different shapes.
    """
    if not longitude.shape == latitude.shape == bottom.shape or bottom.ndim != 2:
        raise PlanError(
            f"a bathymetry has longitudes {longitude.shape}, latitudes {latitude.shape}, depths {bottom.shape}; expected one shape"
        )
    return _cells_beside(
        *to_local(projection, longitude, latitude), np.nan_to_num(bottom, nan=0.0) >= needed, f"shallower than {needed:g} m"
    )


def beyond(places: Any, planes: Any, n_planes: int) -> Any:
    """Return how far each place [km] is beyond each of its half-planes [km]; negative inside."""
    repeated = ca.kron(places, ca.MX.ones(1, n_planes))
    return (ca.sum1(planes[:2, :] * repeated) - planes[2, :] / 1e3).T
