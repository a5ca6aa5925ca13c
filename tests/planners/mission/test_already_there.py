"""Missions whose start is where they should go, and one whose start has no way on at the full depth of its dives."""

from dataclasses import replace

import numpy as np

from planners import (
    MissionRequest,
    MissionSettings,
    best_departure,
    cut_at_horizon,
    plan_by_odds,
    plan_mission,
)
from planners.output import as_plan
from tests.planners.flow_samples import eddying_flow, place

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
    # a first goal below the start is met by a dive
    dived = plan_mission(FLOW, asked((0.0, 0.0, 40.0), (6e3, 0.0, 0.0)))
    assert dived.goal_legs[0] == 1


def test_a_mission_without_legs_is_judged_compared_cut_and_published():
    there = asked((50.0, 0.0, 0.0))
    plan = plan_by_odds(FLOW, [FLOW] * 3, there, 0.1)
    assert (plan.status, len(plan.headings_deg)) == ("reached", 0)
    assert best_departure([plan, replace(plan, start_time_ns=86400 * 10**9)]) == 0
    assert cut_at_horizon(plan, 3600.0, FLOW.grid.projection) is plan
    # there is no command
    glide = as_plan(plan, FLOW.grid.projection)
    assert (glide.status, glide.duration, np.isnan(glide.heading_deg)) == ("reached", 0.0, True)
    # the rest of such a plan is planned anew
    assert plan_mission(FLOW, asked((6e3, 0.0, 0.0)), warm=plan).status == "reached"
