"""Free water of a route: the area that rings leave, less a margin, and the corners of obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import Ring
from planners.route.current import Complex
from replay_kit.core.arrays import Array

# Corners lie this much farther out than the line that must not be crossed [m].
_AHEAD = 0.2
# A sharp corner is cut off at so many margins.
_MITRE = 2.0
# Radius of the water around a start or a goal in which the margin is its own clearance, in margins; and the share kept of that clearance.
_AROUND, _KEPT = 4.0, 0.5
# Where no margin is kept, what no disc of this radius [m] reaches is filled: shapes that touch, or nearly, leave no gap.
_DISC = 1.0
# Where there are more corners than this, those closer together than so many metres are one.
_MANY, _APART = 1500, 500.0


# Not slotted: the tree is made when it is first needed.
@dataclass(frozen=True, eq=False)
class Obstacles:
    """Free water of a route.

    Attributes:
        water: Polygons of the free water.
        corners: Corners that a route may round, shape (n,) [m], east + i north.
    """

    water: Any
    corners: Complex

    @cached_property
    def _segments(self) -> Any:
        """Search tree of the outline's pieces."""
        lines = [
            shapely.get_coordinates(ring)
            for ring in shapely.get_parts(shapely.boundary(shapely.get_parts(self.water)))
        ]
        ends = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
        return shapely.STRtree(
            shapely.linestrings(np.concatenate(ends) if ends else np.zeros((0, 2, 2)))
        )

    def free(self, places: Complex) -> NDArray[np.bool_]:
        """Return a mask of the positions, shape (n,) [m], that a route may pass."""
        return np.asarray(shapely.intersects_xy(self.water, places.real, places.imag))

    def outline(self, apart: float) -> Complex:
        """Return points along the outline with at most a given spacing [m]."""
        points = shapely.get_coordinates(shapely.segmentize(shapely.boundary(self.water), apart))
        return as_complex(points)

    def crossed(self, begin: Complex, end: Complex) -> NDArray[np.bool_]:
        """Return a mask of the straight lines, shape (n,) [m], that touch the outline."""
        lines = shapely.linestrings(
            np.stack([np.column_stack([at.real, at.imag]) for at in (begin, end)], axis=1)
        )
        found = np.zeros(begin.size, dtype=bool)
        found[self._segments.query(lines, predicate="intersects")[0]] = True
        return found


def obstacles_of(rings: Sequence[Ring], margin: float, places: Complex) -> Obstacles:
    """Return the free water left by rings, less a margin that shrinks near given positions.

    Args:
        rings: Forbidden areas; rings that forbid surfacing only are ignored.
        margin: Margin to them [m].
        places: Start and goals, shape (n,) [m]. Near one within the margin of a ring, half its distance is the margin.
    """
    solid = [ring for ring in rings if not ring.surface_only]
    edges = [ring.area for ring in solid if ring.outside]
    land = shapely.union_all([ring.area for ring in solid if not ring.outside])
    frame = (
        shapely.intersection_all(edges)
        if edges
        else shapely.box(*(4.0 * np.array([-1e6, -1e6, 1e6, 1e6])))
    )
    water = _water(frame, land, margin - _AHEAD)
    for at in shapely.points(places.real, places.imag):
        solid = [shape for shape in (shapely.boundary(frame), land) if not shape.is_empty]
        clear = min((float(shapely.distance(at, shape)) for shape in solid), default=np.inf)
        if clear < 2.0 * margin:
            around = shapely.buffer(at, _AROUND * margin)
            water = shapely.union(
                water, shapely.intersection(around, _water(frame, land, _KEPT * min(clear, margin)))
            )
    corners = _corners(_water(frame, land, margin))
    shapely.prepare(water)
    return Obstacles(water, corners[shapely.intersects_xy(water, corners.real, corners.imag)])


def _water(frame: Any, land: Any, margin: float) -> Any:
    """Return the water at least a margin [m] from a frame's outline and land; a negative margin keeps touching shapes closed."""
    mitred: dict[str, Any] = {"join_style": "mitre", "mitre_limit": _MITRE}
    if margin < 0.0:
        # shapes that touch at a corner would come apart
        wide = shapely.buffer(shapely.difference(frame, land), -_DISC, **mitred)
        return shapely.buffer(shapely.buffer(wide, _DISC, quad_segs=2), -margin, **mitred)
    return shapely.difference(
        shapely.buffer(frame, -margin, **mitred), shapely.buffer(land, margin, **mitred)
    )


def _corners(water: Any) -> Complex:
    """Return the reentrant corners of the water's outline, shape (n,) [m]."""
    found = [np.zeros(0, dtype=complex)]
    for part in shapely.get_parts(water):
        for k, ring in enumerate((part.exterior, *part.interiors)):
            line = np.ascontiguousarray(shapely.get_coordinates(ring)[:-1]).view(complex).ravel()
            # counterclockwise round the water outside, clockwise round what lies in it: water is on the left
            line = line if shapely.is_ccw(ring) == (k == 0) else line[::-1]
            ahead, behind = np.roll(line, -1) - line, line - np.roll(line, 1)
            found.append(line[(ahead * behind.conj()).imag < 0.0])
    corners = np.concatenate(found)
    if corners.size <= _MANY:
        return corners
    cells = np.round(np.column_stack([corners.real, corners.imag]) / _APART)
    return corners[np.unique(cells, axis=0, return_index=True)[1]]


def directions_around(place: complex, radius: float, count: int) -> Complex:
    """Return evenly spaced corners of a polygon around a disc, shape (count,) [m]."""
    return np.asarray(
        place + radius / np.cos(np.pi / count) * np.exp(2j * np.pi * np.arange(count) / count)
    )


def as_complex(points: Array) -> Complex:
    """Return points, shape (n, 2) [m], as east + i north, shape (n,)."""
    return points[:, 0] + 1j * points[:, 1]
