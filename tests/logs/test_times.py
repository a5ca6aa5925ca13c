"""Times that no mission has are named, with the clock or the unit that would be plausible."""

import pytest

from replay_kit.logs.shared.times import doubtful_times
from tests.command import run_command
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping

DAY = 86_400 * 10**9
STAMP = 1_542_330_000 * 10**9
NOW = STAMP + 3000 * DAY


def _stamped(time_ns, stamp_ns):
    return time_ns, {"stamp": {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}}


@pytest.mark.parametrize(
    ("time_ns", "words"),
    [
        (STAMP, ""),
        (STAMP + 300 * DAY, ""),
        (STAMP // 10**6, "before 1990; by the stamps in the messages it is 2018-11-16"),
        (STAMP // 10**3, "before 1990; by the stamps"),
        (STAMP + 4000 * DAY, "yet to come; by the stamps in the messages it is 2018-11-16"),
        (STAMP + 1500 * DAY, "1500 days after the stamps in its messages"),
    ],
)
def test_times_are_held_against_the_stamps_in_messages(time_ns, words):
    said = doubtful_times((time_ns, time_ns + 10**9), [_stamped(time_ns, STAMP)], NOW)
    assert words in said
    assert bool(said) == bool(words)
    assert ("--clock header" in said) == bool(words)


@pytest.mark.parametrize(
    ("divisor", "unit"), [(10**3, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds")]
)
def test_without_stamps_the_unit_is_named_that_would_be_plausible(divisor, unit):
    said = doubtful_times((STAMP // divisor, STAMP // divisor), [(0, {"x": 1.0})], NOW)
    assert f"as if {unit} were taken for nanoseconds: that would be 2018-11-16" in said
    assert "check the clock" in doubtful_times((5 * DAY, 6 * DAY), [], NOW)
    # what a run says must not depend on the day of the run
    assert doubtful_times((STAMP, STAMP + 10**4 * DAY), [], None) == ""


@pytest.mark.parametrize("command", ["info", "info --full"])
def test_info_names_log_times_in_milliseconds(tmp_path, command):
    stamp = {"stamp": {"sec": 1_542_330_000, "nsec": 0}}
    place = fix(0)
    rows = [(1542.33, place.topic, place.schema, place.payload | stamp)]
    rows += [(1542.33, "/adcp", "replay_kit.AdcpPing", ping(0).payload | stamp)]
    (tmp_path / "log.mcap").write_bytes(json_mcap(rows))
    done = run_command(tmp_path, [*command.split(), "log.mcap"])
    assert "the log begins 1970-01-01 00:25:42Z, before 1990" in done.stdout
    assert "2018-11-16 01:00:00Z: --clock header reads these" in done.stdout
    done = run_command(tmp_path, [*command.split(), "log.mcap", "--clock", "header"])
    assert "1990" not in done.stdout
