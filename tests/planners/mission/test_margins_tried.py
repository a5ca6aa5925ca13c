"""Which margins and numbers of legs are tried for samples of the current: by outcomes that are given, not flown."""

from dataclasses import replace

import numpy as np
import pytest
from planners.mission.scenario import Chances, _wider, chances_of, points_at
from planners.mission.spread import Spread

from planners import Glider, MissionSettings, plan_scenarios
from planners.mission import scenario
from planners.mission.plan import attempts_of
from planners.mission.task import mission_task
from tests.planners.flow_samples import place, uniform_flow

FLOW = uniform_flow(0.02, 0.0)
START, GOAL = place(FLOW, -5e3, -3e3, 0.0), place(FLOW, 6e3, -3e3, 0.0)
SETTINGS = MissionSettings(depth=390.0, legs=5)
N = 20


@pytest.fixture(scope="module")
def problem():
    task = mission_task(FLOW, (START, (GOAL,)), Glider(), SETTINGS, ((), None), 0)
    return task, attempts_of(task, None, 0)[0]


def outcomes(monkeypatch, problem, *clear: list[float]) -> list[Spread]:
    """Let each plan tried come out so clear [m] in the first samples, and 100 m in the others; return the spreads asked for."""
    asked: list[Spread] = []
    given = iter(np.array([*some, *[100.0] * (N - len(some))]) for some in clear)

    def judged(*_: object) -> tuple[Chances, np.ndarray]:
        at = next(given)
        return Chances(1.0, float(np.mean(at > 0.0)), 0.0, 0.0, {}), at

    def wider(task, before, spread):
        asked.append(spread)
        return problem[1]

    monkeypatch.setattr(scenario, "attempts_of", lambda *_: [problem[1]])
    monkeypatch.setattr(scenario, "chances_of", judged)
    monkeypatch.setattr(scenario, "_wider", wider)
    return asked


def test_a_margin_that_falls_short_is_widened_by_more_than_it_falls_short(monkeypatch, problem) -> None:
    asked = outcomes(monkeypatch, problem, [-300.0] * 4, [-80.0, -30.0], [-10.0], [])
    plan, chances = plan_scenarios(FLOW, [FLOW] * N, START, GOAL, settings=SETTINGS)
    # the first time by what the samples deviate alone; then by 1.15 times what the worst falls short, and by 50 m at least
    assert [spread.more for spread in asked] == pytest.approx([0.0, 92.0, 142.0])
    assert {spread.share for spread in asked} == {0.9}
    assert (chances.safe, plan.statistics["margins_tried"], plan.statistics["attempts"]) == (1.0, 4, 4)
    assert plan.statistics["margin_beside_spread_m"] == pytest.approx(142.0)


def test_the_samples_that_may_trespass_do_not_count_as_falling_short(monkeypatch, problem) -> None:
    # where three in ten are allowed, three of twenty may trespass: the fourth decides
    asked = outcomes(monkeypatch, problem, [-300.0] * 9, [-900.0, -800.0, -700.0, -600.0, -200.0], [])
    plan_scenarios(FLOW, [FLOW] * N, START, GOAL, settings=SETTINGS, allowed=0.3)
    most = scenario.most_enough(N, 0.3)
    assert most == 3
    worst = sorted([900.0, 800.0, 700.0, 600.0, 200.0], reverse=True)
    assert asked[-1].more == pytest.approx(1.15 * worst[most])


def test_four_margins_are_tried_and_the_safest_is_kept_when_none_is_enough(monkeypatch, problem) -> None:
    outcomes(monkeypatch, problem, [-300.0] * 6, [-80.0] * 3, [-80.0] * 4, [-80.0] * 5)
    plan, chances = plan_scenarios(FLOW, [FLOW] * N, START, GOAL, settings=SETTINGS)
    assert plan.statistics["margins_tried"] == 4
    assert chances.safe == pytest.approx(17.0 / 20.0)
    assert plan.statistics["margin_beside_spread_m"] == 0.0


def test_on_the_edge_of_an_area_is_in_it(monkeypatch, problem) -> None:
    task, attempt = problem
    monkeypatch.setattr(scenario, "clearances", lambda *_: {"range": np.array([0.0]), "land": np.array([3.0])})
    chances, clear = chances_of(task, attempt.flight, points_at(attempt.flight, attempt.flight.time[-1:]))
    assert (chances.safe, chances.trespass, clear.tolist()) == (0.0, {"range": 1.0}, [0.0])


def legs_tried(monkeypatch, problem, settings: MissionSettings, *found: tuple[bool, float]) -> tuple[list[int], float]:
    """Return the numbers of legs solved for, each of which is safe at the goal or not and trespasses by so much, and what is kept of it."""
    task, before = replace(problem[0], settings=settings), problem[1]
    given, tried = iter(found), []

    def solved(_, attempt, spread):
        tried.append(len(attempt.guess.headings))
        met, trespass = next(given)
        return replace(attempt, trespass=trespass, miss=np.array([0.0 if met else 1e4]))

    monkeypatch.setattr(scenario, "solve_clear", solved)
    kept = _wider(task, before, Spread(np.zeros((2, 3, 2)), 0.9, 0.0))
    return tried, kept.trespass


def test_more_legs_are_tried_only_where_the_margin_leaves_the_goal_out_of_reach(monkeypatch, problem) -> None:
    free = replace(SETTINGS, legs=None)
    assert legs_tried(monkeypatch, problem, free, (True, 4.0)) == ([5], 4.0)
    # at the goal, but not clear by the margin; or clear, but not at the goal
    assert legs_tried(monkeypatch, problem, free, (True, 6.0), (True, 1.0)) == ([5, 6], 1.0)
    assert legs_tried(monkeypatch, problem, free, (False, 0.0), (True, 2.0)) == ([5, 6], 2.0)
    # two more at most, no more than are allowed, and none where their number is given
    assert legs_tried(monkeypatch, problem, free, (False, 9.0), (False, 7.0), (False, 8.0)) == ([5, 6, 7], 7.0)
    assert legs_tried(monkeypatch, problem, replace(free, max_legs=6), (False, 9.0), (False, 7.0)) == ([5, 6], 7.0)
    assert legs_tried(monkeypatch, problem, SETTINGS, (False, 9.0)) == ([5], 9.0)
    # what is at the goal comes before what trespasses less
    assert legs_tried(monkeypatch, problem, free, (False, 0.0), (True, 30.0), (False, 1.0)) == ([5, 6, 7], 30.0)
