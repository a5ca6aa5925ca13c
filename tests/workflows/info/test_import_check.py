"""Faults planted in twin logs are named, sound twins are not accused.

A sample of a larger study (replay_kit/DECISIONS.md): the sample ocean, 30 pings of a vessel's survey, 100 of a glider's mission.
"""

import io
import json
import math

import numpy as np
import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import Finding, MeasurementError
from replay_kit.core.message import Message
from replay_kit.estimator import build
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.checks.slips import Sounding, declination_of, direction_faults
from replay_kit.show.text import SafeConsole
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.info.import_check import (
    ImportCheck,
    check_import,
    check_logs,
    import_check_json,
    print_import_check,
)
from replay_kit.workflows.replay.inputs.checks import check_inputs
from replay_kit.workflows.replay.inputs.job import ReplayJob
from tests.benchmarks.fault_kinds import FAULTS
from tests.command import invoke, succeed
from tests.measurements.samples import mavlink_frames, ping
from tests.places import SAMPLES
from tests.planted import NAMES, PINGS, in_centimetres, planted

CONFIG = load_config(
    None, {"forecast": {"levels": (5.0, 150.0, 500.0)}, "estimator": {"modes": 60}}
)


@pytest.fixture(scope="module")
def estimator():
    return build([read_ensemble(SAMPLES / "ensemble.nc", CONFIG.forecast)], CONFIG.estimator)


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    folder, truth = (
        tmp_path_factory.mktemp("twins"),
        read_truth(str(SAMPLES / "truth.nc"), CONFIG.forecast),
    )
    for seed in range(4):
        make_twin(truth, Twin("vessel", 30, 0.09, seed), folder / f"{seed}.mcap")
    return [list(open_log(folder / f"{seed}.mcap").messages()) for seed in range(4)]


@pytest.fixture(scope="module")
def glider():
    messages = open_log(SAMPLES / "glider.mcap").messages()
    return [
        message
        for message in messages
        if message.topic != "/adcp" or message.payload["ping"] % 4 == 0
    ]


@pytest.fixture(scope="module")
def soundings(tmp_path_factory):
    """A function of messages: their profiles with the declination stated, and the names of what the checks of a replay find."""
    folder = tmp_path_factory.mktemp("log")

    def of(messages):
        found, messages = [], list(messages)
        (stated,) = {declination_of(one) for one in messages if one.topic == "/adcp"} or {math.nan}
        job = ReplayJob(tuple(written(folder, messages)), SAMPLES / "ensemble.nc")
        try:
            findings = check_inputs(
                job, CONFIG, on_profile=lambda one: found.append(Sounding(one, stated))
            ).findings
        except MeasurementError as error:
            findings = error.findings
        return found, [finding.name for finding in findings]

    return of


@pytest.fixture
def check(soundings, estimator):
    return lambda messages, fault: check_import(soundings(planted(messages, fault))[0], estimator)


@pytest.fixture
def of_replay(soundings):
    return lambda messages, fault: soundings(planted(messages, fault))[1]


@pytest.mark.parametrize(
    ("fault", "seed"),
    [(fault, k % 3) for k, fault in enumerate(PINGS) if "sign" in fault or "declin" in fault],
)
def test_a_planted_fault_is_told_as_a_contradiction_with_the_ensemble(
    surveys, check, of_replay, fault, seed
):
    if fault.startswith("the sign of depth"):
        assert of_replay(surveys[seed], fault) == ["depths above the surface"]
        return
    (warning,) = check(surveys[seed], fault).findings
    assert (warning.name, warning.severity) == ("log and ensemble contradict each other", "warning")
    assert warning.cause == NAMES[fault]
    # the ensemble alone convicts nobody
    assert of_replay(surveys[seed], fault) == []


@pytest.mark.parametrize("fault", [fault for fault in PINGS if "speeds" in fault])
def test_a_planted_unit_is_named_as_a_replay_names_it(surveys, of_replay, fault):
    assert of_replay(surveys[0], fault) == ["unit of the velocities"]


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_survey_is_not_accused_and_tells_of_every_fault(surveys, check, seed):
    assert check(surveys[seed], "sound") == ImportCheck(30, ())


@pytest.mark.full
def test_a_sound_glider_is_not_accused_and_cannot_tell_a_declination(glider, check):
    found = check(glider, "sound")
    assert found.findings == ()
    assert {"the declination was not applied", "the declination was applied twice"} <= set(
        found.undetermined
    )


@pytest.mark.full
def test_a_fault_in_a_gliders_log_is_named(glider, check, of_replay):
    (warning,) = check(glider, "both signs are wrong").findings
    assert warning.cause == NAMES["both signs are wrong"]
    assert of_replay(glider, "the sign of depth is wrong: pressure") == ["depths above the surface"]


def test_without_a_stated_declination_it_is_said_not_to_be_looked_for(
    surveys, soundings, estimator
):
    assert (
        "states no magnetic declination" in check_import(soundings(surveys[0])[0], estimator).note
    )


def test_too_few_profiles_and_a_log_elsewhere(surveys, soundings, estimator):
    few = soundings(surveys[0])[0][:2]
    assert "fewer than 3" in check_import(few, estimator).note
    assert check_import([], estimator).profiles == 0


