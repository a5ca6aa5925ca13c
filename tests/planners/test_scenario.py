"""Missions that keep clear in samples of the current."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionSettings, plan_mission, plan_scenarios
from planners.flight import currents_of_samples
from planners.mission_task import mission_task
from planners.scenario import chances_of, legs_of
from replay_kit.errors import PlanError
from tests.planners.flow_samples import eddying_flow, place, uniform_flow
from tests.planners.test_mission import _area

FLOW = uniform_flow(0.02, 0.0)
START, GOAL = place(FLOW, -5e3, -3e3, 0.0), place(FLOW, 6e3, -3e3, 0.0)
SETTINGS = MissionSettings(depth=390.0, legs=5)
AREA = _area(FLOW, -0.7e3, -6e3, 0.7e3, -1e3)


def _drawn(n: int, seed: int) -> list:
    rng = np.random.default_rng(seed)
    east, north = uniform_flow(0.1, 0.0).latent, uniform_flow(0.0, 0.1).latent
    return [replace(FLOW, latent=FLOW.latent + 0.1 * rng.standard_normal() * east + 0.1 * rng.standard_normal() * north) for _ in range(n)]


def test_the_margin_widens_until_the_samples_keep_clear():
    plan, chances = plan_scenarios(FLOW, _drawn(20, 1), START, GOAL, settings=SETTINGS, no_go=(AREA,))
    narrow = plan_mission(FLOW, START, GOAL, settings=SETTINGS, no_go=(AREA,))
    task = mission_task(FLOW, (START, (GOAL,)), plan.vehicle, SETTINGS, ((AREA,), None), 0)
    fresh = currents_of_samples(_drawn(60, 2))
    (wide_chances, wide), (narrow_chances, near) = (chances_of(task, fresh, legs_of(task, one), one.goal_times) for one in (plan, narrow))
    assert plan.status == narrow.status == "reached"
    assert chances.safe >= 0.9
    assert plan.settings.margin > SETTINGS.margin
    assert narrow_chances.safe < 0.8 < wide_chances.safe
    # a sample is safe where its path keeps clear by more than nothing
    np.testing.assert_allclose(np.mean(near > 0.0), narrow_chances.safe, atol=0.05)
    assert np.median(wide) > np.median(near)


def test_a_certain_current_needs_no_margin_and_no_samples_are_refused():
    plan, chances = plan_scenarios(FLOW, [FLOW] * 3, START, GOAL, settings=SETTINGS)
    assert (plan.settings.margin, chances.safe, chances.reached) == (SETTINGS.margin, 1.0, 1.0)
    assert chances.miss_90_percent < 1.0
    with pytest.raises(PlanError, match="needs some"):
        plan_scenarios(FLOW, [], START, GOAL)
    with pytest.raises(PlanError, match="sample 1"):
        plan_scenarios(FLOW, [eddying_flow(1)], START, GOAL)
