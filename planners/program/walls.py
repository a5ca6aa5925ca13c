"""Half-planes that keep segments clear of forbidden areas, and the clearance of segments."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import Ring
from planners.program.graph import FAR, KM, PLANES
from replay_kit.core.arrays import Array

# Distance within which a ring counts [m]; half-planes of a segment that are kept from round to round.
_NEAR, _KEPT = 5e3, 2


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Simulated segments of a mission.

    Attributes:
        lines: Tracks, shape (N, n, 2) [m].
        up: Surfacing position of each segment, shape (N, 2) [m]; its end if it stays below.
        chords: Begin and end in the program, shape (N, 2, 2) [m].
    """

    lines: Array
    up: Array
    chords: Array

    def taken(self, ring: Ring) -> Any:
        """Return the lines that a ring applies to: only the drifts for one that forbids surfacing."""
        if not ring.surface_only:
            return shapely.linestrings(self.lines)
        ends = self.lines[:, -1]
        drifts = shapely.linestrings(np.stack([self.up, ends], axis=1))
        # a line without a length is nowhere
        still = np.all(self.up == ends, axis=1)
        return np.where(still, shapely.points(ends), drifts)


@dataclass(eq=False)
class Walls:
    """Constraints of simulated segments; mutable, as half-planes persist between iterations.

    Attributes:
        rings: Rings, each with the numbers of the segments it applies to.
        margin: Margin to the rings [m].
        reference: Route clear of them, shape (N, n, 2) [m].
        kept: Half-planes of each segment.
    """

    rings: Sequence[tuple[Ring, NDArray[np.intp]]]
    margin: float
    reference: Array
    kept: dict[int, list[Array]] = field(default_factory=dict)

    def near(self, segments: Segments) -> bool:
        """Return whether any segment is near a ring."""
        return any(self._close(segments, ring, rows).size for ring, rows in self.rings)

    def _close(self, segments: Segments, ring: Ring, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the numbers of the segments near a ring that it applies to."""
        near = shapely.dwithin(ring.solid, segments.taken(ring)[rows], _NEAR)
        return np.asarray(rows[near])

    def planes(self, segments: Segments, extra: float, straight: bool) -> Array:
        """Return half-planes, shape (4, N PLANES): normal, offset [km], and fraction of the chord at which each applies.

        Args:
            segments: Simulated segments.
            extra: Distance in addition to the margin [m].
            straight: Whether the segments belong to a route and follow their chords.
        """
        found: dict[int, list[tuple[float, Array]]] = {}
        for ring, rows in self.rings:
            taken = segments.taken(ring)
            for k in self._close(segments, ring, rows).tolist():
                touched = _touched(ring, taken[k], segments.lines[k], self.reference[k])
                for inside, at, nearest in touched:
                    away = nearest - at if not inside else at - nearest
                    depth = float(np.hypot(*away))
                    if depth == 0.0:
                        continue
                    begin, end = segments.chords[k]
                    line = shapely.LineString(segments.lines[k])
                    share = shapely.line_locate_point(line, shapely.Point(at), normalized=True)
                    share = 1.0 if ring.surface_only else float(share)
                    bend = at - begin - share * (end - begin)
                    if straight:
                        bend = np.zeros(2)
                    normal = away / depth
                    offset = float(normal @ (nearest - bend)) - self.margin - extra
                    plane = np.array([*normal, offset / KM, share])
                    found.setdefault(k, []).append((-depth if inside else depth, plane))
        planes = np.zeros((len(segments.lines), PLANES, 4))
        planes[:, :, 2] = FAR
        for k in range(len(planes)):
            new = [plane for _, plane in sorted(found.get(k, []), key=lambda one: one[0])]
            held = (new[: PLANES - 1] + self.kept.get(k, []))[:PLANES]
            self.kept[k] = new[:_KEPT]
            for j, row in enumerate(held):
                planes[k, j] = row
        return planes.reshape(-1, 4).T

    def clearance(self, segments: Segments) -> float:
        """Return the smallest distance of the segments from any ring [m]; infinite without a ring nearby."""
        least = np.inf
        for ring, rows in self.rings:
            near = segments.taken(ring)[self._close(segments, ring, rows)]
            if near.size:
                least = min(least, float(np.min(shapely.distance(ring.solid, near))))
        return least


def _touched(
    ring: Ring, taken: Any, line: Array, reference: Array
) -> list[tuple[bool, Array, Array]]:
    """Return the contacts of a segment with a ring: whether forbidden, point of the segment and nearest point of the ring [m]."""
    overlap = shapely.intersection(ring.solid, taken)
    parts = [
        part
        for part in shapely.get_parts(overlap)
        if part.length > 1e-6 or (ring.surface_only and not part.is_empty)
    ]
    if not parts:
        nearest, at = shapely.get_coordinates(shapely.shortest_line(ring.solid, taken))
        return [(False, at, nearest)]
    found = []
    for part in parts:
        points = shapely.get_coordinates(part)
        middle = points.mean(axis=0)
        nearest, at = shapely.get_coordinates(
            shapely.shortest_line(ring.line, shapely.Point(middle))
        )
        # what lies between the segment and the way that it came from is passed on the side of that way
        loop = shapely.make_valid(shapely.Polygon(np.vstack([line, reference[::-1]])))
        corners = shapely.get_coordinates(ring.solid)
        between = corners[shapely.intersects_xy(loop, *corners.T)]
        if len(between) and not ring.surface_only:
            way = points[-1] - points[0]
            left = np.array([-way[1], way[0]]) / max(float(np.linalg.norm(way)), 1e-9)
            beside = (between - middle) @ left
            farthest = int(np.argmax(np.abs(beside)))
            if abs(beside[farthest]) > 1e-3:
                nearest = between[farthest]
                at = nearest - beside[farthest] * left
        found.append((True, at, nearest))
    return found
