"""Every named fault is still one of the code: its text occurs once, and what it becomes is Python."""

import ast
from collections import Counter
from functools import cache

import pytest

from tests.faults.listed import ROOT, faults


@cache
def read(file):
    text = (ROOT / file).read_text()
    return text, ast.dump(ast.parse(text))


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: fault.name)
def test_a_fault_moves_with_the_code(fault):
    sound, dumped = read(fault.file)
    assert sound.count(fault.text) == 1
    assert ast.dump(ast.parse(fault.planted(sound))) != dumped


def test_every_room_has_five_faults_or_more_and_no_name_is_twice():
    assert min(Counter(fault.room for fault in faults()).values()) >= 5
    assert max(Counter(fault.name for fault in faults()).values()) == 1
