"""Paths of constant velocity through water: integrated with NumPy or CasADi, and their closest approach on the continuous path.

The integration steps are the same text for NumPy arrays and CasADi expressions, so that the optimiser and the check of its solution
cannot differ.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planners.flow import field_function
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import depth_weights

# Each round narrows the time of closest approach sixteenfold; five leave well under a millimetre.
_ZOOM_POINTS, _ZOOM_ROUNDS = 33, 5


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A path known at some times together with its velocity, so that it is continuous between them (cubic Hermite).

    Attributes:
        time: shape (n,) [s] since the start, increasing.
        position: shape (n, 3) [m], local east, north, depth.
        velocity: shape (n, 3) [m/s], over ground.
    """

    time: Array
    position: Array
    velocity: Array

    def at(self, time: Array) -> Array:
        """Return positions, shape (m, 3) [m], at times [s] within the track."""
        i = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, self.time.size - 2)
        step = (self.time[i + 1] - self.time[i])[:, None]
        s = (time - self.time[i])[:, None] / step
        begin, end = self.position[i], self.position[i + 1]
        bend = (
            s
            * (1.0 - s)
            * (
                (1.0 - s) * (step * self.velocity[i] - (end - begin))
                - s * (step * self.velocity[i + 1] - (end - begin))
            )
        )
        return begin + s * (end - begin) + bend

    def closest(self, goal: Array, until: float) -> tuple[float, float]:
        """Return (time [s], distance [m]) of the closest approach to a goal, shape (3,) [m], no later than ``until`` [s]."""
        inner = self.time[:-1, None] + np.diff(self.time)[:, None] * np.linspace(
            0.0, 1.0, 8, endpoint=False
        )
        times = np.append(inner[inner < until], until)
        for _ in range(_ZOOM_ROUNDS):
            distance = np.linalg.norm(self.at(times) - goal, axis=1)
            i = int(np.argmin(distance))
            best = float(times[i]), float(distance[i])
            times = np.linspace(
                times[max(i - 1, 0)], times[min(i + 1, times.size - 1)], _ZOOM_POINTS
            )
        return best

    def allowed_until(self, allowed: Callable[[Array], NDArray[np.bool_]]) -> float:
        """Return the last time [s] before the path first leaves what is allowed; the whole track when it never does."""
        outside = np.flatnonzero(~allowed(self.position))
        if outside.size == 0:
            return float(self.time[-1])
        if outside[0] == 0:
            return 0.0
        low, high = self.time[outside[0] - 1], self.time[outside[0]]
        # many times at once: to ask for one point costs nearly as much as for all
        while high - low > 1e-3:
            times = np.linspace(low, high, _ZOOM_POINTS)
            first = int(np.argmin(np.append(allowed(self.at(times[1:-1])), False))) + 1
            low, high = times[first - 1], times[first]
        return float(low)


def velocity_through_water(
    maths: Any, heading: Any, glide_angle: Any, speed: Any
) -> tuple[Any, Any, Any]:
    """Return the velocity through water [m/s] as (east, north, down) in the frame that the heading refers to.

    Args:
        maths: ``numpy`` or ``casadi``: where sine and cosine come from.
        heading: Clockwise from north [rad].
        glide_angle: Below the horizontal, positive down [rad].
        speed: Through water [m/s].
    """
    horizontal = speed * maths.cos(glide_angle)
    return (
        horizontal * maths.sin(heading),
        horizontal * maths.cos(heading),
        speed * maths.sin(glide_angle),
    )


def rk4_step(rate: Callable[[Any], Any], position: Any, step: Any, first: Any) -> Any:
    """Return the position one classical Runge-Kutta step later.

    Args:
        rate: Velocity over ground at a position.
        position: Where the step begins; a vector or a stack of them.
        step: Length of the step [s], a scalar or one that broadcasts against the positions.
        first: ``rate(position)``, which the caller often needs too.
    """
    second = rate(position + step / 2.0 * first)
    third = rate(position + step / 2.0 * second)
    fourth = rate(position + step * third)
    return position + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


