"""Runs that are killed and go on give the bytes of an uninterrupted run; a checkpoint that does not fit is refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.estimation import TimeConfig
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import ConsistencyConfig, OutputConfig, RunConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.plan import Place
from replay_kit.estimator import ReducedBasisEstimator
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay import checkpoint as states
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.state_file import read_state, write_state
from replay_kit.workflows.verify import verify
from tests.workflows.replay.interrupted import Killed, job_in, make_ocean, run_until, truth_in

CONFIG = RunConfig(
    planner=PlannerConfig(kind="glide"),
    output=OutputConfig(checkpoint_interval=600.0, interval=7200.0),
)
GOAL = Place(152.3, -39.8, 150.0)


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, 90)
    make_twin(truth_in(folder, CONFIG), Twin("vessel", 40, 0.05, 2), folder / "survey.mcap")
    return folder


def run(
    ocean,
    out,
    checkpoint=None,
    stop_after=None,
    config=CONFIG,
    goal=GOAL,
    logs=("glider.mcap",),
    include_inputs=False,
):
    job = job_in(ocean, out, goal, checkpoint, logs, include_inputs=include_inputs)
    return run_until(job, config, stop_after)


@pytest.fixture(scope="module")
def whole(ocean, tmp_path_factory):
    """The bytes and the summary of a run without checkpoints."""
    out = tmp_path_factory.mktemp("whole") / "out.mcap"
    summary, _ = run(ocean, out)
    return out.read_bytes(), summary


@pytest.fixture(scope="module")
def stopped_run(ocean, tmp_path_factory):
    """What a run that was killed leaves, by name."""
    folder = tmp_path_factory.mktemp("stopped")
    with pytest.raises(Killed):
        run(ocean, folder / "out.mcap", folder / "run.ck", 130)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def stopped(stopped_run, tmp_path):
    """The result and the checkpoint of a run that was killed, in a folder of the test's own."""
    for name, data in stopped_run.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path / "out.mcap", tmp_path / "run.ck"


@pytest.mark.full
def test_a_run_stopped_again_and_again_gives_the_bytes_of_one_that_was_not(ocean, tmp_path, whole):
    out, checkpoint = tmp_path / "out.mcap", tmp_path / "run.ck"
    stops = 0
    for stop_after in (130, 40, 20, None):
        try:
            summary, _ = run(ocean, out, checkpoint, stop_after)
        except Killed:
            stops += 1
            assert checkpoint.exists()
            assert not out.exists()
    assert stops == 3
    assert out.read_bytes() == whole[0]
    assert summary.by_dive == whole[1].by_dive
    assert summary.messages == whole[1].messages
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]


WINDOW = CONFIG.model_copy(update={"time": TimeConfig(scale=432_000.0, window=1800.0)})


@pytest.fixture(scope="module")
def grouped(ocean, tmp_path_factory):
    """The result of a run whose profiles count together, in groups that begin and end within blocks; without checkpoints."""
    out = tmp_path_factory.mktemp("grouped") / "out.mcap"
    run(ocean, out, config=WINDOW, goal=None)
    return out


@pytest.mark.full
@pytest.mark.parametrize("block", [1, 5, 1000])
def test_blocks_of_the_replay_hardly_change_profiles_that_count_together(
    ocean, tmp_path, grouped, block, monkeypatch
):
    """Where a block ends its profiles count for another time: the noise between is what makes the difference."""
    monkeypatch.setattr(ReducedBasisEstimator, "block_size", block)
    run(ocean, tmp_path / "out.mcap", config=WINDOW, goal=None)
    paths = tmp_path / "out.mcap", grouped
    one, other = (rk.open_result(path).estimate.to_pandas() for path in paths)
    assert one.time.equals(other.time)
    off = (one - other)[["u", "v"]].to_numpy()
    assert np.mean(off**2) < 2.5e-7
    assert abs(off).max() < 3e-3


@pytest.mark.full
def test_a_run_stopped_within_a_group_goes_on_to_the_same_bytes_and_is_verified(
    ocean, tmp_path, grouped, monkeypatch
):
    out, checkpoint = tmp_path / "out.mcap", tmp_path / "run.ck"
    kept = []

    def recorded(path, run, value):
        kept.append(value)
        write_state(path, run, value)

    monkeypatch.setattr(states, "write_state", recorded)
    for stop_after in (130, 40, 20):
        with pytest.raises(Killed):
            run(ocean, out, checkpoint, stop_after, config=WINDOW, goal=None)
        # the state that is kept holds the open group
        assert kept[-1].state.estimation.waiting
    run(ocean, out, checkpoint, config=WINDOW, goal=None)
    assert out.read_bytes() == grouped.read_bytes()
    assert verify(out, [ocean], planner_of).same


