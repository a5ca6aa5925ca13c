"""Legs: their steps, what their integrators are exact for, the current at each stage, and which of them count as flown."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionRequest, MissionSettings, plan_mission
from planners.mission.flight.legs import Legs, fly_legs, fly_midpoints, fly_steps
from planners.mission.solve.attempt import GoalSteps
from planners.mission.solve.legs import solve_legs
from planners.mission.task import (
    leg_depths,
    mission_task,
    refine_steps,
    step_stops,
    steps_needed,
)
from planners.route.current import Route
from planners.shooting.program import MissionGuess
from planners.shooting.schedule import DRIFT_STEPS
from planners.simulation.currents import currents_of, currents_of_samples
from tests.planners.flow_samples import (
    LEVELS,
    eddying_flow,
    forbidden,
    place,
    plan_between,
    still_flow,
)

GLIDER, HERE = Glider(), np.array([3e3, -4e3])
DAY_NS = 86_400 * 10**9


def test_a_leg_needs_a_step_for_each_dive_climb_and_level_crossed():
    levels = np.array(LEVELS)
    # down and up again through 5, 40, 110 and 230 m; to 110 m only 5 and 40 m are crossed
    assert steps_needed((0.0, 300.0, 0.0), levels, 1) == 8 + 2
    assert steps_needed((0.0, 300.0, 0.0), levels, 3) == 8 + 6
    assert steps_needed((0.0, 110.0, 0.0), levels, 2) == 4 + 4
    assert steps_needed((110.0, 230.0), levels, 2) == 2


def test_steps_go_where_the_way_to_each_is_longest():
    none = np.array([1e4])
    np.testing.assert_allclose(leg_depths((50.0, 100.0, 0.0), none, 3), [50.0, 100.0, 50.0, 0.0])
    np.testing.assert_allclose(
        leg_depths((0.0, 60.0, 0.0), none, 5), [0.0, 20.0, 40.0, 60.0, 30.0, 0.0]
    )
    # a level within the dive has a step's end of its own there, and no more are needed
    np.testing.assert_allclose(
        leg_depths((0.0, 60.0, 0.0), np.array([20.0]), 4), [0.0, 20.0, 60.0, 20.0, 0.0]
    )


def test_steps_also_end_at_goals_below_the_surface():
    np.testing.assert_array_equal(
        step_stops(np.array([5.0, 40.0]), np.array([0.0, 30.0, 40.0])), [5.0, 30.0, 40.0]
    )


def test_a_step_cut_in_parts_goes_evenly_through_its_depths():
    np.testing.assert_allclose(
        refine_steps(np.array([0.0, 10.0, 40.0]), 2), [0.0, 5.0, 10.0, 25.0, 40.0]
    )
    np.testing.assert_array_equal(refine_steps(np.array([0.0, 10.0]), 1), [0.0, 10.0])


@pytest.mark.parametrize(("method", "power"), [(fly_steps, 3), (fly_midpoints, 1)])
def test_a_rate_that_is_a_power_of_time_or_depth_is_integrated_exactly(method, power):
    depths, durations = np.array([0.0, 6.0, 2.0]), np.array([3.0, 2.0])

    def rate(_, depth, now):
        return np.array([now**power, depth**power])

    path = method(rate, np.array([7.0, 0.0]), 1.0, depths, durations, 2)
    assert [now for _, now in path] == [4.0, 6.0]

    # the depth grows by 2 m/s for three seconds, then falls by 2 m/s for two
    def integral(begin, end):
        return (end ** (power + 1) - begin ** (power + 1)) / (power + 1)

    np.testing.assert_allclose(
        path[0][0], [7.0 + integral(1.0, 4.0), integral(0.0, 6.0) / 2.0], rtol=1e-12
    )
    np.testing.assert_allclose(
        path[1][0],
        [7.0 + integral(1.0, 6.0), (integral(0.0, 6.0) + integral(2.0, 6.0)) / 2.0],
        rtol=1e-12,
    )


def _dated(seed, days):
    return replace(eddying_flow(seed), time_ns=10**18 + int(days * DAY_NS))


def test_a_flow_that_changes_is_between_its_times_by_their_share_and_before_and_after_them_as_they_are():
    first, second, third = flows = [
        _dated(seed, days) for seed, days in ((3, 0.0), (4, 1.0), (5, 3.0))
    ]
    currents = currents_of(flows)
    places, of_levels = np.array([[1e3, 2e3], [-8e3, 5e3]]), currents.weights(np.array([75.0]))[0]

    def of(flow):
        return np.array([flow.velocity(*at, 75.0) for at in places])

    for days, expected in (
        *((-5.0, of(first)), (0.0, of(first)), (0.25, 0.75 * of(first) + 0.25 * of(second))),
        *((1.0, of(second)), (2.5, 0.25 * of(second) + 0.75 * of(third)), (9.0, of(third))),
    ):
        np.testing.assert_allclose(
            currents.velocity(places, of_levels, 86_400.0 * days), expected, atol=1e-12
        )


def test_a_flight_begins_at_its_time_on_the_clock_of_the_flow_and_knows_the_leg_of_each_point():
    changing = currents_of([_dated(3, 0.0), _dated(4, 0.5)])
    dive = leg_depths((0.0, 300.0, 0.0), np.array(LEVELS), 10)
    legs = Legs(np.array([0.3, 2.0]), np.array([0.3, 0.5]), (dive, dive), np.array([900.0, 0.0]))
    begin = 20_000.0
    flight = fly_legs(changing, GLIDER, HERE, legs, begin)
    # the second leg alone, from where and when the first and its drift have ended
    after = flight.ends[0]
    alone = Legs(legs.headings[1:], legs.angles[1:], legs.depths[1:], legs.drifts[1:])
    second = fly_legs(
        changing, GLIDER, flight.place[0, after], alone, begin + float(flight.time[after])
    )
    np.testing.assert_allclose(flight.place[0, after:], second.place[0], rtol=1e-12)
    np.testing.assert_allclose(
        flight.time[after:] - flight.time[after], second.time, rtol=1e-12, atol=1e-9
    )
    assert (
        np.linalg.norm(
            second.place[0, -1]
            - fly_legs(changing, GLIDER, flight.place[0, after], alone).place[0, -1]
        )
        > 10.0
    )
    assert flight.ends.tolist() == [10 + DRIFT_STEPS, 20 + DRIFT_STEPS]
    assert flight.leg.tolist() == [0] * (11 + DRIFT_STEPS) + [1] * 10
    np.testing.assert_array_equal(flight.depth, [*dive, *[0.0] * DRIFT_STEPS, *dive[1:]])


def test_one_current_serves_many_places_and_many_currents_each_its_own():
    flows = [eddying_flow(seed) for seed in (4, 5)]
    places = np.array([[1e3, 2e3], [-8e3, 5e3]])
    one, both = currents_of(flows[0]), currents_of_samples(flows)
    of_levels = one.weights(np.array([20.0]))[0]
    np.testing.assert_allclose(
        one.velocity(places, of_levels, 0.0),
        [flows[0].velocity(*at, 20.0) for at in places],
        atol=1e-12,
    )
    own = [flow.velocity(*at, 20.0) for flow, at in zip(flows, places, strict=True)]
    np.testing.assert_allclose(both.velocity(places, of_levels, 0.0), own, atol=1e-12)


def test_no_leg_counts_as_flown_before_half_of_it_is_however_steep_it_is():
    flow = still_flow()
    # eleven legs over the way of five are steep: one at 15 degrees would last more than twice as long
    plan = plan_between(
        flow, (-5e3, 0.0), (5e3, 0.0), settings=MissionSettings(depth=300.0, legs=11)
    )
    assert plan.glide_angles_deg.max() > 33.0
    for number, end in enumerate(plan.surfacing_times, start=1):
        half = 0.5 * (end - (plan.surfacing_times[number - 2] if number > 1 else 0.0))
        for early, flown in ((0.0, number), (0.9 * half, number), (1.1 * half, number - 1)):
            assert plan.legs_flown(round(1e9 * (end - early))) == flown


@pytest.mark.full
def test_between_the_dives_of_a_leg_the_glider_comes_up_clear_of_areas_that_forbid_it():
    flow = eddying_flow(12)
    start = place(flow, -9e3, 0.0)
    goal = place(flow, 9e3, 1e3)
    settings = MissionSettings(depth=390.0, yos=3)
    lane = forbidden(flow, -1e3, -15e3, 1e3, 15e3, name="lane", surface_only=True)
    free, past = (
        plan_mission(flow, MissionRequest(start, (goal,), settings=settings, no_go=areas))
        for areas in ((), (lane,))
    )
    assert (free.status, past.status) == ("reached", "reached")
    # passed under, not gone round
    assert past.duration < 1.1 * free.duration


def test_a_goal_below_the_surface_is_met_on_the_way_down_or_up_and_the_last_one_at_the_end():
    flow = still_flow()
    goals = (place(flow, 2e3, 0.0), place(flow, 4e3, 0.0, 120.0), place(flow, 6e3, 0.0, 200.0))
    task = mission_task(
        flow,
        MissionRequest(place(flow, 0.0, 0.0), goals, Glider(), MissionSettings(depth=300.0)),
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
    assert both.clock(12 * 10**9) == 5.0
    # before the first estimate
    assert both.clock(4 * 10**9) == -3.0
    assert both.clock(0) == currents_of(first).clock(12 * 10**9) == 0.0


def test_legs_that_fall_short_come_as_near_as_they_can_also_where_the_graph_took_the_goal_for_reached():
    flow, vehicle = still_flow(), Glider()
    start, goal = place(flow, -8e3, 0.0), place(flow, 8e3, 3e3)
    task = mission_task(flow, MissionRequest(start, (goal,), vehicle, MissionSettings(depth=300.0)))
    points = np.linspace(task.start[:2], task.goals[0, :2], 5)
    guess = MissionGuess(points[1:], np.full(4, np.pi / 2), np.full(4, 0.3))
    attempt = solve_legs(
        task, guess, GoalSteps((4,), (0,)), Route(points, np.linspace(0.0, 3e4, 5), True)
    )
    # each dive to 300 m leads 600 m / tan(a) on at the flattest angle a
    reach = 4 * 600.0 / np.tan(vehicle.angles[0])
    assert attempt.miss[0] == pytest.approx(np.hypot(16e3, 3e3) - reach, abs=1.0)
