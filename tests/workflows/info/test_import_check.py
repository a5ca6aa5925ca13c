"""Faults planted in twin logs are named, sound twins are not accused.

A sample of a larger study (replay_kit/DECISIONS.md): the sample ocean, 30 pings of a vessel's survey, 100 of a glider's mission.
"""

import json
import math

import numpy as np
import pytest

from replay_kit.config.run import load_config
from replay_kit.core.message import Message
from replay_kit.estimator import build_estimator
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.quality.import_faults import declination_of, depth_faults, direction_faults, scale_faults
from replay_kit.studies.twins import Twin, make_twin
from replay_kit.workflows.info.import_check import ImportCheck, Suspicion, check_import, import_check_json, soundings
from tests.command import invoke
from tests.measurements.samples import mavlink_frames, ping
from tests.places import SAMPLES
from tests.planted import NAMES, PINGS, planted

CONFIG = load_config(None, {"forecast": {"levels": (5.0, 150.0, 500.0)}, "estimator": {"modes": 60}})


@pytest.fixture(scope="module")
def estimator():
    return build_estimator(read_ensemble(SAMPLES / "ensemble.nc", CONFIG.forecast), CONFIG.estimator)


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    folder, truth = tmp_path_factory.mktemp("twins"), read_truth(str(SAMPLES / "truth.nc"), CONFIG.forecast)
    for seed in range(4):
        make_twin(truth, Twin("vessel", 30, 0.09, seed), folder / f"{seed}.mcap")
    return [list(open_log(folder / f"{seed}.mcap").messages()) for seed in range(4)]


@pytest.fixture(scope="module")
def glider():
    messages = open_log(SAMPLES / "glider.mcap").messages()
    return [message for message in messages if message.topic != "/adcp" or message.payload["ping"] % 4 == 0]


def check(messages, fault, estimator) -> ImportCheck:
    return check_import(soundings(planted(messages, fault), CONFIG.measurements), estimator)


@pytest.mark.parametrize(("fault", "seed"), [(fault, k % 3) for k, fault in enumerate(PINGS) if fault != "sound"])
def test_a_planted_fault_is_named(surveys, estimator, fault, seed):
    assert [suspicion.fault for suspicion in check(surveys[seed], fault, estimator).suspicions] == [NAMES[fault]]


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_survey_is_not_accused_and_tells_of_every_fault(surveys, estimator, seed):
    assert check(surveys[seed], "sound", estimator) == ImportCheck(30, ())


def test_a_sound_glider_is_not_accused_and_cannot_tell_a_declination(glider, estimator):
    found = check(glider, "sound", estimator)
    assert found.suspicions == ()
    assert {"the declination was not applied", "the declination was applied twice"} <= set(found.undetermined)


@pytest.mark.parametrize("fault", ["both signs are wrong", "the sign of depth is wrong: pressure"])
def test_a_fault_in_a_gliders_log_is_named(glider, estimator, fault):
    assert [suspicion.fault for suspicion in check(glider, fault, estimator).suspicions] == [NAMES[fault]]


def test_without_a_stated_declination_it_is_said_not_to_be_looked_for(surveys, estimator):
    assert "states no magnetic declination" in check_import(soundings(surveys[0], CONFIG.measurements), estimator).note


def test_too_few_profiles_and_a_log_elsewhere(surveys, estimator):
    few = soundings(surveys[0], CONFIG.measurements)[:2]
    assert "fewer than 3" in check_import(few, estimator).note
    assert check_import([], estimator).profiles == 0


