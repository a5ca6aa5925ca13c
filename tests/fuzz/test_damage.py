"""A fixed small sample of ``python -m tests.fuzz``."""

import pytest

from tests.fuzz import damage_vehicle
from tests.fuzz.damage import ROOT, damage, logs
from tests.fuzz.subjects import subjects, sweep
from tests.logs.log_samples import tlog

FILES = logs()


@pytest.mark.parametrize(
    "file", [f for f in FILES if f.parent.name == "sample_logs"], ids=lambda file: file.name
)
def test_a_damaged_sample_gives_what_is_whole_before_the_damage(file):
    assert damage(file, 8) == []


@pytest.mark.skipif(len(FILES) < 100, reason="the shared logs are not on this machine")
def test_damaged_shared_logs_give_what_is_whole_before_the_damage():
    for file in FILES[:: len(FILES) // 24]:
        assert damage(file, 4) == [], file


def test_a_damaged_telemetry_log_gives_what_is_whole():
    assert damage_vehicle.damage(ROOT / "sample_logs" / "glider.tlog", 4) == []


def test_the_oracle_takes_no_frame_whose_message_it_does_not_know():
    """Its checksum says nothing, and the bytes that it claims may hold known ones."""
    entry = tlog(1)[0]
    at = entry.index(0xFE) + 5
    assert [piece for _, _, piece in damage_vehicle.frames(entry)] == [entry[8:]]
    assert damage_vehicle.frames(entry[:at] + bytes([255]) + entry[at + 1 :]) == []


@pytest.mark.skipif(
    not any(file.suffix == ".BIN" for file in damage_vehicle.logs()),
    reason="the shared logs are not on this machine",
)
def test_a_damaged_dataflash_log_gives_what_is_whole_before_the_damage():
    (file,) = (file for file in damage_vehicle.logs() if file.suffix == ".BIN")
    assert damage_vehicle.damage(file, 6) == []


def test_random_damages_of_every_format(tmp_path):
    """A share of ``python -m tests.fuzz damage --count N``; NetCDF-4 is left to it, as the library that reads it may hang."""
    names = [subject.name for subject in subjects(tmp_path) if subject.name != "netcdf"]
    assert [wrong for _, wrong in sweep(2 * len(names), 3, tmp_path, names) if wrong] == []
