"""Runs that are killed and go on give the bytes of an uninterrupted run; a checkpoint that does not fit is refused."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.plan import Place
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml
from replay_kit.workflows.replay.replay import replay
from tests.workflows.replay.interrupted import QUICK, Killed, goes_on, job_in, run_until

CONFIG = RunConfig(
    planner={"kind": "glide"},
    estimator=QUICK,
    output={"checkpoint_interval": 1800.0, "interval": 7200.0},
)
GOAL = Place(152.3, -39.8, 150.0)


@pytest.fixture(scope="module")
def whole(ocean, tmp_path_factory):
    """The bytes of a run without checkpoints."""
    out = tmp_path_factory.mktemp("whole") / "out.mcap"
    replay(job_in(ocean, out, GOAL), CONFIG, planner_of)
    return out.read_bytes()


@pytest.fixture(scope="module")
def stopped(ocean, tmp_path_factory):
    """The folder that a run leaves that was killed."""
    folder = tmp_path_factory.mktemp("stopped")
    job = job_in(ocean, folder / "out.mcap", GOAL, checkpoint=folder / "run.ck")
    with pytest.raises(Killed):
        run_until(job, CONFIG, 75)
    return folder


# profiles that count together, in groups that begin and end within blocks
WINDOW = CONFIG.model_copy(
    update={"time": RunConfig(time={"scale": 432_000.0, "window": 1800.0}).time}
)


@pytest.mark.parametrize(
    ("config", "more"),
    [
        (CONFIG, {"goal": GOAL}),
        pytest.param(WINDOW, {}, marks=pytest.mark.full),
        pytest.param(
            CONFIG,
            {"logs": ("glider.mcap", "survey.mcap"), "include_inputs": True},
            marks=pytest.mark.full,
        ),
        pytest.param(CONFIG, {"truth": "truth.nc"}, marks=pytest.mark.full),
    ],
)
def test_a_run_stopped_again_and_again_gives_the_bytes_of_one_that_was_not(
    ocean, tmp_path, config, more
):
    if "truth" in more:
        more = {"truth": str(ocean / more["truth"])}
    goes_on(job_in(ocean, tmp_path / "out.mcap", **more), config, 50, 15)


@pytest.mark.full
def test_the_caller_s_environment_changes_nothing(ocean, tmp_path, whole):
    (tmp_path / "run.toml").write_text(run_settings_toml(CONFIG))
    files = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --config {tmp_path}/run.toml"
    line = f"replay {files} --goal=152.3,-39.8,150 -o {tmp_path}/out.mcap"
    other = {"PYTHONHASHSEED": "7", "TZ": "Pacific/Auckland", "LC_ALL": "C", "LANG": "C"}
    other |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "2")
    command = [sys.executable, "-m", "replay_kit", *line.split()]
    subprocess.run(command, check=True, capture_output=True, env=os.environ | other)
    assert (tmp_path / "out.mcap").read_bytes() == whole


@pytest.mark.parametrize("what", ["settings", "flip", "result gone"])
def test_a_state_of_another_run_or_damaged_is_told_and_the_run_begins_anew(
    ocean, stopped, tmp_path, whole, what
):
    folder, said, config = shutil.copytree(stopped, tmp_path / "run"), [], CONFIG
    out, checkpoint = folder / "out.mcap", folder / "run.ck"
    file = folder / "out.mcap.part"
    if what == "settings":
        other = RunConfig(consistency={"on_failure": "ignore"}).consistency
        config = CONFIG.model_copy(update={"consistency": other})
    elif what.endswith("gone"):
        file.unlink()
    else:
        data = bytearray(file.read_bytes())
        data[2 * len(data) // 5] ^= 4
        file.write_bytes(data)
    job = job_in(ocean, out, GOAL, checkpoint=checkpoint, tell=said.append)

    def open_at_restart(done, total, of):
        """The log is open in no pass of the run that was given up."""
        if said and of == "reading the forecast":
            held.append([each for each in Path("/proc/self/fd").iterdir() if each.resolve() == log])

    log, held = job.logs[0].resolve(), []
    replay(job, config, planner_of, open_at_restart)
    assert held == [[]]
    (text,) = said
    assert "run.ck: the run cannot resume from it: " in text
    assert (out.read_bytes() == whole) == (what != "settings")
    assert not checkpoint.exists()


@pytest.mark.parametrize("name", ["out.mcap", "glider.mcap", "ensemble.nc", "other"])
def test_a_checkpoint_harms_no_other_file(ocean, tmp_path, name):
    for source in ("glider.mcap", "ensemble.nc"):
        shutil.copy(ocean / source, tmp_path / source)
    (tmp_path / "other").write_text("precious")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    job = job_in(tmp_path, tmp_path / "out.mcap", checkpoint=tmp_path / name)
    with pytest.raises((ConfigError, LogError), match=r"out\.mcap|input|not the state of a run"):
        replay(job, CONFIG)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
