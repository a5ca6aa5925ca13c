"""A fixed small sample of ``python -m tests.fuzz``."""

import pytest

from tests.fuzz.damage import damage, logs

FILES = logs()


@pytest.mark.parametrize("file", [f for f in FILES if f.parent.name == "sample_logs"], ids=lambda file: file.name)
def test_a_damaged_sample_gives_what_is_whole_before_the_damage(file):
    assert damage(file, 8) == []


@pytest.mark.skipif(len(FILES) < 100, reason="the shared logs are not on this machine")
def test_damaged_shared_logs_give_what_is_whole_before_the_damage():
    for file in FILES[:: len(FILES) // 24]:
        assert damage(file, 4) == [], file