@pytest.mark.full
def test_a_resumed_run_scores_the_truth_near_all_profiles_used_not_only_those_since_the_checkpoint(
    ocean, tmp_path
):
    job = ReplayJob(
        (ocean / "glider.mcap",),
        ocean / "ensemble.nc",
        tmp_path / "out.mcap",
        truth=str(ocean / "truth.nc"),
        truth_radius_km=8.0,
    )
    whole, _ = replay(job, CONFIG)
    resumed = replace(job, checkpoint=tmp_path / "run.ck", overwrite=True)
    with pytest.raises(Killed):
        run_until(resumed, CONFIG, 200)
    assert resumed.checkpoint.exists()
    summary, _ = replay(resumed, CONFIG)
    assert summary.truth is not None
    # as text, because what a run without a goal does not know is NaN
    assert repr(summary.truth) == repr(whole.truth)
    far, _ = replay(replace(job, out=None, truth_radius_km=None), CONFIG)
    assert repr(summary.truth) != repr(far.truth)


@pytest.mark.full
def test_copied_inputs_of_several_logs_are_copied_once_however_often_a_run_is_stopped(
    ocean, tmp_path
):
    logs = ("glider.mcap", "survey.mcap")
    run(ocean, tmp_path / "whole.mcap", logs=logs, include_inputs=True)
    out, checkpoint = tmp_path / "out.mcap", tmp_path / "run.ck"
    for stop_after in (130, 50):
        with pytest.raises(Killed):
            run(ocean, out, checkpoint, stop_after, logs=logs, include_inputs=True)
    run(ocean, out, checkpoint, logs=logs, include_inputs=True)
    assert out.read_bytes() == (tmp_path / "whole.mcap").read_bytes()
    assert verify(out, [ocean], planner_of).same


def test_checkpoints_change_nothing_in_the_result(ocean, tmp_path, whole):
    run(ocean, tmp_path / "out.mcap", tmp_path / "run.ck")
    assert (tmp_path / "out.mcap").read_bytes() == whole[0]


def command_line(ocean, folder, *more):
    """The run of ``whole`` as a command, its result in a folder."""
    (folder / "run.toml").write_text(
        '[output]\ncheckpoint_interval = 600.0\ninterval = 7200.0\n[planner]\nkind = "glide"\n'
    )
    inputs = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --config {folder}/run.toml"
    line = f"replay {inputs} --goal=152.3,-39.8,150 --overwrite -o {folder}/out.mcap"
    code = "from replay_kit.cli.app import main; main()"
    return [sys.executable, "-c", code, *line.split(), *more]


@pytest.mark.full
def test_a_process_that_is_killed_goes_on(ocean, tmp_path, whole):
    out, checkpoint = tmp_path / "out.mcap", tmp_path / "run.ck"
    command = command_line(ocean, tmp_path, "--checkpoint", str(checkpoint))
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    while not checkpoint.exists() and process.poll() is None:
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not out.exists()
    subprocess.run(command, check=True, capture_output=True)
    assert out.read_bytes() == whole[0]


@pytest.mark.full
def test_the_caller_s_environment_changes_nothing(ocean, tmp_path, whole):
    other = {
        "PYTHONHASHSEED": "7",
        "OMP_NUM_THREADS": "2",
        "OPENBLAS_NUM_THREADS": "2",
        "TZ": "Pacific/Auckland",
        "LC_ALL": "C",
        "LANG": "C",
    }
    subprocess.run(
        command_line(ocean, tmp_path), check=True, capture_output=True, env={**os.environ, **other}
    )
    assert (tmp_path / "out.mcap").read_bytes() == whole[0]


@pytest.mark.parametrize(
    "what", ["settings", "cut", "flip", "result cut", "result flip", "result gone", "parts"]
)
def test_a_state_of_another_run_or_damaged_is_told_and_the_run_begins_anew(
    ocean, stopped, whole, what
):
    (out, checkpoint), said, config = stopped, [], CONFIG
    part = out.with_name("out.mcap.part")
    file = part if what.startswith("result") else checkpoint
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 4
    if what == "settings":
        config = CONFIG.model_copy(update={"consistency": ConsistencyConfig(on_failure="ignore")})
    elif what == "parts":
        name, _ = json.loads(np.load(checkpoint)["replay-kit state 14"].tobytes())
        write_state(checkpoint, name, replace(read_state(checkpoint, name), state=None))
    elif what.endswith("gone"):
        file.unlink()
    else:
        file.write_bytes(data if what.endswith("flip") else data[: len(data) // 2])
    job = job_in(ocean, out, GOAL, checkpoint, tell=said.append)
    run_until(job, config, None)
    (text,) = said
    assert "run.ck: the run cannot go on from it: " in text
    assert text.endswith("; the replay begins anew")
    if what != "settings":
        assert out.read_bytes() == whole[0]
    assert not checkpoint.exists()


@pytest.mark.parametrize("name", ["out.mcap", "glider.mcap", "ensemble.nc", "other"])
def test_a_checkpoint_harms_no_other_file(ocean, tmp_path, name):
    for source in ("glider.mcap", "ensemble.nc"):
        shutil.copy(ocean / source, tmp_path / source)
    (tmp_path / "other").write_text("precious")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises((ConfigError, LogError), match=r"out\.mcap|input|no state of a run"):
        run(tmp_path, tmp_path / "out.mcap", tmp_path / name)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
