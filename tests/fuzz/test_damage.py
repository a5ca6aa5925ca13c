"""Logs and other inputs damaged at random; ``FUZZ_SEED`` is the seed of places and sizes."""

import os
import resource

import pytest

from replay_kit.logs import FORMATS
from tests.fuzz import damage
from tests.fuzz.subjects import damaged, of_file, subjects, sweep
from tests.logs.log_samples import tlog

SEED = int(os.environ.get("FUZZ_SEED", "3"))
#: More memory than this means that something was allocated on a damaged file's word [kB].
MOST = 300_000
FILES = damage.logs()
SAMPLES = [file for file in FILES if file.parent.name == "sample_logs"]


@pytest.fixture(autouse=True)
def small():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST


def wrong(file, count, folder):
    subject = of_file(file)
    return [words for number in range(count) for words in damaged(subject, number, SEED, folder)]


@pytest.mark.parametrize("file", SAMPLES, ids=lambda file: file.name)
def test_a_damaged_sample_gives_what_is_whole(file, tmp_path):
    assert wrong(file, 8, tmp_path) == []


@pytest.mark.skipif(len(FILES) < 100, reason="no shared logs here")
@pytest.mark.parametrize(
    ("every", "count"), [(len(FILES) // 24, 4), pytest.param(1, 128, marks=pytest.mark.full)]
)
def test_damaged_shared_logs_give_what_is_whole(tmp_path, every, count):
    some = [file for file in FILES if file.suffix == ".BIN"] + FILES[::every]
    assert [words for file in some for words in wrong(file, count, tmp_path)] == []


def test_the_oracle_takes_no_frame_whose_message_it_does_not_know():
    """Its checksum says nothing, and the bytes that it claims may hold known ones."""
    entry = tlog(1)[0]
    at = entry.index(0xFE) + 5
    assert [piece for _, _, piece in damage.frames(entry)] == [entry[8:]]
    assert damage.frames(entry[:at] + bytes([255]) + entry[at + 1 :]) == []


OTHERS = ("areas", "toml", "bathymetry", "zarr")


def test_every_format_is_damaged(tmp_path):
    assert {subject.format for subject in subjects(tmp_path)} == {
        *(form.name for form in FORMATS),
        *OTHERS,
    }


@pytest.mark.parametrize("name", [form.name for form in FORMATS])
@pytest.mark.parametrize(
    ("count", "more"), [(67, 0), (67, 1), (66, 2), pytest.param(5000, 0, marks=pytest.mark.full)]
)
def test_random_damages_of_every_format(name, count, more, tmp_path):
    found = sweep(count, SEED + more, tmp_path, (name,))
    assert [wrong for _, wrong in found if wrong] == []


@pytest.mark.parametrize("name", OTHERS)
# HDF5 never returns from the 512th bathymetry, a limit that SECURITY.md states
@pytest.mark.parametrize("count", [10, pytest.param(500, marks=pytest.mark.full)])
def test_random_damages_of_other_inputs(name, count, tmp_path):
    assert [wrong for _, wrong in sweep(count, SEED, tmp_path, (name,)) if wrong] == []
