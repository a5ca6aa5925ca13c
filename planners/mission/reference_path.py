"""What a mission is to stay near: a place, or the line between two."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from replay_kit.core.arrays import Array

# Kilometres of a trespass that a kilometre of straying costs as much as.
_STRAYING = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Guide:
    """A place or a line that a path is to stay near.

    Attributes:
        name: What messages call it.
        origin: shape (2,) [m], the place, or a point of the line; local east and north.
        across: shape (2, 2), what of the way from the origin counts: all of it, or that across the line.
        limit: Farthest distance allowed [m].
        weight: What an hour at a distance of a kilometre costs; it grows with the distance's square.
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
        """Return how far points, shape (n, 2) [m], are from the place or line [m]."""
        return np.asarray(np.linalg.norm((points - self.origin) @ self.across.T, axis=1))

    def farthest_and_rms(self, time: Array, points: Array, ends: Array) -> tuple[float, float]:
        """Return the farthest distance of a path and its root mean square over time, or over its surfacings [m].

        Args:
            time: shape (n,) [s].
            points: shape (n, 2) [m].
            ends: Numbers of the points at which a leg ends.
        """
        if self.surfacings_only:
            away = self.distances(points[ends])
            return float(away.max()), float(np.sqrt(np.mean(away**2)))
        away = self.distances(points)
        return float(away.max()), float(np.sqrt(np.trapezoid(away**2, time) / time[-1]))


def near_place(place: Array, radius: float, duration: float, surfacings_only: bool) -> Guide:
    """Return the guide that keeps a path within a radius [m] of a place, shape (2,) [m], for a duration [s]."""
    return Guide("the mooring", place, np.eye(2), radius, 3600.0 / duration, surfacings_only, duration)


def along_line(begin: Array, end: Array, weight: float, width: float) -> Guide:
    """Return the guide that keeps a path on the line between two points, shape (2,) [m].

    Args:
        begin: Of the line.
        end: Of the line.
        weight: Hours that an hour costs more a kilometre off the line.
        width: Farthest distance allowed [m].
    """
    along = (end - begin) / np.linalg.norm(end - begin)
    normal = np.array([along[1], -along[0]])
    return Guide("the line", begin, np.outer(normal, normal), width, weight, False, 0.0)


class GuideTerms:
    """What a guide adds to a mission's program: costs and limits of the distance of each place.

    Attributes:
        parameters: Origin [km], what counts of the way from it, weight and limit [km] of each place.
        stray: The unknown [km] by which the limits are missed.
        strayed: What that costs, in kilometres of a trespass, which is worse.
        cost: Of all places.
        beyond: What is to be 0 or less, one column a leg.
    """

    def __init__(self, n_legs: int, n_places: int) -> None:
        """Make the symbols of so many legs and places in each; without places there is no guide, and nothing is added."""
        size = int(n_places > 0)
        self.parameters = (
            ca.MX.sym("origin", 2 * size),
            ca.MX.sym("across", 2 * size, 2 * size),
            ca.MX.sym("guide_weights", n_legs * n_places),
            ca.MX.sym("guide_limits", n_legs * n_places),
        )
        self.stray, self.n_places = ca.MX.sym("stray", size), n_places
        self.strayed = _STRAYING * ca.sum1(self.stray)
        self.cost: Any = ca.MX(1, 1)
        self.beyond: list[Any] = []

    def add(self, leg: int, places: Any) -> None:
        """Count the places of a leg, shape (2, n_places) [km]."""
        if self.n_places == 0:
            return
        origin, across, weights, limits = self.parameters
        some = slice(leg * self.n_places, (leg + 1) * self.n_places)
        squared = ca.sum1((across @ (places - ca.repmat(origin, 1, self.n_places))) ** 2).T
        self.cost += ca.dot(weights[some], squared)
        # over the limit, so that one that is far away is as well scaled as one that is near
        self.beyond.append((squared - (limits[some] + self.stray) ** 2) / limits[some])
