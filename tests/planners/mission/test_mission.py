"""Missions: still water, a uniform current, forbidden areas, what cannot be reached, what cannot be asked."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionSettings, Weights, plan_mission
from replay_kit.core.plan import Place
from tests.planners.flow_samples import (
    eddying_flow,
    plan_between,
    request_between,
    still_flow,
    uniform_flow,
)

GLIDER = Glider()
SETTINGS = MissionSettings(depth=300.0)
FLAT = np.deg2rad(15.0)


def test_still_water_is_crossed_straight_at_the_shallowest_angle_that_fits():
    flow = still_flow()
    result = plan_between(flow, (-12e3, 0.0), (4e3, 9e3), settings=SETTINGS)
    way, legs = float(np.hypot(16e3, 9e3)), len(result.headings_deg)
    # n dives to 300 m at the glide angle a lead 600 n / tan(a) metres far
    assert result.status == "reached"
    assert legs == np.ceil(way / (600.0 / np.tan(FLAT)))
    assert result.duration == pytest.approx(
        way / 0.3 / np.cos(np.arctan(600.0 * legs / way)), rel=1e-4
    )
    np.testing.assert_allclose(
        result.glide_angles_deg, np.rad2deg(np.arctan(600.0 * legs / way)), atol=0.1
    )
    assert result.closest_approach[0] < 1.0
    assert result.energy == pytest.approx(
        GLIDER.hotel * result.duration + legs * GLIDER.pump_work(300.0), rel=1e-12
    )
    assert result.surfacing_times[-1] == result.duration == result.track_time[-1]


def test_a_warm_start_ends_where_the_cold_one_does_and_goes_on_from_the_next_surfacing():
    flow = eddying_flow(6)
    asked = request_between(flow, (-9e3, -6e3), (9e3, 6e3), settings=SETTINGS)
    cold = plan_mission(flow, asked)
    again = plan_mission(flow, asked, warm=cold)
    assert again.duration == pytest.approx(cold.duration, rel=1e-4)
    assert again.statistics["attempts"] == 1
    here = Place(*(float(x) for x in cold.surfacings[1]), 0.0)
    then = replace(asked, start=here, start_time_ns=int(cold.surfacing_times[1] * 1e9))
    later = plan_mission(flow, then, warm=cold)
    assert len(later.headings_deg) == len(cold.headings_deg) - 2
    assert later.duration == pytest.approx(cold.duration - cold.surfacing_times[1], rel=1e-3)


def test_a_flow_that_changes_is_planned_in_as_it_will_be():
    first = replace(uniform_flow(0.0, 0.0), time_ns=0)
    later = replace(uniform_flow(0.0, 0.12), time_ns=int(6e4 * 1e9))
    asked = request_between(first, (-8e3, 0.0), (8e3, 0.0), settings=SETTINGS)
    result = plan_mission((first, later), asked)
    drift = 0.12 * result.duration**2 / 2.0 / 6e4
    assert result.status == "reached"
    east, north = 0.3 * np.cos(np.deg2rad(result.glide_angles_deg)), np.deg2rad(result.headings_deg)
    assert np.mean(east * np.cos(north)) * result.duration == pytest.approx(-drift, rel=0.02)


@pytest.mark.full
def test_goals_are_met_in_order_at_the_surface_on_the_way_down_or_up_and_at_the_end():
    flow = eddying_flow(7)
    goals = (-4e3, 8e3), (2e3, 4e3, 120.0), (10e3, 2e3, 200.0)
    settings = replace(SETTINGS, surface_time=600.0)
    asked = request_between(flow, (-12e3, -4e3, 40.0), *goals, settings=settings)
    result = plan_mission(flow, asked)
    assert result.status == "reached"
    # thirteen dives of the optimiser's coarser steps
    assert np.all(result.closest_approach < 3.0)
    assert result.yo_depths[0][0] == 40.0
    assert list(result.goal_legs) == sorted(set(result.goal_legs))
    # at its time the track is at the goal's depth, within a leg
    depths = np.interp(result.goal_times, result.track_time, result.track[:, 2])
    np.testing.assert_allclose(depths, [0.0, 120.0, 200.0], atol=1e-6)
    assert result.goal_times[1] not in result.surfacing_times
    # from the surfacing after the first goal, at the same steps of the legs that are left
    begun = result.goal_legs[0] - 1
    here, now = Place(*result.surfacings[begun].tolist(), 0.0), result.surfacing_times[begun]
    left = replace(asked, start=here, goals=asked.goals[1:], start_time_ns=int(now * 1e9))
    later = plan_mission(flow, left, warm=result)
    np.testing.assert_allclose(later.goal_times + now, result.goal_times[1:], rtol=1e-3)


@pytest.mark.parametrize(("worth_of_a_kilometre", "comes_close"), [(0.8, False), (1.2, True)])
def test_coming_close_is_weighed_against_time(worth_of_a_kilometre, comes_close):
    # a kilometre more at the glide angle a takes cos(a) / 0.3 / 3.6 hours: for less it is not gone, and no second dive is worth it
    settings = replace(SETTINGS, objective=Weights(time=1.0, closest=worth_of_a_kilometre))
    result = plan_between(still_flow(), (-2e3, 0.0), (2e3, 0.0), settings=settings)
    off = 0.0 if comes_close else 4e3 - 600.0 / np.tan(np.arccos(0.8 * 0.3 * 3.6))
    assert result.closest_approach[0] == pytest.approx(off, abs=15.0)
    assert (result.status == "reached") == comes_close == ("the weights" not in result.message)


def test_no_vehicle_is_said_to_stay_farther_off_than_the_plan():
    """It misses by 6.6 km, and none was said to come nearer than 6.9."""
    short = replace(SETTINGS, max_duration=8000.0)
    plan = plan_between(uniform_flow(-0.1, 0.0), (-4e3, 0.0), (4e3, 1e3), settings=short)
    assert "no vehicle of this speed comes nearer;" in plan.message


def test_power_grows_with_the_cube_of_a_propellers_speed_and_least_energy_is_between_the_ends():
    powered = Glider(1.0, volume=0.0, thrust=30.0, hotel=2.0)

    def planned(**more):
        settings = MissionSettings(depth=100.0, surface_time=600.0, speeds=(0.2, 1.0), **more)
        return plan_between(
            still_flow(), (-4e3, 0.0), (4e3, 0.0), vehicle=powered, settings=settings
        )

    fast, frugal = planned(), planned(objective="energy")
    assert fast.vehicle.speed == 1.0
    # an earliest arrival is known for one speed alone
    assert "bound_h" not in fast.statistics
    # the propeller rests while the vehicle drifts at the surface
    drifts = len(fast.yo_depths[1:])
    assert fast.energy == pytest.approx(32.0 * fast.duration - 18e3 * drifts)
    # (hotel + thrust v^3) / v is least where v^3 = hotel / (2 thrust)
    assert frugal.vehicle.speed == pytest.approx(np.cbrt(2.0 / 60.0), rel=1e-3)
    # within the battery the quickest, and no more than it
    between = planned(battery=2.0 * frugal.energy)
    assert between.status == "reached"
    assert between.energy <= 2.0 * frugal.energy
    assert frugal.duration > between.duration > fast.duration


@pytest.mark.full
def test_a_goal_out_of_reach_leaves_the_others_as_they_are_without_it():
    flow, settings = eddying_flow(2, speed=0.08), replace(SETTINGS, max_legs=10)
    begin, near, far = (-20e3, 0.0), [(-14e3, 3e3), (-15e3, -4e3)], (24e3, 0.0)
    alone = plan_between(flow, begin, *near, settings=settings)
    for position in range(3):
        goals = [*near[:position], far, *near[position:]]
        plan = plan_between(flow, begin, *goals, settings=settings)
        assert plan.status == "unreachable"
        np.testing.assert_array_equal(plan.track, alone.track)
        np.testing.assert_array_equal(np.delete(plan.goal_times, position), alone.goal_times)
        assert f"goal {position + 1} is out of reach: it needs more than 10 legs" in plan.message
    # of several that are out of reach each is named; without another the first is approached
    few = replace(SETTINGS, max_legs=4)
    both = plan_between(flow, begin, far, (20e3, 4e3), settings=few)
    towards = plan_between(flow, begin, far, settings=few)
    np.testing.assert_array_equal(both.track, towards.track)
    assert both.message.count("out of reach") == 2
