"""Rules of all options of all commands: an output's name fits what is written, and an option with one value is given once."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from replay_kit.cli.app import app
from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ConfigError
from replay_kit.logs import open_log
from replay_kit.workflows.convert import convert
from tests.places import ROOT

WRITTEN = {"--out", "--netcdf", "--save-estimate", "--json", "--geojson", "--csv", "--waypoints", "--suggest"}


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield each command of the command line with the words that call it."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


COMMANDS = list(commands(typer.main.get_command(app)))
OPTIONS = [
    (words, max(param.opts, key=len), param) for words, command in COMMANDS for param in command.params if param.param_type_name == "option"
]
OUTPUTS = [
    (words, option)
    for words, option, _ in OPTIONS
    if option in WRITTEN or (words == ("synthesize",) and option in ("--ensemble", "--truth"))
]
FOLDERS = [(words, option) for words, option in OUTPUTS if words[0] == "experiment" and option == "--out"]


def refusal(*arguments: object) -> str:
    """Return what a command line that is refused with exit 2 says."""
    done = CliRunner().invoke(app, [*map(str, arguments)])
    assert isinstance(done.exception, ConfigError), done.output
    assert done.exception.exit_code == 2
    return str(done.exception)


def test_the_outputs_of_every_command_are_known() -> None:
    assert {words for words, option in OUTPUTS if option == "--out"} == {
        *(("replay",), ("convert",), ("plan",), ("twin",), ("fit",)),
        *(("experiment", name) for name in ("paper", "missions", "planning")),
    }
    without = {words for words, _ in COMMANDS} - {words for words, option in OUTPUTS if option == "--json"}
    assert without == {("twin",), ("synthesize",)}


@pytest.mark.parametrize(("words", "option"), [given for given in OUTPUTS if given not in FOLDERS])
def test_an_ending_that_does_not_fit_is_refused_before_anything_is_read(words, option, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, shown in (("wrong.xyz", ".xyz"), ("flow.nc.gz", ".gz"), ("WRONG.KML", ".KML")):
        said = refusal(*words, option, name)
        assert said.startswith(f"{option}: expected the name of a file that ends in ")
        assert f"with the ending {shown};" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("words", "option"), FOLDERS)
def test_a_folder_does_not_get_the_name_of_a_file(words, option) -> None:
    for name in ("study.json", "table.CSV"):
        assert f"{option}: expected the name of a folder" in refusal(*words, option, name)
    # a point alone is no ending of a file: what is missing next is complained of
    assert CliRunner().invoke(app, [*words, option, "study.v2"]).exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "listed"),
    [
        (["convert", "-o", "x.csv"], ".mcap, .tlog,"),
        (["convert", "-o", "x.nc"], ".mcap, .tlog,"),
        (["convert", "-o", "x"], ".mcap, .tlog, got 'x' with no ending"),
        (["replay", "-o", "m2.nc"], "in .mcap,"),
        (["replay", "--netcdf", "x.mcap"], "in .nc,"),
        (["plan", "--geojson", "w.kml"], ".geojson, .json,"),
        (["plan", "--waypoints", "w"], ".csv, .geojson, .json, .ma, .targets,"),
        (["fit", "-o", "fitted.json"], "in .toml,"),
        (["qc", "--json", "quality.csv"], "in .json,"),
    ],
)
def test_the_endings_that_are_possible_are_listed(arguments, listed) -> None:
    assert listed in refusal(*arguments)


@pytest.mark.parametrize("name", ["result", "result.mcap", "RESULT.MCAP", "a.b.Mcap"])
def test_names_that_fit_go_on_to_what_is_missing(name) -> None:
    done = CliRunner().invoke(app, ["replay", "--out", name])
    assert done.exit_code == 2
    assert "Missing" in done.output


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("log") / "A.TLOG"
    made = CliRunner().invoke(app, ["twin", "--truth", str(ROOT / "sample_logs" / "truth.nc"), "--pings", "2", "-o", str(out)])
    assert made.exit_code == 0, made.exception
    return out


def test_upper_case_endings_choose_the_same_format(log, tmp_path) -> None:
    convert([log], tmp_path / "B.TLOG", False, LogConfig())
    convert([log], tmp_path / "C.MCAP", False, LogConfig())
    assert (tmp_path / "B.TLOG").read_bytes() == log.read_bytes()
    assert (tmp_path / "C.MCAP").read_bytes()[1:5] == b"MCAP"
    assert sum(1 for _ in open_log(tmp_path / "B.TLOG").messages()) > 0


def test_answers_go_to_streams_and_logs_do_not(log, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for stream in ("-", "/dev/null"):
        assert CliRunner().invoke(app, ["info", str(log), "--json", stream]).exit_code == 0
    # a file that takes a device's name would replace it
    os.mkfifo("pipe.mcap")
    for stream in ("-", "/dev/null", "pipe.mcap"):
        for words in (("convert", log), ("replay", log), ("twin",), ("plan", "flow.nc")):
            assert f"got the stream '{stream}'" in refusal(*words, "-o", stream, "--overwrite")
    assert Path("pipe.mcap").is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.mcap"]


SINGLE = [(words, option) for words, option, param in OPTIONS if not (param.multiple or param.is_flag)]


@pytest.mark.parametrize("words", [words for words, _ in COMMANDS])
def test_an_option_with_one_value_is_given_once(words) -> None:
    options = [option for of, option in SINGLE if of == words]
    assert options
    for option in options:
        said = refusal(*words, option, "first", f"{option}=second")
        assert said == f"{option}: only one {option[2:]} is supported, got 2: first and second; give the option once"


def test_every_command_with_an_ensemble_takes_one() -> None:
    assert {words for words, option in SINGLE if option == "--ensemble"} == {
        *(("replay",), ("info",), ("synthesize",)),
        *(("experiment", name) for name in ("accuracy", "paper", "missions", "planning", "dives")),
    }


def test_short_and_long_names_are_one_option_and_flags_and_lists_may_come_again(log, tmp_path) -> None:
    said = refusal("replay", "log.mcap", "-o", "a.mcap", "--ensemble", "e.nc", "--out", "b.mcap")
    assert "--out: only one out is supported, got 2: a.mcap and b.mcap" in said
    again = ["--remap", "/a=/b", "--remap", "/c=/d", "--overwrite", "--overwrite"]
    done = CliRunner().invoke(app, ["convert", str(log), "-o", str(tmp_path / "o.mcap"), *again])
    assert done.exit_code == 0, done.exception
