"""Short texts of values, times as notebooks have them, and values changed."""

import dataclasses
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime

import numpy as np
import pandas as pd
import pytest

from replay_kit.core import arrays
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Innovation, PathMean, Source
from replay_kit.core.words.quantities import to_time_ns
from replay_kit.core.words.text import (
    count_text,
    csv_cell,
    place_text,
    some_text,
    span_text,
    time_text,
)
from tests.synthetic_flow import TIME_NS

SOURCE = Source(0, "/adcp", 1, TIME_NS)


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (time_text(TIME_NS), "2023-11-14 22:13:20Z"),
        (time_text(None), "no time"),
        (span_text([3.0, np.nan, -0.123456, np.inf]), "-0.1235..3"),
        (span_text([3.0, -0.123456], 2), "-0.12..3"),
        (span_text([5.00001, 5.0]), "5"),
        (span_text([]), "unknown"),
        (place_text(-61.8, 16.1), "61.8000 W, 16.1000 N"),
        (place_text(152.61236, -40.0), "152.6124 E, 40.0000 S"),
        (count_text(2, "file"), "2 files"),
        (count_text(1, "file"), "1 file"),
        (some_text("abcdef"), "a, b, c, d, e, f"),
        (some_text("abc", 1), "a and 2 more"),
    ],
)
def test_values_as_text(found, text):
    assert found == text


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
        (pd.DatetimeIndex([TIME_NS, TIME_NS + 1]).tz_localize("UTC"), [TIME_NS, TIME_NS + 1]),
        (np.array([7, 8], dtype=np.uint32), [7, 8]),
        ([], []),
    ],
)
def test_times_of_notebooks(time, expected):
    got = to_time_ns(time)
    assert (got.dtype, got.tolist()) == (np.int64, expected)


def test_what_is_no_time_is_named():
    expected = "time: expected ISO 8601 text, datetime64 or integer nanoseconds .* got "
    with pytest.raises(ConfigError, match=expected + r"a missing time \(NaT\)"):
        to_time_ns(np.array(["1970-01-01", "NaT"], dtype="datetime64[ns]"))
    with pytest.raises(ConfigError, match=r"got 1\.5"):
        to_time_ns(1.5)


def test_measurements_say_what_they_are():
    two, depth, when = np.full(2, 0.5), np.array([0.0, 300.0]), np.array([0, 1])
    path = PathMean(TIME_NS, when, two, two, depth, two, (0.1234, -0.05), 0.02, "dac", 7, SOURCE)
    assert repr(path).splitlines() == [
        "PathMean (dac) 2023-11-14 22:13:20Z, dive 7: 2 points, 0..300 m deep",
        "  u 0.123, v -0.050 +- 0.020 m/s (true axes)",
    ]
    off, flags = np.array([[0.3, np.nan], [-0.4, np.nan]]), np.ones(2, np.int8)
    rest = (off, off, off / 2.0, off, 3.21, 2, True, 1.0, flags, np.zeros(2, np.int32), 7, SOURCE)
    innovation = Innovation(TIME_NS, np.array([10.0, 20.0]), *rest)
    assert repr(innovation).splitlines() == [
        "Innovation 2023-11-14 22:13:20Z, dive 7: accepted, 2 bins, 10..20 m deep",
        "  RMS 0.354 m/s before and 0.177 m/s after the update, NIS 3.2 of 2 degrees of freedom",
    ]
    assert "RMS - m/s before" in repr(replace(innovation, innovation=off * np.nan))


def test_a_text_that_a_spreadsheet_would_run_begins_with_an_apostrophe():
    for begins in "=+-@\t\r\n\uff1d\uff0b\uff0d\uff20":
        assert csv_cell(f"{begins}1+1") == f"'{begins}1+1"
        assert csv_cell(f"1{begins}1") == f"1{begins}1"
    for value in (-1, -1.5, True, None, "", "/adcp", "'=1"):
        assert csv_cell(value) is value


@dataclass(frozen=True, slots=True)
class Checked:
    """A value that is refused."""

    low: float = 1.0
    high: float = 2.0

    def __post_init__(self) -> None:
        """Raise ValueError where the limits are exchanged."""
        if self.low > self.high:
            raise ValueError("low > high")


def test_values_changed_are_those_of_the_standard_library():
    before = Checked()
    assert (arrays.replace(before, high=3.0), before) == (Checked(1.0, 3.0), Checked())
    with pytest.raises(ValueError, match="low"):
        arrays.replace(before, high=0.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        arrays.replace(before, high=3.0).low = 2.0
    with pytest.raises((AttributeError, TypeError)):
        arrays.replace(before, middle=1.0)


@pytest.mark.parametrize("in_memory", [0, 1 << 30], ids=["on disk", "in memory"])
def test_parts_taken_one_by_one_are_those_of_the_array_and_what_is_written_stays(
    monkeypatch, in_memory
):
    monkeypatch.setattr(arrays, "IN_MEMORY", in_memory)
    array = arrays.large_array((3, 600, 2), np.dtype(float))
    array[:] = whole = np.arange(array.size).reshape(array.shape)
    for part, expected in zip(arrays.one_by_one(array), whole, strict=True):
        assert np.array_equal(part, expected)
        part[0] = -1.0
    assert np.all(array[:, 0] == -1.0)
