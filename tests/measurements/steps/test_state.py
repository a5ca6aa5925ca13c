"""When a dive begins and ends: at twice the surface depth, and at the surface depth itself."""

import numpy as np
import pytest

from replay_kit.measurements.track.dives import depths_of, no_depths


def states(depths):
    order = np.arange(len(depths))
    found = depths_of(no_depths(), [(order, np.array(depths), True)], 3.0)
    at = np.searchsorted(found["order"], order, side="right") - 1
    return [(bool(found["submerged"][k]), int(found["dive"][k])) for k in at]


@pytest.mark.parametrize(
    ("depths", "found"),
    [
        # begins below twice the surface depth, and ends at the surface depth
        ([0.0, 50.0, 5.0, 50.0, 3.5, 6.5], [(False, 0)] + [(True, 1)] * 5),
        ([50.0, 2.9, 5.0, 6.5], [(True, 1), (False, 1), (False, 1), (True, 2)]),
        ([0.0, -1.0, 6.0, 6.001], [(False, 0)] * 3 + [(True, 1)]),
        ([50.0, 3.001, 3.0], [(True, 1), (True, 1), (False, 1)]),
        ([np.nan, 50.0, np.nan], [(False, 0), (True, 1), (True, 1)]),
    ],
)
def test_a_dive_ends_at_the_surface_depth_and_not_at_twice_of_it(depths, found):
    assert states(depths) == found
