"""Which bins an estimate can use, at each limit: on it, and to either side."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.grid import Grid
from replay_kit.core.observation import Flag, PathMean, Reason, Source
from replay_kit.estimator.update.screening import is_duplicate, screen
from tests import synthetic

GRID = synthetic.ensemble(levels=np.array([5.0, 65.0, 165.0])).grid


def screened(depth, grid: Grid = GRID, relative: bool = False, **changes):
    depth = np.asarray(depth, dtype=float)
    profile = synthetic.profile(grid, 0.0, 0.0, depth, np.zeros((depth.size, 2)))
    (flags,), (reasons,) = screen([replace(profile, **changes)], grid, relative)
    return flags, reasons


def test_a_bin_at_the_last_level_is_used_and_one_below_it_is_not():
    flags, reasons = screened([np.nextafter(165.0, 0.0), 165.0, np.nextafter(165.0, 200.0)])
    assert flags.tolist() == [Flag.GOOD, Flag.GOOD, Flag.FAIL]
    assert reasons.tolist() == [0, 0, Reason.BELOW_GRID]


def test_an_error_of_nothing_is_none_and_the_least_number_above_it_is_one():
    smallest = np.nextafter(0.0, 1.0)
    flags, reasons = screened([10.0, 20.0, 30.0], error_std=np.array([0.0, smallest, np.inf]))
    assert flags.tolist() == [Flag.FAIL, Flag.GOOD, Flag.FAIL]
    assert reasons.tolist() == [Reason.MALFORMED, 0, Reason.MALFORMED]


def test_a_bin_between_two_levels_is_on_land_as_the_nearer_level_and_the_upper_one_in_the_middle():
    wet = GRID.wet.copy()
    wet[1:] = False
    flags, reasons = screened([34.999, 35.0, 35.001], replace(GRID, wet=wet))
    assert flags.tolist() == [Flag.GOOD, Flag.GOOD, Flag.FAIL]
    assert reasons.tolist() == [0, 0, Reason.ON_LAND]


@pytest.mark.parametrize(
    ("usable", "relative", "used"), [(1, True, 0), (2, True, 2), (3, True, 3), (3, False, 0)]
)
def test_two_bins_say_something_of_their_difference_and_one_alone_does_not(usable, relative, used):
    flags = np.array([Flag.GOOD] * usable + [Flag.MISSING] * (4 - usable), np.int8)
    found, reasons = screened(
        [10.0, 20.0, 30.0, 40.0],
        relative=relative,
        flags=flags,
        common_std=np.inf,
        reference="platform",
    )
    assert np.count_nonzero(found == Flag.GOOD) == used
    assert np.all((reasons & Reason.PLATFORM_REFERENCE > 0) == (used == 0))


def test_a_suspect_bin_is_one_that_counts():
    flags = np.array([Flag.GOOD, Flag.SUSPECT], np.int8)
    found, _ = screened(
        [10.0, 20.0], relative=True, flags=flags, common_std=np.inf, reference="platform"
    )
    assert found.tolist() == [Flag.GOOD, Flag.SUSPECT]


def test_the_edge_of_the_region_belongs_to_it():
    east = float(GRID.east[2, -1])
    inside, outside = (
        synthetic.profile(
            GRID, east + away, float(GRID.north[2, -1]), np.array([10.0]), np.zeros((1, 2))
        )
        for away in (0.0, 2.0)
    )
    flags, reasons = screen([inside, outside], GRID)
    assert flags[0] == Flag.GOOD
    assert reasons[1] == Reason.OUTSIDE_REGION


def test_a_mean_along_a_path_stands_where_half_of_its_time_has_passed():
    longitude = np.array([152.0, 152.1, 152.2, 152.3])
    mean = PathMean(
        time_ns=4,
        path_time_ns=np.arange(4),
        longitude=longitude,
        latitude=np.full(4, -40.0),
        depth=np.array([0.0, 100.0, 100.0, 0.0]),
        weight=np.full(4, 0.25),
        velocity=(0.1, 0.2),
        error_std=0.01,
        kind="dac",
        dive=1,
        source=Source(0, "/dac", 0, 4),
    )
    # exactly half of it with the second point, a little less, and all of it with the last
    assert mean.linear.middle == (152.1, -40.0)
    assert replace(mean, weight=np.array([0.25, 0.249, 0.251, 0.25])).linear.middle[0] == 152.2
    assert replace(mean, weight=np.array([0.0, 0.0, 0.0, 0.4999])).linear.middle[0] == 152.3
    assert mean.linear.value_depth.tolist() == [50.0]


PROFILE = synthetic.profile(
    GRID, 1e3, 2e3, np.array([20.0, 40.0]), np.array([[0.1, np.nan], [0.2, -0.1]]), 0.05, time_ns=7
)


def test_the_same_numbers_are_the_same_observation_missing_ones_too():
    assert is_duplicate(
        PROFILE.linear,
        replace(PROFILE, velocity=PROFILE.velocity.copy(), depth=PROFILE.depth.copy()),
    )
    assert not is_duplicate(None, PROFILE)


@pytest.mark.parametrize("name", ["time_ns", "longitude", "latitude", "depth", "velocity"])
def test_one_other_number_makes_another_observation(name):
    other = replace(PROFILE, **{name: getattr(PROFILE, name) + 1})
    assert not is_duplicate(PROFILE.linear, other)
