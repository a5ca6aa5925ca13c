"""A glider's leg, from one surfacing to the next: heading and glide angle held, through depths that are known beforehand.

``fly_steps`` and ``fly_midpoints`` accept NumPy arrays and CasADi expressions. Depths are parameters: a yo passes the same depths at any
heading and glide angle, which only determine how long that takes.
"""

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from planners.flow import layer_function
from planners.spline import FlowSpline
from planners.track import fractions_of_duration
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import rate_in_frame
from replay_kit.core.grid import Projection

# Steps of the drift at the surface.
DRIFT_STEPS = 2
#: ``fly_steps`` or ``fly_midpoints``.
Integrator = Callable[[Callable[[Any, Any, Any], Any], Any, Any, Any, Any, int], list[tuple[Any, Any]]]


def fly_steps(
    rate: Callable[[Any, Any, Any], Any], place: Any, time: Any, depths: Any, durations: Any, count: int
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
        place, time = place + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth), time + step
        path.append((place, time))
    return path


def fly_midpoints(
    rate: Callable[[Any, Any, Any], Any], place: Any, time: Any, depths: Any, durations: Any, count: int
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
    least = np.array([1 + np.sum((levels > min(a, b)) & (levels < max(a, b))) for a, b in pairwise(depths)])
    counts = least.copy()
    for _ in range(n_steps - int(least.sum())):
        counts[np.argmax(distance / counts)] += 1
    parts = [a + (b - a) * fractions_of_duration(a, b, levels, int(n)) for a, b, n in zip(depths[:-1], depths[1:], counts, strict=True)]
    return np.concatenate([*(part[:-1] for part in parts), [depths[-1]]])


def step_stops(levels: Array, goal_depths: Array) -> Array:
    """Return the depths [m] at which steps end: the levels, shape (Z,), and those of goals below the surface."""
    return np.union1d(levels, goal_depths[goal_depths > 0.0])


def steps_needed(depths: tuple[float, ...], levels: Array, each: int) -> int:
    """Return the number of steps of a leg: ``each`` for a dive or climb, and one for each level crossed."""
    crossed = sum(int(np.sum((levels > min(a, b)) & (levels < max(a, b)))) for a, b in pairwise(depths))
    return crossed + each * (len(depths) - 1)


def stage_latent(latent: Array, levels: Array, functions: DepthFunctions, depths: Array) -> Array:
    """Return the latent velocities at each step's beginning, middle and end, and of the surface: shape (2N, (2 n_steps + 2) T).

    Args:
        latent: shape (2N, Z T), as ``field_function`` takes it.
        levels: shape (Z,) [m].
        functions: How levels combine.
        depths: shape (n_steps + 1,) [m].
    """
    stages = np.zeros(2 * depths.size)
    stages[:-1:2], stages[1:-2:2] = depths, 0.5 * (depths[:-1] + depths[1:])
    weights = depth_weights(functions, stages, levels)
    by_time = latent.reshape(len(latent), -1, levels.size) @ weights.T
    return by_time.transpose(0, 2, 1).reshape(len(latent), -1)


def leg_function(
    flow: FlowEstimate, vehicle: Glider, n_steps: int, times: Array | None, drifts: bool, spline: FlowSpline | None = None
) -> ca.Function:
    """Return the function of one leg: (place, time, heading, glide angle, depths, drift, latent) -> (places after each step, end time).

    Its last place is that after the drift at the surface, which takes the time ``drift`` [s].

    Args:
        flow: Any flow on the nodes; the function takes ``stage_latent``.
        vehicle: The glider.
        n_steps: Steps under water.
        times: As for ``field_function``.
        drifts: Whether there is a drift at the surface; if not, ``drift`` is ignored.
        spline: Used instead of the latent velocities, which are then empty.
    """
    layer, n_times = layer_function(flow, times), 1 if times is None else times.size
    place, time = ca.MX.sym("place", 2), ca.MX.sym("time")
    heading, angle, drift, depths = ca.MX.sym("heading"), ca.MX.sym("angle"), ca.MX.sym("drift"), ca.MX.sym("depths", n_steps + 1)
    latent: Any = ca.MX.sym("latent", len(flow.latent) if spline is None else 0, (2 * n_steps + 2) * n_times)
    stages = ca.horzsplit(latent, n_times)
    along, down = vehicle.speeds(ca, angle)
    durations = [ca.fabs(depths[i + 1] - depths[i]) / down for i in range(n_steps)]
    through = along * ca.vertcat(ca.sin(heading), ca.cos(heading))
    rate, turn, stretch = frame_function(flow.grid.projection)(place, through, sum(durations))

    def current(at: Any, stage: int, now: Any) -> Any:
        if spline is None:
            return layer(at if times is None else ca.vertcat(at, now), stages[stage])
        depth = 0.0 if stage < 0 else 0.5 * (depths[stage // 2] + depths[(stage + 1) // 2])
        return spline.function(ca.vertcat(at, depth))

    def over_ground(at: Any, stage: float, now: Any) -> Any:
        return rate + turn @ (at - place) + stretch @ current(at, round(stage), now)

    def drifting(at: Any, _: float, now: Any) -> Any:
        return stretch @ current(at, -1, now)

    # stages are numbered, two to a step, and the number takes the place of the depth
    path = fly_midpoints(over_ground, place, time, [2.0 * i for i in range(n_steps + 1)], durations, n_steps)
    if drifts:
        path.append(fly_midpoints(drifting, *path[-1], [0.0] * (DRIFT_STEPS + 1), [drift / DRIFT_STEPS] * DRIFT_STEPS, DRIFT_STEPS)[-1])
    inputs = [place, time, heading, angle, depths, drift, latent]
    options: dict[str, Any] = {"is_diff_in": [True, True, True, True, False, False, False], "never_inline": True, "cse": True}
    return ca.Function("leg", inputs, [ca.horzcat(*(at for at, _ in path)), path[-1][1]], options)


@lru_cache(maxsize=8)
def frame_function(projection: Projection) -> ca.Function:
    """Return the function of a leg that makes ``rate_in_frame`` linear: (place, velocity through water, duration) -> (rate, turn, stretch).

    A compass holds a heading of true north, which turns along the leg, and the frame stretches lengths. At a place x in a current u the
    local coordinates change by rate + turn (x - place) + stretch u, the slopes being those halfway along the leg: to a part in a million
    for a leg of 5 km.

    Args:
        projection: The local frame.
    """
    place, through, current = (ca.SX.sym(name, 2) for name in ("place", "through", "current"))
    duration, at = ca.SX.sym("duration"), ca.SX.sym("at", 2)
    exact = ca.vertcat(*rate_in_frame(projection, at[0], at[1], (through[0], through[1]), (current[0], current[1])))
    halfway = 0.5 * duration * through
    turn, stretch = (
        ca.substitute(ca.substitute(value, current, ca.DM.zeros(2)), at, place + halfway)
        for value in (ca.jacobian(exact, at), ca.jacobian(exact, current))
    )
    rate = ca.substitute(ca.substitute(exact, current, ca.DM.zeros(2)), at, place + halfway) - turn @ halfway
    return ca.Function("frame", [place, through, duration], [rate, turn, stretch], {"cse": True})
