"""Legs of a mission: which of them count as flown, and where the glider is at the surface within one."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionRequest, MissionSettings, NoGo, plan_mission
from planners.front.route import Route
from planners.mission.flight.currents import currents_of
from planners.mission.solve.attempt import GoalSteps
from planners.mission.solve.legs import solve_legs
from planners.mission.task import mission_task, time_on_clock
from planners.shooting.program import MissionGuess
from planners.vehicle import Glider
from tests.planners.flow_samples import eddying_flow, place, still_flow


def test_no_leg_counts_as_flown_before_half_of_it_is_however_steep_it_is():
    flow = still_flow()
    # eleven legs over the way of five are steep: one at 15 degrees would last more than twice as long
    plan = plan_mission(
        flow,
        MissionRequest(
            place(flow, -5e3, 0.0, 0.0),
            (place(flow, 5e3, 0.0, 0.0),),
            settings=MissionSettings(depth=300.0, legs=11),
        ),
    )
    assert plan.glide_angles_deg.max() > 33.0
    for number, end in enumerate(plan.surfacing_times, start=1):
        half = 0.5 * (end - (plan.surfacing_times[number - 2] if number > 1 else 0.0))
        for early, flown in ((0.0, number), (0.9 * half, number), (1.1 * half, number - 1)):
            assert plan.legs_flown(round(1e9 * (end - early))) == flown


@pytest.mark.full
def test_between_the_dives_of_a_leg_the_glider_comes_up_clear_of_areas_that_forbid_it():
    flow = eddying_flow(12)
    start, goal, settings = (
        place(flow, -9e3, 0.0, 0.0),
        place(flow, 9e3, 1e3, 0.0),
        MissionSettings(depth=390.0, yos=3),
    )
    corners = [
        place(flow, *corner, 0.0)
        for corner in ((-1e3, -15e3), (1e3, -15e3), (1e3, 15e3), (-1e3, 15e3))
    ]
    lane = NoGo(
        tuple((corner.longitude, corner.latitude) for corner in corners), "lane", surface_only=True
    )
    free, past = (
        plan_mission(flow, MissionRequest(start, (goal,), settings=settings, no_go=areas))
        for areas in ((), (lane,))
    )
    assert (free.status, past.status) == ("reached", "reached")
    # passed under, not gone round
    assert past.duration < 1.1 * free.duration


def test_a_goal_below_the_surface_is_met_on_the_way_down_or_up_and_the_last_one_at_the_end():
    flow = still_flow()
    goals = (place(flow, 2e3, 0.0, 0.0), place(flow, 4e3, 0.0, 120.0), place(flow, 6e3, 0.0, 200.0))
    task = mission_task(
        flow,
        MissionRequest(place(flow, 0.0, 0.0, 0.0), goals, Glider(), MissionSettings(depth=300.0)),
    )
    depths = task.depths(task.yo_depths(3))[1]
    for share, upward in ((0.3, False), (0.7, True)):
        at_surface, below, last = task.goal_steps((1, 2, 3), 3, np.array([1.0, share, 1.0]))
        assert at_surface == last == 0
        assert depths[below] == 120.0
        # the dive turns at half of its way
        assert (below > np.argmax(depths)) == upward


def test_the_clock_of_a_flow_that_changes_begins_with_its_first_estimate():
    first = replace(still_flow(), time_ns=7 * 10**9)
    both = currents_of([first, replace(first, time_ns=20 * 10**9)])
    assert time_on_clock(both, 12 * 10**9) == 5.0
    # before the first estimate
    assert time_on_clock(both, 4 * 10**9) == -3.0
    assert time_on_clock(both, 0) == time_on_clock(currents_of(first), 12 * 10**9) == 0.0


def test_legs_that_fall_short_come_as_near_as_they_can_also_where_the_graph_took_the_goal_for_reached():
    flow, vehicle = still_flow(), Glider()
    start, goal = place(flow, -8e3, 0.0, 0.0), place(flow, 8e3, 3e3, 0.0)
    task = mission_task(flow, MissionRequest(start, (goal,), vehicle, MissionSettings(depth=300.0)))
    points = np.linspace(task.start[:2], task.goals[0, :2], 5)
    guess = MissionGuess(points[1:], np.full(4, np.pi / 2), np.full(4, 0.3))
    attempt = solve_legs(
        task, guess, GoalSteps((4,), (0,)), Route(points, np.linspace(0.0, 3e4, 5), True)
    )
    # each dive to 300 m leads 600 m / tan(a) on at the flattest angle a
    reach = 4 * 600.0 / np.tan(vehicle.angles[0])
    assert attempt.miss[0] == pytest.approx(np.hypot(16e3, 3e3) - reach, abs=1.0)
