"""A plan flown in another flow, such as a plan made on an estimate flown in the truth."""

import numpy as np

from planners.route.region import locate, region_of
from planners.track import fly_glide, fractions_of_duration, velocity_through_water
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import true_north_halfway
from replay_kit.core.plan import Plan

# A head current stronger than planned delays the closest approach; half as long again catches it, and a glide that has not come close
# by then has passed the goal.
_LONGER = 1.5
_FINER = 2


def fly(flow: FlowEstimate, plan: Plan) -> tuple[Array, Array, float]:
    """Return (time, track, closest approach) of a plan's heading and glide angle kept in a flow.

    The glide is flown for one and a half times the planned duration, or until it leaves the flow's region, meets land, surfaces or
    passes the deepest level. The closest approach is taken on the continuous path.

    Args:
        flow: Where to fly it; its projection may differ from that of the plan's flow.
        plan: The plan; one that failed stays where it is.

    Returns:
        Time, shape (n,) [s] since the start; track, shape (n, 3) [m], east, north, depth in the flow's local frame; distance [m].

    Raises:
        PlanError: The plan's start or goal is outside the flow's region or on land there.
    """
    region = region_of(flow.grid)
    start, goal = locate(region, plan.start, "start"), locate(region, plan.goal, "goal")
    duration = _LONGER * plan.duration
    if plan.status == "failed" or duration == 0.0:
        return np.zeros(1), start[None, :], float(np.linalg.norm(start - goal))
    turn = float(true_north_halfway(flow.grid.projection, start[None, :2], goal[None, :2])[0])
    velocity = np.array(
        velocity_through_water(
            np, np.deg2rad(plan.heading_deg) + turn, np.deg2rad(plan.glide_angle_deg), plan.speed
        )
    )
    n_steps = _FINER * plan.track_time.size + flow.levels.size
    fractions = fractions_of_duration(
        start[2], start[2] + velocity[2] * duration, flow.levels, n_steps
    )
    track = fly_glide(flow, start, velocity, fractions * duration)
    until = track.allowed_until(region.allowed)
    _, distance = track.closest(goal, until)
    time = np.append(track.time[track.time < until], until)
    return time, track.at(time), distance
