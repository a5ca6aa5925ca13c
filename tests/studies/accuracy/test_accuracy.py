"""A small accuracy run end to end, its truths, its profiles and its bounds."""

import json
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble
from replay_kit.studies.accuracy import METHODS, AccuracyJob, run_accuracy
from replay_kit.studies.accuracy.page import to_json
from replay_kit.studies.scoring import bound, build_method
from replay_kit.studies.twins.adcp import IDEAL_ERROR_STD, random_observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import cases, leave_out, most_distant
from replay_kit.workflows.replay.scoring import scored_points
from tests import synthetic
from tests.studies.results import final

MEMBERS = synthetic.ensemble(n_members=6, shape=(5, 6))
CONFIG = EstimatorConfig(modes=20)
KEYS = {
    "method",
    "pings",
    "rel_error",
    "rel_error_by_seed",
    "rmse",
    "bound",
    "nis_per_dof",
    "coverage50",
    "coverage90",
    "crps",
}


@pytest.fixture(scope="module")
def result():
    return final(
        run_accuracy(MEMBERS, None, CONFIG, AccuracyJob(leave_out="2", pings=(2, 6), seeds=2))
    )


def test_a_row_for_each_method_and_number_of_pings(result):
    answer = json.loads(json.dumps(to_json(result), allow_nan=False))
    assert set(answer) == {"results", "ensemble", "truth", "modes", "noise", "versions"}
    assert [(row["method"], row["pings"]) for row in answer["results"]] == [
        (method, n) for method in METHODS for n in (2, 6)
    ]
    assert all(set(row) == KEYS for row in answer["results"])
    assert answer["truth"] == "synthetic#2"
    for row in answer["results"]:
        assert row["rel_error"] == pytest.approx(np.mean(row["rel_error_by_seed"]))
        assert len(row["rel_error_by_seed"]) == 2


def test_no_method_beats_its_bound(result):
    for row in result.rows:
        if np.isfinite(row.bound):
            assert row.rmse >= row.bound * (1 - 1e-9), row.method


def test_what_has_no_uncertainty_has_no_coverage(result):
    by_method = {row["method"]: row for row in to_json(result)["results"]}
    assert by_method["nearest"]["coverage50"] is None
    assert by_method["nearest"]["nis_per_dof"] is None
    assert by_method["letkf"]["bound"] is None
    assert by_method["default"]["coverage90"] > by_method["default"]["coverage50"]


def test_measurements_help(result):
    by_key = {(row.method, row.pings): row.rel_error for row in result.rows}
    assert by_key["default", 6] < by_key["ensemble_mean", 6]
    assert by_key["ensemble_mean", 2] == by_key["ensemble_mean", 6]


def test_scores_on_the_way_are_those_of_a_shorter_run(result):
    """Online is offline: the first row does not know that more pings follow; only the places drawn depend on their number."""
    estimator = build_method("default", leave_out(MEMBERS, 2).ensemble, CONFIG)
    truth = leave_out(MEMBERS, 2).truth
    at = scored_points(MEMBERS.grid, truth)
    state = estimator.initial()
    for observation in random_observations(build_field(truth), 6, 0.09, 0)[:2]:
        state, _ = estimator.step(state, observation)
    error = estimator.flow(state).velocity(*at.place) - at.velocity
    speed = np.sqrt(np.mean(np.sum(at.velocity**2, axis=1)))
    row = next(row for row in result.rows if row.method == "default" and row.pings == 2)
    assert row.rel_error_by_seed[0] == pytest.approx(
        np.sqrt(np.mean(np.sum(error**2, axis=1))) / speed
    )


def test_a_wrong_mean_is_found_by_an_estimator_that_expects_it():
    """The truth has half of what all members agree on; 90 % intervals are of use only where this is expected."""
    strong = replace(MEMBERS, velocity=MEMBERS.velocity + 2.0 * MEMBERS.velocity[0])
    case = leave_out(strong, 2)
    truth = replace(case.truth, velocity=case.truth.velocity - 0.5 * strong.velocity.mean(axis=0))
    job = AccuracyJob(pings=(8,), seeds=1, methods=("default",))
    certain, uncertain = (
        final(run_accuracy(case.ensemble, truth, config, job)).rows[0]
        for config in (CONFIG.model_copy(update={"mean_variance": 0.0}), CONFIG)
    )
    assert uncertain.rel_error < 0.8 * certain.rel_error
    assert uncertain.crps < certain.crps
    assert uncertain.coverage90 > certain.coverage90


def test_all_members_in_turn_with_their_means():
    seen = []
    job = AccuracyJob(leave_out="all", pings=(2,), seeds=1, methods=("nearest", "etkf"))
    result = final(
        run_accuracy(
            MEMBERS, None, CONFIG, job, lambda done, total, what: seen.append((done, total))
        )
    )
    assert [row.truth for row in result.rows] == [k for k in range(6) for _ in range(2)] + [
        "mean",
        "mean",
    ]
    each = [row.rel_error for row in result.rows if row.method == "etkf" and row.truth != "mean"]
    assert result.rows[-1].rel_error == pytest.approx(np.mean(each))
    assert result.truth == "all"
    assert seen == [(n + 1, 24) for n in range(24)]
    assert "truth" in to_json(result)["results"][0]


def test_a_truth_of_its_own():
    truth = Ensemble(MEMBERS.grid, MEMBERS.velocity[5:], None, "truth.nc")
    result = final(
        run_accuracy(
            MEMBERS,
            truth,
            CONFIG,
            AccuracyJob(pings=(3,), seeds=1, noise=0.0, methods=("nearest",)),
        )
    )
    # the truth is among the members, and without noise it is found
    assert result.rows[0].rel_error < 0.02
    assert result.truth == "truth.nc"


def test_the_most_distant_member_is_the_farthest_from_the_others_mean():
    distance = [
        np.mean((MEMBERS.velocity[k] - np.delete(MEMBERS.velocity, k, axis=0).mean(axis=0)) ** 2)
        for k in range(6)
    ]
    assert most_distant(MEMBERS) == int(np.argmax(distance))
    (case,) = cases(MEMBERS, None, "most-distant")
    assert case.member == most_distant(MEMBERS)
    assert case.ensemble.n_members == 5


@pytest.mark.parametrize("which", ["9", "-1", "some", None])
def test_a_member_that_is_not_there_is_said(which):
    with pytest.raises(ConfigError):
        list(cases(MEMBERS, None, which))


@pytest.mark.parametrize(
    "job",
    [
        AccuracyJob(leave_out="0", methods=("kriging",)),
        AccuracyJob(leave_out="0", pings=(10, 5)),
        AccuracyJob(leave_out="0", pings=()),
        AccuracyJob(leave_out="0", seeds=0),
        AccuracyJob(leave_out="0", noise=-1.0),
    ],
)
def test_wrong_options_are_said(job):
    with pytest.raises(ConfigError):
        final(run_accuracy(MEMBERS, None, CONFIG, job))


def test_profiles_are_seeded_and_state_their_noise():
    field = build_field(leave_out(MEMBERS, 0).truth)
    first, again, other = (random_observations(field, 20, 0.09, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first[3].velocity, again[3].velocity)
    assert first[0].longitude != other[0].longitude
    assert first[0].depth[0] == 16.0
    assert first[0].depth.size == 22
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
    least = bound(estimator, at)
    state = estimator.initial()
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
