"""What the front tells a mission: its bound, how many legs, a goal by a wall, a pilot's habit, the rest of a plan that goes astray."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionSettings, plan_mission
from planners.route.bound import _second_order, bound_of
from planners.route.current import shares_of_levels
from planners.task import task_of
from replay_kit.core.arrays import Array
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


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_mission_is_told_against_a_bound_that_it_does_not_beat(seed):
    flow = eddying_flow(seed, speed=0.1)
    plan = plan_mission(flow, request_in(flow, (-12e3, -3e3), (9e3, 6e3)))
    above = float(plan.statistics["above_bound_percent"])
    assert plan.status == "reached"
    assert 0.0 < above < 8.0
    assert (
        f"{above:.1f} % above the earliest arrival that any vehicle of this speed could make"
        in plan.message
    )
    assert plan.duration / 3600.0 == pytest.approx(
        float(plan.statistics["bound_h"]) * (1.0 + above / 100.0)
    )


def test_the_shear_that_raises_the_bounds_speed_is_that_of_the_region(monkeypatch):
    flow = eddying_flow(1, speed=0.1)
    low, high = (
        np.array([pick(flow.grid.east), pick(flow.grid.north)]) for pick in (np.min, np.max)
    )
    begin, end = (tuple(share * high) for share in (0.9, 0.2))
    task = task_of(flow, request_in(flow, begin, end))
    seen, kind = list[Array](), type(flow.horizontal)
    velocity = kind.velocity
    monkeypatch.setattr(
        kind,
        "velocity",
        lambda self, points, latent: (seen.append(points), velocity(self, points, latent))[1],
    )
    # functions on a lattice are no current at all beyond it
    water, _ = bound_of(task)
    points = np.concatenate(seen)
    assert np.all((points >= low - 1.0) & (points <= high + water.current.spacing))


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


def test_what_shear_gives_grows_with_its_square_and_a_dive_s_time_and_is_none_without():
    task = task_of(eddying_flow(1), request_in(eddying_flow(1), (-10e3, -2e3), (10e3, 4e3)))
    gain = _second_order(task)
    assert 0.0 < gain < 0.1
    assert (
        _second_order(task_of(still_flow(), request_in(still_flow(), (-10e3, -2e3), (10e3, 4e3))))
        == 0.0
    )
    twice = replace(eddying_flow(1), latent=2.0 * eddying_flow(1).latent)
    assert _second_order(
        task_of(twice, request_in(twice, (-10e3, -2e3), (10e3, 4e3)))
    ) == pytest.approx(4.0 * gain)
    # Wirtinger's bound of the largest mean square deviation anywhere, looked for place by place
    flow, share = task.flow, SETTINGS.surface_time / task.leg_time(task.vehicle.angles[0])
    shares = shares_of_levels(flow, SETTINGS.depth, share)
    places = np.random.default_rng(0).uniform(-20e3, 20e3, (300, 2))
    squares = []
    for where in places:
        at = np.array([flow.velocity(*where, level) for level in flow.levels])
        squares.append(
            sum(
                part * np.sum((one - shares @ at) ** 2)
                for part, one in zip(shares, at, strict=True)
            )
        )
    length = min(flow.horizontal.kernel.length_east, flow.horizontal.kernel.length_north)
    dive = task.leg_time(task.vehicle.angles[0])
    assert gain == pytest.approx(dive * max(squares) / (2.0 * np.pi * length), rel=0.5)


def test_a_goal_by_a_wall_is_reached_though_the_margin_would_forbid_it():
    flow = still_flow()
    area = forbidden(flow, 11.0, -4e3, 3e3, 4e3)
    asked = request_in(flow, (-8e3, 1e3), (0.0, 0.0), no_go=(area,))
    assert plan_mission(flow, asked).status == "reached"
    assert np.isfinite(bound_of(task_of(flow, asked))[1].time)
