"""Words, units and times of values, stages announced, and values changed."""

import dataclasses
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime

import numpy as np
import pandas as pd
import pytest

from replay_kit.core import arrays
from replay_kit.core.observation import Innovation, PathMean, Source, reasons_of
from replay_kit.core.words import quantities
from replay_kit.core.words.progress import announce, called_by, each_call, shown_by, step_counter
from replay_kit.core.words.text import csv_cell, place_text, some_text, span_text, time_text
from tests.synthetic_flow import TIME_NS

SOURCE = Source(0, "/adcp", 1, TIME_NS)


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (time_text(TIME_NS), "2023-11-14 22:13:20Z"),
        (time_text(None), "no time"),
        (span_text([3.0, np.nan, -0.123456, np.inf], 2), "-0.12..3"),
        (span_text([5.00001, 5.0]), "5"),
        (span_text([]), "unknown"),
        (place_text(-61.8, 16.1), "61.8000 W, 16.1000 N"),
        (place_text(152.61236, -40.0), "152.6124 E, 40.0000 S"),
        (some_text("abcdef"), "a, b, c, d, e, f"),
        (some_text("abc", 1), "a and 2 more"),
        # a bin below the grid that has no value
        (reasons_of(np.array([5]), np.array([9])), [("missing", 1)]),
    ],
)
def test_values_as_text(found, text):
    assert found == text


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        (5, 5),
        ("1970-01-01T02:00:00+02:00", 0),
        (np.datetime64("1970-01-01T00:00:01"), 10**9),
        (datetime(1970, 1, 1, 0, 0, 2, tzinfo=UTC), 2 * 10**9),
        (date(1970, 1, 2), 86_400 * 10**9),
        (pd.Timestamp(TIME_NS, tz="Europe/Oslo"), TIME_NS),
        ([["1970-01-01", "1970-01-02"]], [[0, 86_400 * 10**9]]),
        (pd.DatetimeIndex([TIME_NS, TIME_NS + 1]).tz_localize("UTC"), [TIME_NS, TIME_NS + 1]),
        ([], []),
    ],
)
def test_times_of_notebooks(time, expected):
    got = quantities.to_time_ns(time)
    assert (got.dtype, got.tolist()) == (np.int64, expected)


KNOWN = [
    ("metres", 1.0, "m|meter|meters|metre|Metres"),
    ("metres", 0.01, "cm|centimeters"),
    ("metres", 0.3048, "ft|foot|feet"),
    ("metres", None, "|M|K|ms|fathoms|m s-1|degrees"),
    ("seconds", 1.0, "s|sec|secs|second|seconds"),
    ("seconds", 3600.0, "h|hr|hrs|hours|Hour"),
    ("seconds", 86_400.0, "d|day|days"),
    ("seconds", 1e-3, "ms|msec|milliseconds"),
    ("seconds", 1e-9, "ns|nanoseconds"),
    ("seconds", None, "|month|years|m"),
    ("metres_per_second", 1.0, "m s-1|m/s|m/sec|m.s-1|m s^-1|m s**-1|meter/s|metre s-1"),
    ("metres_per_second", 1.0, "meter second^-1|meters/second|meters per second|meters s-1"),
    ("metres_per_second", 0.01, "cm s-1|cm/s|cm/sec|cm.s-1|centimeter/s|centimeters/second"),
    ("metres_per_second", 1852.0 / 3600.0, "knots|kt"),
    ("metres_per_second", None, "|m|s-1|m s-2|m/min|furlong/s"),
    ("decibars", 1.0, "dbar|decibars"),
    ("decibars", 1e-4, "Pa"),
    ("decibars", None, "|m|barn"),
]


@pytest.mark.parametrize(("of", "value", "names"), KNOWN)
def test_names_of_a_unit(of, value, names):
    assert {getattr(quantities, of)(name) for name in names.split("|")} == {value}


def test_measurements_say_what_they_are():
    two, depth, when = np.full(2, 0.5), np.array([0.0, 300.0]), np.array([0, 1])
    path = PathMean(TIME_NS, when, two, two, depth, two, (0.1234, -0.05), 0.02, "dac", 7, SOURCE)
    words = "2 points, 0..300 m deep\n  u 0.123, v -0.050 +- 0.020 m/s (true axes)"
    assert repr(path).endswith(words)
    off, flags = np.array([[0.3, np.nan], [-0.4, np.nan]]), np.ones(2, np.int8)
    rest = (off, off, off / 2.0, off, 3.21, 2, True, 1.0, flags, np.zeros(2, np.int32), 7, SOURCE)
    innovation = Innovation(TIME_NS, np.array([10.0, 20.0]), *rest)
    assert "dive 7: accepted, 2 bins, 10..20 m deep" in repr(innovation)
    assert "RMS 0.354 m/s before and 0.177 m/s after the update, NIS 3.2 of 2" in repr(innovation)
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

    high: float = 2.0

    def __post_init__(self):
        """Raise ValueError where the limit is too low."""
        if self.high < 1.0:
            raise ValueError("low")


def test_values_changed_are_those_of_the_standard_library():
    changed = arrays.replace(SOURCE, time_ns=0)
    assert changed == dataclasses.replace(SOURCE, time_ns=0) != SOURCE
    with pytest.raises(dataclasses.FrozenInstanceError):
        changed.time_ns = 2
    with pytest.raises(ValueError, match="low"):
        arrays.replace(Checked(), high=0.0)
    with pytest.raises((AttributeError, TypeError)):
        arrays.replace(SOURCE, middle=1.0)


def test_what_is_announced_goes_to_whoever_shows_it_and_to_nobody_else():
    outer, inner = [], []
    with shown_by(lambda *told: outer.append(told)):
        announce("one")
        with shown_by(lambda *told: inner.append(told)):
            announce("two", 1, 3)
        advance = step_counter("three", 1)
        advance()
    announce("nobody looks")
    assert (outer, inner) == ([(0, 0, "one"), (1, 1, "three")], [(1, 3, "two")])


def test_calls_are_made_one_by_one_or_by_whoever_is_given_them_in_the_block_alone():
    with called_by(lambda function, rows: iter([function, *rows])):
        assert list(each_call(abs, [(-1,)])) == [abs, (-1,)]
    made = []
    values = each_call(lambda a, b: made.append(a) or a + b, ((a, 10) for a in (1, 2, 3)))
    assert not made
    assert next(values) == 11
    assert made == [1]
    assert list(values) == [12, 13]