def fractions_of_duration(
    start_depth: float, end_depth: float, levels: Array, n_steps: int
) -> Array:
    """Return where the steps of a steady glide end, shape (n_steps + 1,) from 0 to 1, with a step's end at each level crossed.

    Hats bend at the levels; a step across a bend would lose the integrator's order.

    Args:
        start_depth: [m].
        end_depth: [m].
        levels: shape (Z,) [m].
        n_steps: Number of steps, more than the number of levels crossed.
    """
    low, high = min(start_depth, end_depth), max(start_depth, end_depth)
    crossed = levels[(levels > low) & (levels < high)]
    knots = np.concatenate(
        [
            [0.0],
            np.sort((crossed - start_depth) / (end_depth - start_depth)) if crossed.size else [],
            [1.0],
        ]
    )
    share = np.diff(knots) * (n_steps - (knots.size - 1))
    counts = 1 + np.floor(share).astype(int)
    # What rounding down left over goes to the segments that lost most; a stable sort keeps it reproducible.
    counts[np.argsort(np.floor(share) - share, kind="stable")[: n_steps - counts.sum()]] += 1
    inner = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(knots[:-1], knots[1:], counts, strict=True)
    ]
    fractions: Array = np.concatenate([*inner, np.ones(1)])
    return fractions


def fly_glide(flow: FlowEstimate, start: Array, velocity: Array, time: Array) -> Track:
    """Return the track of a constant velocity through water in a flow, by RK4 between the given times.

    Args:
        flow: The current.
        start: shape (3,) [m], local east, north, depth.
        velocity: shape (3,) [m/s], through water.
        time: shape (n,) [s], from zero.
    """
    # The depths of all stages are known beforehand, so the contraction over the levels is done once: the rest is one small product a stage.
    steps = np.diff(time)
    depths = start[2] + velocity[2] * np.concatenate([time, time[:-1] + 0.5 * steps])
    latent = flow.latent @ depth_weights(flow.depth_functions, depths, flow.levels).T
    # of each step its middle twice, its end, and its end again as the next one's beginning
    numbers = [(time.size + i, time.size + i, i + 1, i + 1) for i in range(steps.size)]
    order = iter([0, *np.ravel(numbers)])

    def over_ground(position: Array) -> Array:
        current = flow.horizontal.velocity(position[None, :2], latent[:, next(order), None]).ravel()
        ground: Array = velocity + np.append(current, 0.0)
        return ground

    positions, velocities = [start], [over_ground(start)]
    for step in steps:
        positions.append(rk4_step(over_ground, positions[-1], step, velocities[-1]))
        velocities.append(over_ground(positions[-1]))
    return Track(time, np.array(positions), np.array(velocities))


def path_function(flow: FlowEstimate, n_steps: int) -> ca.Function:
    """Return the function (start, velocity, steps, latent) -> positions after each step.

    The steps are written out in it, so that its derivatives evaluate a flow's value and Jacobian once where all need them; of a
    function for one step each derivative would evaluate its own.
    """
    current = field_function(flow)
    of_inputs = (
        ("start", 3),
        ("velocity", 3),
        ("steps", n_steps),
        ("latent", flow.horizontal.size, flow.levels.size),
    )
    inputs: list[Any] = [ca.MX.sym(*what) for what in of_inputs]
    start, velocity, steps, latent = inputs

    def over_ground(at: Any) -> Any:
        return velocity + ca.vertcat(current(at, latent), 0.0)

    positions: list[Any] = [start]
    for i in range(n_steps):
        positions.append(rk4_step(over_ground, positions[-1], steps[i], over_ground(positions[-1])))
    options: dict[str, Any] = {
        "is_diff_in": [True, True, True, False],
        "never_inline": True,
        "cse": True,
    }
    return ca.Function("path", inputs, [ca.horzcat(*positions[1:])], options)
