"""The options with which ``replay`` follows logs."""

import pytest

from tests.command import invoke

ENSEMBLE = "--ensemble sample_logs/ensemble.nc"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--until-idle 1", "--until-idle: needs --follow"),
        ("--goal-file goal.txt", "--goal-file: needs --follow"),
        ("--notify true", "--notify: needs --follow"),
        ("--follow --dry-run", "--dry-run: cannot be combined"),
        ("--follow --checkpoint c", "--checkpoint: cannot be combined"),
        ("--follow --interval 0", "--interval"),
        ("--follow --goal=152.8,-40.1,300 --goal-file goal.txt", "cannot be combined with --goal"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, words, tmp_path):
    done = invoke(f"replay {tmp_path} {ENSEMBLE} -o {tmp_path.parent}/out.mcap {options}")
    assert done.exit_code == 2
    assert words in done.stderr


def test_a_folder_in_which_no_log_comes_ends_with_exit_code_3_and_what_was_there(tmp_path):
    inbox, out = tmp_path / "inbox", tmp_path / "out.mcap"
    inbox.mkdir()
    (inbox / "notes.txt").write_text("none")
    line = f"replay {inbox} {ENSEMBLE} -o {out} --follow --interval 0.1 --until-idle 0"
    done = invoke(line)
    assert done.exit_code == 3
    assert "notes.txt not used" in done.stdout
    assert "no log that can be replayed has arrived" in done.stderr
    assert not out.exists()
