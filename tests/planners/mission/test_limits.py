"""What keeps a mission from its goals: the number of legs, the longest duration, the current, or no open way; and which goals it spares."""

from dataclasses import replace

import numpy as np
import pytest

from planners import (
    MissionSettings,
    plan_scenarios,
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
from tests.planners.mission.test_bottom import bathymetry, least_height, turns

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


def test_legs_grow_with_the_way_and_a_limit_of_them_is_named_where_it_binds():
    shallow = planned(STILL, (25e3, 0.0), start=(-25e3, 0.0), depth=100.0)
    assert (shallow.status, len(shallow.headings_deg)) == ("reached", 67)
    few = planned(STILL, (25e3, 0.0), start=(-25e3, 0.0), depth=100.0, max_legs=60)
    assert few.status == "unreachable"
    assert (
        "the goal is out of reach: it needs more than 60 legs; limit: max_legs = 60 (--max-legs)"
        in few.message
    )
    assert "current" not in few.message
    # as near as these legs lead
    assert few.closest_approach[0] == pytest.approx(50e3 - 60 * LEG / 3.0, abs=10.0)


def test_the_longest_duration_the_current_or_a_wall_are_named_where_they_bind():
    late = planned(STILL, (20e3, 0.0), max_duration=50e3)
    assert late.message.endswith("; limit: max_duration = 50000 s (--max-duration)")
    assert "within 13.9 h no vehicle of this speed comes nearer than about 25." in late.message
    assert "current" not in late.message
    # no number of legs helps against a current that is faster than the glider
    against = planned(uniform_flow(-0.4, 0.0), (20e3, 0.0), max_legs=20)
    assert "; the current keeps a glider of 0.29 m/s from it: it makes good 0.1" in against.message
    assert "legs;" not in against.message.split(";", 1)[1]
    # what the lattice does not reach in such a current may be reached
    assert "no way was found that comes nearer than" in against.message
    wall = forbidden(STILL, -1e3, -60e3, 1e3, 60e3)
    closed = plan_between(STILL, (-9e3, 0.0), (9e3, 0.0), settings=SETTINGS, no_go=(wall,))
    assert closed.status == against.status == "unreachable"
    assert "; a constraint closes every way: land, an area, " in closed.message
    assert "current" not in closed.message


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
    np.testing.assert_array_equal(
        waypoints_of(flow, plan).longitude, waypoints_of(flow, alone).longitude
    )
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
    plan, summary = plan_scenarios(flow, drawn, asked)
    assert plan.status == "unreachable"
    assert plan.goal_legs[0] == 0
    assert max(plan.closest_approach[:2]) <= 250.0 < plan.closest_approach[2]
    assert "goal 3 is out of reach: it needs more than 9 legs" in plan.message
    assert (summary.reached, summary.safe) == (0.0, 1.0)


def test_legs_over_a_shelf_that_are_too_few_are_named():
    bottom = bathymetry(lambda x, y: 60.0 + 0.0 * x + np.where(x > 152.6, 900.0, 0.0))
    few = replace(SETTINGS, max_legs=12)
    way = (-5e3, 0.0), (5e3, 0.0)
    plan = plan_between(STILL, *way, settings=few, bathymetry=bottom)
    assert plan.status == "unreachable"
    assert (
        "the goal is out of reach: it needs more than 12 legs; limit: max_legs = 12 (--max-legs)"
        in plan.message
    )
    assert set(turns(plan)) == {40.0}
    assert least_height(STILL, plan.track, bottom) >= 20.0 - 1e-3
    more = plan_between(STILL, *way, settings=SETTINGS, bathymetry=bottom)
    assert more.status == "reached"
    assert len(more.headings_deg) > 30
