"""Units, times and flags of glider files: each conversion exactly, and what is said of it."""

from typing import Any

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs.netcdf import quality, units
from replay_kit.logs.netcdf.variables import Stored

FILE = "a.nc"


def _stored(values, **attributes: Any):
    return Stored(np.asarray(values), attributes)


@pytest.mark.parametrize(
    ("unit", "quantity", "value", "expected", "note"),
    [
        ("m s-1", "east", 0.5, 0.5, None),
        ("cm/s", "east", 50.0, 0.5, "x: converted from cm/s to m/s"),
        ("knots", "east", 1.0, 1852.0 / 3600.0, "x: converted from knots to m/s"),
        ("Pa", "pressure", 1e6, 100.0, "x: converted from Pa to dbar"),
        ("rad", "heading", np.pi, 180.0, "x: converted from rad to degrees"),
        ("cm", "depth", 250.0, 2.5, "x: converted from cm to m"),
        ("furlong", "depth", 2.0, 2.0, "x: unit 'furlong' is not known, taken as m"),
        ("", "east", 0.25, 0.25, "x: states no unit, taken as m/s"),
        ("1", "dive", 7.0, 7.0, None),
    ],
)
def test_units(unit, quantity, value, expected, note):
    notes: list[str] = []
    (found,) = units.in_si("x", _stored([value], units=unit), units.quantity_of(quantity), notes)
    assert found == pytest.approx(expected, rel=1e-12)
    assert notes == ([] if note is None else [note])


def test_degrees_and_minutes_south_and_west():
    notes: list[str] = []
    found = units.in_si(
        "lat",
        _stored([-4530.0, 1015.6, 69_696_969.0]),
        units.quantity_of("latitude"),
        notes,
        "nmea",
    )
    np.testing.assert_allclose(found, [-45.5, 10.26, np.nan], atol=1e-12)
    assert notes[-1] == "lat: 1 values outside -90..90 degrees taken as missing"


@pytest.mark.parametrize(
    ("unit", "value", "expected_s"),
    [
        ("seconds since 1970-01-01T00:00:00Z", 1.7e9, 1.7e9),
        ("seconds since 1970-1-1 00:00:00", 1.7e9, 1.7e9),
        ("s since 2000-01-01", 1e8, 946_684_800.0 + 1e8),
        ("ms since 1970-01-01", 1.7e12, 1.7e9),
        ("minutes since 2023-01-01 06:30", 60.0, 1_672_531_200.0 + 7.5 * 3600.0),
        ("days since 2023-01-01", 0.5, 1_672_531_200.0 + 43_200.0),
        ("nanoseconds since 2010-09-03 18:24:38.193000192", 2e9, 1_283_538_278.193 + 2.0),
        ("timestamp", 1.7e9, 1.7e9),
    ],
)
def test_times(unit, value, expected_s):
    found, known = units.time_ns("t", _stored([value, np.nan], units=unit), FILE, [])
    assert found.tolist() == [round(expected_s * 1000) * 10**6, 0]
    assert known.tolist() == [True, False]


def test_times_of_a_clock_that_lost_them_are_unknown():
    stored = _stored(
        np.array([-(2**63), 86_400 * 10**9, 1_700_000_000 * 10**9]),
        units="nanoseconds since 1970-01-01",
    )
    assert units.time_ns("t", stored, FILE, [])[1].tolist() == [False, False, True]
    with pytest.raises(
        LogError,
        match=r"a\.nc: t: expected units .* got 'seconds since 1970-01-01' and times from 5 on",
    ):
        units.time_ns("t", _stored([5.0], units="seconds since 1970-01-01"), FILE, [])


MEANINGS = {"flag_values": np.array([1, 2, 3, 4, 9], np.int8)}


@pytest.mark.parametrize(
    ("meanings", "bad"),
    [
        ("good not_evaluated questionable bad missing", [3, 4, 9]),
        ("GOOD UNKNOWN SUSPECT FAIL MISSING", [3, 4, 9]),
        ("good probably_good probably_bad bad missing", [3, 4, 9]),
        ("bad good good good good", [1]),
    ],
)
def test_flags_are_read_by_their_meanings(meanings, bad):
    notes: list[str] = []
    found = quality.flagged_bad(
        "q",
        _stored(np.array([1, 2, 3, 4, 9], np.int8), **MEANINGS, flag_meanings=meanings),
        "",
        notes,
    )
    assert found.tolist() == [value in bad for value in (1, 2, 3, 4, 9)]
    assert len(notes) == len(bad)


def test_flags_as_text_and_values_as_text():
    flags = _stored(
        np.array([b"1", b"4", b"8"]),
        flag_values="0b, 1b, 4b, 8b",
        flag_meanings="none good bad interpolated",
    )
    assert quality.flagged_bad("q", flags, "", []).tolist() == [False, True, False]
    # a file that states no meanings is read by its dialect's; without those, nothing is bad
    bare = _stored(np.array([b"1", b"4"]))
    assert quality.flagged_bad("q", bare, "4 QC_BAD", []).tolist() == [False, True]
    assert quality.flagged_bad("q", bare, "", []).tolist() == [False, False]


@pytest.mark.parametrize(("largest", "turned"), [(6.2, True), (6.4, False)])
def test_headings_within_a_turn_in_radians_are_radians(largest, turned):
    values = np.linspace(0.0, largest, 30)
    found = units.attitude_degrees("h", values, True, [])
    np.testing.assert_allclose(found, np.rad2deg(values) if turned else values)
    # a few samples, or tilts within a right angle, tell nothing or the same
    assert units.attitude_degrees("h", values[:5], True, [])[-1] == values[4]
    np.testing.assert_allclose(
        units.attitude_degrees("p", values / 4.0, False, []),
        np.rad2deg(values / 4.0) if turned else values / 4.0,
    )
