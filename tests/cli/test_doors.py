"""Whatever is given where a command reads or writes: no pipe is waited for, no device is read without end, and a sentence says so."""

import json
import os
import signal
import socket
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import get_args

import pytest

from replay_kit import open_ensemble, open_estimate, open_log, open_result
from replay_kit.cli.options import Ending
from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import ConfigError, ForecastError, LogError, PlanError
from replay_kit.forecast import read_truth
from replay_kit.workflows.planning.areas import read_areas
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from tests.cli.test_cli_options import OPTIONS, refusal
from tests.command import invoke, succeed
from tests.places import SAMPLES

_REPLAY, _PLAN = "replay log.mcap --ensemble e.nc -o out.mcap", "plan flow.nc --start 1,2,0"
#: Commands with an X for what is read.
DOORS = (
    *("info X", "info --ensemble X", "info log.mcap --config X"),
    *("qc X", "qc log.mcap --config X", "convert X -o out.mcap"),
    *("replay X --ensemble e.nc -o out.mcap", "replay log.mcap --ensemble X -o out.mcap"),
    *(f"{_REPLAY} {name} X" for name in ("--against", "--truth", "--checkpoint", "--config")),
    *(f"{_REPLAY} --bathymetry X", f"{_REPLAY} --follow --goal-file X"),
    "replay --as a=X --ensemble e.nc -o out.mcap",
    *("smooth X --ensemble e.nc -o out.mcap", "smooth log.mcap --ensemble X -o out.mcap"),
    "smooth log.mcap --ensemble e.nc --config X -o out.mcap",
    *("report X -o out.html", "status X", "layout X -o out.json", "plot X map -o out.png"),
    *("export X -o out.nc", "verify X", "verify log.mcap --inputs X"),
    *("plan X --start 1,2,0", *(f"{_PLAN} --{name} X" for name in ("no-go", "bathymetry"))),
    f"{_PLAN} --config X",
    "twin --truth X -o out.mcap",
    *("fleet X -o out", "fleet log.mcap --ensemble X -o out", "fleet log.mcap --config X -o out"),
    *(f"fetch {words} --ensemble https://a.b/c" for words in ("X", "--config X")),
    *("experiment paper --ensemble X --truth t.nc -o out", "experiment paper --ensemble e.nc --truth X -o out"),
)  # fmt: skip
_NO_FILE = ", not a file; save its output to a file, and give that"
KINDS = {
    "link": f"it is a pipe{_NO_FILE}",
    "socket": f"it is a socket{_NO_FILE}",
    "/dev/zero": f"it is a device{_NO_FILE}",
    "loop": "Too many levels of symbolic links; give the name of a file",
}


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """A folder with a file of each kind that is none; what waits is ended."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("link").symlink_to("pipe")
    Path("loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        signal.alarm(20)
        yield tmp_path
        signal.alarm(0)


@pytest.mark.parametrize("line", DOORS)
def test_a_pipe_is_refused_at_every_door(hostile, line):
    before = set(hostile.iterdir())
    said = refusal(line.replace("X", "pipe"))
    assert said.startswith("pipe: cannot ")
    assert said.endswith(f": it is a pipe{_NO_FILE}")
    assert set(hostile.iterdir()) == before


@pytest.mark.parametrize(
    "line", [*DOORS[:40:10], f"{_REPLAY} --checkpoint X", f"{_REPLAY} --follow --goal-file X"]
)
def test_each_kind_that_is_no_file_is_refused(hostile, line):
    for name, kind in KINDS.items():
        assert refusal(line.replace("X", name)) == f"{name}: cannot be read: {kind}"


def test_every_option_that_is_read_is_one_of_these_doors():
    lines = [line.split() for line in DOORS]
    given = {(line[0], before) for line in lines for before, word in pairwise(line) if word == "X"}
    for words, name, option in OPTIONS:
        marks = get_args(option.field_info.annotation)[1:]
        written = any(isinstance(mark, Ending) for mark in marks)
        if "Path" in str(option.hint) and not written and words != "fetch":
            assert (words.split()[0], name) in given, option


def test_a_device_that_is_full_and_a_folder_are_told(hostile):
    Path("folder.json").mkdir()
    for name, code, words in (
        (
            "/dev/full",
            1,
            "/dev/full: cannot be written: No space left on device; is the disk full?",
        ),
        ("folder.json", 2, "folder.json: is a folder; give the name of a file"),
    ):
        done = invoke(f"info {SAMPLES / 'survey.mcap'} --json {name}")
        assert (done.exit_code, words in done.stderr) == (code, True)


def test_a_pipe_that_is_read_has_the_answer(hostile):
    with ThreadPoolExecutor() as pool:
        read = pool.submit(Path("pipe").read_text)
        succeed(f"info {SAMPLES / 'survey.mcap'} --json pipe")
    assert json.loads(read.result())["logs"]


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (open_log, LogError),
        (open_result, LogError),
        (open_estimate, ForecastError),
        (load_config, ConfigError),
        (open_ensemble, ForecastError),
        (lambda path: read_truth(f"{path}", ForecastConfig()), ForecastError),
        (lambda path: read_bathymetry(path, None), ForecastError),
        (read_areas, PlanError),
    ],
)
@pytest.mark.parametrize("name", ["pipe", "/dev/zero", "folder"])
def test_a_script_is_told_too(hostile, read, error, name):
    Path("folder").mkdir()
    with pytest.raises(error, match=name):
        read(Path(name))
