"""Twin surveys end to end: their truths, profiles and bounds, and methods that fail."""

import json

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError, EstimatorError
from replay_kit.core.grid import Ensemble
from replay_kit.studies.bench import surveys
from replay_kit.studies.bench.frame import Figure, Lost, results_of, rows_of
from replay_kit.studies.bench.page import to_json
from replay_kit.studies.bench.surveys import SurveyJob, run_surveys
from replay_kit.studies.jobs import METHODS, bound, build_method
from replay_kit.studies.twins.adcp import IDEAL_ERROR_STD, random_observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import cases, leave_out, most_distant
from replay_kit.workflows.replay.scoring import scored_points
from tests import synthetic
from tests.studies.results import bench, final
from tests.workflows.replay.interrupted import Killed

MEMBERS = synthetic.ensemble(n_members=6, shape=(5, 6))
CONFIG = EstimatorConfig(modes=20)
FEW = SurveyJob(leave_out="2", pings=(1, 3), seeds=2, methods=("nearest", "etkf", "ensemble_mean"))


def run(job, config=CONFIG, truth=None, members=MEMBERS, progress=lambda *_: None):
    return final(results_of(run_surveys(members, truth, config, job, progress), {}))


def values(result, figure="relative error"):
    return {(row.method, row.after): row for row in result.rows if row.figure == figure}


@pytest.fixture(scope="module")
def result():
    return run(SurveyJob(leave_out="2", pings=(2, 6), seeds=2))


def test_every_method_has_every_figure_and_none_beats_its_bound(result):
    answer = json.loads(json.dumps(to_json(result), allow_nan=False))
    assert list(values(result)) == [(method, n) for method in METHODS for n in (2, 6)]
    assert len(answer["rows"]) == 7 * 2 * len(METHODS)
    error, least = (values(result, name) for name in ("RMSE [m/s]", "bound [m/s]"))
    for key, row in error.items():
        assert row.cases == ("seed 0", "seed 1")
        assert row.value == pytest.approx(np.mean(row.by_case))
        assert row.low <= row.value <= row.high
        assert not row.value < least[key].value * (1 - 1e-9)
    for name in ("coverage 50 %", "NIS per degree of freedom"):
        assert np.isnan(values(result, name)["nearest", 6].value)
    assert np.isnan(least["letkf", 6].value)
    relative = {key: row.value for key, row in values(result).items()}
    assert relative["default", 6] < relative["ensemble_mean", 6] == relative["ensemble_mean", 2]


def test_scores_on_the_way_are_those_of_a_shorter_run(result):
    """Online is offline: the first row does not know that more pings follow; only the places drawn depend on their number."""
    case = leave_out(MEMBERS, 2)
    estimator = build_method("default", case.ensemble, CONFIG)
    at, state = scored_points(MEMBERS.grid, case.truth), estimator.initial()
    for observation in random_observations(build_field(case.truth), 6, 0.09, 0)[:2]:
        state, _ = estimator.step(state, observation)
    error = estimator.flow(state).velocity(*at.place) - at.velocity
    expected = np.sqrt(np.sum(error**2) / np.sum(at.velocity**2))
    assert values(result)["default", 2].by_case[0] == pytest.approx(expected)


def test_a_wrong_mean_is_found_by_an_estimator_that_expects_it():
    """The truth has half of what all members agree on; 90 % intervals are of use only where this is expected."""
    strong = Ensemble(MEMBERS.grid, MEMBERS.velocity + 2.0 * MEMBERS.velocity[0], None, "strong")
    case = leave_out(strong, 2)
    truth = Ensemble(
        MEMBERS.grid, case.truth.velocity - 0.5 * strong.velocity.mean(axis=0), None, "truth"
    )
    job = SurveyJob(pings=(8,), seeds=1, methods=("default",))
    certain, uncertain = (
        {row.figure: row.value for row in run(job, config, truth, case.ensemble).rows}
        for config in (CONFIG.model_copy(update={"mean_variance": 0.0}), CONFIG)
    )
    assert uncertain["relative error"] < 0.8 * certain["relative error"]
    assert uncertain["CRPS [m/s]"] < certain["CRPS [m/s]"]
    assert uncertain["coverage 90 %"] > certain["coverage 90 %"]


def test_truths_in_turn_are_the_cases():
    seen = []
    job = SurveyJob(leave_out="all", pings=(2,), seeds=2, methods=("nearest", "etkf"))
    found = run(job, progress=lambda done, total, what: seen.append((done, total)))
    assert values(found)["etkf", 2].cases == tuple(f"synthetic#{k}" for k in range(6))
    assert seen == [(n + 1, 48) for n in range(48)]
    # a truth of its own, which is among the members, is found without noise
    own = Ensemble(MEMBERS.grid, MEMBERS.velocity[5:], None, "truth.nc")
    alone = run(SurveyJob(pings=(3,), seeds=1, noise=0.0, methods=("nearest",)), truth=own)
    assert alone.rows[0].value < 0.02
    assert (alone.rows[0].cases, np.isnan(alone.rows[0].low)) == (("seed 0",), True)


