"""An observation that is the last one once more: the same in every number, and nothing less."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.estimator.update.screening import is_duplicate
from tests import synthetic

GRID = synthetic.ensemble(n_members=2).grid
PROFILE = synthetic.profile(
    GRID, 1e3, 2e3, np.array([20.0, 40.0]), np.array([[0.1, np.nan], [0.2, -0.1]]), 0.05, time_ns=7
)


def test_the_same_numbers_are_the_same_observation_missing_ones_too():
    assert is_duplicate(
        PROFILE, replace(PROFILE, velocity=PROFILE.velocity.copy(), depth=PROFILE.depth.copy())
    )
    assert not is_duplicate(None, PROFILE)


@pytest.mark.parametrize("name", ["time_ns", "longitude", "latitude", "depth", "velocity"])
def test_one_other_number_makes_another_observation(name):
    other = replace(PROFILE, **{name: getattr(PROFILE, name) + 1})
    assert not is_duplicate(PROFILE, other)
