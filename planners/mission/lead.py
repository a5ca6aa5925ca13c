"""How far legs may lead a glider ahead of the vehicle that bounds its arrival, which has one speed in the mean current of dives and drifts.

A leg of duration T at glide angle g, and a drift d after it, lead over ground by V(g) T through water and by what the current gives: over
the leg's own depths and at the surface. In the same time the vehicle of the bound goes S (T + d), beside the mean current m (T + d). Steep
dives are short, so that the drifts between them are a larger part of the time; the last leg has no drift, may end at a depth, and the first
may begin at one. Where the current differs between the surface and below, each of these may gain on the mean.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planners.front.current import shares_of_levels
from planners.mission.task import MissionTask, YoDepths
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights

# Kernel lengths around start and goals within which shear counts, and points that it is looked up at in each.
_AROUND, _SAMPLES = 1.5, 2.0
# Glide angles, and depths of a dive, among which the largest lead is sought.
_ANGLES, _DEPTHS = 16, 101


@dataclass(frozen=True, slots=True, eq=False)
class Lead:
    """What the vehicle of a bound is given so that no mission leads ahead of it.

    Attributes:
        speed: Through water, horizontal [m/s].
        start: How far from the start it may begin [m].
        goals: shape (G,) [m], how far from each goal it may pass, beside the tolerance.
    """

    speed: float
    start: float
    goals: Array


def lead_of(task: MissionTask, by_level: Array) -> Lead:
    """Return the lead of a mission.

    Args:
        task: The mission.
        by_level: shape (2, n, Z) [m/s], the current of each level wherever and whenever it may be met.
    """
    drift, (first, full, last) = (
        task.settings.surface_time,
        (task.yo_depths(3)[k] for k in range(3)),
    )
    speed = float(np.max(np.divide(*_ways(task, by_level, full, drift))))

    def ahead(leg: YoDepths, then: float = 0.0) -> float:
        way, lasts = _ways(task, by_level, leg, then)
        # whole legs are not ahead but for rounding
        return max(round(float(np.max(way - speed * lasts)), 3), 0.0)

    goals = [
        # a goal on the way is passed within a dive, or after a whole leg and its drift
        max((ahead(part) for part in _down_to(full, float(depth))), default=0.0)
        for depth in task.goals[:-1, 2]
    ]
    return Lead(
        speed,
        ahead(first, drift),
        np.array([*goals, max(ahead(last), ahead(task.yo_depths(1)[0]))]),
    )


def currents_around(task: MissionTask, latent: Array) -> Array:
    """Return the current of each level [m/s], shape (2, n, Z), at places around start and goals, in all of T times.

    Args:
        task: The mission.
        latent: shape (M, Z T), all levels of the first time first.
    """
    flow = task.flow
    kernel, ends = flow.horizontal.kernel, np.vstack([task.start, task.goals])[:, :2]
    lengths = np.array([kernel.length_east, kernel.length_north])
    # beyond its region the flow is no estimate of a current
    corners = np.array(
        [[pick(axis) for axis in (flow.grid.east, flow.grid.north)] for pick in (np.min, np.max)]
    )
    low, high = np.clip(
        [ends.min(axis=0) - _AROUND * lengths, ends.max(axis=0) + _AROUND * lengths], *corners
    )
    counts = np.ceil((high - low) / lengths * _SAMPLES).astype(int) + 1
    points = np.stack(
        np.meshgrid(*(np.linspace(low[i], high[i], counts[i]) for i in (0, 1))), axis=-1
    ).reshape(-1, 2)
    return np.asarray(flow.horizontal.velocity(points, latent)).reshape(2, -1, flow.levels.size)


def _ways(task: MissionTask, by_level: Array, leg: YoDepths, drift: float) -> tuple[Array, Array]:
    """Return how far a leg and a drift [s] lead at some glide angles at most, beside the mean current [m], and how long they last [s]."""
    flow, whole, shallowest = task.flow, task.settings.surface_time, task.vehicle.angles[0]
    along, down = task.vehicle.speeds(np, np.linspace(*task.vehicle.angles, _ANGLES))
    dives, heights = zip(
        *((_mean_weights(task, begin, end), abs(end - begin)) for begin, end in pairwise(leg)),
        strict=True,
    )
    lasts = sum(heights) / np.asarray(down)
    own = np.average(dives, axis=0, weights=heights)
    surface = depth_weights(flow.depth_functions, np.zeros(1), flow.levels)[0]
    mean = shares_of_levels(flow, task.settings.depth, whole / task.leg_time(shallowest))
    weights = lasts[:, None] * own + drift * surface - (lasts + drift)[:, None] * mean
    beside = np.linalg.norm(by_level @ weights.T, axis=0).max(axis=0)
    return np.asarray(along * lasts + beside), lasts + drift


def _mean_weights(task: MissionTask, begin: float, end: float) -> Array:
    """Return the weights of the levels, shape (Z,), in the mean between two depths [m]."""
    return np.asarray(
        depth_weights(
            task.flow.depth_functions, np.linspace(begin, end, _DEPTHS), task.flow.levels
        ).mean(axis=0)
    )


def _down_to(leg: YoDepths, depth: float) -> list[YoDepths]:
    """Return the parts of a leg up to where it passes a depth [m] below the surface."""
    passes = [
        k
        for k, (begin, end) in enumerate(pairwise(leg))
        if min(begin, end) < depth <= max(begin, end)
    ]
    return [(*leg[: k + 1], depth) for k in passes]