def test_the_most_distant_member_is_the_farthest_from_the_others_mean():
    distance = [
        np.mean((MEMBERS.velocity[k] - np.delete(MEMBERS.velocity, k, axis=0).mean(axis=0)) ** 2)
        for k in range(6)
    ]
    (case,) = cases(MEMBERS, None, "most-distant")
    assert case.member == most_distant(MEMBERS) == int(np.argmax(distance))
    assert case.ensemble.n_members == 5
    for which in ("9", "-1", "some", None):
        with pytest.raises(ConfigError):
            list(cases(MEMBERS, None, which))


@pytest.mark.parametrize(
    "job",
    [
        SurveyJob(leave_out="0", methods=("kriging",)),
        SurveyJob(leave_out="0", pings=(10, 5)),
        SurveyJob(leave_out="0", pings=()),
        SurveyJob(leave_out="0", seeds=0),
        SurveyJob(leave_out="0", noise=-1.0),
    ],
)
def test_wrong_options_are_said(job):
    with pytest.raises(ConfigError):
        run(job)


def test_profiles_are_seeded_and_state_their_noise():
    field = build_field(leave_out(MEMBERS, 0).truth)
    first, again, other = (random_observations(field, 20, 0.09, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first[3].velocity, again[3].velocity)
    assert first[0].longitude != other[0].longitude
    assert (first[0].depth[0], first[0].depth.size) == (16.0, 22)
    assert np.all(first[0].error_std == 0.09)
    ideal = random_observations(field, 20, 0.0, 1)
    assert np.all(ideal[0].error_std == IDEAL_ERROR_STD)
    noise = np.concatenate([a.velocity - b.velocity for a, b in zip(first, ideal, strict=True)])
    assert np.nanstd(noise) == pytest.approx(0.09, rel=0.1)


@pytest.mark.parametrize("method", ["default", "naive3d", "etkf", "nearest", "ensemble_mean"])
def test_the_bound_is_the_least_error_of_the_span(method):
    """A random flow of the span is never better; the best flow, where the span is small enough to search, is as good."""
    case = leave_out(MEMBERS, 1)
    at = scored_points(MEMBERS.grid, case.truth)
    estimator = build_method(method, case.ensemble, CONFIG)
    least, state = bound(estimator, at), estimator.initial()
    for observation in random_observations(build_field(case.truth), 5, 0.0, 0):
        state, _ = estimator.step(state, observation)
        error = estimator.flow(state).velocity(*at.place) - at.velocity
        assert np.sqrt(np.mean(np.sum(error**2, axis=1))) >= least * (1 - 1e-9)


def test_the_bound_of_all_modes_is_what_the_kernel_cannot_say():
    case = leave_out(MEMBERS, 1)
    at = scored_points(MEMBERS.grid, case.truth)
    few, all_of_them = (
        bound(build_method("default", case.ensemble, EstimatorConfig(modes=m)), at)
        for m in (5, None)
    )
    assert all_of_them < 0.3 * few


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
    build = surveys.build_method

    def fail(error, after=None):
        def built(name, *arguments):
            if name == "etkf" and after is None:
                raise error
            estimator = build(name, *arguments)
            return Failing(estimator, error, after) if name == "etkf" else estimator

        monkeypatch.setattr(surveys, "build_method", built)

    return fail


@pytest.mark.parametrize(
    "error", [np.linalg.LinAlgError("not positive definite"), EstimatorError("no update")]
)
@pytest.mark.parametrize("after", [None, 0, 2])
def test_a_method_that_fails_is_named_and_keeps_what_was_scored(failing, error, after):
    whole = run(FEW)
    failing(error, after)
    found = run(FEW)
    lost = {("etkf", n) for n in FEW.pings if n > (after or 0)}
    assert set(values(whole)) - set(values(found)) == lost
    assert all(f"{type(error).__name__}: {error}" in why for why in found.lost)
    kept = [row for row in found.rows if row.figure != "bound [m/s]"]
    both = [row for row in whole.rows if (row.method, row.after) not in lost]
    assert repr(kept) == repr([row for row in both if row.figure != "bound [m/s]"])


def test_errors_of_the_program_and_of_options_end_the_run(failing):
    for error in (TypeError("wrong"), ConfigError("an option")):
        failing(error)
        with pytest.raises(type(error), match=str(error)):
            run(FEW)


def test_a_method_that_is_missing_in_one_case_has_no_row():
    found = [Figure(method, "x", 1.0, task="t", case=case) for method in "ab" for case in "cd"]
    rows = rows_of(found, [Lost("t", "d", "singular", "b"), Lost("t", "e", "carried away")])
    assert [(row.method, row.cases) for row in rows] == [("a", ("c", "d"))]


def test_a_run_that_is_killed_leaves_what_was_done_and_one_without_scores_fails(
    failing, ensemble, tmp_path
):
    answer = tmp_path / "answer.json"
    words = f"--ensemble {ensemble} --leave-out 2 --seeds 1 --modes 6 --json {answer} --pings 1,3"
    failing(Killed(), 0)
    with pytest.raises(Killed):
        bench(f"{words} --methods nearest,etkf,ensemble_mean")
    said = json.loads(answer.read_text())
    assert said["unfinished"] is True
    assert {row["method"] for row in said["rows"]} == {"nearest"}
    failing(np.linalg.LinAlgError("singular"))
    done = bench(f"{words} --methods etkf --overwrite")
    assert isinstance(done.exception, EstimatorError)
    assert "etkf after 1 pings: LinAlgError: singular" in str(done.exception)
