"""Zermelo's quickest paths, each by its own solution: a uniform current, solid rotation, a jet."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from replay_kit.core.arrays import Array


def time_in_uniform_current(way: Array, current: Array, speed: float) -> float:
    """Return the least time [s] along a way (2,) [m] in a current (2,) [m/s] slower than the vehicle."""
    length = float(np.hypot(*way))
    along = float(way @ current) / length
    return length / (along + float(np.sqrt(speed**2 - current @ current + along**2)))


def time_in_solid_rotation(begin: Array, end: Array, rate: float, speed: float) -> float:
    """Return the least time [s] in water that turns at a rate [rad/s], clockwise from north, about the origin.

    Seen from the turning water the path is straight: the goal turns backwards, and the time is that of the first meeting.
    """

    def ahead(time: float) -> float:
        # a clockwise turn of the water carries east to south; seen from it the goal turns the other way
        cos, sin = np.cos(rate * time), np.sin(rate * time)
        goal = np.array([cos * end[0] - sin * end[1], sin * end[0] + cos * end[1]])
        return float(np.hypot(*(goal - begin)) - speed * time)

    times = np.linspace(0.0, 10.0 * float(np.hypot(*(end - begin))) / speed, 4000)
    values = np.array([ahead(time) for time in times])
    first = int(np.argmax(values <= 0.0))
    return float(brentq(ahead, times[first - 1], times[first], xtol=1e-6))


def time_in_jet(begin: Array, end: Array, east: Callable[[float], float], speed: float) -> float:
    """Return the least time [s] in a current towards the east that depends on north alone.

    Along a quickest path the heading turns with the shear, at d east / d north times sin(heading)^2, clockwise from north
    (Zermelo 1931). The first heading is found by shooting; where none within 1.5 rad of north or south leads there, the answer is infinity.
    """

    def arrival(first: float) -> tuple[float, float]:
        """Return (distance past the goal, time) where the path crosses the goal's north."""

        def rate(_: float, at: Array) -> Array:
            slope = (east(at[1] + 1.0) - east(at[1] - 1.0)) / 2.0
            return np.array(
                [
                    speed * np.sin(at[2]) + east(at[1]),
                    speed * np.cos(at[2]),
                    slope * np.sin(at[2]) ** 2,
                ]
            )

        def crosses(_: float, at: Array) -> float:
            return float(at[1] - end[1])

        crosses.terminal = True  # type: ignore[attr-defined]
        longest = 20.0 * float(np.hypot(*(end - begin))) / speed
        path = solve_ivp(
            rate, (0.0, longest), [*begin, first], rtol=1e-10, atol=1e-6, events=crosses
        )
        return float(path.y[0, -1] - end[0]), float(path.t[-1])

    headings = np.linspace(-1.5, 1.5, 31) + (0.0 if end[1] > begin[1] else np.pi)
    values = [arrival(heading)[0] for heading in headings]
    roots = [
        brentq(lambda heading: arrival(heading)[0], a, b, xtol=1e-10)
        for (a, b), (x, y) in zip(pairwise(headings), pairwise(values), strict=True)
        if x * y < 0.0
    ]
    return min((arrival(root)[1] for root in roots), default=np.inf)
