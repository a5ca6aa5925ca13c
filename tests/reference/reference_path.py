"""What a path stays near, point by point: its distance from a place or a line, and the surfacings that a list of waypoints leaves out."""

import math

import numpy as np

from replay_kit.core.arrays import Array


def distance_from_place(point: Array, place: Array) -> float:
    """Return the distance between two points [m]."""
    return math.hypot(point[0] - place[0], point[1] - place[1])


def distance_from_line(point: Array, begin: Array, end: Array) -> float:
    """Return the distance of a point from the line through two others [m]: the area they span over the length of its base."""
    area = (end[0] - begin[0]) * (point[1] - begin[1]) - (end[1] - begin[1]) * (point[0] - begin[0])
    return abs(area) / distance_from_place(end, begin)


def farthest_left_out(kept: tuple[int, ...], times: Array, places: Array) -> float:
    """Return how far the place farthest from steady progress between its neighbours in a list is [m].

    Args:
        kept: Numbers of the places in the list; the first place, number 0, counts as in it.
        times: shape (n,) [s], of all places.
        places: shape (n, 2) [m].
    """
    worst = 0.0
    for k in range(len(times)):
        before, after = max(n for n in (0, *kept) if n <= k), min(n for n in (0, *kept) if n >= k)
        if after > before:
            share = (times[k] - times[before]) / (times[after] - times[before])
            worst = max(
                worst,
                float(
                    np.linalg.norm(places[before] * (1 - share) + places[after] * share - places[k])
                ),
            )
    return worst