@pytest.mark.parametrize(
    "fault", [fault for fault in PINGS if "depth" not in fault and "speeds" not in fault]
)
def test_undoing_a_fault_gives_what_was_measured(surveys, soundings, fault):
    sound, _ = soundings(planted(surveys[0][:6], "sound"))
    wrong, _ = soundings(planted(surveys[0][:6], fault))
    known = [known for known in direction_faults(wrong) if known.name == NAMES[fault]]
    if fault == "sound":
        assert known == []
        return
    for ours, theirs in zip([known[0].undo(sounding) for sounding in wrong], sound, strict=True):
        np.testing.assert_allclose(
            ours["velocity"], theirs.profile["velocity"], rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(ours["error_std"], theirs.profile["error_std"], rtol=1e-9)


def test_what_a_ping_says_of_the_declination():
    assert declination_of(ping(magnetic_declination=11.5)) == 11.5
    assert math.isnan(declination_of(ping()))
    for schema, payload in (
        ("vendor.Thing", {}),
        ("ds_sensor_msgs/Adcp", {}),
        ("DEBUG_FLOAT_ARRAY", {"name": "ADCP_CFG"}),
    ):
        assert math.isnan(declination_of(Message(0, "/x", schema, payload, 0, 0)))
    frames = list(mavlink_frames())
    assert [declination_of(frame) for frame in frames[:1]] == [0.0]
    assert all(math.isnan(declination_of(frame)) for frame in frames[1:])


def test_a_check_in_json_has_the_findings_of_a_replay():
    finding = Finding("a", 0, "b", "c", "d", "warning")
    found = ImportCheck(3, (finding,), ("e", "g"), "f")
    answer = import_check_json(found)
    assert answer == {
        "profiles": 3,
        "consistency": [
            {
                "name": "a",
                "since": None,
                "evidence": "b",
                "likely_cause": "c",
                "set": "d",
                "severity": "warning",
            }
        ],
        "undetermined": ["e", "g"],
        "note": "f",
        "refusal": None,
    }
    said = io.StringIO()
    for one in (found, ImportCheck(3, ())):
        print_import_check(one, SafeConsole(file=said, width=200))
    assert said.getvalue().splitlines()[1:] == [
        "Import check: the profiles do not determine whether e, or g",
        "Import check: f",
        "Import check: 3 profiles look sound against the ensemble",
    ]


def written(folder, messages):
    write_mcap_log(folder / "log.mcap", messages)
    return [folder / "log.mcap"]


def test_an_ensemble_in_another_unit_is_named_and_the_log_is_not_blamed(tmp_path, surveys):
    in_centimetres(SAMPLES / "ensemble.nc", tmp_path / "cm.nc")
    found = check_logs(written(tmp_path, surveys[0]), (tmp_path / "cm.nc",), CONFIG)
    assert [finding.name for finding in found.findings] == ["unit of the ensemble"]
    assert (found.profiles, found.undetermined, found.note) == (
        0,
        (),
        "the log was not compared with the ensemble",
    )


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("knots", "scale of the velocities"),
        pytest.param("frozen positions", "frozen positions", marks=pytest.mark.full),
    ],
)
def test_info_names_what_a_replay_names(tmp_path, glider, fault, name):
    edit = next(known.edit for known in FAULTS if known.name == fault)
    found = check_logs(
        written(tmp_path, list(edit(iter(glider)))), (SAMPLES / "ensemble.nc",), CONFIG
    )
    assert name in [finding.name for finding in found.findings]


def test_speeds_in_another_unit_leave_directions_alone(tmp_path, surveys):
    found = check_logs(
        written(tmp_path, planted(surveys[0], "speeds are in cm/s")),
        (SAMPLES / "ensemble.nc",),
        CONFIG,
    )
    assert [finding.name for finding in found.findings] == ["unit of the velocities"]
    assert (found.profiles, found.note) == (0, "the directions were not compared with the ensemble")


def test_info_with_an_ensemble(tmp_path, surveys):
    write_mcap_log(
        tmp_path / "wrong.mcap", planted(surveys[0], "the declination was applied twice")
    )
    (tmp_path / "run.toml").write_text(
        "[forecast]\nlevels = [5, 150, 500]\n[estimator]\nmodes = 60\n"
    )
    options = f"--config {tmp_path}/run.toml --ensemble {SAMPLES}/ensemble.nc"
    done = succeed(f"info {tmp_path}/wrong.mcap {options}")
    said = done.stdout
    assert "WARNING: log and ensemble contradict each other: likely cause: " in said
    assert "likely cause: the declination was applied twice; check whether the instrument" in said


def test_a_mission_in_two_files_is_checked_as_one(tmp_path, surveys):
    messages = list(planted(surveys[1], "the sign of east is wrong"))
    files = [tmp_path / "nav.mcap", tmp_path / "adcp.mcap"]
    for file, pings in zip(files, (False, True), strict=True):
        write_mcap_log(
            file, [message for message in messages if (message.topic == "/adcp") == pings]
        )
    (tmp_path / "run.toml").write_text(
        "[forecast]\nlevels = [5, 150, 500]\n[estimator]\nmodes = 60\n"
    )
    options = f"--config {tmp_path}/run.toml --ensemble {SAMPLES}/ensemble.nc"
    done = invoke(f"info {files[0]} {files[1]} {options} --json {tmp_path}/info.json")
    assert done.stdout.count("likely cause: the sign of east is wrong") == 1
    answer = json.loads((tmp_path / "info.json").read_text())
    assert (answer["import_check"]["profiles"], len(answer["logs"])) == (30, 2)
