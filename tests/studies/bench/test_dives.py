"""Tasks on dives: what is asked, answered and scored; programs that answer late, wrongly or not at all."""

import json
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.grid import Ensemble
from replay_kit.core.surfacing import SHARES
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.studies.bench import missions as bench_missions
from replay_kit.studies.bench.dives import DiveJob, run_dives
from replay_kit.studies.bench.frame import results_of
from replay_kit.studies.bench.methods import LastDive, _at_depths, last_here
from replay_kit.studies.bench.missions import Dive, Mission, mission_of, read_dives
from replay_kit.studies.bench.page import to_json
from replay_kit.studies.bench.records import (
    DIVE_TASKS,
    MEAN_TASKS,
    answer_of_json,
    records,
)
from replay_kit.studies.twins.make import Twin, make_twin
from tests import synthetic
from tests.places import DATA, needs
from tests.studies.results import bench, final

MEMBERS = synthetic.ensemble(n_members=9, shape=(5, 6))
TRUTH = Ensemble(MEMBERS.grid, MEMBERS.velocity[:1], None, "truth")
HOUR_NS = 3600 * 10**9


def made(n=8, seed=0, name="made"):
    """Dives of two hours every six, with the current by depth and its mean."""
    rng, dives = np.random.default_rng(seed), []
    for k in range(n):
        depth = np.arange(10.0, 100.0, 20.0)
        velocity = 0.1 * rng.standard_normal((depth.size, 2)) + 0.2
        begin = 6 * k * HOUR_NS
        dives.append(
            Dive(
                k + 1,
                begin,
                begin + 2 * HOUR_NS,
                (5.0 + 0.1 * (k % 3), 60.0),
                rng.normal(0.0, 0.2, 2),
                velocity.mean(axis=0),
                depth,
                velocity,
                at=np.tile([5.0, 60.0], (depth.size, 1)),
            )
        )
    return Mission(name, tuple(dives), {})


def run(missions, job, estimator=None):
    return final(results_of(run_dives(missions, estimator, job), {}))


def values(result, task="next-dive"):
    return {(row.method, row.figure): row.value for row in result.rows if row.task == task}


@pytest.mark.parametrize("task", DIVE_TASKS)
def test_a_record_never_holds_what_is_asked(task):
    mission, sent = made(12), []
    asked = list(records(task, mission))
    for record in asked:
        sent += record.given
        assert [dive.number for dive in sent] == [dive.number for dive in record.known]
        assert all(dive.end_ns <= record.target.begin_ns for dive in record.known)
        line = json.loads(json.dumps(record.json(), allow_nan=False))
        assert line["target"]["velocity"] == []
        assert (line["target"]["mean"] is None) == (task != "deny-adcp")
        assert (line["target"]["way"] is None) == (task == "planned-dive")
        number, later = record.target.number, json.dumps(line["given"])
        assert str(mission.dives[number - 1].velocity[0, 0]) not in later
        if task == "deny-dive" and record.known:
            assert record.known[-1].number == number - 2
        if task == "deny-day" and record.known:
            assert record.known[-1].end_ns <= record.target.begin_ns - 24 * HOUR_NS
        if task == "deny-adcp":
            assert not any(dive["depth"] for dive in line["given"])
        # one that is started anew learns all that is known
        assert len(record.json(from_the_first=True)["given"]) == len(record.known)
    assert len(asked) == 12
    unknown = sum(not record.known for record in asked)
    assert unknown == {"deny-dive": 2, "deny-day": 5}.get(task, 1)
    assert asked[0].truth.shape == ((1, 2) if task in MEAN_TASKS else (5, 2))


def test_scores_are_those_of_the_answers_from_the_third_predicted_dive_on():
    missions = [made(seed=1, name="a"), made(6, seed=2, name="b")]
    found = run(missions, DiveJob(("next-dive", "profile")))
    means = [np.array([dive.mean for dive in mission.dives]) for mission in missions]
    last = [np.diff(each, axis=0)[2:] for each in means]
    rms = [np.sqrt(np.mean(np.sum(each**2, axis=1))) for each in last]
    by_case = {(row.method, row.figure): row for row in found.rows if row.task == "next-dive"}
    assert by_case["last_dive", "RMS error [cm/s]"].by_case == pytest.approx(100.0 * np.array(rms))
    both = np.concatenate(last)
    assert by_case["last_dive", "RMS error [cm/s]"].value == pytest.approx(
        100.0 * np.sqrt(np.mean(np.sum(both**2, axis=1)))
    )
    zero = [np.sqrt(np.mean(np.sum(each[3:] ** 2, axis=1))) for each in means]
    assert by_case["zero", "over last dive"].value == pytest.approx(
        np.exp(np.mean(np.log(np.array(zero) / rms)))
    )
    assert by_case["last_dive", "log score gain [nats]"].value == 0.0
    assert by_case["last_dive", "over last dive"].low == 1.0
    profile = values(found, "profile")
    assert profile["zero", "over zero"] == pytest.approx(1.0)
    assert 0.0 <= profile["by_depth", "coverage 50 %"] <= profile["by_depth", "coverage 90 %"] <= 1
    # a mission that is too short is said
    short = run([missions[0], made(3, name="short")], DiveJob(("next-dive",)))
    assert short.lost == (
        "next-dive, short: 2 dives can be predicted, and the first 2 are not scored",
    )


