"""Short texts of values, and times."""

from dataclasses import replace
from datetime import UTC, date, datetime

import numpy as np
import pandas as pd
import pytest

from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Innovation, PathMean, Source
from replay_kit.core.quantities import to_time_ns
from replay_kit.core.text import count_text, csv_cell, place_text, some_text, span_text, time_text
from tests.synthetic_flow import TIME_NS

SOURCE = Source(0, "/adcp", 1, TIME_NS)


def test_times_are_to_the_second():
    assert time_text(TIME_NS) == "2023-11-14 22:13:20Z"
    assert time_text(0) == "1970-01-01 00:00:00Z"
    assert time_text(10**9 - 1) == "1970-01-01 00:00:00Z"
    assert time_text(None) == "no time"


def test_spans_leave_out_what_is_no_number():
    assert span_text([3.0, np.nan, -0.123456, np.inf]) == "-0.1235..3"
    assert span_text([3.0, -0.123456], 2) == "-0.12..3"
    assert span_text([5.00001, 5.0]) == "5"
    assert span_text([]) == span_text([np.nan]) == "unknown"


def test_places_have_letters_for_signs():
    assert place_text(-61.8, 16.1) == "61.8000 W, 16.1000 N"
    assert place_text(152.61236, -40.0) == "152.6124 E, 40.0000 S"
    assert place_text(0.0, 0.0) == "0.0000 E, 0.0000 N"


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        (5, 5),
        ("1970-01-02", 86_400 * 10**9),
        ("1970-01-01T02:00:00+02:00", 0),
        (np.datetime64("1970-01-01T00:00:01"), 10**9),
        (datetime(1970, 1, 1, 0, 0, 2, tzinfo=UTC), 2 * 10**9),
        (date(1970, 1, 2), 86_400 * 10**9),
        (pd.Timestamp(TIME_NS), TIME_NS),
        ([["1970-01-01", "1970-01-02"]], [[0, 86_400 * 10**9]]),
        (pd.DatetimeIndex([TIME_NS, TIME_NS + 1]), [TIME_NS, TIME_NS + 1]),
        (pd.DatetimeIndex([TIME_NS, TIME_NS + 1]).tz_localize("UTC"), [TIME_NS, TIME_NS + 1]),
        (np.array([7, 8], dtype=np.uint32), [7, 8]),
        ([], []),
    ],
)
def test_times_of_notebooks(time, expected):
    got = to_time_ns(time)
    assert got.dtype == np.int64
    assert got.tolist() == expected


def test_what_is_no_time_is_named():
    with pytest.raises(
        ConfigError,
        match=r"time: expected ISO 8601 text, datetime64 or integer nanoseconds .* got a missing time \(NaT\)",
    ):
        to_time_ns(np.array(["1970-01-01", "NaT"], dtype="datetime64[ns]"))
    with pytest.raises(ConfigError, match=r"got 1\.5"):
        to_time_ns(1.5)


@pytest.mark.parametrize(
    "time",
    [
        np.datetime64("1969-12-31T23:59:59", "ns"),
        np.array(["2018-11-16", "1850-01-01"], "datetime64[D]"),
        np.datetime64("2300-01-01", "s"),
        "1969-12-31T23:59:59",
        -1,
        np.array([1, 2**63], np.uint64),
    ],
)
def test_a_time_that_nanoseconds_since_1970_cannot_hold_is_refused_in_every_form(time):
    with pytest.raises(ConfigError, match=r"is outside 1970\.\.2262; write a time of the mission"):
        to_time_ns(time)


def test_measurements_say_what_they_are():
    depth, twice = np.array([0.0, 300.0]), np.array([0.5, 0.5])
    path = PathMean(
        TIME_NS,
        np.array([0, 1]),
        twice,
        twice,
        depth,
        twice,
        (0.1234, -0.05),
        0.02,
        "dac",
        7,
        SOURCE,
    )
    assert repr(path).splitlines() == [
        "PathMean (dac) 2023-11-14 22:13:20Z, dive 7: 2 points, 0..300 m deep",
        "  u 0.123, v -0.050 +- 0.020 m/s (true axes)",
    ]
    misfit = np.array([[0.3, np.nan], [-0.4, np.nan]])
    innovation = Innovation(
        TIME_NS, np.array([10.0, 20.0]), misfit, misfit, misfit / 2.0, misfit, 3.21, 2, True, 1.0, np.array([1, 1], dtype=np.int8),
        np.array([0, 0], dtype=np.int32), 7, SOURCE,
    )  # fmt: skip
    assert repr(innovation).splitlines() == [
        "Innovation 2023-11-14 22:13:20Z, dive 7: accepted, 2 bins, 10..20 m deep",
        "  RMS 0.354 m/s before and 0.177 m/s after the update, NIS 3.2 of 2 degrees of freedom",
    ]
    unused = replace(
        innovation, innovation=misfit * np.nan, residual=misfit * np.nan, decision="unusable"
    )
    assert "unusable" in repr(unused)
    assert "RMS - m/s before and - m/s after" in repr(unused)


def test_numbers_of_things():
    assert [count_text(n, "file") for n in (0, 1, 2)] == ["0 files", "1 file", "2 files"]


def test_long_lists_end_with_how_many_more_there_are():
    assert some_text(list("abcdef")) == "a, b, c, d, e, f"
    assert some_text(list("abcdefgh")) == "a, b, c, d, e, f and 2 more"
    assert some_text(list("abc"), 1) == "a and 2 more"
    assert some_text([]) == ""


@pytest.mark.parametrize(
    "begins", ["=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20"]
)
def test_a_text_that_a_spreadsheet_would_run_begins_with_an_apostrophe(begins):
    assert csv_cell(f"{begins}1+1") == f"'{begins}1+1"
    assert csv_cell(f"1{begins}1") == f"1{begins}1"


@pytest.mark.parametrize("value", [-1, -1.5, True, None, "", "/adcp", "'=1"])
def test_other_values_of_a_csv_file_are_as_they_are(value):
    assert csv_cell(value) is value
