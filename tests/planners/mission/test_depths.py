"""The depth of the dives and the speed of a propeller as controls, and the battery that limits them."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Bathymetry, Glider, MissionSettings, plan_mission
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import (
    eddying_flow,
    place,
    request_between,
    still_flow,
    uniform_flow,
)

SETTINGS = MissionSettings(depth=390.0, surface_time=600.0)
FLOW = eddying_flow(3, speed=0.2)
ASKED = request_between(FLOW, (-6e3, -4e3), (8e3, 3e3), settings=SETTINGS)
POWERED = Glider(1.0, volume=0.0, thrust=30.0, hotel=2.0)


def planned(flow=FLOW, asked=ASKED, **settings):
    return plan_mission(flow, replace(asked, settings=replace(asked.settings, **settings)))


@pytest.mark.full
def test_a_range_of_depths_is_no_slower_than_any_depth_in_it():
    free = planned(depths=(150.0, 390.0))
    fixed = [planned(depth=depth).duration for depth in (150.0, 390.0)]
    assert free.status == "reached"
    assert free.duration <= 1.01 * min(fixed)
    assert free.duration < fixed[-1]
    depths = [max(leg) for leg in free.yo_depths]
    assert min(depths) >= 150.0
    assert max(depths) <= 390.0


def test_a_goal_below_the_surface_is_passed_by_dives_of_a_range():
    flow = uniform_flow(0.1, -0.1)
    goals = place(flow, 5e3, -6e3, 200.0), place(flow, 1e3, -3e3, 100.0)
    asked = replace(request_between(flow, (-6e3, 2e3), (0.0, 0.0), settings=SETTINGS), goals=goals)
    found = planned(flow, asked, depths=(100.0, 390.0))
    assert found.status == "reached"
    assert max(found.yo_depths[found.goal_legs[0] - 1]) >= 200.0
    assert max(found.closest_approach) < found.settings.tolerance


def test_a_range_below_the_bottom_is_refused_with_what_there_is():
    flow = still_flow()
    longitude, latitude = np.meshgrid([150.0, 155.0], [-42.0, -38.0])
    shallow = replace(
        request_between(flow, (-5e3, 0.0), (5e3, 0.0), settings=SETTINGS),
        bathymetry=Bathymetry(longitude, latitude, np.full((2, 2), 120.0)),
    )
    with pytest.raises(PlanError, match=r"expected a depth from 300 m.* to 100 m"):
        planned(flow, shallow, depths=(300.0, 390.0))
    found = planned(flow, shallow, depths=(50.0, 390.0))
    assert found.status == "reached"
    # an earliest arrival is known for one depth alone
    assert "bound_h" not in found.statistics


@pytest.mark.parametrize("depths", [(-1.0, 300.0), (300.0, 200.0), (100.0, np.inf)])
def test_ends_that_are_no_range_are_refused(depths):
    with pytest.raises(PlanError, match="expected two increasing numbers"):
        MissionSettings(depths=depths)


def test_power_grows_with_the_cube_of_a_propellers_speed_and_least_energy_is_between_the_ends():
    flow = still_flow()
    asked = request_between(flow, (-4e3, 0.0), (4e3, 0.0), vehicle=POWERED, settings=SETTINGS)
    fast = planned(flow, asked, depth=100.0, speeds=(0.2, 1.0))
    assert fast.vehicle.speed == 1.0
    assert "bound_h" not in fast.statistics
    assert fast.energy == pytest.approx((2.0 + 30.0 * 1.0**3) * fast.duration)
    frugal = planned(flow, asked, depth=100.0, speeds=(0.2, 1.0), objective="energy")
    # (hotel + thrust v^3) / v is least where v^3 = hotel / (2 thrust), but for drifts at the surface
    assert frugal.vehicle.speed == pytest.approx((2.0 / 60.0) ** (1.0 / 3.0), rel=0.25)
    # within the battery the quickest, and no more than it
    between = planned(flow, asked, depth=100.0, speeds=(0.2, 1.0), battery=2.0 * frugal.energy)
    assert between.status == "reached"
    assert between.energy <= 2.0 * frugal.energy
    assert frugal.duration > between.duration > fast.duration
