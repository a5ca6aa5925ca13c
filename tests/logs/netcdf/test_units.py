"""Units, times and flags of glider files: each conversion exactly, and what is said of it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs.netcdf import columns, units
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored

SINCE = "seconds since 1970-01-01"


def _stored(values, **attributes: Any):
    return Stored(np.asarray(values), attributes)


def _file(stored):
    return NetcdfFile(Path("a.nc"), {}, {"x": stored}, ())


def _times(stored):
    return units.times_of(_file(stored), "x").tolist()


@pytest.mark.parametrize(
    ("unit", "key", "value", "expected", "note"),
    [
        ("m s-1", "dac_east", 0.5, 0.5, None),
        ("cm/s", "dac_east", 50.0, 0.5, "converted from cm/s to m/s"),
        ("Pa", "pressure", 1e6, 100.0, "converted from Pa to dbar"),
        ("rad", "heading", np.pi, 180.0, "converted from rad to degrees"),
        ("cm", "depth", 250.0, 2.5, "converted from cm to m"),
        ("mS/cm", "conductivity", 40.0, 4.0, "converted from mS/cm to S/m"),
        ("furlong", "depth", 2.0, 2.0, "unit 'furlong' is not known, taken as m"),
        ("", "dac_east", 0.25, 0.25, "states no unit, taken as m/s"),
        ("1", "dive", 7.0, 7.0, None),
    ],
)
def test_units(unit, key, value, expected, note):
    file = _file(_stored([value], units=unit))
    found = units.in_si(file, "x", units.quantity_of(key))
    assert found == pytest.approx(expected, rel=1e-12)
    assert file.told.notes == ([] if note is None else [f"x: {note}"])


_2023 = 1_672_531_200.0


@pytest.mark.parametrize(
    ("unit", "value", "expected_s"),
    [
        ("seconds since 1970-1-1 00:00:00", 1.7e9, 1.7e9),
        ("seconds since 2023-01-01 00:00:00 UTC", np.int32(60), _2023 + 60.0),
        ("s since 2000-01-01", 1e8, 946_684_800.0 + 1e8),
        ("ms since 1970-01-01", 1.7e12, 1.7e9),
        ("minutes since 2023-01-01 06:30", 60.0, _2023 + 7.5 * 3600.0),
        ("days since 2023-01-01", 0.5, _2023 + 43_200.0),
        ("nanoseconds since 2010-09-03 18:24:38.193000192", 2e9, 1_283_538_278.193 + 2.0),
        ("nanoseconds since 1970-01-01", np.int64(1_700_000_000_001_000_000), 1.7e9 + 1e-3),
        ("", 1.7e9, 1.7e9),
    ],
)
def test_times(unit, value, expected_s):
    stored = _stored([value] if isinstance(value, np.integer) else [value, np.nan], units=unit)
    found = _times(stored)
    assert found == [round(expected_s * 1000) * 10**6, 0][: len(found)]


def test_times_of_a_clock_that_lost_them_are_unknown():
    values = np.array([-(2**63), 86_400 * 10**9, 1_700_000_000 * 10**9])
    stored = _stored(values, units="nanoseconds since 1970-01-01")
    assert _times(stored) == [0, 0, 1_700_000_000 * 10**9]
    words = rf"a\.nc: x: expected units .* got '{SINCE}' and times from 5 on"
    with pytest.raises(LogError, match=words):
        _times(_stored([5.0], units=SINCE))


def test_days_before_months_are_read_and_days_after_them_refused():
    assert _times(Stored(np.array([b"02/01/2023 00:00"]), {}, ("row",))) == [
        (1_672_531_200 + 86_400) * 10**9
    ]
    with pytest.raises(LogError, match=r"a\.nc: x: .* got '11/13/2018 03:00'"):
        _times(Stored(np.array([b"11/12/2018 03:00", b"11/13/2018 03:00"]), {}, ("row",)))


_TEXT = np.array([b"1", b"4", b"8"])
_NUMBERS = np.array([1, 2, 3, 4, 9], np.int8)


@pytest.mark.parametrize(
    ("values", "stated", "meanings", "usual", "bad"),
    [
        (_NUMBERS, _NUMBERS, "good not_evaluated questionable bad missing", "", [3, 4, 9]),
        (_NUMBERS, _NUMBERS, "good probably_good probably_bad bad missing", "", [3, 4, 9]),
        (_NUMBERS, _NUMBERS, "bad good good good good", "", [1]),
        (_TEXT, "0b, 1b, 4b, 8b", "none good bad interpolated", "", [4]),
        # a file that states no meanings is read by its dialect's; without those, nothing is bad
        (_TEXT, None, "", "4 QC_BAD", [4]),
        (_TEXT, None, "", "", []),
    ],
)
def test_flags_are_read_by_their_meanings(values, stated, meanings, usual, bad):
    about = {} if stated is None else {"flag_values": stated, "flag_meanings": meanings}
    file = _file(Stored(values, about))
    assert columns.flagged_bad(file, "x", usual).tolist() == [int(value) in bad for value in values]
    assert len(file.told.notes) == len(bad)


@pytest.mark.parametrize(("largest", "turned"), [(6.2, True), (6.4, False)])
def test_headings_within_a_turn_in_radians_are_radians(largest, turned):
    values = np.linspace(0.0, largest, 30)
    # a few samples, or tilts within a right angle, tell nothing or the same
    file = _file(None)
    for given, whole_turn in ((values, True), (values / 4.0, False)):
        found = units.attitude_degrees(file, "x", given, whole_turn)
        np.testing.assert_allclose(found, np.rad2deg(given) if turned else given)
    assert units.attitude_degrees(file, "x", values[:5], True)[-1] == values[4]
