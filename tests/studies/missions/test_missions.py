"""Small missions end to end: their flights, what is counted of them, the studies' rows, the command."""

import csv
import io
import json
import math
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.stats import chi2

from replay_kit.cli.app import run
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.estimator import build_estimator
from replay_kit.studies.missions import STUDIES, MissionJob, run_missions
from replay_kit.studies.missions import run as missions
from replay_kit.studies.missions.follow import (
    Figure,
    MissionRow,
    evaluated_after,
    follow,
    over_missions,
)
from replay_kit.studies.missions.page import to_json
from replay_kit.studies.missions.scene import fly_pings, measurements, staying, withhold
from replay_kit.studies.reports.tables import rows_to_csv
from replay_kit.studies.twins.adcp import Faults
from replay_kit.studies.twins.field import build_field
from tests import synthetic
from tests.studies.results import final

DAY = 86_400 * 10**9
LEVELS = np.array([5.0, 90.0, 220.0])
CONFIG = RunConfig(estimator=EstimatorConfig(modes=12, sample_share=0.6))
JOB = MissionJob("1,3", pings=10, days=20.0, evaluations=3)


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
def withheld():
    return withhold(series(), 1)


@cache
def sea():
    return build_field(*withheld().truths)


@cache
def flown():
    return staying(partial(fly_pings, sea(), 10, 20.0, 0.05), 0)


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        # a ping in ten minutes of a mission is many for a test
        patch.setattr(missions, "_EVERY_S", 3600.0)
        return final(run_missions(series(), CONFIG, JOB))


def value_of(result, study, method, figure):
    (row,) = (
        row for row in result.rows if (row.study, row.method, row.figure) == (study, method, figure)
    )
    return row


def test_parts_add_up_over_their_wholes():
    missions = [
        [Figure("m", "ratio", 1.0, 2.0, at_most=0.3)],
        [Figure("m", "ratio", 1.0, 6.0, at_most=0.3)],
    ]
    (row,) = over_missions("s", missions)
    assert (row.value, row.by_mission, row.met) == (0.25, (0.5, 1.0 / 6.0), True)
    assert math.isnan(row.at_least)
    below, undefined, unasked = over_missions(
        "s",
        [
            [
                Figure("m", "a", 1.0, at_least=2.0),
                Figure("m", "b", 1.0, 0.0, at_most=9.0),
                Figure("m", "c", 7.0),
            ]
        ],
    )
    assert (below.met, undefined.met, unasked.met) == (False, False, None)
    assert math.isnan(undefined.value)


def test_the_truth_is_withheld_and_linear_between_the_forecasts_times():
    forecasts = series()
    assert all(one.n_members == 5 for one in withheld().forecasts)
    quarter = DAY + int(0.25 * 0.6 * DAY)
    j, i = 2, 3
    point = int(
        np.flatnonzero(
            (withheld().at.index[0] == 1)
            & (withheld().at.index[1] == j)
            & (withheld().at.index[2] == i)
        )[0]
    )
    expected = 0.5 * (forecasts[0].velocity[1, :, 1, j, i] + forecasts[1].velocity[1, :, 1, j, i])
    np.testing.assert_allclose(withheld().truth_at(quarter)[point], expected, rtol=1e-12)
    np.testing.assert_array_equal(withheld().truth_at(99 * DAY), withheld().truth[-1])


def test_a_mission_ends_with_the_truth_and_its_course_does_not_depend_on_faults():
    sound, faulty = (
        measurements(flown()),
        measurements(flown(), Faults("platform", 0.02, 5.0, 0.03)),
    )
    assert (
        [m.time_ns for m in sound]
        == flown().mission.pings.time_ns.tolist()
        == [m.time_ns for m in faulty]
    )
    assert flown().mission.positions[-1].time_ns <= sea().time_ns[-1]
    # the pings fill the time that there is, but for one dive
    assert sound[-1].time_ns - sound[0].time_ns > 0.7 * 0.6 * DAY
    assert len(set(np.diff([m.time_ns for m in sound]))) == 1
    for one, other in zip(sound, faulty, strict=True):
        assert isinstance(one, Observation)
        assert (one.common_std, other.common_std) == (0.0, pytest.approx(0.02))
        assert (one.longitude, one.latitude) == (other.longitude, other.latitude)
    unknown = measurements(flown(), Faults("platform"))
    assert {m.common_std for m in unknown if isinstance(m, Observation)} == {math.inf}
    with pytest.raises(ConfigError, match="--pings"):
        fly_pings(sea(), 2000, 20.0, 0.05, 0)


def test_a_course_that_leaves_the_water_is_tried_elsewhere():
    tried = []

    def fly(seed):
        tried.append(seed)
        if len(tried) < 3:
            raise ForecastError("out")
        return flown()

    assert staying(fly, 7) is flown()
    assert tried == [7, 10_007, 20_007]
    torrent = [
        replace(truth, velocity=np.full_like(truth.velocity, 4.0)) for truth in withheld().truths
    ]
    with pytest.raises(ForecastError, match="out of the truth's water"):
        staying(partial(fly_pings, build_field(*torrent), 10, 20.0, 0.05), 0)