def test_an_answer_states_a_gaussian_by_its_covariance_or_deviations():
    cov = np.array([[0.04, 0.01], [0.01, 0.02]])
    answer = answer_of_json({"velocity": [[0.1, 0.2]], "cov": cov.tolist()}, 1)
    expected = multivariate_normal([0.1, 0.2], cov).logpdf([0.0, 0.3])
    assert answer.stated.log_density(np.array([0.0, 0.3])) == pytest.approx(expected)
    assert answer.stated.holds(np.array([0.1, 0.2]), SHARES) == (True, True)
    assert answer.stated.holds(np.array([0.1, 0.8]), SHARES) == (False, False)
    assert answer_of_json({"velocity": [[0, 1], [2, 3]]}, 2).std is None
    for said, words in (
        ([1.0], "an object"),
        ({"velocity": [[0.1, float("nan")]]}, "finite"),
        ({"velocity": [[0.1]]}, "shape"),
        ({"velocity": "east"}, "numbers"),
        ({"velocity": [[0.1, 0.2]], "std": [[0.1, 0.0]]}, "above 0"),
        ({"velocity": [[0.1, 0.2]], "cov": [[1.0, 2.0], [2.0, 1.0]]}, "positive definite"),
    ):
        with pytest.raises(ValueError, match=words):
            answer_of_json(said, 1)


def test_baselines_are_what_they_say():
    mission = made(9)
    *_, record = records("next-dive", mission)
    here = last_here(record).velocity[0]
    # every third dive begins at the same place; the two before do not count
    np.testing.assert_array_equal(here, mission.dives[5].mean)
    *_, record = records("profile", mission)
    column = _at_depths(record.known, record)
    expected = np.mean([dive.velocity for dive in record.known], axis=0)
    np.testing.assert_allclose(column, expected)
    last = LastDive()(record).velocity
    np.testing.assert_allclose(last, record.known[-1].velocity)


ENTRY = """
import json, sys, time
how, count, last = sys.argv[1], 0, [0.0, 0.0]
for line in sys.stdin:
    record, count = json.loads(line), count + 1
    if record["given"]:
        last = record["given"][-1]["mean"]
    if count == 4 and record["target"]["dive"] == 4:
        if how == "hangs": time.sleep(60)
        if how == "ends": sys.exit(3)
        if how == "text": print("hello", flush=True); continue
        if how == "nan": print('{"velocity": [[NaN, 0.0]]}', flush=True); continue
    print(json.dumps({"velocity": [last], "std": [[0.1, 0.1]]}), flush=True)
"""


@pytest.mark.full
def test_programs_that_fail_are_scored_as_the_last_dive_named_and_cost_no_other(tmp_path):
    path = tmp_path / "entry.py"
    path.write_text(ENTRY)
    how = ("well", "hangs", "ends", "text", "nan")
    programs = {each: f"{sys.executable} {path} {each}" for each in how}
    job = DiveJob(("next-dive",), ("last_dive",), {**programs, "absent": "./no-such-program"}, 1.0)
    begun = time.monotonic()
    found = run([made()], job)
    assert time.monotonic() - begun < 30.0
    score = values(found)
    for each in (*how, "absent"):
        # an answer that is the last dive's and one that is missing score the same
        assert score[each, "RMS error [cm/s]"] == score["last_dive", "RMS error [cm/s]"]
    assert len(found.lost) == 5
    reasons = (
        "no answer within 1 s",
        "it ended",
        "no usable answer",
        "finite",
        "cannot be started",
    )
    for name, reason in zip((*how[1:], "absent"), reasons, strict=True):
        (why,) = (each for each in found.lost if f" {name}: " in each)
        assert f"{8 if name == 'absent' else 1} of 8 answers missing" in why
        assert reason in why
    again = run([made()], job)
    assert repr(again) == repr(found)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("twin") / "glider.mcap"
    make_twin(TRUTH, Twin("glider", 70, 0.05, 3, interval_s=1200.0), path)
    return path


