"""How much is printed, where a copy is kept, and how progress is shown."""

import io
import json
import re
import sys

import pytest

from replay_kit.cli import console
from replay_kit.cli.console import FORMAT_VERSION, progress
from replay_kit.core.errors import ConfigError
from tests.command import invoke, run_command, succeed
from tests.places import ROOT

TRUTH = str(ROOT / "sample_logs" / "truth.nc")


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    made = tmp_path_factory.mktemp("log") / "survey.mcap"
    succeed(f"twin --truth {TRUTH} --pings 3 -o {made} -q")
    return str(made)


@pytest.mark.parametrize(("before", "after"), [([], ["-q"]), (["-q"], []), (["--quiet"], ["-q"])])
def test_quiet_prints_nothing_wherever_it_stands(log, before, after):
    done = invoke([*before, "info", log, *after])
    assert (done.exit_code, done.output) == (0, "")


def test_quiet_keeps_answers_that_are_asked_for_and_errors(log):
    done = invoke(f"info {log} -q --json -")
    assert json.loads(done.stdout)["format_version"] == FORMAT_VERSION == 2
    assert done.stderr == ""
    assert "file not found" in invoke("-q info absent.mcap").stderr


def test_a_log_keeps_what_is_printed_with_the_time(log, tmp_path):
    usual = succeed(f"info {log}", columns=80).stdout
    for more in ([], ["-q"]):
        succeed(["--log", str(tmp_path / "a.log"), "info", log, *more], columns=80)
    run_command(tmp_path, "info absent.mcap --log a.log")
    lines = (tmp_path / "a.log").read_text().splitlines()
    assert all(re.match(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\dZ .", line) for line in lines)
    printed = [line.rstrip() for line in usual.splitlines() if line.strip()]
    # the second run is added to the first
    *kept, started, error = [line[21:] for line in lines]
    assert kept == 2 * ["started", "reading", *printed]
    assert started == "started"
    assert error.startswith("ERROR: absent.mcap: file not found")


def test_a_log_is_no_other_file_of_the_command(log, tmp_path):
    (tmp_path / "flight.log").write_bytes(b"precious")
    for line, words in (
        (
            "info flight.log --log ./flight.log",
            "--log: 'flight.log' is another file of this command",
        ),
        (f"info {log} --log absent/a.log", "--log: cannot write 'absent/a.log': No such file"),
        (f"info {log} --log {log}", "--log: expected the name of a file that ends in one of .log"),
    ):
        done = run_command(tmp_path, line)
        assert (done.returncode, words in done.stderr) == (2, True), done.stderr
    assert (tmp_path / "flight.log").read_bytes() == b"precious"


def test_one_run_does_not_report_as_the_one_before(log, tmp_path):
    invoke(f"info {log} -q -v")
    assert console.current() == console.Reporting(quiet=True, verbose=True)
    invoke("--version")
    assert console.current() == console.Reporting()
    with pytest.raises(ConfigError):
        console.begin(console.Reporting(log=tmp_path))
    assert console.current().log is None


def test_a_terminal_is_shown_the_stages_and_a_pipe_nothing(monkeypatch, tmp_path):
    own = console.Reporting(log=tmp_path / "a.log")
    monkeypatch.setattr(console, "_CURRENT", console.ContextVar("own", default=own))
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress() as advance:
            advance(0, 0, "computing the basis")
            for k in range(5):
                advance(k, 4, f"planning: try {k}")
        for words in ("computing the basis", "planning: try 4", "100 %"):
            assert (words in stream.getvalue()) == stream.isatty()
    # a stage once, without its details
    lines = [line[21:] for line in (tmp_path / "a.log").read_text().splitlines()]
    assert lines == 2 * ["computing the basis", "planning"]
