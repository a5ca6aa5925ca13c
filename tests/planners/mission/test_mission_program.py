"""A mission's program: where it begins, what it costs, what a guide adds to it, and what its answer says."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionSettings
from planners.mission.flight.legs import Flight
from planners.mission.solve.attempt import GoalSteps, LegsProblem
from planners.mission.solve.legs import _points_along
from planners.mission.solve.optimum import _PLANE_COST, _reference
from planners.mission.task import REFINED, mission_task
from planners.route.current import Route
from planners.shooting.functions import MissionCase, Reference
from planners.shooting.layout import Layout
from planners.shooting.program import (
    MissionGuess,
    _unknowns,
    along_line,
    mission_program,
    near_place,
    solve_mission,
)
from planners.shooting.schedule import schedule_of
from planners.shooting.stream import stream_of
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM
from tests.planners.flow_samples import request_between, still_flow

GLIDER = Glider()
FLOW = still_flow()
DIVE = np.array([0.0, 5.0, 40.0, 110.0, 230.0, 300.0, 230.0, 110.0, 40.0, 5.0, 0.0])


def _case(goal, n_legs, **more):
    drifts = np.array([*[600.0] * (n_legs - 1), 0.0])
    case = MissionCase(
        stream_of(FLOW, FLOW.latent),
        schedule_of([DIVE] * n_legs, drifts, True, FLOW.levels, FLOW.depth_functions, None),
        drifts,
        np.zeros(2),
        0.0,
        goal[None],
        None,
        time_weight=1.0,
        miss_weights=(0.0, 0.0, 50.0),
        plane_cost=50.0 * _PLANE_COST,
        reference=None,
    )
    return replace(case, **more)


def _layout(n_legs, n_planes=0, has_reference=False):
    return Layout(n_legs, ((n_legs - 1, 0),), 11, n_planes, has_reference, False)


def _solved(layout, case, guess):
    return solve_mission(mission_program(FLOW.grid.projection, GLIDER, layout), GLIDER, case, guess)


def _straight(goal, n_legs, angle=0.4):
    heading = float(np.arctan2(*goal))
    return MissionGuess(
        goal * np.arange(1, n_legs + 1)[:, None] / n_legs,
        np.full(n_legs, heading),
        np.full(n_legs, angle),
    )


def test_a_guess_begins_with_the_times_of_its_dives_and_drifts_and_with_what_it_misses():
    goal, angles = np.array([3e3, -2e3]), np.array([0.3, 0.5, 0.4])
    guess = MissionGuess(
        np.array([[1e3, 0.0], [2e3, -1e3], [2.5e3, -1.2e3]]), np.array([0.1, 0.2, 0.3]), angles
    )
    unknowns, lower, upper = _unknowns(GLIDER, _layout(3), _case(goal, 3), guess)
    legs = unknowns[:15].reshape(3, 5)
    np.testing.assert_allclose(legs[:, :2], guess.places / KM)
    np.testing.assert_allclose(
        legs[:, 2], np.cumsum(600.0 / 0.3 / np.sin(angles) + [600.0, 600.0, 0.0]) / HOUR
    )
    np.testing.assert_allclose(legs[:, 3:], np.column_stack([guess.headings, angles]))
    # 500 m short to the east, 800 m too far north
    np.testing.assert_allclose(unknowns[15:], [0.0, 0.8, 0.5, 0.0])
    assert np.isinf(lower[:15].reshape(3, 5)[:, :4]).all()
    np.testing.assert_allclose(lower[:15].reshape(3, 5)[:, 4], np.deg2rad(15.0))
    np.testing.assert_allclose(upper[:15].reshape(3, 5)[:, 4], np.deg2rad(35.0))
    assert lower[15:].tolist() == [0.0] * 4
    # a mooring has to last, which is a bound on the end of its last leg alone; it and half-planes have a slack each
    none = np.zeros((3, 11))
    case = _case(goal, 3, reference=Reference(np.zeros(2), np.eye(2), none, none, 1.0, 5.0 * HOUR))
    unknowns, lower, _ = _unknowns(GLIDER, _layout(3, 2, True), case, guess)
    assert lower[:15].reshape(3, 5)[:, 2].tolist() == [-np.inf, -np.inf, 5.0]
    assert unknowns[15:].tolist() == pytest.approx([0.0, 0.8, 0.5, 0.0, 0.0, 0.0])


def test_time_is_the_objective_where_the_goal_is_met_and_the_penalty_is_added_where_it_is_not():
    flattest = float(np.cos(np.deg2rad(15.0)) / np.sin(np.deg2rad(15.0))) * 600.0
    for goal_at, short in ((0.8 * 2 * flattest, 0.0), (2 * flattest + 1e3, 1.0)):
        goal = np.array([0.0, goal_at])
        found = _solved(_layout(2), _case(goal, 2), _straight(goal, 2))
        angle = float(np.mean(found.guess.angles))
        hours = (2 * 600.0 / 0.3 / np.sin(angle) + 600.0) / HOUR
        assert found.objective == pytest.approx(hours + 50.0 * short, rel=1e-3)
        assert found.guess.places[-1, 1] == pytest.approx(goal_at - 1e3 * short, abs=2.0)
        assert found.plane_violation == 0.0
    # weighed, the distance itself costs, with a bowl of ten metres at the goal
    weighed = _case(goal, 2, miss_weights=(0.0, 0.5, 1e-6))
    found = _solved(_layout(2), weighed, _straight(goal, 2))
    off = abs(found.guess.places[-1, 1] - goal_at) / KM
    hours = sum(600.0 / 0.3 / np.sin(found.guess.angles)) / HOUR + 600.0 / HOUR
    assert found.objective == pytest.approx(hours + 0.5 * np.hypot(off, 0.01), rel=1e-3)
    # the closest approach is a square
    closest = _case(goal, 2, time_weight=0.0, miss_weights=(2.0, 0.0, 0.0))
    found = _solved(_layout(2), closest, _straight(goal, 2))
    assert found.objective == pytest.approx(2.0 * 1.0**2, rel=1e-2)


def test_half_planes_are_kept_rather_than_the_goal_and_what_is_trespassed_by_is_said():
    goal = np.array([0.0, 3e3])
    # the flattest dive leads 2.2 km towards the goal; it may end a kilometre away
    planes = np.zeros((1, 11, 1, 3))
    planes[0, 9] = [[0.0, 1.0, 1000.0]]
    case = _case(goal, 1, walls=Walls(np.ones(planes.shape[:3]), planes))
    found = _solved(_layout(1, 1), case, _straight(goal, 1))
    assert found.guess.places[0, 1] == pytest.approx(1000.0, abs=5.0)
    assert found.plane_violation == pytest.approx(0.0, abs=5.0)
    # the steepest leads 857 m: wherever it heads it comes out of a box of 600 m by 200 m, least of all objectives towards the goal
    planes = np.zeros((1, 11, 4, 3))
    planes[0, 9] = [[0.0, 1.0, 300.0], [0.0, -1.0, 300.0], [1.0, 0.0, 100.0], [-1.0, 0.0, 100.0]]
    case = replace(case, walls=Walls(np.ones(planes.shape[:3]), planes))
    found = _solved(_layout(1, 4), case, _straight(goal, 1))
    hop = 600.0 / np.tan(np.deg2rad(35.0))
    np.testing.assert_allclose(found.guess.places[0], [0.0, hop], atol=5.0)
    assert found.plane_violation == pytest.approx(hop - 300.0, abs=5.0)
    # a kilometre beyond costs as much as four kilometres missed
    assert found.objective == pytest.approx(50.0 * (4.0 * (hop - 300.0) + 3e3 - hop) / KM, rel=0.01)


def test_guides_weigh_hours_and_distances_as_they_were_asked_to():
    mooring = near_place(np.zeros(2), 1e3, 4.0 * HOUR, True)
    # a mission's length at a kilometre's distance costs one, however long it is
    assert (mooring.weight, mooring.least_duration, mooring.limit, mooring.surfacings_only) == (
        0.25,
        4.0 * HOUR,
        1e3,
        True,
    )
    line = along_line(np.zeros(2), np.array([0.0, 5e3]), 3.0, 2e3)
    assert (line.weight, line.least_duration, line.limit, line.surfacings_only) == (
        3.0,
        0.0,
        2e3,
        False,
    )
    # farther along the line is no distance from it
    np.testing.assert_allclose(line.distances(np.array([[0.0, 9e3], [-700.0, -1e3]])), [0.0, 700.0])


def _task(**more):
    settings = MissionSettings(depth=300.0, **more)
    return mission_task(
        FLOW,
        request_between(FLOW, (-1e3, 0.0), (3e3, 2e3), vehicle=GLIDER, settings=settings),
    )


def test_a_guide_s_weight_goes_by_the_time_of_each_step_and_its_limit_stops_short_of_what_is_checked():
    task = replace(
        _task(surface_time=900.0), reference_path=near_place(np.zeros(2), 2e3, 4.0 * HOUR, False)
    )
    problem, angles = LegsProblem(task, 2, GoalSteps((2,), (0,))), np.array([0.3, 0.5])

    def weighed(**more):
        path = replace(task.reference_path, **more)
        return _reference(replace(problem, task=replace(task, reference_path=path)), angles, 2.0, 1)

    found = weighed()
    hours = np.abs(np.diff(DIVE)) / (0.3 * np.sin(angles))[:, None] / HOUR
    np.testing.assert_allclose(found.weights[:, :10], 2.0 * hours)
    # the drift after the first leg lasts a quarter of an hour, and there is none after the last
    np.testing.assert_allclose(found.weights[:, 10], [2.0 * 0.25, 0.0])
    longer = replace(problem, n_legs=3, goals=GoalSteps((3,), (0,)))
    drifts = _reference(longer, np.full(3, 0.3), 2.0, 1).weights[:, 10]
    np.testing.assert_allclose(drifts, [2.0 * 0.25, 2.0 * 0.25, 0.0])
    np.testing.assert_allclose(found.limits, (2e3 - 50.0) / KM)
    assert found.least_duration == 4.0 * HOUR
    # of a narrow limit the margin takes half at most
    np.testing.assert_allclose(weighed(limit=60.0).limits, 30.0 / KM)
    # surfacings alone have the weight of their whole legs, and nothing limits what is between them
    found = weighed(surfacings_only=True)
    assert np.all(found.weights[:, :10] == 0.0)
    np.testing.assert_allclose(
        found.weights[:, 10], 2.0 * (hours.sum(axis=1) + np.array([0.25, 0.0]))
    )
    np.testing.assert_allclose(found.limits[:, 10], (2e3 - 50.0) / KM)
    assert np.all(found.limits[:, :10] >= 1e3)
    assert _reference(replace(problem, task=_task()), angles, 2.0, 1) is None


def test_half_planes_are_first_laid_along_the_route_and_then_straight_from_leg_to_leg():
    task = _task()
    yo_depths = task.yo_depths(2)
    guess = MissionGuess(np.array([[1e3, 0.0], [3e3, 2e3]]), np.zeros(2), np.full(2, 0.3))
    n_places, problem = task.n_steps(yo_depths), LegsProblem(task, 2, GoalSteps((2,), (0,)))
    straight = _points_along(problem, guess)
    share = np.arange(1, n_places + 1)[:, None] / n_places
    np.testing.assert_allclose(
        straight[0], task.start[:2] + share * (guess.places[0] - task.start[:2]), rtol=1e-12
    )
    np.testing.assert_allclose(
        straight[1], guess.places[0] + share * (guess.places[1] - guess.places[0]), rtol=1e-12
    )
    # by a route with a corner, gone at its own pace: half of the time for the first leg
    route = Route(np.array([[-1e3, 0.0], [-1e3, 3e3], [3e3, 3e3]]), np.array([0.0, 1e4, 4e4]), True)
    along = _points_along(problem, guess, route).reshape(-1, 2)
    times = 4e4 * np.arange(1, 2 * n_places + 1) / (2 * n_places)
    expected = [np.interp(times, route.times, route.points[:, i]) for i in (0, 1)]
    np.testing.assert_allclose(along, np.column_stack(expected), rtol=1e-9, atol=1e-6)
    # a drift is one more place after each leg
    assert _points_along(replace(problem, task=_task(surface_time=600.0)), guess).shape == (
        2,
        n_places + 1,
        2,
    )


def test_goals_are_met_at_the_end_of_a_leg_or_after_so_many_of_its_steps():
    flight = Flight(
        np.arange(61.0),
        np.zeros(61),
        np.zeros((1, 61, 2)),
        np.zeros(61, dtype=int),
        np.array([20, 40, 60]),
    )
    assert GoalSteps((1, 2, 3), (3, 0, 4)).points(flight).tolist() == [
        3 * REFINED,
        40,
        40 + 4 * REFINED,
    ]
