"""Half-planes that keep flown segments clear of what is forbidden, their clearance, and how deep the bottom lets them go."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely

from planners.hazards.areas import Ring
from planners.hazards.bottom import Bottom
from planners.program.graph import FAR, PLANES
from planners.task import LEAST_DIVE
from planners.water import KM
from replay_kit.core.arrays import Array

# Distance within which a ring counts [m]; half-planes of a segment that are kept from round to round.
_NEAR, _KEPT = 5e3, 2
# Points of each step of a segment at which its depth is looked up.
_POINTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Segments as flown.

    Attributes:
        lines: shape (N, n, 2) [m].
        up: shape (N, 2), where each ends its dive [m], from where on the vehicle is at the surface; its end where it stays below.
        chords: shape (N, 2, 2), where the program has them begin and end [m].
    """

    lines: Array
    up: Array
    chords: Array

    def taken(self, ring: Ring) -> Any:
        """Return the lines that count for a ring: of one that forbids surfacing alone the drifts."""
        if not ring.surface_only:
            return shapely.linestrings(self.lines)
        return shapely.linestrings(np.stack([self.up, self.lines[:, -1]], axis=1))


@dataclass(eq=False)
class Walls:
    """What flown segments must keep clear of: mutable, as each segment keeps the nearest half-planes of the round before.

    Attributes:
        rings: What is forbidden.
        margin: Distance kept from them [m].
        kept: Half-planes of each segment.
    """

    rings: Sequence[Ring]
    margin: float
    kept: dict[int, list[Array]] = field(default_factory=dict)

    def near(self, segments: Segments) -> bool:
        """Return whether any segment is near a ring."""
        whole = shapely.MultiLineString(list(segments.lines))
        return any(shapely.dwithin(ring.solid, whole, _NEAR) for ring in self.rings)

    def planes(self, segments: Segments, extra: float, straight: bool) -> Array:
        """Return half-planes, shape (4, N PLANES): normal, offset [km], and share of the chord at which they count.

        Args:
            segments: As flown.
            extra: Distance kept beside the margin [m].
            straight: Whether the segments are those of a route, which are not bent against their chords.
        """
        found: dict[int, list[tuple[float, Array]]] = {}
        for ring in self.rings:
            taken = segments.taken(ring)
            for k in np.flatnonzero(shapely.dwithin(ring.solid, taken, _NEAR)).tolist():
                touched = _touched(ring, taken[k])
                for inside, at, nearest in touched:
                    away = nearest - at if not inside else at - nearest
                    depth = float(np.hypot(*away))
                    if depth == 0.0:
                        continue
                    begin, end = segments.chords[k]
                    share = 1.0 if ring.surface_only else _share(segments.lines[k], at)
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
            rows = (new[: PLANES - 1] + self.kept.get(k, []))[:PLANES]
            self.kept[k] = new[:_KEPT]
            for j, row in enumerate(rows):
                planes[k, j] = row
        return planes.reshape(-1, 4).T

    def clearance(self, segments: Segments) -> float:
        """Return the least distance of the segments from any ring [m]; infinite without one near."""
        least = np.inf
        for ring in self.rings:
            taken = segments.taken(ring)
            near = shapely.dwithin(ring.solid, taken, _NEAR)
            if near.any():
                least = min(least, float(np.min(shapely.distance(ring.solid, taken[near]))))
        return least


def _touched(ring: Ring, taken: Any) -> list[tuple[bool, Array, Array]]:
    """Return whether points of a segment are forbidden, these and the nearest of the ring [m]: one where it is clear of the ring."""
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
        middle = (
            part
            if part.geom_type == "Point"
            else shapely.line_interpolate_point(part, 0.5, normalized=True)
            if part.geom_type == "LineString"
            else shapely.centroid(part)
        )
        nearest, at = shapely.get_coordinates(shapely.shortest_line(ring.line, middle))
        found.append((True, at, nearest))
    return found


def _share(line: Array, at: Array) -> float:
    """Return the share of a line's length at which it passes a point."""
    return float(
        shapely.line_locate_point(shapely.LineString(line), shapely.Point(at), normalized=True)
    )


def depth_limits(bottom: Bottom, segments: Segments, most: float) -> Array:
    """Return the greatest depth of dives along each segment that stay above the bottom, shape (N,), at most a depth [m]."""
    lines = segments.lines
    shares = np.linspace(0.0, 1.0, _POINTS + 1)[:, None, None]
    fine = lines[:, :-1] + shares[..., None] * (lines[:, 1:] - lines[:, :-1])
    points = np.moveaxis(fine, 0, 1).reshape(-1, 2)
    limits = bottom.limit_beside(points, LEAST_DIVE).reshape(len(lines), -1).min(axis=1)
    return np.clip(limits, LEAST_DIVE, most)
