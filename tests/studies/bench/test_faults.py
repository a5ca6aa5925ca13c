"""Small simulated missions with faults end to end: their flights, what is counted of them, the command."""

import csv
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.estimator import build_estimator
from replay_kit.studies.bench import faults
from replay_kit.studies.bench.faults import (
    FAULT_TASKS,
    FaultJob,
    Scene,
    fly_pings,
    follow,
    measurements,
    run_faults,
)
from replay_kit.studies.bench.frame import results_of
from replay_kit.studies.twins.adcp import Faults
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import leave_out
from tests import synthetic
from tests.studies.results import bench, final

DAY = 86_400 * 10**9
LEVELS = np.array([5.0, 90.0, 220.0])
CONFIG = RunConfig(estimator=EstimatorConfig(modes=12, sample_share=0.6))
JOB = FaultJob("1,3", pings=10, days=20.0, noise=0.05, evaluations=3)


def series(n_times=3, days=0.6, speed=0.3) -> list[Ensemble]:
    """An ensemble that turns into another one, slow enough for a glider to stay in its small region."""
    first, last = (synthetic.ensemble(seed, n_members=6, levels=LEVELS) for seed in (0, 50))
    shares = np.linspace(0.0, 1.0, n_times)
    return [
        Ensemble(
            first.grid,
            speed * (np.cos(s) * first.velocity + np.sin(s) * last.velocity),
            DAY + int(s * days * DAY),
            "synthetic",
        )
        for s in shares
    ]


@cache
def scene():
    cases = [leave_out(forecast, 1) for forecast in series()]
    truths = tuple(case.truth for case in cases)
    return Scene(truths, tuple(case.ensemble for case in cases), CONFIG, JOB, 0)


@cache
def sea():
    return build_field(*scene().truths)


@cache
def flown():
    return scene().fly(sea(), 10, 20.0)


def run(forecasts, config, job):
    return final(results_of(run_faults(forecasts, config, job), {}))


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        # a ping in ten minutes of a mission is many for a test
        patch.setattr(faults, "_EVERY_S", 3600.0)
        return run(series(), CONFIG, JOB)


def test_the_truth_is_withheld_and_linear_between_the_forecasts_times():
    assert all(one.n_members == 5 for one in scene().forecasts)
    forecasts, wet = series(), series()[0].grid.wet
    quarter = scene().truth_at(DAY + int(0.25 * 0.6 * DAY))
    middle = 0.5 * (forecasts[0].velocity[1] + forecasts[1].velocity[1])
    assert quarter.shape[0] <= wet.sum()
    for component in range(2):
        assert np.isin(quarter[:, component].round(12), middle[component].round(12)).all()
    last = scene().truth_at(99 * DAY)
    np.testing.assert_array_equal(last, scene().truth_at(int(1.6 * DAY)))


def test_a_mission_ends_with_the_truth_and_its_course_does_not_depend_on_faults():
    sound = measurements(flown())
    faulty = measurements(flown(), Faults("platform", 0.02, 5.0, 0.03))
    times = [m.time_ns for m in sound]
    assert times == flown().mission.pings.time_ns.tolist() == [m.time_ns for m in faulty]
    assert flown().mission.positions[-1].time_ns <= sea().time_ns[-1]
    # the pings fill the time that there is, but for one dive
    assert times[-1] - times[0] > 0.7 * 0.6 * DAY
    assert len(set(np.diff(times))) == 1
    for one, other in zip(sound, faulty, strict=True):
        assert isinstance(one, Observation)
        assert (one.common_std, other.common_std) == (0.0, pytest.approx(0.02))
        assert (one.longitude, one.latitude) == (other.longitude, other.latitude)
    with pytest.raises(ConfigError, match="--pings"):
        fly_pings(sea(), 2000, 20.0, 0.05, 0)


def test_a_course_that_leaves_the_water_is_tried_elsewhere(monkeypatch):
    tried = []

    def fly(sea, pings, days, noise, seed):
        tried.append(seed)
        if len(tried) < 3:
            raise ForecastError("out")
        return flown()

    monkeypatch.setattr(faults, "fly_pings", fly)
    assert replace(scene(), seed=7).fly(sea(), 10, 20.0) is flown()
    assert tried == [7, 10_007, 20_007]


