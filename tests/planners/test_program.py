"""The program: its current and depth integrals against the flow, its plans against random missions and what more of something costs."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionRequest, MissionSettings, closest_approach, plan_mission
from planners.program.graph import HOUR, KM, Water
from planners.task import task_of
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    place,
    request_between,
    uniform_flow,
)
from tests.planners.pilot import currents

SETTINGS = MissionSettings(depth=300.0)


def test_the_current_of_the_program_is_that_of_each_level():
    flow = eddying_flow(2, speed=0.3)
    water = Water(task_of(flow, request_between(flow, (-5e3, 0.0), (5e3, 0.0), settings=SETTINGS)))
    for at in np.random.default_rng(0).uniform(-2e4, 2e4, (10, 2)):
        found = np.array(water.at(at / KM, 0.0)).reshape(-1, 2) * KM / HOUR
        levels = [flow.velocity(*at, float(z)) for z in flow.levels[: water.count]]
        np.testing.assert_allclose(found, levels, atol=2e-3)


def against(seed, speed):
    """Eddies of 5 cm/s RMS in wide functions, on a uniform current from ahead of some speed [m/s]."""
    ahead = uniform_flow(-1.0, 0.0)
    rough = np.random.default_rng(seed).standard_normal((len(ahead.latent), 1))
    eddies = replace(ahead, latent=rough * np.ones(ahead.levels.size))
    at_nodes = eddies.velocity(*ahead.nodes.T, 5.0)
    scale = 0.05 / np.sqrt(np.mean(np.sum(at_nodes**2, axis=1)))
    return replace(ahead, latent=speed * ahead.latent + scale * eddies.latent)


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
    free = plan_mission(flow, asked).duration
    hurried, later = (replace(SETTINGS, max_duration=share * free) for share in (1.02, 1.5))
    yield flow, replace(asked, settings=hurried), replace(asked, settings=later)
    yield [against(seed, speed) for speed in (0.12, 0.06)], asked, asked


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.full) for k in range(1, 40))]
)
def test_more_of_something_never_costs_time(seed):
    for flow, asked, more in freer(seed):
        flows = flow if isinstance(flow, list) else [flow] * 2
        less, freed = (plan_mission(*one) for one in zip(flows, (asked, more), strict=True))
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


def brute_search(flow, request, legs, headings=16, cell=1500.0):
    """Whether headings at the shallowest angle lead to the goal, when only the first way into each cell goes on."""
    frame, grid, vehicle = flow.grid.projection, flow.grid, request.vehicle
    front, goal = (
        np.array([to_local(frame, at.longitude, at.latitude)])
        for at in (request.start, request.goals[0])
    )
    low, high = (np.array([pick(grid.east), pick(grid.north)]) for pick in (np.min, np.max))
    along, down = (float(speed) for speed in vehicle.speeds(np, vehicle.angles[0]))
    ways = np.linspace(0.0, 2.0 * np.pi, headings, endpoint=False)
    new = np.ones(((high - low) // cell).astype(int) + 1, dtype=bool)
    deep, steps = request.settings.depth, 12
    dt = 2.0 * deep / down / steps
    for _ in range(legs):
        at, heading = np.repeat(front, headings, axis=0), np.tile(ways, len(front))
        through = along * np.column_stack([np.sin(heading), np.cos(heading)])
        for k in range(steps):
            z = np.full(len(at), deep * (1.0 - abs((k + 0.5) / (steps / 2) - 1.0)))
            half = at + 0.5 * dt * (through + currents(flow, flow.latent[None], at, z))
            at = at + dt * (through + currents(flow, flow.latent[None], half, z))
        if np.min(np.linalg.norm(at - goal, axis=1)) < request.settings.tolerance - 50.0:
            return True
        at = at[np.all((at > low) & (at < high), axis=1)]
        cells, first = np.unique(((at - low) // cell).astype(int), axis=0, return_index=True)
        front = at[first[new[tuple(cells.T)]]]
        new[tuple(cells.T)] = False
    return False


@pytest.mark.parametrize(
    "seed", [3, *(pytest.param(k, marks=pytest.mark.full) for k in range(40) if k != 3)]
)
def test_what_a_brute_search_over_headings_reaches_is_reached(seed):
    rng = np.random.default_rng(seed)
    flow = eddying_flow(seed, speed=rng.uniform(0.2, 0.5))
    settings = replace(SETTINGS, max_legs=16)
    ends = rng.uniform(-1.4e4, 1.4e4, (2, 2))
    request = request_between(flow, *ends, settings=settings)
    if brute_search(flow, request, 16):
        assert plan_mission(flow, request).status == "reached"
