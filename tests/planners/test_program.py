"""The program: its current and depth integrals against the flow, its plans against random missions and what more of something costs."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionRequest, MissionSettings, closest_approach, plan_mission
from planners.program.solve import parts_of
from planners.route.passage import by_rays, mean_current, passage
from planners.task import task_of
from planners.water import HOUR, KM, Water
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    place,
    request_between,
    still_flow,
    uniform_flow,
)
from tests.record import missions

SETTINGS = MissionSettings(depth=300.0)


def test_the_current_of_the_program_is_that_of_each_level():
    flow = eddying_flow(2, speed=0.3)
    water = Water(task_of(flow, request_between(flow, (-5e3, 0.0), (5e3, 0.0), settings=SETTINGS)))
    for at in np.random.default_rng(0).uniform(-2e4, 2e4, (10, 2)):
        found = np.array(water.at(at / KM, 0.0)).reshape(-1, 2) * KM / HOUR
        levels = [flow.velocity(*at, float(z)) for z in flow.levels[: water.count]]
        np.testing.assert_allclose(found, levels, atol=2e-3)


@pytest.mark.parametrize("yos", [1, 2, 3, 5])
@pytest.mark.parametrize("segments", [1, 2, 4])
def test_segments_pass_depths_as_a_walk_along_the_dives_does(yos, segments):
    passes, whole, half = parts_of(yos, segments)
    way = np.linspace(0.0, 2.0 * yos, 4000 * yos + 1)
    depth = 1.0 - np.abs(way % 2.0 - 1.0)
    # any weight over depth will do; its integrals down to half and to all of it
    weight = 1.0 + depth**2
    whole_of, half_of = 1.0 + 1.0 / 3.0, 0.5 + 0.125 / 3.0
    parts = np.array_split(np.arange(way.size - 1), segments)
    for k, part in enumerate(parts):
        ends = np.append(part, part[-1] + 1)
        walked = float(np.trapezoid(weight[ends], way[ends]))
        assert passes[k] == pytest.approx(2.0 * yos / segments)
        if segments == 4 or half[k] == 0.0:
            assert whole[k] * whole_of + half[k] * half_of == pytest.approx(walked, rel=1e-5)


def test_rays_find_the_way_of_the_front_where_the_vehicle_is_faster():
    flow = eddying_flow(5, speed=0.15)
    task = task_of(flow, request_between(flow, (-9e3, -4e3), (9e3, 5e3), settings=SETTINGS))
    mean = mean_current(task)
    rays, front = by_rays(task, mean), passage(task, mean)
    assert rays is not None
    assert rays.passed[-1] == pytest.approx(front.passed[-1], rel=0.02)


@pytest.mark.parametrize(("name", "number", "hours"), [("strong", 8, 95.0), ("three", 1, 30.5)])
def test_missions_that_0_3_planned_worse_are_planned_better(name, number, hours):
    answer = missions.answers(name, {number})[str(number)]
    assert answer["status"] == "reached"
    assert answer["hours"] < hours
    assert answer["miss"] < 255.0
    assert answer.get("clearance", 50.0) > 45.0


def freer(seed):
    """Yield pairs of missions in an eddying flow, the second with more of something."""
    flow = eddying_flow(seed, speed=0.12)
    asked = request_between(flow, (-9e3, -2e3), (9e3, 3e3), settings=SETTINGS)
    walls = tuple(forbidden(flow, -1e3 + 3e3 * k, -4e3, 3e3 * k, 2e3) for k in (-1, 1))
    yield flow, replace(asked, no_go=walls), replace(asked, no_go=walls[:1])
    shallow = replace(SETTINGS, depths=(100.0, 200.0))
    deeper = replace(SETTINGS, depths=(100.0, 300.0))
    yield flow, replace(asked, settings=shallow), replace(asked, settings=deeper)
    few, many = (replace(SETTINGS, max_legs=count) for count in (12, 40))
    yield flow, replace(asked, settings=few), replace(asked, settings=many)
    fast = replace(asked, vehicle=Glider(speed=0.33))
    yield flow, asked, fast


@pytest.mark.parametrize(
    "seed", [*range(2), *(pytest.param(k, marks=pytest.mark.full) for k in range(2, 40))]
)
def test_more_of_something_never_costs_time(seed):
    for flow, asked, more in freer(seed):
        less, freed = plan_mission(flow, asked), plan_mission(flow, more)
        assert freed.status == "reached", freed.message
        assert less.status != "reached" or freed.duration <= 1.01 * less.duration


@pytest.mark.parametrize("depths", [(0.0, 400.0), (350.0, 120.0), (200.0, 200.0)])
def test_a_glide_passes_its_goal_at_one_velocity_through_water(depths):
    flow = eddying_flow(6, speed=0.2)
    start, goal = place(flow, -9e3, -3e3, depths[0]), place(flow, 7e3, 4e3, depths[1])
    plan = plan_mission(flow, MissionRequest(start, (goal,), settings=replace(SETTINGS, yos=0)))
    assert (plan.status, len(plan.headings_deg)) == ("reached", 1)
    assert plan.closest_approach[0] < 0.1
    assert closest_approach(flow, plan) < 1.0
    way = 0.3 * plan.duration * np.sin(np.deg2rad(plan.glide_angles_deg[0]))
    assert way == pytest.approx(max(abs(depths[1] - depths[0]), 0.01), rel=1e-3)


def test_a_glide_heads_off_a_uniform_current():
    flow = uniform_flow(0.0, 0.1)
    start, goal = place(flow, -6e3, 0.0, 0.0), place(flow, 6e3, 0.0, 300.0)
    plan = plan_mission(flow, MissionRequest(start, (goal,), settings=replace(SETTINGS, yos=0)))
    assert plan.headings_deg[0] == pytest.approx(90.0 + np.rad2deg(np.arcsin(1.0 / 3.0)), abs=0.2)


def test_a_battery_is_kept_by_a_slower_propeller():
    flow = still_flow()
    vehicle = Glider(volume=0.0, thrust=30.0, hotel=2.0)
    settings = MissionSettings(depth=100.0, speeds=(0.2, 1.0))
    asked = request_between(flow, (-4e3, 0.0), (4e3, 0.0), vehicle=vehicle, settings=settings)
    fast = plan_mission(flow, asked)
    half = replace(asked, settings=replace(settings, battery=0.5 * fast.energy))
    slower = plan_mission(flow, half)
    assert slower.status == "reached"
    assert slower.energy == pytest.approx(0.5 * fast.energy, rel=0.01)
    assert slower.vehicle.speed < fast.vehicle.speed
