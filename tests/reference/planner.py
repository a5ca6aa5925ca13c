"""The planner's slow twin: every heading and time to depth flown in the flow itself, the best polished without derivatives."""

import numpy as np
from scipy.optimize import minimize

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid


def exhaustive_closest_approach(
    flow: FlowEstimate,
    start: Array,
    goal: Array,
    speed: float,
    max_duration: float,
    *,
    headings: int = 360,
    times: int = 60,
    steps: int = 40,
) -> float:
    """Return the least closest approach [m] of all glides that reach the goal's depth, found by trying them.

    Args:
        flow: The current.
        start: shape (3,) [m], local east, north, depth.
        goal: shape (3,) [m], at another depth.
        speed: Through water [m/s].
        max_duration: [s].
        headings: Number of headings tried.
        times: Number of times to depth tried, evenly in the logarithm.
        steps: RK4 steps of a glide; twice as many where the best are polished.
    """
    shortest = max(abs(goal[2] - start[2]) / speed, 600.0)
    heading, duration = (
        a.ravel()
        for a in np.meshgrid(
            np.linspace(0, 2 * np.pi, headings, endpoint=False),
            np.geomspace(shortest, max_duration, times),
        )
    )
    tried = np.column_stack([heading, (goal[2] - start[2]) / (speed * duration), np.log(duration)])
    distance = _closest(flow, start, goal, speed, tried, steps)
    best = np.inf
    for i in np.argsort(distance, kind="stable")[:2]:
        simplex = tried[i] + np.vstack([np.zeros(3), np.diag([0.02, 0.05 * tried[i, 1], 0.03])])
        answer = minimize(
            lambda x: float(
                _closest(flow, start, goal, speed, _within(x, max_duration)[None], 2 * steps)[0]
            ),
            tried[i],
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 1e-6, "fatol": 1.0, "maxiter": 60},
        )
        best = min(best, float(answer.fun))
    return best


def _within(unknowns: Array, max_duration: float) -> Array:
    return np.array(
        [unknowns[0], np.clip(unknowns[1], -1.0, 1.0), min(unknowns[2], np.log(max_duration))]
    )


def _closest(
    flow: FlowEstimate, start: Array, goal: Array, speed: float, tried: Array, steps: int
) -> Array:
    """Return the least distance to the goal along straight legs between the steps, while the path stays inside the grid's box."""
    heading, sine, log_duration = tried.T
    level = speed * np.sqrt(1.0 - np.clip(sine, -1.0, 1.0) ** 2)
    through = np.column_stack([level * np.sin(heading), level * np.cos(heading), speed * sine])
    h = (np.exp(log_duration) / steps)[:, None]

    def rate(at: Array) -> Array:
        flowing = flow.velocity(at[:, 0], at[:, 1], at[:, 2])
        return through + np.column_stack([flowing, np.zeros(len(at))])

    at = np.tile(start, (len(tried), 1))
    best = np.linalg.norm(at - goal, axis=1)
    inside = np.full(len(tried), True)
    for _ in range(steps):
        k1 = rate(at)
        k2 = rate(at + h / 2 * k1)
        k3 = rate(at + h / 2 * k2)
        after = at + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(at + h * k3))
        inside &= (
            inside_grid(flow.grid, after[:, 0], after[:, 1])
            & (after[:, 2] > -1e-3)
            & (after[:, 2] < flow.levels[-1] + 1e-3)
        )
        leg = after - at
        share = np.clip(
            np.sum((goal - at) * leg, axis=1) / np.maximum(np.sum(leg**2, axis=1), 1e-12), 0.0, 1.0
        )
        best = np.where(
            inside, np.minimum(best, np.linalg.norm(at + share[:, None] * leg - goal, axis=1)), best
        )
        at = after
    return best
