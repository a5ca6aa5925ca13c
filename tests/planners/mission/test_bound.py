"""The lower bound of an arrival: no mission is below it, in currents up to twice the vehicle's speed, sheared ones and with drifts."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionRequest, MissionSettings, plan_mission
from planners.route.bound import bound_of
from planners.task import task_of
from planners.vehicle import SteadyFlight
from tests.planners.flow_samples import (
    eddying_flow,
    place,
    request_between,
    still_flow,
    uniform_flow,
)


def bounded(flow, asked):
    """Return a plan and the bound of its arrival, after having compared them."""
    plan, bound = plan_mission(flow, asked), bound_of(task_of(flow, asked))[1]
    assert plan.status == "reached"
    assert bound.time <= plan.goal_times[-1]
    above = float(plan.statistics.get("above_bound_percent", 0.0))
    assert above >= 0.0
    if bound.is_tight:
        told = float(plan.statistics["bound_h"]) * (1.0 + above / 100.0)
        assert plan.duration / 3600.0 == pytest.approx(told)
    # what is not near to what can be done is not told
    assert bound.is_tight or "lower bound" not in plan.message
    return plan, bound


def random_mission(seed, fastest=0.45):
    """Return a mission in eddies of up to twice the vehicle's 0.29 m/s."""
    rng = np.random.default_rng(seed)
    flow = eddying_flow(seed, speed=float(rng.uniform(fastest - 0.2, fastest)))
    ends = rng.uniform([-25e3, -15e3], [25e3, 15e3], (2, 2))
    settings = MissionSettings(depth=300.0, surface_time=300.0)
    return flow, request_between(flow, ends[0], ends[1], settings=settings)


# in the first two the lattice misses the way that the plan finds
@pytest.mark.parametrize("seed", [pytest.param(21, marks=pytest.mark.full), 107, 3])
def test_no_plan_is_below_its_bound_where_the_current_is_faster_than_the_vehicle(seed):
    _, bound = bounded(*random_mission(seed))
    assert not bound.is_tight
    assert bound.time > 0.0


@pytest.mark.full
@pytest.mark.parametrize("fastest", [0.2, 0.3, 0.45])
def test_no_plan_of_many_is_below_its_bound(fastest):
    told = [bounded(*random_mission(seed, fastest))[1].is_tight for seed in range(300, 310)]
    assert any(told)


def sheared(profile, speed=0.2):
    """Return an eastward current that is so many times a speed at each level, the same everywhere."""
    flow = uniform_flow(speed, 0.0)
    return replace(flow, latent=flow.latent * np.array(profile))


SURFACE, AGAINST = (1.0, 0.5, 0.0, 0.0, 0.0), (1.0, 0.5, -0.5, -1.0, -1.0)


@pytest.mark.parametrize(
    ("profile", "depth", "drift", "way", "below"),
    [
        # westward a drift carries the glider back: the last leg gains what it spares, and steep dives lose
        (SURFACE, 230.0, 3600.0, 1.5e3, 0.0),
        (SURFACE, 230.0, 3600.0, 1.5e3, 230.0),
        (AGAINST, 230.0, 3600.0, 15e3, 0.0),
        # a last dive to 40 m meets the surface current alone
        (tuple(-part for part in SURFACE), 390.0, 0.0, 5e3, 40.0),
    ],
)
def test_no_plan_is_below_its_bound_where_the_surface_moves_otherwise_than_the_water_below(
    profile, depth, drift, way, below
):
    flow = sheared(profile)
    settings = MissionSettings(depth=depth, surface_time=drift, tolerance=100.0)
    ends = place(flow, 0.5 * way, 0.0), (place(flow, -0.5 * way, 0.0, below),)
    bounded(flow, MissionRequest(*ends, settings=settings))


def test_no_plan_is_below_its_bound_that_starts_below_the_surface_or_is_quicker_at_steep_angles():
    flow = sheared(SURFACE)
    settings = MissionSettings(depth=230.0, surface_time=600.0)
    ends = (place(flow, -3e3, 0.0, 150.0), (place(flow, 4e3, 0.0),))
    bounded(flow, MissionRequest(*ends, settings=settings))
    # by a flight model a glider makes most way at some 35 degrees
    steep, still = Glider(flight=SteadyFlight()), still_flow()
    asked = request_between(
        still, (-8e3, 0.0), (8e3, 0.0), vehicle=steep, settings=replace(settings, surface_time=0.0)
    )
    _, bound = bounded(still, asked)
    fastest = max(float(steep.speeds(np, angle)[0]) for angle in np.linspace(*steep.angles, 200))
    assert bound.time == pytest.approx(0.998 * (16e3 - 250.0) / fastest, rel=2e-3)


def test_no_plan_is_below_its_bound_where_the_shear_comes_later():
    later, day = sheared(SURFACE), 86400 * 10**9
    through = [
        replace(later, latent=share * later.latent, time_ns=day + k * day // 8)
        for k, share in enumerate((0.0, 1.0))
    ]
    ends = place(later, 0.0, 0.0), (place(later, -4e3, 0.0),)
    settings = MissionSettings(depth=230.0, surface_time=3600.0, tolerance=100.0)
    asked = MissionRequest(*ends, settings=settings, start_time_ns=day)
    bounded(through, asked)


def test_in_a_uniform_current_the_bound_is_zermelos_to_the_disc_less_the_lattices_error():
    flow, current = uniform_flow(0.08, 0.05), np.array([0.08, 0.05])
    settings = MissionSettings(depth=300.0, surface_time=600.0)
    task = task_of(flow, request_between(flow, (-10e3, -2e3), (10e3, 4e3), settings=settings))
    way = task.goals[0, :2] - task.start[:2]
    share = 600.0 / task.leg_time(task.vehicle.angles[0])
    speed = (1.0 - share) * float(task.vehicle.speeds(np, task.vehicle.angles[0])[0])
    unit = way / np.linalg.norm(way)
    along, across = float(unit @ current), float(unit[0] * current[1] - unit[1] * current[0])
    exact = (np.linalg.norm(way) - settings.tolerance) / (along + np.sqrt(speed**2 - across**2))
    # the last leg arrives without the drift that the mean speed has
    assert 0.99 * exact < bound_of(task)[1].time + 600.0 < 0.9985 * exact
