"""The arrival of a vehicle that heads through water in one direction, and how an error of the current moves it.

With T the time at which x' = V (sin, cos) + u(x, t) meets the goal and l the vector that is orthogonal to the end's derivative by the
heading and of unit product with the velocity over ground there, an error e of the current changes T by the sum of
-l' M(T, t) e(x(t), t) dt: -l' M is the gradient of the arrival time along the path.
"""

from dataclasses import dataclass

import numpy as np

from planners.learning.current import Currents
from planners.learning.transit import Sensitivity, Transit, end_and_derivative, end_sensitivity
from replay_kit.core.arrays import Array

_ITERATIONS, _CLOSE = 30, 1e-6
# Largest turn [rad] and largest share of the time by which a step of Newton's changes them.
_TURN, _SHARE = 0.5, 0.3


@dataclass(frozen=True, slots=True)
class Arrival:
    """The arrival at a goal.

    Attributes:
        through_water: The velocity held [m/s].
        duration: [s].
        miss: Distance from the goal then [m]: small where it is met.
    """

    through_water: complex
    duration: float
    miss: float


def arrive(
    currents: Currents, start: complex, begin: float, goal: complex, speed: float
) -> Arrival:
    """Return the arrival of a vehicle that holds one heading through water in one current.

    Args:
        currents: One.
        start: [m].
        begin: [s].
        goal: [m].
        speed: Through water [m/s].
    """
    way = goal - start
    angle, duration = float(np.angle(way)), abs(way) / speed
    miss = np.inf
    for _ in range(_ITERATIONS):
        held = speed * np.exp(1j * angle)
        end, by_angle, by_time = _end(currents, (start, begin), held, duration)
        off = goal - end
        miss = abs(off)
        if miss < _CLOSE:
            break
        change = np.linalg.lstsq(
            np.array([[by_angle.real, by_time.real], [by_angle.imag, by_time.imag]]),
            [off.real, off.imag],
            1e-6,
        )[0]
        angle += float(np.clip(change[0], -_TURN, _TURN))
        duration *= 1.0 + float(np.clip(change[1] / duration, -_SHARE, _SHARE))
    return Arrival(speed * np.exp(1j * angle), duration, miss)


def _end(
    currents: Currents, begins: tuple[complex, float], held: complex, duration: float
) -> tuple[complex, complex, complex]:
    """Return the end of a path, its derivative by the angle of what is held, and by its duration: the velocity over ground there."""
    start, begin = begins
    end, derivative = end_and_derivative(
        currents, np.array([start]), begin, np.array([held]), duration
    )
    turned = derivative[0] @ np.array([(1j * held).real, (1j * held).imag])
    return complex(end[0]), complex(*turned), held + complex(currents.at(end, begin + duration)[0])


def arrival_sensitivity(
    currents: Currents, start: complex, begin: float, arrival: Arrival
) -> Sensitivity:
    """Return how the time of arrival [s] changes with the current: weights of shape (1, 2 n) [s^2/m].

    Args:
        currents: One.
        start: [m].
        begin: [s].
        arrival: Of ``arrive``.
    """
    held = arrival.through_water
    _, by_angle, by_time = _end(currents, (start, begin), held, arrival.duration)
    across = 1j * by_angle
    gradient = across / (by_time.real * across.real + by_time.imag * across.imag)
    sense = end_sensitivity(
        currents,
        start,
        begin,
        Transit(
            np.array([[held]]), np.zeros((1, 1), dtype=np.complex128), np.array([arrival.duration])
        ),
    )
    weights: Array = -np.array([[gradient.real, gradient.imag]]) @ sense.weights
    return Sensitivity(sense.points, sense.times, weights)
