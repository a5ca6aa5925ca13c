"""A fixed small sample of ``python -m tests.fuzz``."""

import pytest

from tests.fuzz import damage
from tests.fuzz.subjects import damaged, of_file, subjects, sweep
from tests.logs.log_samples import tlog

FILES = damage.logs()
SAMPLES = [file for file in FILES if file.parent.name == "sample_logs"]


def wrong(file, count, folder):
    subject = of_file(file)
    return [words for number in range(count) for words in damaged(subject, number, 1, folder)]


@pytest.mark.parametrize("file", SAMPLES, ids=lambda file: file.name)
def test_a_damaged_sample_gives_what_is_whole(file, tmp_path):
    assert wrong(file, 8, tmp_path) == []


@pytest.mark.skipif(len(FILES) < 100, reason="no shared logs here")
def test_damaged_shared_logs_give_what_is_whole(tmp_path):
    some = [file for file in FILES if file.suffix == ".BIN"] + FILES[:: len(FILES) // 24]
    assert [words for file in some for words in wrong(file, 4, tmp_path)] == []


def test_the_oracle_takes_no_frame_whose_message_it_does_not_know():
    """Its checksum says nothing, and the bytes that it claims may hold known ones."""
    entry = tlog(1)[0]
    at = entry.index(0xFE) + 5
    assert [piece for _, _, piece in damage.frames(entry)] == [entry[8:]]
    assert damage.frames(entry[:at] + bytes([255]) + entry[at + 1 :]) == []


def test_random_damages_of_every_format(tmp_path):
    """A share of ``python -m tests.fuzz damage --count N``; NetCDF-4 is left to it, as the library that reads it may hang."""
    names = [subject.name for subject in subjects(tmp_path) if subject.name != "netcdf"]
    # these take milliseconds
    logs = [name for name in names if name.startswith(("mcap", "tlog", "dataflash"))]
    for some, count in ((names, 2), (logs, 80)):
        assert [wrong for _, wrong in sweep(count * len(some), 3, tmp_path, some) if wrong] == []
