"""Inputs that a replay refuses are refused as well by ``info``, by both dry runs, and by whatever else replays."""

import json

import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ForecastError, MeasurementError
from replay_kit.core.plan import Place
from replay_kit.logs import open_log
from replay_kit.measurements.checks.causes import TRACKS
from replay_kit.workflows.fleet.missions import Mission
from replay_kit.workflows.fleet.run import expected_of
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.checks import check_inputs, dry_run
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.smooth import smooth
from tests import synthetic
from tests.command import invoke, succeed
from tests.workflows.follow.delivery import CONFIG as FOLLOWED
from tests.workflows.follow.delivery import Sea
from tests.workflows.replay.given import moved
from tests.workflows.replay.interrupted import QUICK, job_in, make_ocean

CONFIG = RunConfig(estimator=QUICK)


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, 30, (5, 16))
    log = folder / "glider.mcap"
    begin = next(one for one in open_log(log).messages() if one.topic == "/vehicle/fix").payload
    for name, longitude in (("far", -30.0), ("first", 152.37), ("second", 153.13)):
        east = longitude - begin["longitude"]
        for kind, without in (("", ()), ("-currents", ("/adcp",))):
            moved(log, folder / f"{name}{kind}.mcap", degrees=east, without=without)
    return folder


def refused(job, config=CONFIG):
    """The words of a replay's refusal, which those of the dry runs must be."""
    with pytest.raises((MeasurementError, ForecastError)) as error:
        replay(job, config, planner_of)
    words = str(error.value)
    assert error.value.exit_code == 3
    for other in (dry_run, check_inputs):
        with pytest.raises(type(error.value)) as again:
            other(job, config, planner_of)
        assert str(again.value) == words
    found = expected_of(Mission("one", job, config))
    assert (found.failed, found.exit_code) == (words, 3)
    return words


LARGE = synthetic.dataset(n_members=3, shape=(36, 36), west=10.0, south=10.0)


@pytest.mark.parametrize(
    ("log", "ensemble", "words", "described"),
    [
        ("far.mcap", "ensemble.nc", "the log lies outside the ensemble's region", "12 members"),
        ("far-currents.mcap", "ensemble.nc", "outside the ensemble's region", "12 members"),
        ("glider.mcap", "large.nc", "no position of the log lies there", "3 members"),
        ("glider.mcap", "truth.nc", "no member dimension", "one field"),
    ],
)
def test_logs_and_forecasts_that_do_not_fit_are_refused_by_all(
    ocean, tmp_path, log, ensemble, words, described
):
    if ensemble == "large.nc":
        LARGE.to_netcdf(ocean / ensemble, engine="h5netcdf")
    told = refused(job_in(ocean, logs=(log,), ensemble=ocean / ensemble))
    assert words in told
    answer = tmp_path / "info.json"
    done = invoke(f"info {ocean}/{log} --ensemble {ocean}/{ensemble} --json {answer}")
    assert (done.exit_code, told in done.stderr, described in done.stdout) == (3, True, True)
    assert "Next: replay-kit replay" not in done.stdout
    said = json.loads(answer.read_text())
    assert (said["import_check"]["refusal"], "next" in said) == (told, False)


@pytest.mark.full
def test_dry_runs_check_the_goal_and_count_as_the_replay_does(ocean):
    job = job_in(ocean)
    counts, found = replay(job, CONFIG)[0].observations, dry_run(job, CONFIG)
    assert found.profiles_used + counts["mean_currents"] == counts["used"]
    assert found.profiles == 30
    away = job_in(ocean, goal=Place(10.0, 0.0, 100.0))
    assert "goal" in expected_of(Mission("one", away, CONFIG)).failed
    assert expected_of(Mission("one", job, CONFIG)).profiles == 30


@pytest.mark.parametrize("kind", ["", "-currents"])
def test_two_gliders_in_one_replay_are_refused_unless_they_are_named(ocean, tmp_path, kind):
    names = f"first{kind}.mcap", f"second{kind}.mcap"
    job = job_in(ocean, tmp_path / "out.mcap", logs=names)
    for door in (replay, smooth, dry_run):
        with pytest.raises(MeasurementError, match=r"65 km.*--as NAME=LOG") as error:
            door(job, CONFIG)
        both = " and ".join(str(ocean / name) for name in names)
        assert str(error.value).startswith(f"{TRACKS}: {both}; ")
    assert not job.out.exists()
    ignored = RunConfig(estimator=QUICK, consistency={"on_failure": "ignore"})
    assert replay(job_in(ocean, logs=names), ignored)[0].observations["used"] > 0


def test_a_follower_sets_the_log_of_another_vehicle_aside(ocean, tmp_path):
    sea = Sea(ocean, tmp_path)
    sea.put("first.mcap", (ocean / "first.mcap").read_bytes())()
    summary = sea.follow([sea.put("second.mcap", (ocean / "second.mcap").read_bytes())], FOLLOWED)
    told = "second.mcap not used: it makes the replay fail: these logs hold two tracks"
    assert any(text.startswith(told) for text in sea.told)
    assert summary.exit_code == 0


def test_what_fits_is_told_to_and_what_could_not_be_told(ocean):
    done = succeed(f"info {ocean}/glider.mcap --ensemble {ocean}/ensemble.nc")
    for words in (
        "Import check: 27 profiles look sound",
        "the profiles do not determine whether turned by",
        "Import check: the log states no magnetic declination",
        "Next: replay-kit replay",
    ):
        assert words in done.stdout
