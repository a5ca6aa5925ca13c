"""A glider's leg, from one surfacing to the next: heading and glide angle held, through depths that are known beforehand.

``fly_steps`` and ``fly_midpoints`` accept NumPy arrays and CasADi expressions. Depths are parameters: a yo passes the same depths at any
heading and glide angle, which only determine how long that takes.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from planners.track import fractions_of_duration
from replay_kit.core.arrays import Array

#: ``fly_steps`` or ``fly_midpoints``.
Integrator = Callable[
    [Callable[[Any, Any, Any], Any], Any, Any, Any, Any, int], list[tuple[Any, Any]]
]


def fly_steps(
    rate: Callable[[Any, Any, Any], Any],
    place: Any,
    time: Any,
    depths: Any,
    durations: Any,
    count: int,
) -> list[tuple[Any, Any]]:
    """Return (place, time) after each step, by the classical Runge-Kutta method.

    Args:
        rate: (place, depth, time) -> horizontal velocity over ground [m/s].
        place: East and north at the beginning [m].
        time: At the beginning [s].
        depths: Of the steps' ends, one more than there are steps [m].
        durations: Of the steps [s].
        count: Number of steps.
    """
    path = []
    for i in range(count):
        step, middle = durations[i], 0.5 * (depths[i] + depths[i + 1])
        first = rate(place, depths[i], time)
        second = rate(place + step / 2.0 * first, middle, time + step / 2.0)
        third = rate(place + step / 2.0 * second, middle, time + step / 2.0)
        fourth = rate(place + step * third, depths[i + 1], time + step)
        place, time = (
            place + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth),
            time + step,
        )
        path.append((place, time))
    return path


def fly_midpoints(
    rate: Callable[[Any, Any, Any], Any],
    place: Any,
    time: Any,
    depths: Any,
    durations: Any,
    count: int,
) -> list[tuple[Any, Any]]:
    """Return (place, time) after each step by the midpoint method: half of the work of ``fly_steps``, whose arguments it takes.

    Between levels the flow is linear in depth, and a step leads over a hundredth of an eddy: ten dives end within a metre or so of where
    ``fly_steps`` ends, which is accurate enough for the optimiser.
    """
    path = []
    for i in range(count):
        step, middle = durations[i], 0.5 * (depths[i] + depths[i + 1])
        halfway = place + step / 2.0 * rate(place, depths[i], time)
        place, time = place + step * rate(halfway, middle, time + step / 2.0), time + step
        path.append((place, time))
    return path


def leg_depths(depths: tuple[float, ...], levels: Array, n_steps: int) -> Array:
    """Return the depths [m] of a leg's steps, shape (n_steps + 1,), its turning points and each level crossed among them.

    Args:
        depths: Where the leg begins, turns and ends [m].
        levels: shape (Z,) [m]; hats bend there, and a step across a bend would lose the integrator's order.
        n_steps: Number of steps.
    """
    distance = np.abs(np.diff(depths))
    # Steps go in proportion to the distance, but no part has fewer than it has levels.
    least = np.array(
        [1 + np.sum((levels > min(a, b)) & (levels < max(a, b))) for a, b in pairwise(depths)]
    )
    counts = least.copy()
    for _ in range(n_steps - int(least.sum())):
        counts[np.argmax(distance / counts)] += 1
    parts = [
        a + (b - a) * fractions_of_duration(a, b, levels, int(n))
        for a, b, n in zip(depths[:-1], depths[1:], counts, strict=True)
    ]
    return np.concatenate([*(part[:-1] for part in parts), [depths[-1]]])


def step_stops(levels: Array, goal_depths: Array) -> Array:
    """Return the depths [m] at which steps end: the levels, shape (Z,), and those of goals below the surface."""
    return np.union1d(levels, goal_depths[goal_depths > 0.0])


def steps_needed(depths: tuple[float, ...], levels: Array, each: int) -> int:
    """Return the number of steps of a leg: ``each`` for a dive or climb, and one for each level crossed."""
    crossed = sum(
        int(np.sum((levels > min(a, b)) & (levels < max(a, b)))) for a, b in pairwise(depths)
    )
    return crossed + each * (len(depths) - 1)
