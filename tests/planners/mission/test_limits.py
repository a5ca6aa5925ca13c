"""What keeps a mission from its goals: the number of legs, the longest duration, the current, or no open way; and which goals it spares."""

from dataclasses import replace

import numpy as np
import pytest

from planners import (
    MissionSettings,
    mission_odds,
    plan_by_odds,
    waypoints_of,
)
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    plan_between,
    request_between,
    still_flow,
    uniform_flow,
)

# a leg to 300 m leads 2,239 m at 15 degrees
SETTINGS, LEG = MissionSettings(depth=300.0), 600.0 / np.tan(np.deg2rad(15.0))
STILL = still_flow()


def planned(flow, *goals, start=(-20e3, 0.0), **settings):
    return plan_between(flow, start, *goals, settings=replace(SETTINGS, **settings))


def test_a_mission_that_lasts_longer_than_the_longest_has_not_reached_its_goal():
    # the goal is near, but the steepest dive takes an hour
    long, short = (
        planned(STILL, (900.0, 0.0), start=(0.0, 0.0), max_duration=t) for t in (1e4, 1800.0)
    )
    assert (long.status, short.status) == ("reached", "unreachable")
    assert short.duration > 1800.0
    assert short.closest_approach[0] <= 250.0
    assert "limit: max_duration = 1800 s (--max-duration)" in short.message
    # a goal that the dive passes is missed as well, which the same limit explains once
    missed = planned(STILL, (300.0, 0.0), start=(0.0, 0.0), max_duration=1800.0)
    assert missed.closest_approach[0] > 250.0
    assert missed.message.count("limit: max_duration = 1800 s") == 1


@pytest.mark.full
def test_a_goal_out_of_reach_leaves_the_others_as_they_are_without_it():
    flow = eddying_flow(2, speed=0.08)
    near, far = ((-14e3, 3e3), (-15e3, -4e3)), (24e3, 0.0)
    alone = planned(flow, *near, max_legs=10)
    assert alone.status == "reached"
    for position in range(3):
        goals = [*near]
        goals.insert(position, far)
        plan = planned(flow, *goals, max_legs=10)
        assert plan.status == "unreachable"
        np.testing.assert_array_equal(plan.track, alone.track)
        np.testing.assert_allclose(
            np.delete(plan.closest_approach, position), alone.closest_approach
        )
        np.testing.assert_array_equal(np.delete(plan.goal_times, position), alone.goal_times)
        assert list(plan.goal_legs) == sorted(plan.goal_legs)
        assert (
            f"; goal {position + 1} is out of reach: it needs more than 10 legs; limit: max_legs = 10 (--max-legs)"
            in plan.message
        )
        assert plan.message.count("out of reach") == 1
    # a list of waypoints leads to those that are met
    asked = [
        request_between(flow, (-20e3, 0.0), *one, settings=replace(SETTINGS, max_legs=10))
        for one in (goals, near)
    ]
    lists = [waypoints_of(flow, *pair)[0] for pair in zip((plan, alone), asked, strict=True)]
    np.testing.assert_array_equal(lists[0].longitude, lists[1].longitude)
    # of several that are out of reach each is named; without another the first is approached
    both = planned(flow, (24e3, 0.0), (20e3, 4e3), max_legs=4)
    towards = planned(flow, (24e3, 0.0), max_legs=4)
    np.testing.assert_array_equal(both.track, towards.track)
    assert "goal 1 is out of reach" in both.message
    assert "goal 2 is out of reach" in both.message


@pytest.mark.full
def test_a_margin_for_samples_leads_to_the_goals_within_reach():
    flow, settings = uniform_flow(0.02, 0.0), replace(SETTINGS, max_legs=9)
    area = forbidden(flow, -17e3, -1e3, -16e3, 1.2e3)
    way = (-20e3, 0.0), (-20e3, 100.0), (-12e3, 0.0), (20e3, 0.0)
    asked = request_between(flow, *way, settings=settings, no_go=(area,))
    drawn = [
        replace(flow, latent=flow.latent + share * uniform_flow(0.0, 0.1).latent)
        for share in np.linspace(-0.2, 0.2, 10)
    ]
    plan = plan_by_odds(flow, drawn, asked, 0.1)
    odds = mission_odds(flow, drawn, plan, asked)
    assert plan.status == "unreachable"
    assert plan.goal_legs[0] == 0
    assert max(plan.closest_approach[:2]) <= 250.0 < plan.closest_approach[2]
    assert "goal 3 is out of reach: it needs more than 9 legs" in plan.message
    assert (odds.reached, odds.safe) == (0.0, 1.0)
