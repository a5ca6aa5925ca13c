"""Our own files damaged at random, through each command that reads them."""

import pytest

from tests.fuzz.mishap import Mishap
from tests.fuzz.own import KINDS, Answer, Own, check, sweep


def test_another_answer_without_a_word_and_a_traceback_are_found(tmp_path):
    answers = {
        "silent": lambda path: Answer(0, False, "", path.read_bytes()),
        "told": lambda path: Answer(4, True, "LOST", path.read_bytes()),
        "same": lambda path: Answer(0, False, "", b"sound"),
        "traceback": lambda path: 1 / 0,
    }
    (tmp_path / "file").write_bytes(b"sound")
    own, sound = Own("file", tmp_path / "file", answers), Answer(0, False, "", b"sound")
    wrong = [name for name in answers if check(own, name, sound, Mishap("cut", b"sou", ()))]
    assert wrong == ["silent", "traceback"]


@pytest.mark.filterwarnings("default")
def test_damages_of_each_of_our_own_files(tmp_path):
    """Ten of each through the quick readers; 2,000 of each through all are marked full."""
    assert [words for words in sweep(10, 3, tmp_path, 0) if words] == []


@pytest.mark.full
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("kind", KINDS)
def test_two_thousand_damages_of_each_of_our_own_files(tmp_path, kind):
    assert [words for words in sweep(2000, 1, tmp_path, 10, (kind,)) if words] == []
