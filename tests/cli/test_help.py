"""The layout of help: it fits a screen, nothing is cut, what is common comes first; --help-all has every option."""

import pytest

from replay_kit.cli.app import _COMMANDS, _STUDIES, app
from replay_kit.cli.help import layout
from tests.command import invoke, succeed

COMMANDS = [(name,) for name in _COMMANDS] + [("experiment", name) for name in _STUDIES]


def headings(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.endswith(":") and not line.startswith(" ")]


def options(text: str) -> list[str]:
    """Return the first name of each entry."""
    return [
        line.split()[0].rstrip(",")
        for line in text.splitlines()
        if line.startswith("  ") and line[2] != " "
    ]


def test_names_and_descriptions_stand_in_columns():
    entries = [
        ("-o, --out FILE", "Where the result goes, with many words."),
        ("--a-name-that-is-too-long X", "Below."),
    ]
    assert layout("Usage: it", "Does it.", [("Options", entries)], 50).splitlines() == [
        "Usage: it",
        "",
        "Does it.",
        "",
        "Options:",
        "  -o, --out FILE          Where the result goes,",
        "                          with many words.",
        "  --a-name-that-is-too-long X",
        "                          Below.",
    ]
    # two spaces at least between a name and its description
    assert layout("u", "a", [("C", [("x" * 22, "d"), ("y" * 23, "d")])], 50).splitlines()[-3:] == [
        f"  {'x' * 22}  d",
        f"  {'y' * 23}",
        " " * 26 + "d",
    ]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_no_line_is_wider_than_the_terminal_and_every_option_is_there(words):
    done = succeed([*words, "--help-all"], columns=80)
    assert max(map(len, done.stdout.splitlines())) <= 80
    command = app
    for word in words:
        command = command[word]
    with app.app_stack((*words,)):
        names = {
            name
            for argument in command.assemble_argument_collection()
            if argument.show
            for name in argument.names
        }
    said = done.stdout.replace(",", " ").split()
    assert names <= set(said)
    assert headings(done.stdout)[-1] == "Reporting:"


@pytest.mark.parametrize("words", [(), ("experiment",), *COMMANDS], ids=" ".join)
def test_help_fits_a_screen_and_says_how_to_see_the_rest(words):
    said, whole = (
        invoke([*words, option], columns=100).stdout for option in ("--help", "--help-all")
    )
    assert len(said.splitlines()) <= 50
    hidden = len(options(whole)) - len(options(said))
    assert hidden >= 0
    assert set(options(said)) <= set(options(whole))
    last = f"{hidden} more options, and what each accepts: {' '.join(('replay-kit', *words))} --help-all"
    assert (last in " ".join(said.split())) == (hidden > 0)
    assert (said == whole) == (hidden == 0)


def test_the_common_options_of_a_long_list_come_first():
    said = invoke("replay --help-all", columns=80).stdout
    found = headings(said)
    assert found[:6] == [
        "Common options:",
        "Inputs:",
        "Outputs:",
        "Options:",
        "Settings:",
        "Section logs of the settings:",
    ]
    common = options(said[said.index("Common options:") : said.index("Inputs:")])
    assert common[:3] == ["LOG", "--ensemble", "-o"]
    expected = (
        "--goal --members --levels --config --report --follow --json --overwrite --as --depth"
    )
    assert set(common[3:]) == {*expected.split(), "--bathymetry", "--radius", "--start"}
    # a short list has no such heading
    assert headings(invoke("synthesize --help").stdout) == [
        "Outputs:",
        "Options:",
        "Reporting:",
    ]


def test_of_a_long_list_the_help_has_first_sentences_short_names_and_defaults():
    said = " ".join(invoke("replay --help", columns=100).stdout.split())
    assert "--levels Z1,Z2,... Depth levels used [m] --" in said
    # what must be given is told whole
    assert "may be repeated. --members defines what a member is. [required]" in said


def test_forms_choices_and_defaults_are_told():
    said = " ".join(invoke("twin --help-all", columns=80).stdout.split())
    assert (
        "--vehicle vessel|glider A vessel surveys at random positions, a glider dives. [default: vessel]"
        in said
    )
    assert "--pings COUNT Number of ADCP pings. [default: 450]" in said
    assert (
        "--noise NUMBER Standard deviation of each velocity component of a bin [m/s]. [default: 0.09]"
        in said
    )
    assert "--truth FILE[#member] The current that the vehicle moves in. [required]" in said
    assert "--changing The current changes" in said


@pytest.mark.parametrize(
    ("arguments", "code", "begin"),
    [
        ([], 2, "Usage: replay-kit COMMAND [OPTIONS]\n"),
        (["-h"], 0, "Usage: replay-kit COMMAND [OPTIONS]\n"),
        (["experiment"], 2, "Usage: replay-kit experiment COMMAND [OPTIONS]\n"),
        (
            "experiment paper -h",
            0,
            "Usage: replay-kit experiment paper --ensemble FILE (--truth FILE | --leave-out K) -o DIR [OPTIONS]\n",
        ),
        ("--help qc a.mcap", 0, "Usage: replay-kit qc LOG... [OPTIONS]\n"),
    ],
)
def test_help_is_shown_wherever_it_is_asked_for(arguments, code, begin):
    done = invoke(arguments)
    assert (done.exit_code, done.stderr) == (code, "")
    assert done.stdout.startswith(begin)
