"""A handful of ``python -m tests.fuzz kill``."""

import sys

import pytest

if sys.platform == "win32":
    pytest.skip("SIGKILL is POSIX", allow_module_level=True)

from tests.fuzz.kill import KINDS, SIGNALS, kill, make_inputs


@pytest.mark.full
@pytest.mark.parametrize("sent", SIGNALS, ids=lambda sent: sent.name)
@pytest.mark.parametrize("kind", KINDS)
def test_a_command_that_gets_a_signal_leaves_the_same_bytes(tmp_path, kind, sent):
    make_inputs(tmp_path)
    found = kill(kind, tmp_path, 1 if "fleet" in kind else 5, 1, sent)
    assert found.wrong == []
    assert found.kills


def test_an_export_that_is_killed_leaves_the_same_bytes(tmp_path):
    make_inputs(tmp_path, 10)
    assert kill("export", tmp_path, 1, 2).wrong == []
