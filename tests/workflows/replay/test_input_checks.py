"""Inputs that a replay refuses are refused as well by ``info``, by both dry runs, and by whatever else replays."""

import json

import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ForecastError, MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.plan import Place
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.checks.concluded import TRACKS
from replay_kit.workflows.fleet.missions import Mission
from replay_kit.workflows.fleet.run import expected_of
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.checks import check_inputs, dry_run
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.smooth import smooth
from tests import synthetic
from tests.command import invoke
from tests.workflows.follow.delivery import CONFIG as FOLLOWED
from tests.workflows.follow.delivery import Sea
from tests.workflows.replay.given import moved
from tests.workflows.replay.interrupted import QUICK, make_ocean

CONFIG = RunConfig(estimator=QUICK)


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, 30, (5, 16))
    log = folder / "glider.mcap"
    begin = next(one for one in open_log(log).messages() if one.topic == "/vehicle/fix").payload
    for name, longitude in (("far", -30.0), ("first", 152.37), ("second", 153.13)):
        for kind, without in (("", ()), ("-currents", ("/adcp",))):
            east = longitude - begin["longitude"]
            moved(log, folder / f"{name}{kind}.mcap", degrees=east, without=without)
    return folder


def refused(ocean, job, config=CONFIG):
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


@pytest.mark.parametrize("log", ["far.mcap", "far-currents.mcap"])
def test_a_log_an_ocean_away_from_the_ensemble_is_refused_by_all(ocean, tmp_path, log):
    words = refused(ocean, ReplayJob((ocean / log,), ocean / "ensemble.nc"))
    assert "the log lies outside the ensemble's region" in words
    done = invoke(f"info {ocean}/{log} --ensemble {ocean}/ensemble.nc --json {tmp_path}/info.json")
    assert done.exit_code == 3
    assert "the log lies outside the ensemble's region" in done.stderr
    assert "Use: an ensemble of 12 members" in done.stdout
    assert "Next: replay-kit replay" not in done.stdout
    answer = json.loads((tmp_path / "info.json").read_text())
    assert answer["import_check"]["refusal"] == words
    assert "next" not in answer


def test_a_large_forecast_elsewhere_is_described_before_it_is_refused(ocean, tmp_path):
    synthetic.dataset(n_members=3, shape=(36, 36), west=10.0, south=10.0).to_netcdf(
        tmp_path / "large.nc", engine="h5netcdf"
    )
    words = refused(ocean, ReplayJob((ocean / "glider.mcap",), tmp_path / "large.nc"))
    assert "no position of the log lies there" in words
    done = invoke(f"info {ocean}/glider.mcap --ensemble {tmp_path}/large.nc")
    assert (
        done.exit_code,
        words in done.stderr,
        "Use: an ensemble of 3 members" in done.stdout,
    ) == (3, True, True)


def test_a_file_without_members_is_no_ensemble_for_info_either(ocean):
    words = refused(ocean, ReplayJob((ocean / "glider.mcap",), ocean / "truth.nc"))
    done = invoke(f"info {ocean}/glider.mcap --ensemble {ocean}/truth.nc")
    assert (done.exit_code, words in done.stderr, "Next:" in done.stdout) == (3, True, False)


@pytest.mark.full
def test_dry_runs_check_the_goal_and_count_as_the_replay_does(ocean):
    job = ReplayJob((ocean / "glider.mcap",), ocean / "ensemble.nc")
    summary, _ = replay(job, CONFIG)
    found = dry_run(job, CONFIG)
    assert (
        found.profiles_used + summary.observations["mean_currents"] == summary.observations["used"]
    )
    assert found.profiles == 30
    away = ReplayJob(job.logs, job.ensemble, goal=Place(10.0, 0.0, 100.0))
    assert "goal" in expected_of(Mission("one", away, CONFIG)).failed
    assert expected_of(Mission("one", job, CONFIG)).profiles == 30
    fitting = invoke(f"info {ocean}/glider.mcap --ensemble {ocean}/ensemble.nc")
    assert (fitting.exit_code, "Next: replay-kit replay" in fitting.stdout) == (0, True)


@pytest.mark.parametrize("kind", ["", "-currents"])
def test_two_gliders_in_one_replay_are_refused_unless_they_are_named(ocean, tmp_path, kind):
    first, second = ocean / f"first{kind}.mcap", ocean / f"second{kind}.mcap"
    job = ReplayJob((first, second), ocean / "ensemble.nc", tmp_path / "out.mcap")
    for door in (replay, smooth, dry_run):
        with pytest.raises(MeasurementError) as error:
            door(job, CONFIG)
        words = str(error.value)
        assert words.startswith(f"{TRACKS}: {first} and {second}; ")
        assert "65 km" in words
        assert "name the vehicles (--as NAME=LOG), or replay each alone" in words
    assert not job.out.exists()
    # alone each is a log like any other
    assert replay(ReplayJob((second,), job.ensemble), CONFIG)[0].exit_code == 0
    asked = CONFIG.model_copy(
        update={"consistency": RunConfig(consistency={"on_failure": "ignore"}).consistency}
    )
    assert replay(ReplayJob(job.logs, job.ensemble), asked)[0].observations["used"] > 0


def test_a_follower_sets_the_log_of_another_vehicle_aside(ocean, tmp_path):
    sea = Sea(ocean, tmp_path, goal=None)
    sea.put("first.mcap", (ocean / "first.mcap").read_bytes())()
    summary = sea.follow([sea.put("second.mcap", (ocean / "second.mcap").read_bytes())], FOLLOWED)
    assert any(
        text.startswith(
            "second.mcap not used: it makes the replay fail: these logs hold two tracks"
        )
        for text in sea.told
    )
    assert summary.exit_code == 0


def test_a_log_without_currents_names_positions_before_topics_of_other_kinds(ocean, tmp_path):
    with open_log(ocean / "glider.mcap") as log:
        begin = next(one for one in log.messages() if one.topic == "/vehicle/fix")
    others = [
        Message(begin.time_ns + k, f"/camera/{k % 12}", "my.Camera", {"shutter": k}, 0, k)
        for k in range(240)
    ]
    write_mcap_log(tmp_path / "log.mcap", [begin, *others])
    words = refused(ocean, ReplayJob((tmp_path / "log.mcap",), ocean / "ensemble.nc"))
    assert "/vehicle/fix (1)" in words
    assert words.index("/vehicle/fix") < words.index("/camera/")
