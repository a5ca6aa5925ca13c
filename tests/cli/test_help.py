"""Help: it has every option with its form, default and choices, and fits the terminal."""

import pytest

from replay_kit.cli.app import FORMS, app
from tests.command import invoke, succeed


@pytest.mark.parametrize("words", FORMS)
def test_every_option_is_there_and_no_line_is_wider_than_the_terminal(words):
    said = succeed(f"{words} --help", columns=80).stdout
    assert max(map(len, said.splitlines())) <= 80
    command = app
    for word in words.split():
        command = command[word]
    with app.app_stack(words.split()):
        arguments = command.assemble_argument_collection(parse_docstring=True)
        shown = [each for each in arguments if each.show]
    assert all(each.parameter.help for each in shown)
    # names may be folded
    joined = "".join(said.replace("\u2502", "").split())
    assert all(name in joined for each in shown for name in each.names)


def test_commands_stand_under_their_headings():
    said = succeed("--help", columns=100).stdout
    place = [said.index(word) for word in (" Estimate and plan ", " replay ", " Logs ", " info ")]
    assert place == sorted(place)
    assert all(f" {name} " in said for name in FORMS if " " not in name)


def test_forms_choices_and_defaults_are_told():
    said = " ".join(invoke("twin --help", columns=80).stdout.replace("\u2502", "").split())
    for words in (
        "--vehicle CHOICE A vessel surveys at random positions, a glider dives. [choices: vessel, glider] [default: vessel]",
        "--noise FLOAT Standard deviation of each velocity component of a bin [m/s]. [default: 0.09]",
        "--truth FILE[#member] The current that the vehicle moves in. [required]",
        "--changing The current changes",
    ):
        assert words in said


@pytest.mark.parametrize(
    ("arguments", "code", "begin"),
    [
        ([], 2, "Usage: replay-kit COMMAND\n"),
        (["-h"], 0, "Usage: replay-kit COMMAND\n"),
        (["experiment"], 2, "Usage: replay-kit experiment COMMAND\n"),
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
