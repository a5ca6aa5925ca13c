"""Times that no mission has are named, with the clock or the unit that would be plausible."""

import pytest

from tests.command import run_command
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping

DAY = 86_400
STAMP = 1_542_330_000
READS = "2018-11-16 01:00:00Z: --clock header reads these"


@pytest.mark.parametrize(
    ("time", "stamp", "words"),
    [
        (STAMP, STAMP, ()),
        (STAMP + 300 * DAY, STAMP, ()),
        (STAMP / 1e6, STAMP, ("begins 1970-01-01 00:25:42Z, before 1990; by the stamps", READS)),
        (STAMP / 1e3, STAMP, ("before 1990; by the stamps", READS)),
        (STAMP + 40_000 * DAY, STAMP, ("in the future; by the stamps", READS)),
        (STAMP + 1500 * DAY, STAMP, ("1500 days after the stamps in its messages",)),
        (STAMP / 1e3, 0, ("as if microseconds were taken for", "would be 2018-11-16")),
        (STAMP / 1e6, 0, ("as if milliseconds were taken for", "would be 2018-11-16")),
        (STAMP / 1e9, 0, ("as if seconds were taken for nanoseconds", "would be 2018-11-16")),
        (5 * DAY, 0, ("check the clock",)),
    ],
)
def test_info_names_times_that_no_mission_has(tmp_path, time, stamp, words):
    about = {"stamp": {"sec": stamp, "nsec": 0}}
    place = fix(0)
    rows = [(time, place.topic, place.schema, place.payload | about)]
    rows += [(time, "/adcp", "replay_kit.AdcpPing", ping(0).payload | about)]
    (tmp_path / "log.mcap").write_bytes(json_mcap(rows))
    for command in ("info log.mcap", "info log.mcap --full"):
        said = run_command(tmp_path, command).stdout
        assert all(each in said for each in words)
        assert ("the log begins" in said or "the log ends" in said) == bool(words)
    if READS in words:
        assert "the log " not in run_command(tmp_path, "info log.mcap --clock header").stdout
