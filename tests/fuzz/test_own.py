"""Our own files damaged at random, through each command that reads them."""

import pytest

from tests.fuzz.mishap import Mishap
from tests.fuzz.own import KINDS, Answer, Own, check, sweep


def test_another_answer_without_a_word_a_traceback_and_an_error_without_the_file_are_found(
    tmp_path,
):
    answers = {
        "silent": lambda path: Answer(0, False, "", path.read_bytes()),
        "told": lambda path: Answer(4, True, "LOST", path.read_bytes()),
        "same": lambda path: Answer(0, False, "", b"sound"),
        "traceback": lambda path: 1 / 0,
    }
    own = Own("file", b"sound", tmp_path / "file", answers)
    own.path.write_bytes(own.data)
    for name in answers:
        ended, words = check(own, name, Answer(0, False, "", b"sound"), Mishap("cut", b"sou", ()))
        assert ended == name
        assert bool(words) == (name in ("silent", "traceback"))


@pytest.mark.filterwarnings("default")
def test_damages_of_each_of_our_own_files(tmp_path):
    """Ten of each through the quick readers; 2,000 of each through all are marked full."""
    assert [words for words in sweep(10, 3, tmp_path, 0) if words] == []


@pytest.mark.full
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("kind", KINDS)
def test_two_thousand_damages_of_each_of_our_own_files(tmp_path, kind):
    assert [words for words in sweep(2000, 1, tmp_path, 10, (kind,)) if words] == []