@pytest.mark.full
def test_a_mission_that_is_lost_leaves_the_others_and_is_said():
    forecasts, job = series(), replace(JOB, tasks=("outliers",), evaluations=1)
    fast = np.arange(6)[:, None, None, None, None] == 3
    torrents = [replace(f, velocity=np.where(fast, 4.0, f.velocity)) for f in forecasts]
    left = run(torrents, CONFIG, job)
    assert {len(row.by_case) for row in left.rows} == {1}
    (why,) = left.lost
    assert why.startswith("outliers, member 3, seed 0: the current carried the glider")


def test_innovations_are_counted():
    given, own = measurements(flown()), build_estimator(scene().forecasts[1], CONFIG.estimator)
    followed = follow(scene(), own, given)
    figures = {one.name: one for one in followed.figures("m", 2.0, 1.1)}
    dof = sum(one.dof for one in followed.innovations)
    nis = figures["NIS per degree of freedom"]
    assert nis.part / nis.whole == pytest.approx(sum(one.nis for one in followed.innovations) / dof)
    within = [0.025 <= chi2.cdf(one.nis, one.dof) <= 0.975 for one in followed.innovations]
    inside = figures["inside their 95 % band"]
    assert (inside.part, inside.whole) == (sum(within), len(within))
    assert figures["RMSE over clean"].part == followed.error
    assert (figures["RMSE over clean"].whole, figures["RMSE over clean"].at_most) == (2.0, 1.1)


def test_every_task_has_figures_with_limits(result):
    assert {row.task for row in result.rows} == set(FAULT_TASKS)
    for task in FAULT_TASKS:
        assert any(row.met is not None for row in result.rows if row.task == task)
    rows = {(row.method, row.figure): row for row in result.rows if row.task == "outliers"}
    error, clean = (rows[method, "RMSE [m/s]"] for method in ("gate reject", "without outliers"))
    ratio = rows["gate reject", "RMSE over clean"]
    each = zip(error.by_case, clean.by_case, strict=True)
    assert ratio.by_case == pytest.approx([a / b for a, b in each])
    assert ratio.value == pytest.approx(sum(error.by_case) / sum(clean.by_case))
    assert (clean.met, ratio.cases) == (None, ("member 1, seed 0", "member 3, seed 0"))
    assert rows["gate reject", "outliers rejected or softened"].value == 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tasks": ("bias", "tides")}, "--task"),
        ({"leave_out": "1,x"}, "--leave-out"),
        ({"leave_out": "6"}, "--leave-out"),
        ({"pings": 0}, "pings"),
        ({"days": float("nan")}, "days"),
        ({"noise": 0.0}, "--noise"),
    ],
)
def test_wrong_options_are_said(changes, words):
    with pytest.raises(ConfigError, match=words):
        run(series(), CONFIG, replace(JOB, **changes))


@pytest.mark.full
def test_what_needs_the_projects_own_estimator_is_said():
    for settings in ({"name": "etkf"}, {"preset": "paper"}):
        changed = CONFIG.estimator.model_copy(update=settings)
        config = CONFIG.model_copy(update={"estimator": changed})
        with pytest.raises(ConfigError, match="own estimator"):
            run(series(), config, replace(JOB, tasks=("bias",)))


def test_the_command_writes_tables_and_replaces_none_unasked(tmp_path, monkeypatch):
    ds = synthetic.dataset(n_members=4, levels=LEVELS).map(
        lambda v: 0.3 * v.expand_dims(lead=[0.0, 0.6]), keep_attrs=True
    )
    ds["lead"].attrs["units"] = "days"
    ds.to_netcdf(tmp_path / "e.nc", engine="h5netcdf")
    monkeypatch.chdir(tmp_path)
    words = "--task outliers --ensemble e.nc --leave-out 2 --reference-time 2020-01-01T00:00:00Z --modes 8 --pings 6 -o out --seeds 1"
    done = bench(words)
    assert "gate reject" in done.output, done.output
    answer = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert answer["job"]["faults"]["tasks"] == ["outliers"]
    with (tmp_path / "out" / "bench.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["figure"] for row in table] == [row["figure"] for row in answer["rows"]]
    refused = bench(words)
    assert isinstance(refused.exception, ConfigError)
    assert "--overwrite" in str(refused.exception)
