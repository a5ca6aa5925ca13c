"""When a dive begins and ends: at twice the surface depth, and at the surface depth itself."""

import numpy as np
import pytest

from replay_kit.measurements.dives import depths_of, no_depths


def states(depths):
    order = np.arange(len(depths))
    found = depths_of(no_depths(), [(order, np.array(depths), True)], 3.0)
    at = np.searchsorted(found["order"], order, side="right") - 1
    return [(bool(found["submerged"][k]), int(found["dive"][k])) for k in at]


def test_a_dive_ends_at_the_surface_depth_and_not_at_twice_of_it():
    assert states([0.0, 50.0, 5.0, 50.0, 3.5, 6.5]) == [(False, 0)] + [(True, 1)] * 5
    assert states([50.0, 2.9, 5.0, 6.5]) == [(True, 1), (False, 1), (False, 1), (True, 2)]


@pytest.mark.parametrize(("depth", "begins"), [(-1.0, False), (6.0, False), (6.001, True)])
def test_a_dive_begins_below_twice_the_surface_depth(depth, begins):
    assert states([0.0, depth])[-1] == (begins, int(begins))


@pytest.mark.parametrize(("depth", "ends"), [(3.001, False), (3.0, True)])
def test_a_dive_ends_at_the_surface_depth(depth, ends):
    assert states([50.0, depth])[-1] == (not ends, 1)


def test_what_is_no_depth_changes_nothing():
    assert states([float("nan"), 50.0, float("nan")]) == [(False, 0), (True, 1), (True, 1)]
