"""What keeps a mission from its goals: the number of legs, the longest duration, the current, or no open way; and which goals it spares."""

from dataclasses import replace

import numpy as np
import pytest

from planners import (
    MissionSettings,
    waypoints_of,
)
from tests.planners.flow_samples import (
    eddying_flow,
    plan_between,
    request_between,
    still_flow,
)

# a leg to 300 m leads 2,239 m at 15 degrees
SETTINGS, LEG = MissionSettings(depth=300.0), 600.0 / np.tan(np.deg2rad(15.0))
STILL = still_flow()


def planned(flow, *goals, start=(-20e3, 0.0), **settings):
    return plan_between(flow, start, *goals, settings=replace(SETTINGS, **settings))


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
