"""The command line: exit codes, what it says, and the paths it refuses before it reads anything.

A process is started only where it matters that there is one: pipes, signals, the interpreter's end.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from replay_kit.config.run import RunConfig
from replay_kit.forecast import read_truth
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins import ensemble
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.info.inspect import inspect_logs
from tests import synthetic
from tests.command import run_command
from tests.measurements.samples import fix
from tests.places import ROOT

MAIN = "from replay_kit.cli.app import main; main()"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "160"}


def process(folder, *command):
    """A command in a process of its own."""
    return subprocess.run(
        command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ocean")
    synthetic.write_ocean(folder, 20)
    truth = read_truth(str(folder / "truth.nc"), RunConfig().forecast)
    make_twin(truth, Twin("vessel", 20, 0.05, 1), folder / "survey.mcap")
    (folder / "run.toml").write_text("[output]\ninterval = 1.0\n")
    (folder / "link.mcap").symlink_to(folder / "survey.mcap")
    (folder / "hard.mcap").hardlink_to(folder / "survey.mcap")
    (folder / "store.zarr").mkdir()
    (folder / "folder.mcap").mkdir()
    (folder / "there.json").write_text("precious")
    return folder


#: Command lines by the words of their refusal, an X for a replay of the survey.
REFUSALS = {
    "an input is never overwritten": [
        # links and part files of inputs are inputs too
        *(f"X -o {name}.mcap --overwrite" for name in ("survey", "link", "hard")),
        "replay o.mcap.part --ensemble ensemble.nc -o o.mcap --overwrite",
        "X -o o.mcap --netcdf ensemble.nc --overwrite",
        "X -o o.mcap --truth truth.nc#3 --save-estimate truth.nc --overwrite",
        "X -o o.mcap --config there.json --json there.json --overwrite",
        "replay survey.mcap --ensemble store.zarr -o store.zarr/o.mcap --overwrite",
        "info there.json --json there.json --overwrite",
        "info survey.mcap --suggest run.toml --config run.toml --overwrite",
        "convert there.json -o o.mcap --json there.json --overwrite",
        "twin --truth survey.mcap -o survey.mcap --overwrite",
    ],
    "--overwrite": [
        "X -o o.mcap --json there.json",
        "replay there.json --ensemble ensemble.nc -o survey.mcap",
        "convert there.json -o survey.mcap",
        "info survey.mcap --json there.json",
        "info survey.mcap --suggest run.toml",
        "synthesize --ensemble e.nc --truth truth.nc",
    ],
    "two outputs": [
        "X -o o.mcap --save-estimate o.nc --netcdf ./o.nc",
        "X -o o.mcap --checkpoint o.mcap.part",
        "info survey.mcap --suggest o --json ./o",
        "synthesize --ensemble e.nc --truth e.nc",
    ],
    "there is no folder absent": ["X -o absent/o.mcap"],
    "is a folder": ["X -o folder.mcap --overwrite"],
    "--goal": ["X -o o.mcap --goal nan,0,0"],
    "'logs.start': 'yesterday' is no time": ["X -o o.mcap --start yesterday"],
    "estimator.modes": ["X -o o.mcap --modes some"],
    "only one can have": ["info survey.mcap --suggest - --json -"],
}
REFUSED = [
    (line.replace("X", "replay survey.mcap --ensemble ensemble.nc"), words)
    for words, lines in REFUSALS.items()
    for line in lines
]


@pytest.fixture(scope="module")
def refusals(ocean):
    """Return what each case of REFUSED ended with, and the folder's files and their times before and after."""
    before = {path: path.stat().st_mtime_ns for path in ocean.rglob("*")}
    answers = [run_command(ocean, arguments) for arguments, _ in REFUSED]
    return answers, before, {path: path.stat().st_mtime_ns for path in ocean.rglob("*")}


@pytest.mark.parametrize("k", range(len(REFUSED)), ids=[line for line, _ in REFUSED])
def test_wrong_paths_and_options_are_refused_with_exit_2(refusals, k):
    answer = refusals[0][k]
    assert answer.returncode == 2
    assert REFUSED[k][1] in answer.stderr


def test_a_refusal_touches_no_file(refusals):
    _, before, after = refusals
    assert before == after


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("twin --truth t.nc -o x.mcap --pings 0", 2, "--pings"),
        ("info absent.mcap", 3, "file not found"),
        ("--version", 0, ""),
    ],
)
def test_usage_errors_keep_their_codes(tmp_path, line, code, said):
    done = run_command(tmp_path, line)
    assert (done.returncode, said in done.stderr) == (code, True)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (OSError(28, "No space left on device"), 1, "[Errno 28] No space left on device"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_an_error_of_the_system_and_an_interrupt_are_a_line(
    tmp_path, monkeypatch, error, code, said
):
    monkeypatch.setattr(ensemble, "write_ensemble", Mock(side_effect=error))
    done = run_command(tmp_path, "synthesize --ensemble e.nc --truth t.nc")
    assert (done.returncode, done.stderr) == (code, f"replay-kit: {said}\n")


def test_json_replaces_whole_files_only_when_asked_and_goes_to_streams(ocean, tmp_path):
    info, answer = ["info", str(ocean / "survey.mcap"), "--json"], tmp_path / "i.json"
    answer.write_text("old")
    assert run_command(tmp_path, [*info, "i.json", "--overwrite"]).returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["i.json"]
    streams = (
        answer.read_text(),
        run_command(tmp_path, [*info, "-"]).stdout,
        process(tmp_path, sys.executable, "-c", MAIN, *info, "/dev/stderr").stderr,
    )
    assert [json.loads(text)["logs"][0]["profiles"] for text in streams] == [20] * 3


def test_ctrl_c_ends_with_130_and_names_the_part_of_a_replay(ocean, tmp_path):
    # the process interrupts itself after its first block: a signal from outside may come before the run begins or after it ended
    code = (
        "import signal, os, replay_kit.cli.app as c, replay_kit.workflows.replay.run as r\n"
        "real = r.Run.take\n"
        "def taken(*a):\n"
        "    real(*a)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "r.Run.take = taken\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\nc.main()"
    )
    line = f"replay {ocean / 'survey.mcap'} --ensemble {ocean / 'ensemble.nc'} -o out.mcap"
    done = process(tmp_path, sys.executable, "-c", code, *line.split())
    assert done.returncode == 130
    assert done.stderr == "replay-kit: interrupted; what was written so far is in out.mcap.part\n"
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap.part"]


def test_a_reader_that_leaves_early_is_no_traceback(ocean):
    line = f"{sys.executable} -c '{MAIN}' info {ocean}/survey.mcap | true; exit ${{PIPESTATUS[0]}}"
    done = process(ROOT, "bash", "-c", line)
    assert (done.returncode, done.stderr) == (1, "")


def test_the_box_of_a_track_across_the_antimeridian_is_narrow(tmp_path):
    places = (179.5, -20.0), (-179.75, -20.5), (179.25, -19.5)
    write_mcap_log(tmp_path / "log.mcap", [fix(k, *place) for k, place in enumerate(places)])
    found = inspect_logs([tmp_path / "log.mcap"], RunConfig())[0].content
    assert (found.positions, found.depths) == (3, None)
    np.testing.assert_allclose(found.box, (179.25, -20.5, 180.25, -19.5), rtol=0, atol=1e-12)
