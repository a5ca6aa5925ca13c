"""A stretch flown by dead reckoning, and how an error of the current moves its end.

The vehicle holds a velocity w through water along each leg, chosen so that in the current it knows each leg ends in time at its place. With
x' = w + u(x, t) an error e of the current moves the end by the sum over the path of M(t_end, t) e(x(t), t) dt, where M' = (grad u) M.
The integration is by Runge and Kutta's fourth order rule, and G its exact derivative: the sum runs over the stages of its steps.
"""

from dataclasses import dataclass

import numpy as np

from planners.front.current import Complex
from planners.learning.current import Currents
from replay_kit.core.arrays import Array

# Longest step of the integration [s], and Newton steps for a velocity through water, which are enough where it converges.
_STEP, _ITERATIONS = 3_600.0, 8
# Change of the end below which a velocity is as good as it gets [m].
_CLOSE = 0.5
# Stages of a step: time share, weight.
_STAGES = ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0))


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """How the end of a path moves with the current.

    Attributes:
        points: shape (n,) [m], where the current counts.
        times: shape (n,) [s], when.
        weights: shape (2, 2 n) [s], effect on the end of a current at each: columns are east and north of each place in turn.
    """

    points: Complex
    times: Array
    weights: Array


@dataclass(frozen=True, slots=True, eq=False)
class Transit:
    """A dead-reckoned stretch, S times.

    Attributes:
        through_water: shape (S, L) [m/s], the velocity held along each leg.
        ends: shape (S, L) [m], where it ends in the current that it was planned in.
        durations: shape (L,) [s].
    """

    through_water: Complex
    ends: Complex
    durations: Array


def steps_of(duration: float) -> int:
    """Return the number of steps in which a stretch of some time [s] is integrated."""
    return max(int(np.ceil(duration / _STEP)), 2)


def fly(
    currents: Currents, start: Complex, begin: Array | float, held: Complex, duration: float
) -> Complex:
    """Return the path of a vehicle that holds a velocity through water, shape (n + 1, S) [m].

    Args:
        currents: S of them.
        start: shape (S,) [m].
        begin: When [s].
        held: shape (S,) [m/s].
        duration: [s].
    """
    count = steps_of(duration)
    step, place, path = duration / count, start, [start]
    for k in range(count):
        time = begin + k * step
        first = held + currents.at(place, time)
        second = held + currents.at(place + 0.5 * step * first, time + 0.5 * step)
        third = held + currents.at(place + 0.5 * step * second, time + 0.5 * step)
        fourth = held + currents.at(place + step * third, time + step)
        place = place + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        path.append(place)
    return np.stack(path)


def end_and_derivative(
    currents: Currents, start: Complex, begin: Array | float, held: Complex, duration: float
) -> tuple[Complex, Array]:
    """Return where ``fly`` ends, shape (S,) [m], and its derivative by the velocity held, shape (S, 2, 2) [s]."""
    count = steps_of(duration)
    step, place = duration / count, start
    derivative = np.zeros((start.size, 2, 2))
    for k in range(count):
        slopes, turned = list[Complex](), list[Array]()
        for share, _ in _STAGES:
            there = place if not slopes else place + share * step * slopes[-1]
            moved = derivative if not turned else derivative + share * step * turned[-1]
            value, by_east, by_north = currents.with_gradient(there, begin + (k + share) * step)
            slopes.append(held + value)
            turned.append(_matrix(by_east, by_north) @ moved + np.eye(2))
        place = place + step * sum(
            weight * slope for (_, weight), slope in zip(_STAGES, slopes, strict=True)
        )
        derivative = derivative + step * sum(
            weight * turn for (_, weight), turn in zip(_STAGES, turned, strict=True)
        )
    return place, derivative


def plan_transit(
    currents: Currents,
    start: Complex,
    begin: Array | float,
    goals: Complex,
    duration: float,
    speed: float,
) -> Transit:
    """Return velocities through water with which each goal is met, in equal shares of the way; at most of a vehicle's speed.

    Where that speed is too little the velocity is that of the speed which comes near: the ends say how near.

    Args:
        currents: That are known, S of them.
        start: shape (S,) [m].
        begin: When the stretch begins [s].
        goals: shape (L,) [m], in order; the last one is where it ends.
        duration: Of the whole [s].
        speed: Greatest through water [m/s].
    """
    lengths = np.abs(np.diff(np.concatenate([[start.mean()], goals])))
    durations = (
        duration
        * np.maximum(lengths, 1e-3 * lengths.sum() + 1.0)
        / np.sum(np.maximum(lengths, 1e-3 * lengths.sum() + 1.0))
    )
    velocities, ends, time = list[Complex](), list[Complex](), begin
    for goal, leg in zip(goals, durations, strict=True):
        held = _limited((goal - start) / leg - currents.at(start, time), speed)
        for _ in range(_ITERATIONS):
            end, derivative = end_and_derivative(currents, start, time, held, leg)
            better = _limited(held + _solved(derivative, goal - end, leg), speed)
            if np.max(np.abs(better - held)) * leg < _CLOSE:
                break
            held = better
        start = fly(currents, start, time, held, leg)[-1]
        time = time + leg
        velocities.append(held)
        ends.append(start)
    return Transit(np.stack(velocities, axis=1), np.stack(ends, axis=1), durations)


