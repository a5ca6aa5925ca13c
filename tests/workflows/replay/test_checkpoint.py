"""Runs that are killed and go on give the bytes of an uninterrupted run; a checkpoint that does not fit is refused."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import ConsistencyConfig, OutputConfig, RunConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.plan import Place
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.replay import replay
from tests.workflows.replay.interrupted import (
    QUICK,
    Killed,
    goes_on,
    job_in,
    make_ocean,
    run_until,
    truth_in,
)

CONFIG = RunConfig(
    planner=PlannerConfig(kind="glide"),
    estimator=QUICK,
    output=OutputConfig(checkpoint_interval=1800.0, interval=7200.0),
)
GOAL = Place(152.3, -39.8, 150.0)


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, 40)
    make_twin(truth_in(folder, CONFIG), Twin("vessel", 40, 0.05, 2), folder / "survey.mcap")
    return folder


def run(ocean, out, checkpoint=None, stop_after=None):
    return run_until(job_in(ocean, out, GOAL, checkpoint), CONFIG, stop_after)


@pytest.fixture(scope="module")
def whole(ocean, tmp_path_factory):
    """The bytes of a run without checkpoints."""
    out = tmp_path_factory.mktemp("whole") / "out.mcap"
    run(ocean, out)
    return out.read_bytes()


@pytest.fixture(scope="module")
def stopped_run(ocean, tmp_path_factory):
    """What a run that was killed leaves, by name."""
    folder = tmp_path_factory.mktemp("stopped")
    with pytest.raises(Killed):
        run(ocean, folder / "out.mcap", folder / "run.ck", 75)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def stopped(stopped_run, tmp_path):
    """The result and the checkpoint of a run that was killed, in a folder of the test's own."""
    for name, data in stopped_run.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path / "out.mcap", tmp_path / "run.ck"


WINDOW = CONFIG.model_copy(update={"time": TimeConfig(scale=432_000.0, window=1800.0)})


@pytest.mark.parametrize(
    ("config", "more"),
    [
        (CONFIG, {"goal": GOAL}),
        # profiles that count together, in groups that begin and end within blocks
        pytest.param(WINDOW, {}, marks=pytest.mark.full),
        pytest.param(
            CONFIG,
            {"logs": ("glider.mcap", "survey.mcap"), "include_inputs": True},
            marks=pytest.mark.full,
        ),
        pytest.param(CONFIG, {"truth": True}, marks=pytest.mark.full),
    ],
)
def test_a_run_stopped_again_and_again_gives_the_bytes_of_one_that_was_not(
    ocean, tmp_path, config, more
):
    if "truth" in more:
        more = more | {"truth": str(ocean / "truth.nc")}
    goes_on(job_in(ocean, tmp_path / "out.mcap", **({"goal": None} | more)), config, 50, 15)


def command_line(ocean, folder):
    """The run of ``whole`` as a command, its result in a folder."""
    (folder / "run.toml").write_text(
        '[output]\ncheckpoint_interval = 1800.0\ninterval = 7200.0\n[planner]\nkind = "glide"\n'
        "[estimator]\nmodes = 6\nsample_share = 0.5\nshift_distance = 0.0\n"
    )
    inputs = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --config {folder}/run.toml"
    line = f"replay {inputs} --goal=152.3,-39.8,150 --overwrite -o {folder}/out.mcap"
    code = "from replay_kit.cli.app import main; main()"
    return [sys.executable, "-c", code, *line.split()]


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
    assert (tmp_path / "out.mcap").read_bytes() == whole


@pytest.mark.parametrize(
    "what", ["settings", "cut", "flip", "result cut", "result flip", "result gone"]
)
def test_a_state_of_another_run_or_damaged_is_told_and_the_run_begins_anew(
    ocean, stopped, whole, what
):
    (out, checkpoint), said, config = stopped, [], CONFIG
    part = out.with_name("out.mcap.part")
    file = part if what.startswith("result") else checkpoint
    data = bytearray(file.read_bytes())
    data[2 * len(data) // 5] ^= 4
    if what == "settings":
        config = CONFIG.model_copy(update={"consistency": ConsistencyConfig(on_failure="ignore")})
    elif what.endswith("gone"):
        file.unlink()
    else:
        file.write_bytes(data if what.endswith("flip") else data[: len(data) // 2])
    job = job_in(ocean, out, GOAL, checkpoint, tell=said.append)

    def open_at_restart(done, total, of):
        """The log is open in no pass of the run that was given up."""
        if said and of == "reading the forecast":
            held.append([each for each in Path("/proc/self/fd").iterdir() if each.resolve() == log])

    log, held = job.logs[0].resolve(), []
    replay(job, config, planner_of, open_at_restart)
    assert held == [[]]
    (text,) = said
    assert "run.ck: the run cannot resume from it: " in text
    assert text.endswith("; the replay restarts")
    if what != "settings":
        assert out.read_bytes() == whole
    assert not checkpoint.exists()


@pytest.mark.parametrize("name", ["out.mcap", "glider.mcap", "ensemble.nc", "other"])
def test_a_checkpoint_harms_no_other_file(ocean, tmp_path, name):
    for source in ("glider.mcap", "ensemble.nc"):
        shutil.copy(ocean / source, tmp_path / source)
    (tmp_path / "other").write_text("precious")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises((ConfigError, LogError), match=r"out\.mcap|input|not the state of a run"):
        run(tmp_path, tmp_path / "out.mcap", tmp_path / name)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
