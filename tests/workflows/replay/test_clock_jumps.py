"""Replays of logs whose clock is wrong: what is set aside, what a jump moves, and that a stopped run goes on to the same bytes."""

from pathlib import Path

import pytest

from replay_kit.config.run import OutputConfig, RunConfig
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.scan import Logs
from tests.workflows.replay.interrupted import QUICK, goes_on, make_ocean, run_until

CONFIG = RunConfig(estimator=QUICK, output=OutputConfig(checkpoint_interval=600.0, interval=7200.0))
DAY = 86_400_000_000_000
YEAR_2200 = 84_006 * DAY


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    """A sound log, and the same log with two fixes more in the year 2200, one of them first, whose clock jumps back by 30 days halfway."""
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, 30)
    messages = [
        message
        for message in open_log(folder / "glider.mcap").messages()
        if message.topic != "/dac"
    ]
    write_mcap_log(folder / "sound.mcap", messages)
    half = len(messages) // 2
    broken = [
        m if k < half else m._replace(time_ns=m.time_ns - 30 * DAY) for k, m in enumerate(messages)
    ]
    stray = next(m for m in messages if m.topic == "/vehicle/fix")._replace(time_ns=YEAR_2200)
    broken = [stray, *broken[:20], stray, *broken[20:]]
    write_mcap_log(folder / "broken.mcap", broken)
    return folder


def run(ocean, log, out, checkpoint=None, stop_after=None):
    return run_until(
        ReplayJob(
            (ocean / log,), ocean / "ensemble.nc", out, checkpoint=checkpoint, overwrite=True
        ),
        CONFIG,
        stop_after,
    )


def test_a_wrong_clock_costs_the_stray_stamps_alone_and_is_told(ocean, tmp_path):
    sound, _ = run(ocean, "sound.mcap", None)
    broken, _ = run(ocean, "broken.mcap", tmp_path / "out.mcap")
    assert broken.late == 0
    assert broken.observations["used"] == sound.observations["used"] > 25
    (row,) = (row for row in broken.messages if row["topic"] == "/vehicle/fix")
    assert row["skipped"] == 2
    (jump,) = (note for note in broken.notes if "clock jumps" in note)
    assert jump.startswith("broken.mcap: the clock jumps from ")
    assert jump.endswith("days were added to their stamps")
    assert (
        "2 messages on /vehicle/fix were excluded: their stamps are more than a day from those before and after"
        in broken.notes
    )
    assert not any("clock jumps" in note or "excluded" in note for note in sound.notes)


def test_the_first_time_of_a_log_is_not_that_of_a_stray_stamp(ocean):
    assert Logs([[ocean / "broken.mcap"]], CONFIG).ahead()[1] < YEAR_2200


@pytest.mark.full
def test_a_stopped_run_over_a_jump_goes_on_to_the_same_bytes(ocean, tmp_path):
    job = ReplayJob((ocean / "broken.mcap",), ocean / "ensemble.nc", tmp_path / "out.mcap")
    goes_on(job, CONFIG, 50, 15)
