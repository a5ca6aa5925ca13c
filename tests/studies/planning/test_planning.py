"""Plans flown in truths: the studies at their smallest, and that each of their checks can fail."""

import csv
import io
import json
import math
from dataclasses import replace
from functools import partial

import matplotlib.image
import numpy as np
import pytest

import planners
from planners.mission.flights import fly_mission
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import to_local
from replay_kit.core.plan import Place
from replay_kit.studies.jobs import Advance
from replay_kit.studies.planning import STUDIES, PlanningJob
from replay_kit.studies.planning.arrival_tables import Arrival, order_of, place_of_average
from replay_kit.studies.planning.odds import as_sample, odds
from replay_kit.studies.planning.world import build_world, draw_missions
from replay_kit.studies.scoring import bootstrap_ratio
from tests import synthetic
from tests.studies.results import experiment

MEMBERS = synthetic.ensemble(n_members=6, shape=(8, 9))
CONFIG = EstimatorConfig(modes=8)
JOB = PlanningJob(("glides",), "1", pairs=1, pings=6, legs=2)
DRAWN = ("glides", "missions")


def world():
    return build_world(MEMBERS, None, CONFIG, JOB, Advance())


def flown(flow, miss, error=0.1):
    spot = Place(0.0, 0.0, 0.0)
    return Arrival(flow, 3, spot, spot, "reached", 1.0, miss, error, 0.1)


def criterion(report, words):
    (one,) = (one for one in report.criteria if words in one.what)
    return one


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planning")
    synthetic.dataset(n_members=6, shape=(8, 9)).to_netcdf(
        folder / "ensemble.nc", engine="h5netcdf"
    )
    command = f"planning --ensemble {folder}/ensemble.nc -o {folder}/out --modes 8 --leave-out 1,4 --pairs 1 --pings 6 --legs 2"
    # one start, coarse steps and few legs: plans are tested elsewhere
    plan, settings = planners.plan, planners.MissionSettings
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            planners, "plan", partial(plan, settings=planners.GlideSettings(starts=1, n_steps=8))
        )
        patch.setattr(planners, "MissionSettings", lambda **how: settings(**{**how, "max_legs": 3}))
        done = experiment(f"{command} --study {','.join(DRAWN)} --json {folder}/answer.json")
    assert done.exit_code == 0, done.output
    again = experiment(f"{command} --study glides")
    return folder / "out", json.loads((folder / "answer.json").read_text()), done.output, again


@pytest.mark.full
def test_studies_are_reported_in_every_form(answer):
    out, said, printed, again = answer
    assert tuple(said["studies"]) == DRAWN
    assert said == {"format_version": 2, **json.loads((out / "planning.json").read_text())}
    report = (out / "report.md").read_text()
    for study, reported in said["studies"].items():
        for name, rows in reported["tables"].items():
            assert name.startswith(study)
            read = list(csv.DictReader(io.StringIO((out / f"{name}.csv").read_text())))
            assert [row.keys() for row in read] == [row.keys() for row in rows]
        for one in reported["criteria"]:
            assert one["what"] in report
        assert f"Acceptance criteria of {study}" in printed
    pictures = sorted(out.glob("*.png"))
    assert [picture.stem for picture in pictures] == ["glides_misses", "missions_misses"]
    for picture in pictures:
        assert f"({picture.name})" in report
        assert np.ptp(matplotlib.image.imread(picture)[..., :3]) == 1.0
    # what is there already is not replaced without being asked to
    assert isinstance(again.exception, ConfigError)
    assert "index.html: exists" in str(again.exception)


@pytest.mark.full
def test_plans_on_the_truth_meet_goals_that_the_truth_reaches(answer):
    for study, least in (("glides", 10.0), ("missions", 50.0)):
        rows = answer[1]["studies"][study]["tables"][f"{study}_cases"]
        on_truth = [row["miss [m]"] for row in rows if row["planned on"] == "truth"]
        assert len(on_truth) == 1
        assert max(on_truth) < least
        assert max(row["miss [m]"] for row in rows) > 10.0 * max(on_truth)
        assert {row["truth"] for row in rows} == {1}