@pytest.mark.full
def test_a_mission_that_is_lost_leaves_the_others_and_is_said():
    forecasts = series()
    job = replace(JOB, studies=("outliers",), evaluations=1)
    torrents = [
        replace(f, velocity=np.where(np.arange(6)[:, None, None, None, None] == 3, 4.0, f.velocity))
        for f in forecasts
    ]
    *partial, left = run_missions(torrents, CONFIG, job)
    assert [(part.unfinished, len(part.lost), len(part.rows) > 0) for part in partial] == [
        (True, 0, True),
        (True, 1, True),
    ]
    assert to_json(partial[0])["unfinished"] is True
    assert "unfinished" not in to_json(left)
    # nothing is known yet where the first mission is lost
    first = next(iter(run_missions(torrents, CONFIG, replace(job, leave_out="3,1"))))
    assert (first.rows, len(first.lost)) == ((), 1)
    assert (
        rows_to_csv(MissionRow, first.rows)
        == "study,method,figure,value,at_least,at_most,met,by_mission\n"
    )
    assert len(left.lost) == 1
    assert left.lost[0].startswith("member 3, seed 0, outliers: the current carried the glider")
    assert {len(row.by_mission) for row in left.rows} == {1}
    assert to_json(left)["lost"] == list(left.lost)
    with pytest.raises(ForecastError, match="no mission is left"):
        final(run_missions(torrents, CONFIG, replace(job, leave_out="3")))


def test_evaluations_are_spread_evenly_and_end_with_the_mission():
    assert evaluated_after(10, 3) == (3, 7, 10)
    assert evaluated_after(2, 20) == (1, 2)


def test_innovations_are_counted():
    given = measurements(flown())
    static = follow(
        build_estimator(withheld().forecasts[1], CONFIG.estimator),
        given,
        2,
        lambda flow, time_ns: float(time_ns),
    )
    assert static.errors[-1] == given[-1].time_ns
    nis, inside = static.nis("m")
    dof = sum(one.dof for one in static.innovations)
    assert nis.part / nis.whole == pytest.approx(sum(one.nis for one in static.innovations) / dof)
    within = [0.025 <= chi2.cdf(one.nis, one.dof) <= 0.975 for one in static.innovations]
    assert (inside.part, inside.whole) == (sum(within), len(within))


def test_every_study_has_figures_with_limits(result):
    assert tuple(dict.fromkeys(row.study for row in result.rows)) == STUDIES
    for study in STUDIES:
        assert any(row.met is not None for row in result.rows if row.study == study)
    for row in result.rows:
        assert 1 <= len(row.by_mission) <= 2
    error, clean = (
        value_of(result, "outliers", method, "RMSE [m/s]")
        for method in ("with outliers, gate reject", "without outliers")
    )
    ratio = value_of(
        result, "outliers", "with outliers, gate reject", "RMSE over that without outliers"
    )
    each = zip(error.by_mission, clean.by_mission, strict=True)
    assert ratio.by_mission == pytest.approx([a / b for a, b in each])
    assert ratio.value == pytest.approx(sum(error.by_mission) / sum(clean.by_mission))
    assert (ratio.at_most, ratio.met) == (1.05, ratio.value <= 1.05)
    assert clean.met is None
    assert (
        value_of(
            result, "outliers", "with outliers, gate reject", "outliers rejected or softened"
        ).value
        == 1.0
    )


def test_rows_go_to_json_and_csv_as_they_are(result):
    answer = json.loads(json.dumps(to_json(result), allow_nan=False))
    assert answer["members"] == [1, 3]
    assert answer["times"] == 3
    keys = {"study", "method", "figure", "value", "at_least", "at_most", "met", "by_mission"}
    assert all(set(row) == keys for row in answer["rows"])
    table = list(csv.DictReader(io.StringIO(rows_to_csv(MissionRow, result.rows))))
    assert [row["figure"] for row in table] == [row.figure for row in result.rows]
    for written, row in zip(table, result.rows, strict=True):
        assert float(written["value"] or "nan") == pytest.approx(row.value, nan_ok=True)
        assert written["at_most"] == ("" if math.isnan(row.at_most) else str(row.at_most))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"studies": ("bias", "tides")}, "--study"),
        ({"studies": ()}, "--study"),
        ({"leave_out": "1,x"}, "--leave-out"),
        ({"leave_out": "1,1"}, "--leave-out"),
        ({"leave_out": "6"}, "--leave-out"),
        ({"pings": 0}, "pings"),
        ({"days": math.nan}, "days"),
        ({"noise": 0.0}, "--noise"),
    ],
)
def test_wrong_options_are_said(changes, words):
    with pytest.raises(ConfigError, match=words):
        final(run_missions(series(), CONFIG, replace(JOB, **changes)))


def test_what_needs_the_projects_own_estimator_is_said():
    for settings in ({"name": "etkf"}, {"preset": "paper"}):
        config = CONFIG.model_copy(
            update={"estimator": CONFIG.estimator.model_copy(update=settings)}
        )
        with pytest.raises(ConfigError, match="own estimator"):
            final(run_missions(series(), config, replace(JOB, studies=("bias",))))


def test_the_command_writes_tables_and_replaces_none_unasked(tmp_path, monkeypatch, capsys):
    ds = synthetic.dataset(n_members=4, levels=LEVELS).map(
        lambda v: 0.3 * v.expand_dims(lead=[0.0, 0.6]), keep_attrs=True
    )
    ds["lead"].attrs["units"] = "days"
    ds.to_netcdf(tmp_path / "e.nc", engine="h5netcdf")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    words = "--ensemble e.nc --leave-out 2 --reference-time 2020-01-01T00:00:00Z --modes 8 --study outliers --pings 6 -o out"
    command = ["experiment", "missions", *words.split()]
    run(command)
    assert "with outliers, gate reject" in capsys.readouterr().out
    answer = json.loads((tmp_path / "out" / "missions.json").read_text())
    assert (answer["times"], answer["job"]["studies"]) == (2, ["outliers"])
    assert (tmp_path / "out" / "missions.csv").read_text().count("\n") == len(answer["rows"]) + 1
    with pytest.raises(ConfigError, match="--overwrite"):
        run(command)