@pytest.mark.parametrize("fault", [fault for fault in PINGS if "depth" not in fault])
def test_undoing_a_fault_gives_what_was_measured(surveys, fault):
    sound = soundings(planted(surveys[0][:6], "sound"), CONFIG.measurements)
    wrong = soundings(planted(surveys[0][:6], fault), CONFIG.measurements)
    known = [known for known in [*direction_faults(wrong), *scale_faults()] if known.name == NAMES[fault]]
    if fault == "sound":
        assert known == []
        return
    undone = [[known_one.undo(sounding) for sounding in wrong] for known_one in known]
    # of a fault of units, one of the two takes the errors to be in the fault's unit too
    best = min(undone, key=lambda profiles: abs(profiles[0].error_std[0] - sound[0].observation.error_std[0]))
    for ours, theirs in zip(best, sound, strict=True):
        np.testing.assert_allclose(ours.velocity, theirs.observation.velocity, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(ours.error_std, theirs.observation.error_std, rtol=1e-9)


def test_undoing_a_wrong_depth_gives_the_true_one(glider):
    sound, wrong = (
        max(soundings(planted(glider[:40], fault), CONFIG.measurements), key=lambda sounding: sounding.vehicle_depth)
        for fault in ("sound", "the sign of depth is wrong: orientation")
    )
    assert sound.vehicle_depth > 100.0
    undone = [fault.undo(wrong).depth for fault in depth_faults()]
    np.testing.assert_allclose(undone[2], sound.observation.depth, atol=0.1)


def test_what_a_ping_says_of_the_declination():
    assert declination_of(ping(magnetic_declination=11.5)) == 11.5
    assert math.isnan(declination_of(ping()))
    assert math.isnan(declination_of(Message(0, "/x", "vendor.Thing", {}, 0, 0)))
    frames = list(mavlink_frames())
    assert [declination_of(frame) for frame in frames[:1]] == [0.0]
    assert all(math.isnan(declination_of(frame)) for frame in frames[1:])


def test_an_infinite_gain_is_null_in_json():
    answer = import_check_json(ImportCheck(3, (Suspicion("a", "b", math.inf), Suspicion("c", "d", 12.0)), ("e",)))
    assert [fault["log_likelihood_ratio"] for fault in answer["faults"]] == [None, 12.0]
    assert answer["undetermined"] == ["e"]


def test_info_with_an_ensemble(tmp_path, surveys):
    write_mcap_log(tmp_path / "wrong.mcap", planted(surveys[0], "the declination was applied twice"))
    (tmp_path / "run.toml").write_text("[forecast]\nlevels = [5, 150, 500]\n[estimator]\nmodes = 60\n")
    options = ["--config", str(tmp_path / "run.toml"), "--ensemble", str(SAMPLES / "ensemble.nc")]
    done = invoke(["info", str(tmp_path / "wrong.mcap"), *options])
    assert done.exit_code == 0
    said = done.stdout
    assert "LIKELY FAULT: the declination was applied twice" in said


def test_a_malformed_ping_states_no_declination():
    assert math.isnan(declination_of(Message(0, "/x", "ds_sensor_msgs/Adcp", {}, 0, 0)))
    assert math.isnan(declination_of(Message(0, "/x", "DEBUG_FLOAT_ARRAY", {"name": "ADCP_CFG"}, 0, 0)))


def test_a_mission_in_two_files_is_checked_as_one(tmp_path, surveys):
    messages = list(planted(surveys[1], "the sign of east is wrong"))
    files = [tmp_path / "nav.mcap", tmp_path / "adcp.mcap"]
    for file, pings in zip(files, (False, True), strict=True):
        write_mcap_log(file, [message for message in messages if (message.topic == "/adcp") == pings])
    (tmp_path / "run.toml").write_text("[forecast]\nlevels = [5, 150, 500]\n[estimator]\nmodes = 60\n")
    options = ["--config", tmp_path / "run.toml", "--ensemble", SAMPLES / "ensemble.nc", "--json", tmp_path / "info.json"]
    assert invoke(["info", *map(str, [*files, *options])]).stdout.count("LIKELY FAULT: the sign of east is wrong") == 1
    answer = json.loads((tmp_path / "info.json").read_text())
    assert (answer["import_check"]["profiles"], len(answer["logs"])) == (30, 2)
