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


@pytest.mark.parametrize(
    ("arguments", "code", "begin"),
    [
        ("", 2, "Usage: replay-kit COMMAND\n"),
        ("-h", 0, "Usage: replay-kit COMMAND\n"),
        ("experiment", 2, "Usage: replay-kit experiment COMMAND\n"),
        ("experiment paper -h", 0, "Usage: replay-kit experiment paper --ensemble FILE (--truth"),
        ("--help qc a.mcap", 0, "Usage: replay-kit qc LOG... [OPTIONS]\n"),
    ],
)
def test_help_is_shown_wherever_it_is_asked_for(arguments, code, begin):
    done = invoke(arguments)
    assert (done.exit_code, done.stderr) == (code, "")
    assert done.stdout.startswith(begin)
