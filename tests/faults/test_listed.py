"""Every named fault is still one of the code: its text occurs once, and what it becomes is Python."""

import ast
from collections import Counter

import pytest

from tests.faults.listed import ROOT, faults


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: fault.name)
def test_a_fault_moves_with_the_code(fault):
    sound = (ROOT / fault.file).read_text()
    assert sound.count(fault.text) == 1
    assert ast.dump(ast.parse(fault.planted(sound))) != ast.dump(ast.parse(sound))


def test_every_room_has_five_faults_or_more_and_no_name_is_twice():
    assert min(Counter(fault.room for fault in faults()).values()) >= 5
    assert max(Counter(fault.name for fault in faults()).values()) == 1
