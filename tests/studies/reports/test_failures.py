"""A method or study that fails costs the others nothing, and what is done is on the disk."""

import json
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError, EstimatorError
from replay_kit.studies.accuracy import AccuracyJob, run_accuracy
from replay_kit.studies.accuracy import run as accuracy
from replay_kit.studies.accuracy.page import to_json
from replay_kit.studies.planning import odds
from replay_kit.studies.planning.odds import JudgedMission
from tests import synthetic
from tests.studies.results import experiment, final

MEMBERS = synthetic.ensemble(n_members=5, shape=(5, 6))
CONFIG = EstimatorConfig(modes=6)
JOB = AccuracyJob(
    leave_out="2", pings=(1, 3), seeds=2, methods=("nearest", "etkf", "ensemble_mean")
)


class Killed(BaseException):
    """What stops a run in these tests and no code of the project knows."""


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory):
    path = tmp_path_factory.mktemp("ocean") / "ensemble.nc"
    synthetic.dataset(n_members=5, shape=(5, 6)).to_netcdf(path, engine="h5netcdf")
    return path


class Failing:
    """An estimator whose updates fail after some."""

    def __init__(self, estimator, error, after):
        self.estimator, self.error, self.after = estimator, error, after

    def __getattr__(self, name):
        return getattr(self.estimator, name)

    def steps(self, state, observations):
        for n, step in enumerate(self.estimator.steps(state, observations), start=1):
            if n > self.after:
                raise self.error
            yield step


@pytest.fixture
def failing(monkeypatch):
    """Makes the method etkf fail with an error after some updates; None at once."""
    build = accuracy.build_method

    def fail(error, after=None):
        def built(name, *arguments):
            if name == "etkf" and after is None:
                raise error
            estimator = build(name, *arguments)
            return Failing(estimator, error, after) if name == "etkf" else estimator

        monkeypatch.setattr(accuracy, "build_method", built)

    return fail


@pytest.mark.parametrize(
    "error", [np.linalg.LinAlgError("not positive definite"), EstimatorError("no update")]
)
@pytest.mark.parametrize("after", [None, 0, 2])
def test_a_method_that_fails_is_a_row_with_its_reason_and_keeps_what_was_scored(
    failing, error, after
):
    whole = final(run_accuracy(MEMBERS, None, CONFIG, JOB))
    failing(error, after)
    result = final(run_accuracy(MEMBERS, None, CONFIG, JOB))
    for row, expected in zip(result.rows, whole.rows, strict=True):
        if row.method == "etkf" and row.pings > (after or 0):
            assert row.failed.endswith(f"{type(error).__name__}: {error}")
            assert row.rel_error_by_seed == ()
        else:
            # the bound is that of an estimator's kind, which the one that fails hides
            assert repr(replace(row, bound=0.0)) == repr(replace(expected, bound=0.0))
    said = json.loads(json.dumps(to_json(result), allow_nan=False))["results"]
    assert [row.get("failed", "") for row in said] == [row.failed for row in result.rows]
    assert all(row["rmse"] is None for row in said if "failed" in row)


@pytest.mark.parametrize(
    "error", [TypeError("wrong"), IndexError("wrong"), ConfigError("an option")]
)
def test_errors_of_the_program_and_of_options_end_the_run(failing, error):
    failing(error)
    with pytest.raises(type(error), match=str(error)):
        final(run_accuracy(MEMBERS, None, CONFIG, JOB))


def test_a_mean_over_truths_says_on_how_many_a_method_failed(failing):
    failing(np.linalg.LinAlgError("singular"), 1)
    rows = final(run_accuracy(MEMBERS, None, CONFIG, replace(JOB, leave_out="all", seeds=1))).rows
    by_key = {(row.method, row.pings): row for row in rows if row.truth == "mean"}
    assert (
        by_key["etkf", 3].failed
        == "failed on 5 of 5 truths, first on member 0: seed 0: LinAlgError: singular"
    )
    assert by_key["etkf", 1].failed == by_key["nearest", 3].failed == ""
    assert np.isfinite(by_key["etkf", 1].rmse)


def accuracy_of(ensemble, words):
    return experiment(f"accuracy --ensemble {ensemble} --leave-out 2 --seeds 1 --modes 6 {words}")


def test_a_run_that_is_killed_leaves_the_methods_that_were_done(failing, ensemble, tmp_path):
    failing(Killed(), 0)
    answer = tmp_path / "answer.json"
    with pytest.raises(Killed):
        accuracy_of(ensemble, f"--pings 1,3 --methods nearest,etkf,ensemble_mean --json {answer}")
    said = json.loads(answer.read_text())
    assert said["unfinished"] is True
    assert [(row["method"], row["pings"]) for row in said["results"]] == [
        ("nearest", 1),
        ("nearest", 3),
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["answer.json"]


def test_a_command_whose_methods_all_fail_writes_why_and_is_no_success(failing, ensemble, tmp_path):
    failing(np.linalg.LinAlgError("singular"))
    answer = tmp_path / "answer.json"
    done = accuracy_of(ensemble, f"--pings 1 --methods etkf --json {answer}")
    assert isinstance(done.exception, EstimatorError)
    assert "etkf after 1 pings: LinAlgError: singular" in done.output
    said = json.loads(answer.read_text())
    assert "unfinished" not in said
    assert said["results"][0]["failed"] == "LinAlgError: singular"


def planning(ensemble, out, words):
    return experiment(f"planning --ensemble {ensemble} -o {out} --modes 6 {words}")


def test_a_planning_run_that_is_killed_leaves_the_missions_that_were_done(
    monkeypatch, ensemble, tmp_path
):
    def made_up(case, *_):
        if case.member == 2:
            raise Killed
        return [JudgedMission(case.member, "reached", 0.95, 0.9, 100.0, 250.0)]

    monkeypatch.setattr(odds, "_of_truth", made_up)
    with pytest.raises(Killed):
        planning(ensemble, tmp_path / "out", "--leave-out 1,2 --pairs 2")
    said = json.loads((tmp_path / "out" / "planning.json").read_text())
    assert (said["unfinished"], [one["truth"] for one in said["missions"]]) == (True, [1])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "odds.csv",
        "planning.json",
    ]


def test_a_member_that_is_not_there_makes_no_folder(ensemble, tmp_path):
    done = planning(ensemble, tmp_path / "out", "--leave-out 77")
    assert isinstance(done.exception, ConfigError)
    assert "--leave-out: expected 0 to 4, got 77" in str(done.exception)
    assert not (tmp_path / "out").exists()
