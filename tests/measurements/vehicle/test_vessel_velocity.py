"""A vessel's velocity from its fixes, and its error against ordinary linear regression."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import linregress

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.measurements.track import positions

SECOND = 10**9
HOME = Projection(152.0, -40.0)


def track(since, east, north, home=HOME):
    times = np.round(np.asarray(since) * SECOND).astype(np.int64)
    longitude, latitude = to_geographic(home, east, north)
    return {
        **positions.no_rows(),
        "time": times,
        "longitude": longitude,
        "latitude": latitude,
        "submerged": np.zeros(times.size, bool),
        "dead_reckoned": np.zeros(times.size, bool),
    }


def vessel_velocity(time, fixes):
    """Return east, north and error; None for none."""
    all_of_them = np.full(1, fixes["time"].size)
    (found,) = positions.vessel_velocity(np.array([time]), fixes, all_of_them)
    return (
        None
        if np.isnan(found).all()
        else SimpleNamespace(east=found[0], north=found[1], error_std=found[2])
    )


def test_the_velocity_and_its_error_are_those_of_two_lines_through_the_fixes_within_twenty_seconds():
    rng = np.random.default_rng(3)
    seconds = np.sort(rng.uniform(0.0, 300.0, 90))
    place = seconds[:, None] * np.array([1.2, -0.4]) + rng.normal(0.0, 2.0, (90, 2))
    fixes = track(seconds, *place.T, Projection(20.0, 60.0))
    for time in range(30, 300, 30):
        found = vessel_velocity(time * SECOND, fixes)
        near = np.abs(seconds - time) <= 20.0
        lines = [linregress(seconds[near], part) for part in place[near].T]
        assert_allclose((found.east, found.north), [line.slope for line in lines], atol=1e-3)
        # one variance for both components: each line has n - 2 degrees of freedom, the two together twice as many
        expected = np.sqrt(np.mean([line.stderr**2 for line in lines]))
        assert found.error_std == pytest.approx(expected, rel=1e-3)


def test_fixes_on_a_line_have_the_error_of_their_rounding():
    since = np.arange(-5.0, 6.0)
    found = vessel_velocity(0, track(since, 2.0 * since, 0.0 * since))
    assert found.error_std == pytest.approx(0.5 / np.sqrt(since @ since), rel=1e-6)


@pytest.mark.parametrize(
    ("since", "known"),
    [
        ([-20, 0, 20], True),
        ([-21, 0, 20], False),
        ([-2, -1, 0], True),
        ([-3, -2, -1], False),
        ([1, 2, 3], False),
    ],
)
def test_three_fixes_on_both_sides_are_needed(since, known):
    away = np.array(since, np.float64)
    assert (vessel_velocity(0, track(since, away, away)) is not None) == known
