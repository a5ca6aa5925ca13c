"""A handful of ``python -m tests.fuzz kill``."""

import sys

import pytest

if sys.platform == "win32":
    pytest.skip("SIGKILL is POSIX", allow_module_level=True)

from tests.fuzz.kill import KINDS, kill, make_inputs


def check(folder, count, seed):
    make_inputs(folder)
    for kind in KINDS:
        found = kill(kind, folder, count, seed)
        assert found.wrong == []
        assert found.kills == count, kind


@pytest.mark.full
def test_commands_killed_once_each_give_the_same_bytes(tmp_path):
    check(tmp_path, 1, 1)


@pytest.mark.full
def test_commands_killed_often_give_the_same_bytes(tmp_path):
    check(tmp_path, 20, 2)
