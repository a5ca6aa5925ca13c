"""Which margins and numbers of legs are tried for samples of the current: by outcomes that are given, not flown."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionRequest, MissionSettings, MonteCarloSummary, plan_scenarios
from planners.mission import flights, odds, scenarios
from planners.mission.flights import points_at, summarise_flights
from planners.mission.scenarios import _widen_margin, most_violations_allowed
from planners.mission.search.search import solve_attempts
from planners.mission.solve.optimum import SafetyMargin
from planners.mission.task import mission_task
from tests.planners.flow_samples import place, uniform_flow

FLOW = uniform_flow(0.02, 0.0)
START, GOAL = place(FLOW, -5e3, -3e3), place(FLOW, 6e3, -3e3)
SETTINGS = MissionSettings(depth=390.0, legs=5)
REQUEST = MissionRequest(START, (GOAL,), settings=SETTINGS)
N = 20


@pytest.fixture(scope="module")
def problem():
    task = mission_task(FLOW, REQUEST)
    return task, solve_attempts(task)[0]


def outcomes(monkeypatch, problem, *clear):
    """Let each plan tried come out so clear [m] in the first samples, and 100 m in the others; return the margins asked for."""
    asked: list[SafetyMargin] = []
    given = iter(np.array([*some, *[100.0] * (N - len(some))]) for some in clear)

    def judged(*_):
        at = next(given)
        return MonteCarloSummary(1.0, float(np.mean(at > 0.0)), 0.0, 0.0, {}), at

    def wider(task, before, margin):
        asked.append(margin)
        return problem[1]

    monkeypatch.setattr(scenarios, "solve_attempts", lambda *_: [problem[1]])
    monkeypatch.setattr(odds, "summarise_flights", judged)
    monkeypatch.setattr(scenarios, "_widen_margin", wider)
    return asked


def test_a_margin_that_falls_short_is_widened_by_more_than_it_falls_short(monkeypatch, problem):
    asked = outcomes(monkeypatch, problem, [-300.0] * 4, [-80.0, -30.0], [-10.0], [])
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    # the first time by what the samples deviate alone; then by 1.15 times what the worst falls short, and by 50 m at least
    assert [margin.extra for margin in asked] == pytest.approx([0.0, 92.0, 142.0])
    assert {margin.share for margin in asked} == {0.9}
    assert (summary.safe, plan.statistics["margins_tried"], plan.statistics["attempts"]) == (
        1.0,
        4,
        4,
    )
    assert plan.statistics["extra_margin_m"] == pytest.approx(142.0)


def test_the_samples_that_may_trespass_do_not_count_as_falling_short(monkeypatch, problem):
    # where three in ten are allowed, three of twenty may trespass: the fourth decides
    asked = outcomes(
        monkeypatch, problem, [-300.0] * 9, [-900.0, -800.0, -700.0, -600.0, -200.0], []
    )
    plan_scenarios(FLOW, [FLOW] * N, REQUEST, allowed=0.3)
    most = most_violations_allowed(N, 0.3)
    assert most == 3
    worst = sorted([900.0, 800.0, 700.0, 600.0, 200.0], reverse=True)
    assert asked[-1].extra == pytest.approx(1.15 * worst[most])


def test_four_margins_are_tried_and_the_safest_is_kept_when_none_is_enough(monkeypatch, problem):
    outcomes(monkeypatch, problem, [-300.0] * 6, [-80.0] * 3, [-80.0] * 4, [-80.0] * 5)
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert plan.statistics["margins_tried"] == 4
    assert summary.safe == pytest.approx(17.0 / 20.0)
    assert plan.statistics["extra_margin_m"] == 0.0


def leading(monkeypatch, problem, *plans, anew=()):
    """Let each plan tried lead to the goal or past it, and come out so clear; return the margins with which plans are made."""
    outcomes(monkeypatch, problem, *(clear for _, clear in plans))
    margins, leads, made = list[float](), iter(plans[1:]), iter((True, *anew))
    there, past = problem[1], replace(problem[1], miss=np.array([3e3]))

    def solved(task):
        margins.append(task.settings.margin)
        return [there if next(made) else past]

    monkeypatch.setattr(scenarios, "solve_attempts", solved)
    monkeypatch.setattr(scenarios, "_widen_margin", lambda *_: there if next(leads)[0] else past)
    return margins


def test_a_plan_that_keeps_clear_by_leading_past_the_goal_is_none(monkeypatch, problem):
    # the second plan is clear and goes astray: the way is planned anew with wider margins, the first by what was missing at first
    margins = leading(
        monkeypatch,
        problem,
        (True, [-300.0] * 4),
        (False, []),
        (True, [-80.0] * 3),
        (True, []),
        anew=(True, True),
    )
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert (plan.status, summary.safe) == ("reached", 1.0)
    assert margins == pytest.approx([50.0, 50.0 + 345.0, 50.0 + 345.0 + 92.0])
    assert (plan.statistics["margins_tried"], plan.statistics["extra_margin_m"]) == (
        4,
        pytest.approx(437.0),
    )


def test_a_way_that_a_wider_margin_closes_is_planned_with_a_narrower_one(monkeypatch, problem):
    margins = leading(
        monkeypatch,
        problem,
        (True, [-300.0] * 4),
        (False, []),
        (True, []),
        anew=(False, False, True),
    )
    plan, _ = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert plan.status == "reached"
    assert margins == pytest.approx([50.0, 50.0 + 345.0, 50.0 + 345.0 / 2.0, 50.0 + 345.0 / 4.0])


def test_wider_ways_end_where_one_keeps_no_more_samples_clear(monkeypatch, problem):
    no_more = [(True, [-300.0] * 4), (False, [-9.0] * 9), (True, [-80.0] * 3), (True, [-40.0] * 3)]
    margins = leading(monkeypatch, problem, *no_more, anew=(True, True))
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert (plan.status, summary.safe, len(margins)) == ("reached", pytest.approx(17.0 / 20.0), 3)


def test_where_no_margin_leads_to_the_goal_the_least_risk_that_does_is_kept(monkeypatch, problem):
    margins = leading(
        monkeypatch,
        problem,
        (True, [-300.0] * 8),
        (True, [-80.0] * 6),
        (False, []),
        anew=(False,) * 4,
    )
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert (plan.status, summary.safe, len(margins)) == ("reached", pytest.approx(14.0 / 20.0), 5)
    # a goal that is out of reach without a margin leaves nothing but to keep clear
    past = replace(problem[1], miss=np.array([3e3]))
    outcomes(monkeypatch, problem, [-300.0] * 4, [])
    monkeypatch.setattr(scenarios, "solve_attempts", lambda _: [past])
    monkeypatch.setattr(scenarios, "_widen_margin", lambda *_: past)
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert (plan.status, summary.safe, plan.statistics["margins_tried"]) == ("unreachable", 1.0, 2)


def test_a_risk_that_is_kept_by_a_plan_that_arrives_needs_no_other_way(monkeypatch, problem):
    # one of twenty is no proof of one in ten, but within it
    margins = leading(monkeypatch, problem, (True, [-300.0] * 4), (True, [-80.0]), (False, []))
    plan, summary = plan_scenarios(FLOW, [FLOW] * N, REQUEST)
    assert (plan.status, summary.safe, margins) == ("reached", pytest.approx(0.95), [50.0])


def test_on_the_edge_of_an_area_is_in_it(monkeypatch, problem):
    task, attempt = problem
    monkeypatch.setattr(
        flights, "clearances", lambda *_: {"range": np.array([0.0]), "land": np.array([3.0])}
    )
    summary, clear = summarise_flights(
        task, attempt.flight, points_at(attempt.flight, attempt.flight.time[-1:])
    )
    assert (summary.safe, summary.violations, clear.tolist()) == (0.0, {"range": 1.0}, [0.0])


def legs_tried(monkeypatch, problem, settings, *found):
    """Return the numbers of legs solved for, each safe at the goal or not and so far beyond a half-plane, and how far the one kept is."""
    task, before = replace(problem[0], request=replace(REQUEST, settings=settings)), problem[1]
    given, tried = iter(found), []

    def solved(_, attempt, margin):
        tried.append(len(attempt.guess.headings))
        met, violation = next(given)
        return replace(attempt, plane_violation=violation, miss=np.array([0.0 if met else 1e4]))

    monkeypatch.setattr(scenarios, "solve_with_margin", solved)
    kept = _widen_margin(task, before, SafetyMargin(np.zeros((2, 3, 2)), 0.9, 0.0))
    return tried, kept.plane_violation


def test_more_legs_are_tried_only_where_the_margin_leaves_the_goal_out_of_reach(
    monkeypatch, problem
):
    free = replace(SETTINGS, legs=None)
    assert legs_tried(monkeypatch, problem, free, (True, 4.0)) == ([5], 4.0)
    # at the goal, but not clear by the margin; or clear, but not at the goal
    assert legs_tried(monkeypatch, problem, free, (True, 6.0), (True, 1.0)) == ([5, 6], 1.0)
    assert legs_tried(monkeypatch, problem, free, (False, 0.0), (True, 2.0)) == ([5, 6], 2.0)
    # two more at most, no more than are allowed, and none where their number is given
    assert legs_tried(monkeypatch, problem, free, (False, 9.0), (False, 7.0), (False, 8.0)) == (
        [5, 6, 7],
        7.0,
    )
    assert legs_tried(
        monkeypatch, problem, replace(free, max_legs=6), (False, 9.0), (False, 7.0)
    ) == ([5, 6], 7.0)
    assert legs_tried(monkeypatch, problem, SETTINGS, (False, 9.0)) == ([5], 9.0)
    # where one more is no better, two are not tried
    assert legs_tried(monkeypatch, problem, free, (False, 7.0), (False, 9.0)) == ([5, 6], 7.0)
    # what is at the goal comes before what is beyond a half-plane by less
    assert legs_tried(monkeypatch, problem, free, (False, 0.0), (True, 30.0), (False, 1.0)) == (
        [5, 6, 7],
        30.0,
    )
