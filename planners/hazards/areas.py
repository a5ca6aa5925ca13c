"""No-go areas as rings in the local frame, and their intersection with a path."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import ellipsoid, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Area

# Width of the frame around what must not be left [m].
_FRAME = 1e5
# Largest distance between the corners of an area's edges [m]: on it a parallel of latitude is straight to a few centimetres.
_EDGE = 1000.0


@dataclass(frozen=True, slots=True)
class NoGo:
    """No-go area, or fence to stay inside.

    Attributes:
        polygon: Corners, longitude and latitude [degrees].
        name: Name in messages.
        surface_only: Whether only surfacing is forbidden.
        holes: Corners of holes, which are exempt.
        fence: Whether the vehicle must stay inside, and out of the holes.
        begin_ns: Begin of validity [ns, UTC]; None for always.
        end_ns: End of validity [ns, UTC]; None for always.
    """

    polygon: tuple[tuple[float, float], ...]
    name: str
    surface_only: bool = False
    holes: tuple[tuple[tuple[float, float], ...], ...] = ()
    fence: bool = False
    begin_ns: int | None = None
    end_ns: int | None = None

    @property
    def area(self) -> Area:
        """Area as stored in results, its first corner not repeated."""
        closed = self.polygon[0] == self.polygon[-1]
        corners = self.polygon[: -1 if closed else None]
        return Area(self.name, self.surface_only, corners, self.holes, self.fence)

    @property
    def is_timed(self) -> bool:
        """Whether its validity is limited in time."""
        return self.begin_ns is not None or self.end_ns is not None

    def holds(self, begin_ns: int, end_ns: int) -> bool:
        """Return whether the area is valid at any time of an interval [ns, UTC]."""
        return (self.begin_ns is None or self.begin_ns <= end_ns) and (
            self.end_ns is None or self.end_ns >= begin_ns
        )


# Not slotted: the geometries are made when they are first needed.
@dataclass(frozen=True, eq=False)
class Ring:
    """Closed line that must not be crossed.

    Attributes:
        corners: Corners, shape (n, 2) [m], local east and north, the first not repeated.
        outside: Whether its outside is forbidden instead of its inside.
        name: Name in messages.
        surface_only: Whether only surfacing is forbidden.
        holes: Corners of holes, each shape (n, 2) [m].
    """

    corners: Array
    outside: bool
    name: str
    surface_only: bool = False
    holes: tuple[Array, ...] = ()

    @cached_property
    def area(self) -> Any:
        """Polygon within the ring, by the even-odd rule."""
        area = shapely.make_valid(shapely.Polygon(self.corners, self.holes))
        shapely.prepare(area)
        return area

    @cached_property
    def line(self) -> Any:
        """Outlines of the ring and its holes, as closed lines."""
        rings = [shapely.LinearRing(corners) for corners in (self.corners, *self.holes)]
        line = shapely.MultiLineString(rings) if self.holes else rings[0]
        shapely.prepare(line)
        return line

    @cached_property
    def solid(self) -> Any:
        """Forbidden polygon; a wide frame if the outside is forbidden."""
        if not self.outside:
            return self.area
        frame = shapely.difference(shapely.buffer(self.area.envelope, _FRAME), self.area)
        shapely.prepare(frame)
        return frame

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of the points, shape (n, 2) [m], within the ring, by the even-odd rule."""
        return np.asarray(shapely.contains_xy(self.area, *points.T))

    def forbids(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of the points, shape (n, 2) [m], that the ring forbids."""
        return np.asarray(self.inside(points) != self.outside)

    def forbidden(self, lines: Any) -> Any:
        """Return the parts of lines that the ring forbids."""
        return (shapely.difference if self.outside else shapely.intersection)(lines, self.area)

    def clearance(self, points: Array) -> Array:
        """Return the distance of points, shape (n, 2) [m], from the ring [m], negative for forbidden points."""
        distance = shapely.distance(self.line, shapely.points(points))
        return np.asarray(np.where(self.forbids(points), -distance, distance))


def no_go_rings(projection: Projection, area: NoGo) -> tuple[Ring, ...]:
    """Return the rings of an area in the local frame; several if its outline crosses itself.

    An edge may be straight in longitude and latitude (RFC 7946) or a geodesic, kilometres apart on long edges. A no-go area is the union of
    both meanings, a fence their intersection.

    Raises:
        PlanError: Fewer than three corners, a corner that is not a number, or an empty area.
    """
    whole, holes = (
        [_outline(projection, corners, area.name, either) for corners in rings]
        for rings, either in (((area.polygon,), not area.fence), (area.holes, area.fence))
    )
    enclosed = shapely.difference(whole[0], shapely.union_all(holes))
    parts = [part for part in shapely.get_parts(enclosed) if part.geom_type == "Polygon"]
    if not parts or (area.fence and len(parts) > 1):
        what = "no water" if not parts else f"{len(parts)} separate waters"
        raise PlanError(
            f"{area.name} encloses {what}: draw it as one polygon that does not cross itself"
        )
    return tuple(
        Ring(
            shapely.get_coordinates(part.exterior)[:-1],
            area.fence,
            area.name,
            area.surface_only and not area.fence,
            holes=tuple(shapely.get_coordinates(hole)[:-1] for hole in part.interiors),
        )
        for part in parts
    )


def _outline(
    projection: Projection, ring: Sequence[tuple[float, float]], name: str, either: bool
) -> Any:
    """Return the local polygon of a ring of longitudes and latitudes [degrees]: union or intersection of both meanings of edges."""
    corners = np.array(
        [corner for k, corner in enumerate(ring) if k == 0 or corner != ring[0]], dtype=np.float64
    )
    if corners.ndim != 2 or len(corners) < 3 or not np.all(np.isfinite(corners)):
        raise PlanError(
            f"{name} has {len(corners)} corners that are numbers; a no-go area needs three pairs of longitude and latitude"
        )
    corners[:, 0] = unwrap_longitude(corners[:, 0], projection.longitude)
    outlines = [
        shapely.make_valid(shapely.Polygon(np.column_stack(to_local(projection, *line.T))))
        for line in _densified(corners)
    ]
    return (shapely.union_all if either else shapely.intersection_all)(outlines)


def _densified(corners: Array) -> tuple[Array, ...]:
    """Return a closed outline, shape (n, 2) [degrees], densified along straight edges in degrees and along geodesics."""
    straight, shortest = list[Array](), list[Array]()
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        pieces = max(int(np.ceil(ellipsoid().inv(*begin, *end)[2] / _EDGE)), 1)
        straight.append(begin + np.arange(pieces)[:, None] / pieces * (end - begin))
        between = (
            [] if pieces == 1 else ellipsoid().npts(begin[0], begin[1], end[0], end[1], pieces - 1)
        )
        shortest.append(np.array([begin, *between]))
    longest = len(corners) < sum(map(len, straight))
    return (np.concatenate(straight), np.concatenate(shortest)) if longest else (corners,)


def joined_rings(rings: Sequence[Ring]) -> tuple[Ring, ...]:
    """Return the union of rings whose insides are forbidden, with one name."""
    if not rings:
        return ()
    parts = shapely.get_parts(shapely.union_all([ring.area for ring in rings]))
    return tuple(
        Ring(
            shapely.get_coordinates(part.exterior)[:-1],
            False,
            rings[0].name,
            holes=tuple(shapely.get_coordinates(hole)[:-1] for hole in part.interiors),
        )
        for part in parts
        if part.geom_type == "Polygon"
    )


def check_outside(rings: Sequence[Ring], name: str, point: Array) -> None:
    """Raise PlanError if a ring forbids a point, shape (3,) [m]; ``name`` is its role, ``start`` or ``goal``."""
    area = next((ring.name for ring in rings if ring.forbids(point[None, :2])[0]), None)
    if area is not None:
        raise PlanError(f"{name} is in a forbidden area: {area}; move it, or change the area")


def first_crossing(
    rings: Sequence[Ring], segments: Array, skin: Array
) -> tuple[str, int, float] | None:
    """Return the name of the ring that a path crosses first, the segment number and the fraction before the crossing, or None.

    Args:
        rings: Forbidden areas.
        segments: Consecutive segments of the path, shape (n, 2, 2) [m]; a segment may be a point.
        skin: Distance required by the curvature of each segment, shape (n,) [m].
    """
    lines, found = shapely.linestrings(segments), list[tuple[int, float, str]]()
    for ring in rings:
        bad = (
            ~shapely.covers(ring.area, lines)
            if ring.outside
            else shapely.dwithin(ring.area, lines, skin)
        )
        if bad.any():
            number = int(np.argmax(bad))
            begin, way = segments[number, 0], segments[number, 1] - segments[number, 0]
            at = shapely.get_coordinates(ring.forbidden(lines[number]))
            along = (at - begin) @ way / max(float(way @ way), 1e-12)
            found.append((number, float(np.clip(np.min(along, initial=1.0), 0.0, 1.0)), ring.name))
    if not found:
        return None
    number, share, name = min(found)
    return name, number, share
