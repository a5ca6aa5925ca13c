"""Rules of all options of all commands: an output's name fits what is written, and an option with one value is given once."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest
from cyclopts.argument import Argument

from replay_kit.cli.app import FORMS, app
from replay_kit.cli.words import repeat_ensembles
from replay_kit.config.run import LogConfig
from replay_kit.logs import open_log
from replay_kit.workflows.convert import convert
from tests.command import invoke, succeed
from tests.places import ROOT

FILES = "out netcdf save-estimate json geojson csv waypoints suggest"
WRITTEN = {f"--{name}" for name in FILES.split()}
COMMANDS = [*FORMS]


def options(words: str) -> Iterator[Argument]:
    """Yield the options of a command."""
    command = app
    for word in words.split():
        command = command[word]
    for argument in command.assemble_argument_collection():
        if argument.name.startswith("--"):
            yield argument


OPTIONS = [(words, option.name, option) for words in COMMANDS for option in options(words)]
OUTPUTS = [
    (words, option)
    for words, option, _ in OPTIONS
    if option in WRITTEN or (words == "synthesize" and option in ("--ensemble", "--truth"))
]
FOLDERS = [
    (words, option)
    for words, option in OUTPUTS
    if words.split()[0] in ("experiment", "fleet") and option == "--out"
]


def refusal(line: str) -> str:
    """Return what a command line that is refused with exit 2 says."""
    done = invoke(line)
    assert done.exit_code == 2
    assert done.stderr.startswith("replay-kit: ")
    return done.stderr.removeprefix("replay-kit: ").removesuffix("\n")


def test_the_outputs_of_every_command_are_known():
    made, answered = (
        {words for words, option in OUTPUTS if option == name} for name in ("--out", "--json")
    )
    assert " ".join(sorted(made)) == (
        "convert experiment paper export fetch fleet layout plan plot replay report smooth twin"
    )
    without = " ".join(sorted(set(COMMANDS) - answered))
    assert without == "config export layout plot report synthesize twin"


@pytest.mark.parametrize(("words", "option"), [given for given in OUTPUTS if given not in FOLDERS])
def test_an_ending_that_does_not_fit_is_refused_before_anything_is_read(
    words, option, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name, shown in (("wrong.xyz", ".xyz"), ("flow.nc.gz", ".gz"), ("WRONG.DBF", ".DBF")):
        said = refusal(f"{words} {option} {name}")
        assert said.startswith(f"{option}: expected the name of a file that ends in ")
        assert f"with the ending {shown};" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("words", "option"), FOLDERS)
def test_a_folder_does_not_get_the_name_of_a_file(words, option):
    for name in ("study.json", "table.CSV"):
        assert f"{option}: expected the name of a folder" in refusal(f"{words} {option} {name}")
    # a point alone is no ending of a file: what is missing next is complained of
    assert invoke(f"{words} {option} study.v2").exit_code == 2


FORM = "expected replay-kit replay LOG... --ensemble FILE... -o OUT.mcap."


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("replay --out a.b.Mcap", f"LOG is missing; {FORM}"),
        ("replay a.mcap", f"--ensemble is missing; {FORM}"),
        ("replay a.mcap --ensemble e.nc -o", "-o: its value is missing; expected replay-kit"),
        # an underscore and words after two hyphens are no unknown options
        ("replay --dry_run --offline -- --mode", "--ensemble is missing"),
        ("experiment paper -o out", "--ensemble is missing; expected replay-kit experiment paper"),
        (
            "report a.mcap b.mcap -o x.html",
            "'b.mcap' is one too many; expected replay-kit report RESULT.mcap",
        ),
    ],
)
def test_a_missing_option_is_named_with_the_form_of_the_command(line, missing):
    said = refusal(line)
    assert missing in said
    assert f"See replay-kit {' '.join(line.split()[: 1 + line.startswith('exp')])} --help." in said


@pytest.mark.parametrize(
    ("words", "unknown"),
    [
        ("replay a.mcap --mode 3", "Unknown option: --mode. Did you mean --modes?"),
        ("replay --dry_rum", "Unknown option: --dry_rum. Did you mean --dry-run?"),
        # what has left the command line is told where it is
        ("replay a.mcap --tilt-fail=3", "In a file of --config: [measurements.quality] tilt_fail."),
        ("replay --planner.depth 3", "Did you mean --planner? In a file of --config: [planner] de"),
        ("replay a.mcap -z", "Unknown option: -z."),
        ("replya", 'Did you mean "replay"?'),
        ("experiment papr", 'Did you mean "paper"?'),
    ],
)
def test_an_unknown_word_is_named_before_what_is_missing_with_the_nearest(words, unknown):
    said = refusal(words)
    assert unknown in said
    assert "--help." in said


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("log") / "A.MCAP"
    succeed(f"twin --truth {ROOT}/sample_logs/truth.nc --pings 2 -o {out}")
    return out


def test_upper_case_endings_choose_the_same_format(log, tmp_path):
    convert([log], tmp_path / "B.MCAP", False, LogConfig())
    assert (tmp_path / "B.MCAP").read_bytes()[1:5] == b"MCAP"
    assert sum(1 for _ in open_log(tmp_path / "B.MCAP").messages()) > 0


def test_answers_go_to_streams_and_logs_do_not(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for stream in ("-", "/dev/null"):
        succeed(f"info {log} --json {stream}")
    # a file that takes a device's name would replace it
    os.mkfifo("pipe.mcap")
    for stream in ("-", "/dev/null", "pipe.mcap"):
        for words in (f"convert {log}", f"replay {log}", "twin", "plan flow.nc"):
            assert f"got the stream '{stream}'" in refusal(f"{words} -o {stream} --overwrite")
    assert Path("pipe.mcap").is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.mcap"]


SINGLE = [
    (words, option)
    for words, name, option in OPTIONS
    if option.hint is not bool and not option.token_count()[1]
]


@pytest.mark.parametrize("step", [10, pytest.param(1, marks=pytest.mark.full)])
@pytest.mark.parametrize("words", COMMANDS)
def test_an_option_with_one_value_is_given_once(words, step):
    single = [option for of, option in SINGLE if of == words and bool not in get_args(option.hint)]
    assert single or words == "config"
    for option in single[::step]:
        # short and long names are one option
        said = refusal(f"{words} {option.name} first {option.names[-1]}=second")
        assert said.startswith(f"Parameter {option.names[-1]} specified multiple times.")


def test_every_command_that_reads_an_ensemble_takes_several_files():
    assert {words for words, option in SINGLE if option.name == "--ensemble"} == {"synthesize"}
    several = {words for words, name, option in OPTIONS if option.name == "--ensemble"}
    assert " ".join(sorted(several)) == (
        "experiment paper fetch fleet info replay smooth synthesize"
    )


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (
            "info --ensemble a.nc b.nc c.zarr",
            "info --ensemble a.nc --ensemble b.nc --ensemble c.zarr",
        ),
        (
            "replay x.mcap --ensemble a.nc b*.nc -o o.mcap",
            "replay x.mcap --ensemble a.nc --ensemble b*.nc -o o.mcap",
        ),
        (
            "replay --ensemble=a.nc b.nc x.mcap -o o.mcap",
            "replay --ensemble=a.nc --ensemble b.nc x.mcap -o o.mcap",
        ),
        # glider files are logs where no log stands elsewhere
        (
            "replay --ensemble e.nc p1.nc p2.nc -o o.mcap",
            "replay --ensemble e.nc p1.nc p2.nc -o o.mcap",
        ),
        (
            "replay x.mcap --ensemble e.nc y.mcap --ensemble",
            "replay x.mcap --ensemble e.nc y.mcap --ensemble",
        ),
        ("", ""),
    ],
)
def test_words_after_an_ensemble_are_files_of_it(given, meant):
    assert repeat_ensembles(given.split()) == meant.split()


def test_durations_of_options_take_units_and_lists_and_flags_may_come_again(log, tmp_path):
    again = "--remap /a=/b --remap /c=/d --overwrite --overwrite"
    succeed(f"convert {log} -o {tmp_path}/o.mcap {again}")
    words = f"replay {log} --ensemble e.nc -o {tmp_path}/x.mcap --until-idle"
    for given, said in (
        ("10parsecs", "expected a number, or a duration such as 90s, 36h, 2d"),
        ("10min", "--until-idle: needs --follow"),
        ("600", "--until-idle: needs --follow"),
    ):
        assert said in refusal(f"{words} {given}")
