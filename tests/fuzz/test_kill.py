"""Signals at random instants to the commands that write."""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

if sys.platform == "win32":
    pytest.skip("SIGKILL is POSIX", allow_module_level=True)

from tests.fuzz.kill import KINDS, SIGNALS, kill, make_inputs


@pytest.mark.full
@pytest.mark.parametrize("sent", SIGNALS, ids=lambda sent: sent.name)
@pytest.mark.parametrize("kind", KINDS)
def test_a_command_that_gets_a_signal_leaves_the_same_bytes(tmp_path, kind, sent):
    # forks of a process in which other tests ran a scheduler wait for its threads, which they do not have
    with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
        fresh.submit(make_inputs, tmp_path).result()
        count = 1 if "fleet" in kind else 5
        assert fresh.submit(kill, kind, tmp_path, count, 1, sent).result() == []
