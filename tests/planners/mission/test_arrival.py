"""What the front tells a mission: its bound, how many legs, a goal by a wall, a pilot's habit, the rest of a plan that goes astray."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionSettings, plan_mission
from planners.route.bound import bound_of
from planners.task import task_of
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    request_between,
    still_flow,
    uniform_flow,
)

SETTINGS = MissionSettings(depth=300.0, surface_time=600.0)


def request_in(flow, begin, end, **more):
    asked = request_between(flow, begin, end, settings=SETTINGS)
    return replace(asked, **more)


def test_a_mission_is_told_against_a_bound_that_it_does_not_beat():
    flow = eddying_flow(1, speed=0.1)
    plan = plan_mission(flow, request_in(flow, (-12e3, -3e3), (9e3, 6e3)))
    above = float(plan.statistics["above_bound_percent"])
    assert plan.status == "reached"
    assert 0.0 < above < 8.0
    assert f"{above:.1f} % above the lower bound of the arrival time at this speed" in plan.message
    assert plan.duration / 3600.0 == pytest.approx(
        float(plan.statistics["bound_h"]) * (1.0 + above / 100.0)
    )


def test_in_a_uniform_current_the_bound_is_zermelos_to_the_disc_less_the_lattices_error():
    flow = uniform_flow(0.08, 0.05)
    task = task_of(flow, request_in(flow, (-10e3, -2e3), (10e3, 4e3)))
    _, bound = bound_of(task)
    way, current = task.goals[0, :2] - task.start[:2], np.array([0.08, 0.05])
    share = SETTINGS.surface_time / task.leg_time(task.vehicle.angles[0])
    speed = (1.0 - share) * float(task.vehicle.speeds(np, task.vehicle.angles[0])[0])
    unit = way / np.linalg.norm(way)
    along, across = float(unit @ current), float(unit[0] * current[1] - unit[1] * current[0])
    exact = (np.linalg.norm(way) - SETTINGS.tolerance) / (along + np.sqrt(speed**2 - across**2))
    # the last leg arrives without the drift that the mean speed has
    assert 0.99 * exact < bound.time + SETTINGS.surface_time < 0.9985 * exact


def test_a_goal_by_a_wall_is_reached_though_the_margin_would_forbid_it():
    flow = still_flow()
    area = forbidden(flow, 11.0, -4e3, 3e3, 4e3)
    asked = request_in(flow, (-8e3, 1e3), (0.0, 0.0), no_go=(area,))
    assert plan_mission(flow, asked).status == "reached"
    assert np.isfinite(bound_of(task_of(flow, asked))[1].time)
