"""Legs flown all at once are those flown one after the other; Newton's method finds where each begins."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider, MissionSettings, plan_mission
from planners.mission.flight.legs import Legs, fly_legs
from planners.mission.solve.legs import fly_solution
from planners.mission.task import leg_depths, refine_steps
from planners.shooting.program import MissionGuess, MissionSolution
from planners.simulation.currents import currents_of
from tests.planners.flow_samples import LEVELS, eddying_flow, request_between

GLIDER, START = Glider(), np.array([2e3, -5e3])


def _legs(count, drift):
    rng = np.random.default_rng(3)
    depths = tuple(
        refine_steps(leg_depths((0.0, deepest, 0.0), np.array(LEVELS), 10), 2)
        for deepest in rng.choice([90.0, 300.0], count)
    )
    return Legs(
        rng.uniform(0.0, 1.0, count),
        rng.uniform(0.3, 0.5, count),
        depths,
        np.append(np.full(count - 1, drift), 0.0),
    )


def _currents(changing):
    flows = [replace(eddying_flow(seed), time_ns=10**15 + seed * 10**13) for seed in (1, 2, 3)]
    return currents_of(flows if changing else flows[0])


@pytest.mark.parametrize(("changing", "drift"), [(False, 0.0), (False, 900.0), (True, 900.0)])
def test_legs_flown_at_once_are_those_flown_one_after_the_other(changing, drift):
    currents, legs = _currents(changing), _legs(5, drift)
    slowly = fly_legs(currents, GLIDER, START, legs, 500.0)
    # begins that are kilometres off, and no derivatives: only the commands are known
    off = slowly.place[0, slowly.ends] + np.random.default_rng(1).uniform(-3e3, 3e3, (5, 2))
    solution = MissionSolution(MissionGuess(off, legs.headings, legs.angles), 0.0, 0.0, 0, "", None)
    at_once = fly_solution(currents, GLIDER, START, legs, 500.0, solution)
    np.testing.assert_allclose(at_once.place, slowly.place, atol=2e-3)
    np.testing.assert_allclose(at_once.time, slowly.time, rtol=1e-12, atol=1e-7)
    np.testing.assert_array_equal(at_once.depth, slowly.depth)
    np.testing.assert_array_equal(at_once.leg, slowly.leg)
    np.testing.assert_array_equal(at_once.ends, slowly.ends)


def test_a_current_that_is_not_a_number_is_flown_without_end():
    currents, legs = _currents(False), _legs(3, 0.0)
    broken = replace(currents, latent=np.full(currents.latent.shape, np.nan))
    solution = MissionSolution(
        MissionGuess(np.zeros((3, 2)), legs.headings, legs.angles), 0.0, 0.0, 0, "", None
    )
    assert np.isnan(fly_solution(broken, GLIDER, START, legs, 0.0, solution).place[0, -1]).all()


def test_a_plan_is_the_same_whatever_was_planned_before_with_its_program():
    flows = [eddying_flow(6), eddying_flow(7)]
    requests = [
        request_between(
            flow, (-6e3, -6e3), (2e3, 2e3), settings=MissionSettings(depth=300.0, legs=6)
        )
        for flow in flows
    ]
    first = plan_mission(flows[0], requests[0])
    plan_mission(flows[1], requests[1])
    again = plan_mission(flows[0], requests[0])
    np.testing.assert_array_equal(first.headings_deg, again.headings_deg)
    np.testing.assert_array_equal(first.track, again.track)
