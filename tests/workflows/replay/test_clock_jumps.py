"""Replays of logs whose clock is wrong: what is set aside, what a jump moves, and that a stopped run goes on to the same bytes."""

import pytest

from replay_kit.config.run import RunConfig
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.workflows.replay.inputs.scan import Logs
from replay_kit.workflows.replay.replay import replay
from tests.workflows.replay.interrupted import QUICK, goes_on, job_in

CONFIG = RunConfig(estimator=QUICK, output={"checkpoint_interval": 600.0, "interval": 7200.0})
DAY = 86_400_000_000_000
YEAR_2200 = 84_006 * DAY


@pytest.fixture(scope="module")
def logs(ocean, tmp_path_factory):
    """A sound log, and the same log with two fixes more in the year 2200, one of them first, whose clock jumps back by 30 days halfway."""
    sound, broken = (
        tmp_path_factory.mktemp("logs") / name for name in ("sound.mcap", "broken.mcap")
    )
    messages = [one for one in open_log(ocean / "glider.mcap").messages() if one.topic != "/dac"]
    write_mcap_log(sound, messages)
    stray = next(one for one in messages if one.topic == "/vehicle/fix")
    stray = stray._replace(time_ns=YEAR_2200)
    half = len(messages) // 2
    messages[half:] = [one._replace(time_ns=one.time_ns - 30 * DAY) for one in messages[half:]]
    write_mcap_log(broken, [stray, *messages[:20], stray, *messages[20:]])
    return sound, broken


def test_a_wrong_clock_costs_the_stray_stamps_alone_and_is_told(ocean, logs):
    sound, broken = (replay(job_in(ocean, logs=(log,)), CONFIG)[0] for log in logs)
    assert broken.late == 0
    assert broken.observations["used"] == sound.observations["used"] > 25
    (row,) = (row for row in broken.messages if row["topic"] == "/vehicle/fix")
    assert row["skipped"] == 2
    assert [one["code"] for one in row["reasons"]] == ["its_stamp_is_far_from_its_neighbours"]
    told = [note for note in broken.notes if "clock jumps" in note]
    assert [note.split(":")[0] for note in told if "days were added" in note] == ["broken.mcap"]
    assert not any("clock jumps" in note for note in sound.notes)
    assert Logs([[logs[1]]], CONFIG).ahead()[1] < YEAR_2200


@pytest.mark.full
def test_a_stopped_run_over_a_jump_goes_on_to_the_same_bytes(ocean, logs, tmp_path):
    goes_on(job_in(ocean, tmp_path / "out.mcap", logs=logs[1:]), CONFIG, 50, 15)
