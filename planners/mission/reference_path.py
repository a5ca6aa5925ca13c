"""The reference path of a mission: a place, or the line between two, that its track is to stay near."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array

#: A kilometre beyond the allowed distance costs as much as this many hours of the penalty of a kilometre missed.
REFERENCE_SLACK_COST = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePath:
    """A place or a line that a track is to stay near.

    Attributes:
        name: Its name in messages.
        origin: shape (2,) [m], the place, or a point of the line; local east and north.
        across: shape (2, 2), projection of the vector from the origin on what counts: all of it, or its part across the line.
        limit: Largest distance allowed [m].
        weight: Cost of an hour at a distance of a kilometre; it grows with the squared distance.
        surfacings_only: Whether only the places of surfacing count, and not the track between them.
        least_duration: Of the mission [s].
    """

    name: str
    origin: Array
    across: Array
    limit: float
    weight: float
    surfacings_only: bool
    least_duration: float

    def distances(self, points: Array) -> Array:
        """Return the distances [m] of points, shape (n, 2) [m], from the place or line."""
        return np.asarray(np.linalg.norm((points - self.origin) @ self.across.T, axis=1))

    def farthest_and_rms(self, time: Array, points: Array, ends: Array) -> tuple[float, float]:
        """Return the largest distance of a track and its root mean square [m], over time or over the surfacings.

        Args:
            time: shape (n,) [s].
            points: shape (n, 2) [m].
            ends: Numbers of the points at which a leg ends.
        """
        if self.surfacings_only:
            distances = self.distances(points[ends])
            return float(distances.max()), float(np.sqrt(np.mean(distances**2)))
        distances = self.distances(points)
        return float(distances.max()), float(np.sqrt(np.trapezoid(distances**2, time) / time[-1]))


def near_place(
    place: Array, radius: float, duration: float, surfacings_only: bool
) -> ReferencePath:
    """Return the reference path of a mooring within a radius [m] of a place, shape (2,) [m], for a duration [s]."""
    return ReferencePath(
        "the mooring", place, np.eye(2), radius, 3600.0 / duration, surfacings_only, duration
    )


def along_line(begin: Array, end: Array, weight: float, width: float) -> ReferencePath:
    """Return the reference path of the line between two points, shape (2,) [m].

    Args:
        begin: Of the line.
        end: Of the line.
        weight: Cross-track penalty [h per h and km].
        width: Largest distance allowed [m].
    """
    along = (end - begin) / np.linalg.norm(end - begin)
    normal = np.array([along[1], -along[0]])
    return ReferencePath("the line", begin, np.outer(normal, normal), width, weight, False, 0.0)
