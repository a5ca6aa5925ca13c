"""Units by the names that files give them, as forecasts, glider files and bathymetries write them."""

import pytest

from replay_kit.core.words.quantities import decibars, metres, metres_per_second, seconds

KNOWN = [
    (metres, 1.0, "m|meter|meters|metre|Metres"),
    (metres, 0.01, "cm|centimeters"),
    (metres, 0.3048, "ft|foot|feet"),
    (seconds, 1.0, "s|sec|secs|second|seconds"),
    (seconds, 3600.0, "h|hr|hrs|hours|Hour"),
    (seconds, 86_400.0, "d|day|days"),
    (seconds, 1e-3, "ms|msec|milliseconds"),
    (seconds, 1e-9, "ns|nanoseconds"),
    (metres_per_second, 1.0, "m s-1|m/s|m/sec|m.s-1|m s^-1|m s**-1|meter/s|metre s-1"),
    (metres_per_second, 1.0, "meter second^-1|meters/second|meters per second|meters s-1"),
    (metres_per_second, 0.01, "cm s-1|cm/s|cm/sec|cm.s-1|centimeter/s|centimeters/second"),
    (metres_per_second, 1852.0 / 3600.0, "knots|kt"),
    (decibars, 1.0, "dbar|decibars"),
    (decibars, 1e-4, "Pa"),
]


@pytest.mark.parametrize(("of", "value", "names"), KNOWN)
def test_names_of_a_unit(of, value, names):
    assert {of(name) for name in names.split("|")} == {value}


@pytest.mark.parametrize(
    ("of", "names"),
    [
        (metres, "|M|K|ms|fathoms|m s-1|degrees"),
        (seconds, "|month|years|m"),
        (metres_per_second, "|m|s-1|m s-2|m/min|furlong/s"),
        (decibars, "|m|barn"),
    ],
)
def test_other_names_are_no_unit(of, names):
    assert {of(name) for name in names.split("|")} == {None}
