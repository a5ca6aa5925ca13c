"""Ensembles made of another's leads and of a long run: exactly which fields they hold, and the study that compares them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.studies.accuracy import AccuracyJob, read_sources, run_accuracy
from replay_kit.studies.accuracy.made import Sources, made_cases
from replay_kit.studies.twins.truths import leave_out
from tests import synthetic
from tests.forecast.test_series import DAY, with_leads
from tests.studies.results import experiment, final

MEMBERS = synthetic.ensemble(n_members=6)
# members of leads to come are others than the ensemble's, so that none is mistaken for another
LATER = tuple(
    replace(MEMBERS, velocity=synthetic.ensemble(seed=seed, n_members=6).velocity)
    for seed in (1, 2)
)
AGES = (np.timedelta64(2, "D"), np.timedelta64(5, "D"))
RUN = synthetic.ensemble(seed=3, n_members=4)


def made(case, sources):
    return {kind: of_kind.ensemble for kind, of_kind in made_cases(MEMBERS, case, sources)}


def test_lags_share_the_newest_forecast_s_error_and_differ_as_members_do_after_so_many_days():
    case = leave_out(MEMBERS, 1)
    found = made(case, Sources(LATER, AGES, RUN))
    assert list(found) == ["given", "lags", "times"]
    assert found["given"] is case.ensemble
    newest = MEMBERS.velocity[4]
    older = [
        newest + later.velocity[k] - later.velocity[4]
        for later, k in zip(LATER, (5, 0), strict=True)
    ]
    # the reader has the forecast that was started first as its first member
    np.testing.assert_allclose(found["lags"].velocity, np.stack([*older[::-1], newest]), atol=1e-12)
    assert found["lags"].made_from == "lags"
    assert [name.rpartition(" started ")[2] for name in found["lags"].members] == [
        "2019-12-27T00:00",
        "2019-12-30T00:00",
        "2020-01-01T00:00",
    ]
    anomalies = RUN.velocity - RUN.velocity.mean(axis=0)
    np.testing.assert_allclose(found["times"].velocity, newest + anomalies, atol=1e-12)
    assert found["times"].made_from == "times"


def test_no_member_of_a_lag_is_the_truth():
    """Past the end of the ensemble its members go on from the beginning; with more leads than members there are fewer lags."""
    case = leave_out(MEMBERS, 4)
    leads = tuple(LATER[0] for _ in range(7))
    lags = made(case, Sources(leads, tuple(np.timedelta64(k + 1, "D") for k in range(7)), RUN))[
        "lags"
    ].velocity
    newest, later = MEMBERS.velocity[1], LATER[0].velocity
    expected = [newest, *(newest + later[k] - later[1] for k in (2, 3, 5, 0))]
    np.testing.assert_allclose(lags, np.stack(expected[::-1]), atol=1e-12)


def test_without_leads_fields_of_the_run_persist_and_the_truth_is_none_of_them():
    case = leave_out(RUN, 1)
    found = {kind: each.ensemble for kind, each in made_cases(RUN, case, Sources((), (), RUN))}
    # those beside the truth first, the one before it before the one after it
    np.testing.assert_allclose(found["lags"].velocity, RUN.velocity[[3, 2, 0]], atol=1e-12)
    others = RUN.velocity[[2, 3]]
    np.testing.assert_allclose(
        found["times"].velocity, RUN.velocity[0] + others - others.mean(axis=0), atol=1e-12
    )
    of_its_own = replace(
        case, member=None, truth=Ensemble(RUN.grid, MEMBERS.velocity[:1], None, "truth")
    )
    found = {
        kind: each.ensemble for kind, each in made_cases(RUN, of_its_own, Sources((), (), RUN))
    }
    np.testing.assert_allclose(found["lags"].velocity, RUN.velocity, atol=1e-12)
    assert found["times"].n_members == 3


def test_a_run_on_another_grid_is_refused():
    other = synthetic.ensemble(shape=(5, 7))
    with pytest.raises(
        ForecastError,
        match=r"synthetic: its grid \(4 x 5 x 7\) is not the truth's \(4 x 5 x 6\); choose one --region",
    ):
        made(leave_out(MEMBERS, 0), Sources(LATER, AGES, other))


def test_sources_are_all_leads_but_the_first(tmp_path):
    forecast = with_leads(tmp_path / "forecast.nc", reference="")
    run = tmp_path / "run.nc"
    synthetic.dataset(seed=3).to_netcdf(run, engine="h5netcdf")
    sources = read_sources(forecast, run, ForecastConfig(lead=2.0))
    assert [int(age / np.timedelta64(1, "ns")) for age in sources.ages] == [2 * DAY, 5 * DAY]
    for part, factor in zip(sources.leads, (1.5, 2.0), strict=True):
        np.testing.assert_allclose(
            part.velocity, factor * synthetic.ensemble().velocity, atol=1e-14
        )
    np.testing.assert_array_equal(sources.archive.velocity, synthetic.ensemble(seed=3).velocity)
    assert read_sources(forecast, run, ForecastConfig()).leads == ()


def test_a_row_for_each_kind_of_members_and_their_means():
    job = AccuracyJob(leave_out="0,3", pings=(2, 3), seeds=1, methods=("ensemble_mean", "nearest"))
    seen, sources = [], Sources(LATER, AGES, RUN)
    result = final(
        run_accuracy(
            MEMBERS,
            None,
            EstimatorConfig(modes=5),
            job,
            lambda *done: seen.append(done[:2]),
            sources,
        )
    )
    keys = [(row.truth, row.members, row.method, row.pings) for row in result.rows]
    kinds = [
        (kind, method, n)
        for kind in ("given", "lags", "times")
        for method in job.methods
        for n in (2, 3)
    ]
    assert keys == [(truth, *kind) for truth in (0, 3, "mean") for kind in kinds]
    assert result.truth == "0,3"
    assert seen == [(n + 1, 36) for n in range(36)]
    by_key = dict(zip(keys, result.rows, strict=True))
    for kind, method, n in kinds:
        one, two, mean = (by_key[truth, kind, method, n].rmse for truth in (0, 3, "mean"))
        assert mean == pytest.approx((one + two) / 2.0)
    assert (
        by_key[0, "given", "ensemble_mean", 3].rmse != by_key[0, "times", "ensemble_mean", 3].rmse
    )


def test_on_the_command_line(tmp_path):
    forecast, run = with_leads(tmp_path / "forecast.nc"), tmp_path / "run.nc"
    synthetic.dataset(seed=3).to_netcdf(run, engine="h5netcdf")
    options = "--lead 2 --leave-out 0,5 --methods ensemble_mean --pings 1 --seeds 1 --json -"
    done = experiment(f"accuracy --ensemble {forecast} --archive {run} {options}")
    assert done.exit_code == 0
    rows = json.loads(done.stdout)["results"]
    assert [(row["truth"], row["members"]) for row in rows] == [
        (k, kind) for k in (0, 5, "mean") for kind in ("given", "lags", "times")
    ]
    assert "members" in done.stderr
    without = experiment(f"accuracy --ensemble {forecast} {options}")
    assert all("members" not in row for row in json.loads(without.stdout)["results"])
