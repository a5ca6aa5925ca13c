"""A vehicle's clock fitted to UTC: right although stamps are late or wrong; times that no mission has are named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.logs.mavlink.fit import fit_clock, gps_to_utc, without_spikes
from tests.command import run_command
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping

UTC = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def ns(iso):
    return int(np.datetime64(iso, "ns").astype(np.int64))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    drift_ppm=st.floats(-200.0, 200.0),
    wrong=st.lists(st.integers(0, 299), max_size=60),
    seed=st.integers(0, 99),
)
def test_drift_and_offset_although_a_fifth_is_wrong(drift_ppm, wrong, seed):
    rng = np.random.default_rng(seed)
    boot = np.sort(rng.integers(0, 3600 * SECOND, 300))
    true = UTC + boot + np.rint(1e-6 * drift_ppm * boot).astype(np.int64)
    stated = true + rng.normal(0.0, 1e6, 300).astype(np.int64)
    stated[wrong] = rng.integers(0, 2 * UTC, len(wrong))
    fit = fit_clock(boot, stated)
    # a fifth of gross errors moves a median of 1 ms noise by a third of that at most; the ends of the hour are half of it from its middle
    assert np.abs(fit.utc(boot) - true).max() < 2_000_000
    assert fit.outliers >= len(set(wrong))
    assert fit.residual_std < 2e-3


def test_a_short_log_takes_no_drift():
    boot = np.arange(0, 60) * SECOND
    fit = fit_clock(boot, UTC + boot + boot // 20_000)
    assert fit.drift == 0.0
    # a ramp of 2.95 ms
    assert fit.residual_std == pytest.approx(2.95e-3 / np.sqrt(12.0), rel=0.02)


@pytest.mark.parametrize(
    ("week", "week_ms", "utc"),
    [
        (2300, 300_018_000, "2024-02-07T11:20:00"),
        (1930, 18_000, "2017-01-01T00:00:00"),
        (1929, 604_800_000 + 16_000, "2016-12-31T23:59:59"),
        (1512, 14_000, "2008-12-28T00:00:00"),
        (0, 0, "1980-01-06T00:00:00"),
    ],
)
def test_gps_time(week, week_ms, utc):
    assert gps_to_utc(np.array([week]), np.array([week_ms])).tolist() == [ns(utc)]


FAR, MINUTE = 2**40, 60_000_000


@pytest.mark.parametrize(
    ("stamps", "before", "expected"),
    [
        ([0, 1, FAR, 3], 0, [0, 1, 3, 3]),
        ([FAR, 1, 2, 3], None, [1, 1, 2, 3]),
        ([5, FAR, FAR + 1, FAR + 2], 4, None),
        ([FAR, FAR + 1, 3, FAR + 2], FAR, [FAR, FAR + 1, FAR + 2, FAR + 2]),
        ([0, 9_000_000, 1], 0, None),
        ([0, MINUTE, 2 * MINUTE, 3 * MINUTE], 0, None),
        ([0, FAR], 0, None),
    ],
)
def test_a_stamp_alone_far_from_its_neighbours(stamps, before, expected):
    steady, spikes = without_spikes(np.array(stamps), before)
    assert (steady.tolist(), spikes) == (expected or stamps, int(expected is not None))


DAY = 86_400
STAMP = 1_542_330_000
READS = "2018-11-16 01:00:00Z: --clock header reads these"


@pytest.mark.parametrize(
    ("time", "stamp", "words"),
    [
        (STAMP, STAMP, ()),
        (STAMP + 300 * DAY, STAMP, ()),
        (STAMP / 1e6, STAMP, ("begins 1970-01-01 00:25:42Z, before 1990; by the stamps", READS)),
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
        assert ("--clock header -o" in said) == (READS in said)
        assert ("the log begins" in said or "the log ends" in said) == bool(words)
    if READS in words:
        assert "the log " not in run_command(tmp_path, "info log.mcap --clock header").stdout
