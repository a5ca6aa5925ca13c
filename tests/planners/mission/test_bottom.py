"""Missions over a bottom: they turn above it, go round what is too shallow, and never go below it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from scipy.interpolate import RegularGridInterpolator

from planners import Bathymetry, MissionSettings, plan_mission
from planners.clearance import check, clearances
from planners.simulation.fly import Flight, Flights
from planners.task import task_of
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic
from tests.planners.flow_samples import eddying_flow, request_between, still_flow

LONGITUDE, LATITUDE = np.linspace(151.9, 153.1, 121), np.linspace(-40.45, -39.55, 91)


def bathymetry(depth):
    """Return a bathymetry of a function of longitude and latitude."""
    longitude, latitude = np.meshgrid(LONGITUDE, LATITUDE)
    return Bathymetry(
        longitude,
        latitude,
        np.broadcast_to(depth(longitude, latitude), longitude.shape).astype(float),
    )


def least_height(flow, track, bottom):
    """Return the least height [m] of a track above the bottom, linear between its points, at steps of a metre."""
    fine = [np.linspace(a, b, int(np.linalg.norm(b - a)) + 2) for a, b in pairwise(track)]
    points = np.concatenate(fine)
    longitude, latitude = to_geographic(flow.grid.projection, points[:, 0], points[:, 1])
    depth = RegularGridInterpolator((LATITUDE, LONGITUDE), bottom.depth)(
        np.column_stack([latitude, longitude])
    )
    return float(np.min(depth - points[:, 2]))


def request(flow, begin, end, depth, bottom):
    settings = MissionSettings(depth=depth, max_legs=90)
    return request_between(flow, (begin, 0.0), (end, 0.0), settings=settings, bathymetry=bottom)


def turns(plan):
    return [max(leg) for leg in plan.yo_depths]


def test_the_mask_limits_dives_where_no_bathymetry_is_given():
    flow = still_flow()
    wet = flow.grid.wet.copy()
    wet[3:] = False
    shelf = replace(flow, grid=replace(flow.grid, wet=wet))
    plan = plan_mission(shelf, request(shelf, -3e3, 3e3, 300.0, None))
    assert (plan.status, set(turns(plan))) == ("reached", {110.0})


def test_from_the_shelf_into_deep_water_each_dive_turns_above_the_bottom_beneath_it():
    flow = eddying_flow(3, speed=0.1)
    # a wall at 152.5 degrees: 120 m west of it, 900 m east of it
    bottom = bathymetry(lambda x, y: np.where(x < 152.5, 120.0, 900.0))
    plan = plan_mission(flow, request(flow, -4e3, 6e3, 390.0, bottom))
    assert plan.status == "reached"
    depths = turns(plan)
    assert depths[0] == 100.0
    assert max(depths) == 390.0
    assert depths == sorted(depths)
    assert least_height(flow, plan.track, bottom) >= 20.0 - 1e-3


@pytest.mark.full
@pytest.mark.parametrize(("edge", "least"), [(-40.005, 390.0), (-40.03, 130.0)])
def test_a_bank_is_gone_round_at_full_depth_where_that_is_quicker_than_shallow_dives(edge, least):
    flow = still_flow()
    bottom = bathymetry(
        lambda x, y: np.where((np.abs(x - 152.5) < 0.02) & (y > edge), 150.0, 900.0)
    )
    plan = plan_mission(flow, request(flow, -7e3, 7e3, 390.0, bottom))
    assert (plan.status, min(turns(plan)), max(turns(plan))) == ("reached", least, 390.0)
    assert least_height(flow, plan.track, bottom) >= 20.0 - 1e-3


def test_a_start_or_a_goal_without_room_for_a_dive_cannot_be_asked_for():
    flow, bottom = still_flow(), bathymetry(lambda x, y: np.where(x < 152.5, 25.0, 900.0))
    with pytest.raises(
        PlanError,
        match="start is too shallow for dives to 10 m: the bottom less a clearance of 20 m leaves 5 m",
    ):
        plan_mission(flow, request(flow, -4e3, 6e3, 300.0, bottom))
    with pytest.raises(PlanError, match="goal is too shallow for dives to 10 m"):
        plan_mission(flow, request(flow, 6e3, -4e3, 300.0, bottom))
    deep = request(flow, 4e3, 6e3, 300.0, bathymetry(lambda x, y: 100.0 + 0.0 * x))
    with pytest.raises(PlanError, match="goal is too shallow for dives to 90 m"):
        plan_mission(flow, replace(deep, goals=(replace(deep.goals[0], depth=90.0),)))


def test_shallows_count_for_the_legs_that_dive_too_deep_for_them():
    flow, bottom = still_flow(), bathymetry(lambda x, y: np.where(x < 152.5, 900.0, 100.0))
    task = task_of(flow, request(flow, -3e3, 6e3, 300.0, bottom))
    east, shift = np.array([-4.2e3, -3e3, -1.8e3, 100.0, 2e3]), np.array([0.0, -400.0])
    place_ = np.stack([np.column_stack([east + d, np.zeros(5)]) for d in shift])
    leg, ends = np.array([0, 0, 0, 1, 1]), np.array([2, 4])
    first = Flight(
        np.tile(np.arange(5) * 3600.0, (len(place_), 1)),
        np.array([0.0, 300.0, 0.0, 60.0, 0.0]),
        place_,
        leg,
        ends,
    )
    rings = shapely.unary_union([ring.area for ring in task.bottom.rings(300.0)])
    apart = [shapely.distance(rings, shapely.linestrings(path[:3])) for path in place_]
    assert apart[0] < 1.2e3 < apart[1] == pytest.approx(apart[0] + 400.0)
    none = np.zeros((2, 1))
    flown = Flights(none, none, place_, first.time, np.tile(first.depth, (2, 1)), leg, ends)
    found = clearances(task, flown)
    # the edge of the region is far
    (shallows,) = found
    assert shallows == "shallower than 320 m"
    # the second leg dives above the bottom; the second flight is farther from the shallows than a step of its first leg is long
    np.testing.assert_allclose(found[shallows], [apart[0], np.inf])
    assert check(task, replace(first, place=place_[:1])) is None
    # it counts once it dives below what there is, and then both flights are
    lower = np.tile([0.0, 300.0, 0.0, 200.0, 0.0], (2, 1))
    deep = clearances(task, replace(flown, depth=lower))
    assert set(deep) == {shallows, "shallower than 220 m"}
    assert np.all(deep["shallower than 220 m"] <= 0.0)
    # over all the region's shallows, where no cell is beside a deeper one
    flat = task_of(flow, request(flow, -3e3, 6e3, 50.0, bathymetry(lambda x, y: 100.0 + 0.0 * x)))
    np.testing.assert_array_equal(clearances(flat, flown)["the bottom"], 0.0)
