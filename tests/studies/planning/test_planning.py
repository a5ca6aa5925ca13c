"""Odds of missions against truths: the study at its smallest, and that each of its checks can fail."""

import csv
import json
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
from replay_kit.studies.planning import PlanningJob, odds
from replay_kit.studies.planning.odds import as_sample, draw_missions
from replay_kit.studies.planning.page import report_of
from replay_kit.studies.scoring import bootstrap_ratio
from replay_kit.studies.twins.field import build_field
from tests import synthetic
from tests.studies.results import experiment, final

MEMBERS = synthetic.ensemble(n_members=6, shape=(8, 9))
CONFIG = EstimatorConfig(modes=8)
JOB = PlanningJob("1", pairs=2, pings=6, legs=2, fresh=5)


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
    found = final(odds.run_planning(MEMBERS, None, CONFIG, JOB))
    assert [one.truth for one in found.missions] == [1, 1]
    reached = [one for one in found.missions if one.status == "reached"]
    assert reached
    fresh, arrived = report_of(found).answer["criteria"]
    assert fresh["value"] == pytest.approx(np.mean([one.fresh for one in reached]))
    near = [one.miss <= planners.MissionSettings().tolerance for one in reached]
    assert arrived["value"] == pytest.approx(np.mean(near))
    monkeypatch.setattr(odds, "ARRIVING", 1.1)
    none = final(odds.run_planning(MEMBERS, None, CONFIG, JOB))
    assert report_of(none).answer["criteria"] == []
    assert all(math.isnan(one.miss) for one in none.missions)


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


@pytest.mark.full
def test_the_study_is_reported_in_every_form(lenient, tmp_path):
    out, ensemble = tmp_path / "out", tmp_path / "ensemble.nc"
    synthetic.dataset(n_members=6, shape=(8, 9)).to_netcdf(ensemble, engine="h5netcdf")
    command = f"planning --ensemble {ensemble} -o {out} --modes 8 --leave-out 1,4 --pairs 2 --pings 6 --legs 2 --fresh 5"
    done = experiment(f"{command} --json {tmp_path}/answer.json")
    assert done.exit_code == 0, done.output
    said = json.loads((tmp_path / "answer.json").read_text())
    assert said == {"format_version": 2, **json.loads((out / "planning.json").read_text())}
    assert [one["truth"] for one in said["missions"]] == [1, 4]
    read = list(csv.DictReader((out / "odds.csv").read_text().splitlines()))
    assert [row["status"] for row in read] == [one["status"] for one in said["missions"]]
    report = (out / "report.md").read_text()
    for words in (*said["findings"], *(one["what"] for one in said["criteria"])):
        assert words in report
    assert "Acceptance criteria" in done.output
    # what is there already is not replaced without being asked to
    again = experiment(command)
    assert isinstance(again.exception, ConfigError)
    assert "index.html: exists" in str(again.exception)


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
        ({"pairs": 0}, "--pairs"),
        ({"noise": math.nan}, "--noise"),
        ({"leave_out": "2,2"}, "each once"),
    ],
)
def test_what_is_refused(changed, words):
    with pytest.raises(ConfigError, match=words):
        final(odds.run_planning(MEMBERS, None, CONFIG, replace(JOB, **changed)))


def test_a_wrong_option_makes_no_folder(tmp_path):
    done = experiment(f"planning --ensemble {tmp_path}/none.nc -o {tmp_path}/out --noise=-1")
    assert "--noise" in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_a_truth_of_its_own_leaves_no_member_out():
    truth = synthetic.ensemble(5, n_members=1, shape=(8, 9))
    with pytest.raises(ConfigError, match="--truth and --leave-out"):
        JOB.cases(MEMBERS, truth)
    (case,) = replace(JOB, leave_out=None).cases(MEMBERS, truth)
    assert (case.ensemble.n_members, case.member) == (6, None)
    assert case.truth is truth


def test_members_are_spread_over_the_ensemble():
    job = replace(JOB, leave_out=None, pairs=3)
    assert [case.member for case in job.cases(MEMBERS, None)] == [1, 3, 5]
    assert len(replace(job, pairs=500).cases(MEMBERS, None)) == 6
