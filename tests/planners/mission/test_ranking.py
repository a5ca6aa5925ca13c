"""What missions of several numbers of legs are sorted by."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionRequest, MissionSettings, Weights
from planners.mission.plan import to_plan
from planners.mission.search.search import solve_attempts
from planners.mission.solve.attempt import (
    best_of,
    energy_of,
    excess_deviation,
    goals_met,
    ranking_key,
)
from planners.mission.solve.check import Violation
from planners.mission.solve.optimum import _weights
from planners.mission.task import mission_task
from planners.mission.timing import best_departure
from planners.request import OBJECTIVES, Objective
from planners.shooting.program import near_place
from planners.vehicle import SteadyFlight
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import place, still_flow

DEPTH, HOUR = 300.0, 3600.0
# steeper is faster by the flight model, and takes more dives: more work for the pump
GLIDER = Glider(flight=SteadyFlight(), min_angle=20.0, max_angle=40.0, hotel=0.5)


@pytest.fixture(scope="module")
def solved():
    """A task in still water, and its way of six kilometres in five legs and in seven."""
    flow, tasks = still_flow(), []
    ask = (place(flow, -3e3, 0.0), (place(flow, 3e3, 0.0),))
    for legs in (5, 7):
        task = mission_task(
            flow, MissionRequest(*ask, GLIDER, MissionSettings(depth=DEPTH, legs=legs))
        )
        tasks.append((task, solve_attempts(task)[0]))
    (task, few), (_, many) = tasks
    return task, few, many


def with_settings(task, **changed):
    return replace(task, request=replace(task.request, settings=replace(task.settings, **changed)))


def weighed(task, **weights):
    return with_settings(task, legs=None, objective=Weights(**weights))


def test_energy_is_of_the_hotel_load_for_the_time_and_of_the_pump_at_each_apogee(solved):
    task, few, many = solved
    for attempt, dives in ((few, 5), (many, 7)):
        pump = dives * GLIDER.pump_work(DEPTH)
        assert energy_of(task, attempt) == pytest.approx(
            0.5 * attempt.flight.time[-1] + pump, rel=1e-12
        )


def test_a_dive_s_apogee_is_counted_once_however_many_dives_a_leg_has(solved):
    task, few, _ = solved
    twice = with_settings(task, yos=2)
    below = replace(task, start=np.array([-3e3, 0.0, 100.0]), goals=np.array([[3e3, 0.0, 200.0]]))
    hotel = 0.5 * few.flight.time[-1]
    assert energy_of(twice, replace(few, yo_depths=twice.yo_depths(5))) == pytest.approx(
        hotel + 10 * GLIDER.pump_work(DEPTH), rel=1e-12
    )
    # the last leg ends on its way down: it has no apogee
    assert energy_of(below, replace(few, yo_depths=below.yo_depths(5))) == pytest.approx(
        hotel + 4 * GLIDER.pump_work(DEPTH), rel=1e-12
    )


def test_time_prefers_steep_legs_and_energy_few(solved):
    task, few, many = solved
    assert goals_met(task, few)
    assert goals_met(task, many)
    hours = [attempt.flight.time[-1] / HOUR for attempt in (few, many)]
    kilojoules = [energy_of(task, attempt) / 1e3 for attempt in (few, many)]
    assert hours[1] < hours[0]
    assert kilojoules[0] < kilojoules[1]
    # what a kilojoule has to be worth in hours for the two to cost the same
    even = (hours[0] - hours[1]) / (kilojoules[1] - kilojoules[0])
    for energy, best in ((0.0, many), (0.9 * even, many), (1.1 * even, few)):
        asked = weighed(task, time=1.0, energy=energy)
        assert min((few, many), key=lambda attempt: ranking_key(asked, attempt)) is best
        for attempt, lasts, spent in zip((few, many), hours, kilojoules, strict=True):
            assert ranking_key(asked, attempt) == (
                False,
                0.0,
                pytest.approx(lasts + energy * spent, rel=1e-12),
            )


def test_what_is_safe_and_at_the_goal_comes_first_and_the_others_by_how_far_they_miss(solved):
    task, few, many = solved
    within, beyond = (
        replace(few, miss=np.array([miss]))
        for miss in (task.settings.tolerance, task.settings.tolerance + 1.0)
    )
    found = Violation("range", 10.0, 1, 152.5, -40.0)
    unsafe = replace(few, violation=found)
    # the order of a list that time alone would turn round: the slower mission is at the goal
    assert ranking_key(task, within)[:2] == (False, 0.0)
    assert ranking_key(task, beyond)[:2] == (True, task.settings.tolerance + 1.0)
    ranked = sorted(
        [unsafe, replace(many, miss=np.array([900.0])), beyond, within],
        key=lambda attempt: ranking_key(task, attempt),
    )
    assert [ranked.index(attempt) for attempt in (within, beyond)] == [0, 1]
    assert ranked[-1] is unsafe
    # of several goals the one missed most decides, and every one has to be met
    two = replace(few, miss=np.array([0.0, task.settings.tolerance + 5.0]))
    assert not goals_met(task, two)
    assert ranking_key(task, two)[1] == task.settings.tolerance + 5.0
    # coming close is all that counts for a mission that only comes close; its time decides among equals
    closest = with_settings(task, objective="closest")
    assert ranking_key(closest, replace(few, miss=np.array([3.0])))[:2] == (False, 3.0)
    # weighed against time, a goal that is missed is no failure, and all that are missed count
    assert ranking_key(
        weighed(task, time=1.0, closest=2.0), replace(few, miss=np.array([900.0, 600.0]))
    ) == (
        *(False, 0.0),
        pytest.approx(few.flight.time[-1] / HOUR + 2.0 * 1.5, rel=1e-12),
    )


def test_straying_from_a_mooring_is_a_failure_and_its_mean_square_costs(solved):
    task, few, _ = solved
    reference = replace(near_place(np.zeros(2), 1000.0, 5.0 * HOUR, False), weight=0.3)
    moored = replace(task, reference_path=reference)
    near, far = (
        replace(few, deviation=(farthest, 500.0), miss=np.zeros(1)) for farthest in (1000.0, 1200.0)
    )
    assert (
        excess_deviation(task, far),
        excess_deviation(moored, near),
        excess_deviation(moored, far),
    ) == (0.0, 0.0, 200.0)
    hours = few.flight.time[-1] / HOUR
    assert ranking_key(moored, near) == (
        False,
        0.0,
        pytest.approx(hours + 0.3 * hours * 0.5**2, rel=1e-12),
    )
    assert ranking_key(moored, far)[:2] == (True, 200.0)


def test_the_solver_weighs_time_and_hotel_load_against_misses_and_straying(solved):
    task, _, _ = solved
    # 0.5 W for an hour are 1.8 kJ; the largest weight is 1
    assert _weights(weighed(task, time=1.0, energy=0.1)) == (1.0, None, 0.0)
    assert _weights(weighed(task, time=1.0, energy=0.1, closest=2.0)) == (
        pytest.approx(1.18 / 2.0),
        1.0,
        0.0,
    )
    guided = replace(
        weighed(task, time=1.0, energy=0.1),
        reference_path=replace(near_place(np.zeros(2), 1000.0, HOUR, False), weight=4.0),
    )
    assert _weights(guided) == (pytest.approx(1.18 / 4.0), None, 1.0)


def test_an_added_objective_ranks_the_missions_that_are_found(solved, monkeypatch):
    task, few, many = solved

    def surfacings(found):
        assert found.glide_angles.shape == (len(found.yo_depths),)
        return float(len(found.yo_depths))

    monkeypatch.setitem(OBJECTIVES, "rest", Objective(Weights(time=1.0), surfacings))
    monkeypatch.setattr("planners.request.is_objective", OBJECTIVES.__contains__)
    asked = with_settings(task, objective="rest", legs=None)
    assert best_of(task, [few, many]) is many
    assert best_of(asked, [many, few]) is few
    assert _weights(asked) == _weights(task)
    plans = [to_plan(asked, [attempt]) for attempt in (few, many)]
    assert [
        best_departure([replace(plan, settings=which.request.settings) for plan in plans])
        for which in (task, asked)
    ] == [1, 0]
    with pytest.raises(
        PlanError, match=r"expected one of time, energy, odds, closest.*, or weights"
    ):
        with_settings(task, objective="speed")
