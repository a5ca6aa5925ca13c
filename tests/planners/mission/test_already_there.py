"""Missions whose start is where they should go, and one whose start has no way on at the full depth of its dives."""

from dataclasses import replace

import numpy as np
import pytest

from planners import (
    MissionRequest,
    MissionSettings,
    best_departure,
    plan_by_odds,
    plan_departures,
    plan_mission,
    waypoints_of,
)
from planners.odds.departures import cut_at_horizon
from planners.output.mission import as_plan
from tests.planners.flow_samples import eddying_flow, place, still_flow
from tests.planners.mission.test_bottom import bathymetry, least_height, request, turns

FLOW = eddying_flow(3, speed=0.1)
SETTINGS = MissionSettings(depth=300.0, surface_time=600.0)


def asked(*goals, depth=0.0, **settings):
    places = tuple(place(FLOW, *goal) for goal in goals)
    return MissionRequest(
        place(FLOW, 0.0, 0.0, depth), places, settings=replace(SETTINGS, **settings)
    )


def test_a_first_goal_at_the_start_is_met_there_and_the_others_as_without_it():
    both, alone = (
        plan_mission(FLOW, asked(*goals))
        for goals in (((90.0, 0.0, 0.0), (6e3, 0.0, 0.0)), ((6e3, 0.0, 0.0),))
    )
    assert both.status == alone.status == "reached"
    assert (both.goal_legs, both.goal_times[0]) == ((0, len(both.headings_deg)), 0.0)
    np.testing.assert_array_equal(both.track, alone.track)
    np.testing.assert_allclose(both.closest_approach, [90.0, alone.closest_approach[0]], atol=0.1)
    assert "above_bound_percent" in both.statistics
    # a list of waypoints leads to the other one
    request = asked((90.0, 0.0, 0.0), (6e3, 0.0, 0.0))
    few, other = (waypoints_of(FLOW, plan, request)[0] for plan in (both, alone))
    np.testing.assert_array_equal(few.longitude, other.longitude)
    # a first goal below the start is met by a dive
    dived = plan_mission(FLOW, asked((0.0, 0.0, 40.0), (6e3, 0.0, 0.0)))
    assert dived.goal_legs[0] == 1
    assert waypoints_of(FLOW, replace(both, goals=dived.goals), request)[0].times.size > 0


def test_a_mission_without_legs_is_judged_compared_cut_and_published():
    there = asked((50.0, 0.0, 0.0))
    plan = plan_by_odds(FLOW, [FLOW] * 3, there, 0.1)
    assert (plan.status, len(plan.headings_deg)) == ("reached", 0)
    day = 86400 * 10**9
    changing = [replace(FLOW, time_ns=day), replace(FLOW, time_ns=2 * day)]
    plans = plan_departures(changing, there, [day, day + day // 4])
    assert [(one.status, len(one.headings_deg)) for one in plans] == [("reached", 0)] * 2
    assert best_departure(plans) == 0
    projection = FLOW.grid.projection
    assert cut_at_horizon(plan, 3600.0, projection) is plan
    glide = as_plan(plan, projection)
    # there is no command
    assert np.isnan([glide.heading_deg, glide.glide_angle_deg]).all()
    assert (glide.status, glide.duration, glide.velocity_through_water.tolist()) == (
        "reached",
        0.0,
        [0.0, 0.0, 0.0],
    )
    # the rest of such a plan is planned anew
    assert plan_mission(FLOW, asked((6e3, 0.0, 0.0)), warm=plan).status == "reached"


@pytest.mark.parametrize("begin", [-8560.0, -8600.0])
def test_a_start_beside_a_ridge_that_rises_above_the_dives_is_planned_over_it(begin):
    flow, bottom = (
        still_flow(),
        bathymetry(lambda x, y: np.where((x > 152.405) & (x < 152.455), 150.0, 900.0)),
    )
    plan = plan_mission(flow, request(flow, begin, 9e3, 390.0, bottom))
    assert plan.status == "reached"
    # over the ridge, and then as deep as asked for
    assert set(turns(plan)) == {130.0, 390.0}
    assert turns(plan)[0] == 130.0
    assert least_height(flow, plan.track, bottom) >= 20.0 - 1e-3
