"""Faults planted in twin logs are named, sound twins are not accused.

A sample of a larger study (replay_kit/DECISIONS.md): the sample ocean, 30 pings of a vessel's survey, 100 of a glider's mission.
"""

import json
import math

import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.estimator import build
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.checks.slips import Sounding, declination_of
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.replay.inputs.checks import (
    ImportCheck,
    check_import,
    check_inputs,
    check_logs,
)
from replay_kit.workflows.replay.inputs.job import ReplayJob
from tests.benchmarks.fault_kinds import FAULTS
from tests.command import invoke
from tests.measurements.samples import mavlink_frames, ping
from tests.places import SAMPLES
from tests.planted import NAMES, PINGS, in_centimetres, planted

ENSEMBLE = SAMPLES / "ensemble.nc"
SETTINGS = "[forecast]\nlevels = [5, 150, 500]\n[estimator]\nmodes = 60\n"
CONFIG = load_config(
    None, {"forecast": {"levels": (5.0, 150.0, 500.0)}, "estimator": {"modes": 60}}
)


@pytest.fixture(scope="module")
def estimator():
    return build([read_ensemble(ENSEMBLE, CONFIG.forecast)], CONFIG.estimator)


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twins")
    truth = read_truth(str(SAMPLES / "truth.nc"), CONFIG.forecast)
    for seed in range(3):
        make_twin(truth, Twin("vessel", 30, 0.09, seed), folder / f"{seed}.mcap")
    return [list(open_log(folder / f"{seed}.mcap").messages()) for seed in range(3)]


@pytest.fixture(scope="module")
def glider():
    return [
        message
        for message in open_log(SAMPLES / "glider.mcap").messages()
        if message.topic != "/adcp" or message.payload["ping"] % 4 == 0
    ]


@pytest.fixture
def sounded(tmp_path):
    """A function of messages: their profiles with the declination stated, and the names of what the checks of a replay find."""

    def of(messages):
        found, messages = [], list(messages)
        (stated,) = {declination_of(one) for one in messages if one.topic == "/adcp"} or {math.nan}
        job = ReplayJob((written(tmp_path, messages),), ENSEMBLE)
        try:
            _, findings = check_inputs(
                job, CONFIG, on_profile=lambda one, _: found.append(Sounding(one, stated))
            )
        except MeasurementError as error:
            findings = error.findings
        return found, [finding.name for finding in findings]

    return of


def written(folder, messages):
    write_mcap_log(folder / "log.mcap", list(messages))
    return folder / "log.mcap"


@pytest.mark.parametrize(
    ("fault", "seed"), [(fault, k % 3) for k, fault in enumerate(PINGS) if "speeds" not in fault]
)
def test_a_planted_fault_is_told_as_a_contradiction_with_the_ensemble(
    surveys, estimator, sounded, fault, seed
):
    soundings, of_replay = sounded(planted(surveys[seed], fault))
    if "depth" in fault:
        assert of_replay == ["depths above the surface"]
        return
    # the ensemble alone convicts nobody
    assert of_replay == []
    found = check_import(soundings, estimator)
    if fault == "sound":
        assert found == ImportCheck(30, ())
        return
    (warning,) = found.findings
    assert (warning.name, warning.severity) == ("log and ensemble contradict each other", "warning")
    assert warning.cause == NAMES[fault]


@pytest.mark.full
def test_a_gliders_log_cannot_tell_a_declination(glider, estimator, sounded):
    found = check_import(sounded(planted(glider, "sound"))[0], estimator)
    assert found.findings == ()
    unknown = {"the declination was not applied", "the declination was applied twice"}
    assert unknown <= set(found.undetermined)
    wrong = sounded(planted(glider, "both signs are wrong"))[0]
    (warning,) = check_import(wrong, estimator).findings
    assert warning.cause == NAMES["both signs are wrong"]


def test_what_cannot_be_looked_for_is_said(surveys, sounded, estimator):
    found, _ = sounded(surveys[0])
    assert "states no magnetic declination" in check_import(found, estimator).note
    assert "fewer than 3" in check_import(found[:2], estimator).note
    assert check_import([], estimator).profiles == 0


def test_what_a_ping_says_of_the_declination():
    frames = list(mavlink_frames())
    stated = [ping(magnetic_declination=11.5), frames[0]]
    assert list(map(declination_of, stated)) == [11.5, 0.0]
    other = Message(0, "/x", "DEBUG_FLOAT_ARRAY", {"name": "ADCP_CFG"}, 0, 0)
    assert all(map(math.isnan, map(declination_of, [ping(), other, *frames[1:]])))


def test_an_ensemble_in_another_unit_is_named_and_the_log_is_not_blamed(tmp_path, surveys):
    in_centimetres(ENSEMBLE, tmp_path / "cm.nc")
    found = check_logs([written(tmp_path, surveys[0])], (tmp_path / "cm.nc",), CONFIG)
    assert [finding.name for finding in found.findings] == ["unit of the ensemble"]
    assert (found.profiles, found.undetermined) == (0, ())
    assert found.note == "the log was not compared with the ensemble"


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("knots", "scale of the velocities"),
        pytest.param("frozen positions", "frozen positions", marks=pytest.mark.full),
    ],
)
def test_info_names_what_a_replay_names(tmp_path, glider, fault, name):
    edit = next(known.edit for known in FAULTS if known.name == fault)
    found = check_logs([written(tmp_path, edit(iter(glider)))], (ENSEMBLE,), CONFIG)
    assert name in [finding.name for finding in found.findings]


def test_speeds_in_another_unit_leave_directions_alone(tmp_path, surveys):
    log = written(tmp_path, planted(surveys[0], "speeds are in cm/s"))
    found = check_logs([log], (ENSEMBLE,), CONFIG)
    assert [finding.name for finding in found.findings] == ["unit of the velocities"]
    assert (found.profiles, found.note) == (0, "the directions were not compared with the ensemble")


def test_a_mission_in_two_files_is_checked_as_one(tmp_path, surveys):
    messages = list(planted(surveys[1], "the sign of east is wrong"))
    for name, pings in (("nav", False), ("adcp", True)):
        own = [message for message in messages if (message.topic == "/adcp") == pings]
        write_mcap_log(tmp_path / f"{name}.mcap", own)
    (tmp_path / "run.toml").write_text(SETTINGS)
    files = f"{tmp_path}/nav.mcap {tmp_path}/adcp.mcap --config {tmp_path}/run.toml"
    done = invoke(f"info {files} --ensemble {ENSEMBLE} --json {tmp_path}/info.json")
    (cause, name) = NAMES["the sign of east is wrong"], "log and ensemble contradict each other"
    assert done.stdout.count(f"WARNING: {name}: likely cause: {cause}") == 1
    check = json.loads((tmp_path / "info.json").read_text())["import_check"]
    (finding,) = check.pop("consistency")
    assert [finding[key] for key in ("name", "since", "likely_cause")] == [name, None, cause]
    assert check == {"profiles": 30, "undetermined": [], "note": "", "refusal": None}
