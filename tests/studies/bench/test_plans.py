"""Odds of missions against truths: the study at its smallest, and that each of its checks can fail."""

import math
from dataclasses import replace

import numpy as np
import pytest

import planners
from planners.mission.flights import fly_mission
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import to_local
from replay_kit.estimator import embed_member
from replay_kit.studies.bench import plans as odds
from replay_kit.studies.bench.frame import rows_of
from replay_kit.studies.bench.plans import JudgedMission, PlanJob, as_sample, draw_missions
from replay_kit.studies.jobs import bootstrap_ratio
from replay_kit.studies.twins.field import build_field
from tests import synthetic

MEMBERS = synthetic.ensemble(n_members=6, shape=(8, 9))
CONFIG = EstimatorConfig(modes=8)
JOB = PlanJob("1", plans=2, pings=6, legs=2, fresh=5)


def test_goals_are_of_the_reachable_set():
    (case,) = JOB.cases(MEMBERS, None)
    truth, rng = embed_member(case.truth, 0, CONFIG), np.random.default_rng(2)
    grids = truth.grid, case.ensemble.grid
    (pair,) = draw_missions(build_field(case.truth), truth, grids, (1, 3, 300.0), rng)
    settings = planners.MissionSettings(depth=300.0, legs=3)
    plan = planners.plan_mission(
        truth, planners.MissionRequest(pair.start, (pair.target,), settings=settings)
    )
    assert plan.status == "reached"
    end = fly_mission(truth, plan).place[0, -1]
    goal = np.ravel(to_local(truth.grid.projection, pair.target.longitude, pair.target.latitude))
    assert np.linalg.norm(end - goal) < 5.0


@pytest.fixture
def lenient(monkeypatch):
    """Few samples judge a plan, and each plan is reported as reached."""
    monkeypatch.setattr(odds, "JUDGING", 4)
    monkeypatch.setattr(odds, "ARRIVING", 0.0)


def test_odds_are_of_samples_and_of_a_truth(lenient, monkeypatch):
    first, real = [], planners.mission_odds

    def judged(flow, samples, plan, request):
        first.append(samples[0].latent)
        return real(flow, samples, plan, request)

    monkeypatch.setattr(planners, "mission_odds", judged)
    (found,) = odds.run_plans(MEMBERS, None, CONFIG, JOB)
    # a plan is flown in other samples than those that judged it
    assert not np.allclose(first[0], first[1])
    assert [one.name for one in found] == [
        "reported as reached",
        "arrive in fresh samples",
        "arrive in the truth",
        "miss in the truth [m]",
    ]
    assert {(one.task, one.case) for one in found} == {("plans", f"{MEMBERS.source}#1")}
    monkeypatch.setattr(odds, "ARRIVING", 1.1)
    (none,) = odds.run_plans(MEMBERS, None, CONFIG, JOB)
    assert [(one.part, one.whole) for one in none] == [(0, 2)]


def test_shares_are_of_the_missions_reported_as_reached():
    missions = [JudgedMission(True, 0.9, 120.0), JudgedMission(True, 0.94, 400.0)]
    rows = rows_of(odds.figures_of([*missions, JudgedMission(False)]))
    assert [(row.figure, pytest.approx(row.value), row.met) for row in rows] == [
        ("reported as reached", 2 / 3, None),
        ("arrive in fresh samples", 0.92, True),
        ("arrive in the truth", 0.5, False),
        ("miss in the truth [m]", 260.0, None),
    ]


def test_a_truth_is_a_sample_on_the_nodes_of_the_estimate():
    (case,) = JOB.cases(MEMBERS, None)
    truth = embed_member(case.truth, 0, CONFIG)
    estimate = odds._estimate(case, build_field(case.truth), CONFIG, JOB)
    at = np.array([-8e3, 5e3]), np.array([3e3, -4e3]), np.array([20.0, 90.0])
    assert estimate.horizontal.kernel.speed != pytest.approx(
        truth.horizontal.kernel.speed, rel=1e-6
    )
    same = as_sample(estimate, truth)
    np.testing.assert_allclose(same.velocity(*at), truth.velocity(*at), rtol=1e-9, atol=1e-12)


def test_a_ratio_of_medians_is_resampled_case_by_case():
    rng = np.random.default_rng(2)
    others = rng.lognormal(size=60)
    low, high = bootstrap_ratio(2.0 * others, others)
    assert (low, high) == (pytest.approx(2.0), pytest.approx(2.0))
    held = [
        low <= 1.0 <= high
        for low, high in (
            bootstrap_ratio(*rng.lognormal(sigma=0.5, size=(2, 40))) for _ in range(100)
        )
    ]
    assert 0.82 <= np.mean(held) <= 1.0


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"plans": 0}, "--plans"),
        ({"noise": math.nan}, "--noise"),
        ({"leave_out": "2,2"}, "each once"),
    ],
)
def test_what_is_refused(changed, words):
    with pytest.raises(ConfigError, match=words):
        list(odds.run_plans(MEMBERS, None, CONFIG, replace(JOB, **changed)))


def test_a_truth_of_its_own_leaves_no_member_out():
    truth = synthetic.ensemble(5, n_members=1, shape=(8, 9))
    with pytest.raises(ConfigError, match="--truth and --leave-out"):
        JOB.cases(MEMBERS, truth)
    (case,) = replace(JOB, leave_out=None).cases(MEMBERS, truth)
    assert (case.ensemble.n_members, case.member) == (6, None)
    assert case.truth is truth


def test_members_are_spread_over_the_ensemble():
    job = replace(JOB, leave_out=None, plans=3)
    assert [case.member for case in job.cases(MEMBERS, None)] == [1, 3, 5]
    assert len(replace(job, plans=500).cases(MEMBERS, None)) == 6