def test_goals_are_of_the_reachable_set():
    withheld = world().truths[0]
    (pair,) = draw_missions(withheld, withheld.truth, 1, 300.0, 3, 0)
    settings = planners.MissionSettings(depth=300.0, legs=3)
    plan = planners.plan_mission(
        withheld.truth, planners.MissionRequest(pair.start, (pair.target,), settings=settings)
    )
    assert plan.status == "reached"
    end = fly_mission(withheld.truth, plan).place[0, -1]
    goal = np.ravel(
        to_local(withheld.truth.grid.projection, pair.target.longitude, pair.target.latitude)
    )
    assert np.linalg.norm(end - goal) < 5.0


def test_odds_are_of_samples_and_of_a_truth_on_the_nodes_of_the_estimate(monkeypatch):
    small = build_world(
        MEMBERS,
        None,
        CONFIG,
        replace(JOB, studies=("odds",), pairs=2, fresh=5),
        Advance(),
    )
    monkeypatch.setattr("replay_kit.studies.planning.odds.JUDGING", 4)
    monkeypatch.setattr("replay_kit.studies.planning.odds.ARRIVING", 0.0)
    report = odds(small)
    (table,) = report.tables
    assert len(table.rows) == 2
    assert {row[1] for row in table.rows} <= {"reached", "unreachable"}
    flown_in = [row for row in table.rows if row[1] == "reached"]
    assert flown_in
    share = criterion(report, "fresh samples").value
    assert share == pytest.approx(np.mean([row[3] for row in flown_in]))
    arrived = [row[4] <= planners.MissionSettings().tolerance for row in flown_in]
    assert criterion(report, "withheld truth").value == pytest.approx(np.mean(arrived))
    estimate, truth = small.truths[0].estimate(), small.truths[0].truth
    same, at = (
        as_sample(estimate, truth),
        (np.array([-8e3, 5e3]), np.array([3e3, -4e3]), np.array([20.0, 90.0])),
    )
    assert estimate.horizontal.kernel.speed != pytest.approx(
        truth.horizontal.kernel.speed, rel=1e-6
    )
    np.testing.assert_allclose(same.velocity(*at), truth.velocity(*at), rtol=1e-9, atol=1e-12)
    monkeypatch.setattr("replay_kit.studies.planning.odds.ARRIVING", 1.1)
    none = odds(small)
    assert (none.criteria, "None of 2 missions is reported as reached" in none.findings[0]) == (
        (),
        True,
    )


def test_the_order_is_as_asked_or_not():
    right = [
        flown(flow, miss)
        for flow, miss in (("truth", 1.0), ("default", 50.0), ("naive3d", 90.0), ("nearest", 400.0))
    ]
    assert [one.met for one in order_of(right)] == [True] * 3
    wrong = [
        replace(one, miss=60.0)
        if one.flow == "naive3d"
        else replace(one, miss=70.0)
        if one.flow == "default"
        else one
        for one in right
    ]
    assert [one.met for one in order_of(wrong)] == [True, False, True]
    words = place_of_average([*right, flown("depth_averaged_truth", 25.0, 0.3)], 0.9, once=True)
    assert "ratio of 0.5 " in words
    assert "90 % of the truths'" in words


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
        ({"studies": ("glide",)}, "--study"),
        ({"studies": ("glides", "glides")}, "each once"),
        ({"pairs": 0}, "--pairs"),
        ({"noise": math.nan}, "--noise"),
        ({"leave_out": "2,2"}, "each once"),
    ],
)
def test_what_is_refused(changed, words):
    job = replace(JOB, **changed)
    with pytest.raises(ConfigError, match=words):
        job.check(STUDIES) or job.members(6)


def test_a_wrong_option_makes_no_folder(tmp_path):
    done = experiment(f"planning --ensemble {tmp_path}/none.nc -o {tmp_path}/out --study glide")
    assert "expected some of glides" in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_a_truth_of_its_own_leaves_no_member_out():
    truth = synthetic.ensemble(5, n_members=1, shape=(8, 9))
    with pytest.raises(ConfigError, match="--truth and --leave-out"):
        build_world(MEMBERS, truth, CONFIG, JOB, Advance())
    (withheld,) = build_world(
        MEMBERS, truth, CONFIG, replace(JOB, leave_out=None), Advance()
    ).truths
    assert (withheld.case.ensemble.n_members, withheld.member) == (6, 6)
    assert withheld.case.truth is truth


def test_members_are_spread_over_the_ensemble():
    job = replace(JOB, leave_out=None, pairs=4)
    assert job.members(80) == (10, 30, 50, 70)
    assert replace(job, pairs=500).members(6) == (0, 1, 2, 3, 4, 5)
    assert sum(world().shares(7)) == 7