def fly_transit(
    currents: Currents, start: Complex, begin: Array | float, planned: Transit
) -> Complex:
    """Return where planned stretches end in other currents, shape (S,) [m]; arguments as in ``plan_transit``."""
    for held, duration in zip(planned.through_water.T, planned.durations, strict=True):
        start = fly(currents, start, begin, held, duration)[-1]
        begin = begin + duration
    return start


def path_of(
    currents: Currents, start: Complex, begin: float, planned: Transit
) -> tuple[Array, Complex]:
    """Return times [s] and places [m] along planned stretches of one current, shape (n,) each."""
    times, places = [np.array([begin])], [start[:1]]
    for held, duration in zip(planned.through_water.T, planned.durations, strict=True):
        path = fly(currents, places[-1][-1:], times[-1][-1], held, duration)[1:, 0]
        times.append(times[-1][-1] + duration * np.arange(1, len(path) + 1) / len(path))
        places.append(path)
    return np.concatenate(times), np.concatenate(places)


def end_sensitivity(
    currents: Currents, start: complex, begin: float, planned: Transit
) -> Sensitivity:
    """Return how the end of a planned stretch moves with the current: exact for its integration.

    Args:
        currents: One.
        start: [m].
        begin: [s].
        planned: One.
    """
    points, times, weights = list[Complex](), list[Array](), np.zeros((2, 0))
    for held, duration in zip(planned.through_water[0], planned.durations, strict=True):
        count = steps_of(duration)
        step = duration / count
        for k in range(count):
            start, there, moved, added = _step(currents, start, begin + k * step, held, step)
            weights = np.hstack([moved @ weights, added])
            points.append(there)
            times.append(begin + (k + np.array([share for share, _ in _STAGES])) * step)
        begin += duration
    return Sensitivity(np.concatenate(points), np.concatenate(times), weights)


def _step(
    currents: Currents, place: complex, time: float, held: complex, step: float
) -> tuple[complex, Complex, Array, Array]:
    """Return where a step ends, its stages' places, and its end's derivative by its start, (2, 2), and by the current there, (2, 8)."""
    slope, by_start, by_current = 0j, np.zeros((2, 2)), np.zeros((2, 8))
    places, total, of_start, of_current = list[complex](), 0j, np.eye(2), np.zeros((2, 8))
    for j, (share, weight) in enumerate(_STAGES):
        there = place + share * step * slope
        value, by_east, by_north = (
            one[0] for one in currents.with_gradient(np.array([there]), time + share * step)
        )
        gradient = _matrix(by_east, by_north)
        at_stage, from_stage = np.eye(2) + share * step * by_start, share * step * by_current
        slope, by_start, by_current = held + value, gradient @ at_stage, gradient @ from_stage
        by_current[:, 2 * j : 2 * j + 2] += np.eye(2)
        places.append(there)
        total += weight * step * slope
        of_start = of_start + weight * step * by_start
        of_current = of_current + weight * step * by_current
    return place + total, np.array(places), of_start, of_current


def _matrix(by_east: Complex, by_north: Complex) -> Array:
    """Return the gradient of a current, shape (..., 2, 2), from its derivatives."""
    return np.stack(
        [
            np.stack([by_east.real, by_north.real], axis=-1),
            np.stack([by_east.imag, by_north.imag], axis=-1),
        ],
        axis=-2,
    )


def _solved(derivative: Array, miss: Complex, duration: float) -> Complex:
    """Return the change of velocity that removes a miss, damped where the end is insensitive; at most twice that of still water."""
    still = miss / duration
    square = derivative.swapaxes(-1, -2) @ derivative + (0.05 * duration) ** 2 * np.eye(2)
    right = derivative.swapaxes(-1, -2) @ np.stack([miss.real, miss.imag], axis=-1)[..., None]
    change = np.linalg.solve(square, right)[..., 0]
    found = change[..., 0] + 1j * change[..., 1]
    return found * np.minimum(1.0, 2.0 * np.abs(still) / np.maximum(np.abs(found), 1e-12))


def _limited(velocity: Complex, speed: float) -> Complex:
    return velocity * np.minimum(1.0, speed / np.maximum(np.abs(velocity), 1e-12))