def test_with_an_ensemble_dives_are_predicted_on_its_estimate(log):
    mission = mission_of([log], RunConfig())
    assert len(mission.dives) >= 4
    first = mission.dives[0]
    assert first.depth.size == len(first.velocity) == len(first.at) > 0
    forecast = Ensemble(MEMBERS.grid, MEMBERS.velocity[1:], None, "forecast")
    estimator = build_evolving((forecast,), EstimatorConfig(modes=12), TimeConfig())
    # a twin's current by depth is known from the pings that the estimator is given too
    dives = tuple(replace(dive, given=dive.given[::2]) for dive in mission.dives)
    found = run([replace(mission, dives=dives)], DiveJob(("next-dive", "profile")), estimator)
    score = values(found)
    assert score["filter", "over last dive"] < score["forecast", "over last dive"]
    assert score["estimate", "RMS error [cm/s]"] < score["zero", "RMS error [cm/s]"]
    assert "surfacing error [m]" in {figure for _, figure in score}
    profile = values(found, "profile")
    assert profile["filter", "RMS error [cm/s]"] < profile["zero", "RMS error [cm/s]"]
    answer = json.loads(json.dumps(to_json(found), allow_nan=False))
    assert {row["task"] for row in answer["rows"]} == {"next-dive", "profile"}


def test_one_dive_is_none_to_predict(tmp_path):
    make_twin(TRUTH, Twin("glider", 3, 0.05, 3), tmp_path / "short.mcap")
    with pytest.raises(MeasurementError, match="at least two dives"):
        read_dives([tmp_path / "short.mcap"], RunConfig())


def test_frozen_missions_are_known_by_their_hashes(log, tmp_path, monkeypatch):
    entry = {"form": "logs", "origin": "this test", "files": {"glider.mcap": "0" * 64}}
    absent = {**entry, "name": "absent", "files": {"none.mcap": "0" * 64}}
    monkeypatch.setattr(bench_missions, "registry", lambda: [{**entry, "name": "twin"}, absent])
    (tmp_path / "glider.mcap").write_bytes(log.read_bytes())
    wrong = bench(f"{tmp_path}")
    assert isinstance(wrong.exception, MeasurementError)
    assert "expected SHA-256 0000" in str(wrong.exception)
    assert "this test" in str(wrong.exception)
    entry["files"]["glider.mcap"] = str(wrong.exception).partition(", got ")[2][:64]
    done = bench(
        f"{tmp_path} --task next-dive,profile --methods last_dive,zero --json {tmp_path}.json"
    )
    assert done.exit_code == 0, done.output
    assert "absent is not in the folder" in done.output
    answer = json.loads(tmp_path.with_suffix(".json").read_text())
    assert answer["missions"]["twin"]["files"] == entry["files"]


@needs(DATA)
@pytest.mark.full
def test_two_runs_on_a_public_mission_are_the_same_bytes(tmp_path, monkeypatch):
    few = [one for one in bench_missions.registry() if one["name"] in ("rosie", "sp028")]
    monkeypatch.setattr(bench_missions, "registry", lambda: few)
    words = "--task next-dive --methods process,last_dive --first 2 --json"
    for name in ("one", "two"):
        assert bench(f"{DATA} {words} {tmp_path}/{name}.json").exit_code == 0
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()


@pytest.mark.full
@needs(DATA)
def test_the_public_missions_are_there_and_the_process_beats_the_last_dive(tmp_path):
    words = f"--task next-dive --methods process,last_dive,zero --json {tmp_path}/answer.json"
    assert bench(f"{DATA} {words}").exit_code == 0
    answer = json.loads((tmp_path / "answer.json").read_text())
    counts = {name: each["mean_currents"] for name, each in answer["missions"].items()}
    assert counts == {"anegada": 133, "sg171": 5, "sg249": 6, "sg033": 18, "sp028": 4, "rosie": 6}
    rows = {(row["method"], row["figure"]): row for row in answer["rows"]}
    ratio = rows["process", "over last dive"]
    assert ratio["value"] <= 0.88
    assert ratio["by_case"][0] <= 0.85
    assert 0.87 <= rows["process", "coverage 90 %"]["value"] <= 0.96
    assert rows["process", "log score gain [nats]"]["value"] >= 0.3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "pings needs an --ensemble"),
        ("--task tides", "--task"),
        ("--task next-dive", "a folder or logs"),
        ("a.mcap --task pings --ensemble e.nc", "a task on dives"),
        ("--ensemble e.nc", "--truth and --leave-out"),
        ("--ensemble e.nc --task bias", "needs --leave-out"),
        ("a.mcap --methods kriging", "--methods"),
        ("a.mcap --methods etkf", "--methods"),
        ("a.mcap --entry python", "NAME=COMMAND"),
        ("a.mcap --time-limit 0", "--time-limit"),
    ],
)
def test_what_cannot_be_asked_is_said_before_anything_is_read(words, said):
    done = bench(words)
    assert isinstance(done.exception, ConfigError)
    assert said in str(done.exception)
