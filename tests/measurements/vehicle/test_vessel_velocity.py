"""A vessel's velocity from its fixes, and its error against ordinary linear regression."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import linregress

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.measurements import positions

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


@pytest.mark.parametrize("n", [3, 4, 11])
def test_the_error_counts_the_degrees_of_freedom_of_two_lines(n):
    rng = np.random.default_rng(n)
    since = np.linspace(-10.0, 10.0, n)
    east, north = (
        1.5 * since + 20.0 * rng.standard_normal(n),
        -0.7 * since + 20.0 * rng.standard_normal(n),
    )
    found = vessel_velocity(0, track(since, east, north))
    lines = [linregress(since, component) for component in (east, north)]
    assert_allclose((found.east, found.north), [line.slope for line in lines], rtol=1e-4)
    # one variance for both components: each line has n - 2 degrees of freedom, the two together twice as many
    assert found.error_std == pytest.approx(
        np.sqrt(np.mean([line.stderr**2 for line in lines])), rel=1e-4
    )


def test_fixes_on_a_line_have_the_error_of_their_rounding():
    since = np.arange(-5.0, 6.0)
    found = vessel_velocity(0, track(since, 2.0 * since, 0.0 * since))
    assert found.error_std == pytest.approx(0.5 / np.sqrt(since @ since), rel=1e-6)


def test_the_velocity_is_the_slope_of_the_fixes_within_twenty_seconds():
    rng = np.random.default_rng(3)
    seconds = np.sort(rng.uniform(0.0, 300.0, 90))
    place = seconds[:, None] * np.array([1.2, -0.4]) + rng.normal(0.0, 2.0, (90, 2))
    fixes = track(seconds, place[:, 0], place[:, 1], Projection(20.0, 60.0))
    for time in range(30, 300, 30):
        found = vessel_velocity(time * SECOND, fixes)
        near = np.abs(seconds - time) <= 20.0
        slope = np.polyfit(seconds[near], place[near], 1)[0]
        assert_allclose((found.east, found.north), slope, atol=1e-3)


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


def test_fixes_are_kept_for_the_pings_that_the_next_one_releases():
    whole = track([0, 1, 1, 40, 41, 81], *np.zeros((2, 6)))
    whole |= {
        name: np.zeros(6, kind) for name, kind in positions.ROW.items() if not whole[name].size
    }
    for size in (1, 2, 6):
        kept = positions.no_rows()
        for k in range(0, 6, size):
            more = positions.chosen(whole, slice(k, k + size))
            kept = positions.recent(positions.joined(kept, more))
        # the last one is of 81 s, less two windows of 20 s
        assert (positions.fixes_of(kept)["time"] // SECOND).tolist() == [81]
