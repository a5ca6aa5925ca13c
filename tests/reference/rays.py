"""Zermelo's rays: quickest paths in a current that changes, by the turning of their heading; and which of them are not overtaken."""

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

from replay_kit.core.arrays import Array

# Current [m/s], shape (2, n), at places, shape (n, 2) [m], and a time [s].
Velocity = Callable[[Array, float], Array]
# Distance over which the current's gradient is taken [m].
_NEAR = 20.0


def fan(velocity: Velocity, start: Array, speed: float, headings: Array, times: Array) -> Array:
    """Return the places, shape (T, n, 2) [m], of rays that leave a start (2,) in directions (n,) [rad], at increasing times (T,) [s].

    The direction a of motion through water, counterclockwise from east, turns at v_x sin^2 a + (u_x - v_y) sin a cos a - u_y cos^2 a
    (Zermelo 1931), by the classical Runge-Kutta method from one time to the next.
    """

    def rate(at: Array, time: float) -> Array:
        place, sin, cos = at[:, :2], np.sin(at[:, 2]), np.cos(at[:, 2])
        moves = [
            velocity(place + _NEAR * np.array(side), time)
            for side in ([1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0])
        ]
        by_east = (moves[0] - moves[1]) / (2.0 * _NEAR)
        by_north = (moves[2] - moves[3]) / (2.0 * _NEAR)
        turn = by_east[1] * sin**2 + (by_east[0] - by_north[1]) * sin * cos - by_north[0] * cos**2
        here = velocity(place, time)
        return np.column_stack([here[0] + speed * cos, here[1] + speed * sin, turn])

    at, found = np.column_stack([np.tile(start, (headings.size, 1)), headings]), []
    now = 0.0
    for then in times:
        step = then - now
        k1 = rate(at, now)
        k2 = rate(at + 0.5 * step * k1, now + 0.5 * step)
        k3 = rate(at + 0.5 * step * k2, now + 0.5 * step)
        at = at + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(at + step * k3, then))
        now = float(then)
        found.append(at[:, :2])
    return np.array(found)


def in_front(fans: Array, distance: float) -> NDArray[np.bool_]:
    """Return which rays of fans, shape (T, n, 2) [m], end no farther than a distance [m] inside of all that the rays have enclosed.

    A ray behind that was overtaken by others: the path along it is not the quickest.
    """
    reached = shapely.union_all(
        [shapely.buffer(shapely.make_valid(shapely.Polygon(fan)), 0.0) for fan in fans]
    )
    ends = shapely.points(fans[-1])
    return np.asarray(
        ~shapely.contains(reached, ends)
        | (shapely.distance(shapely.boundary(reached), ends) < distance)
    )
