"""The declination of a ping in earth coordinates: applied or not, it is applied once."""

import numpy as np
import pytest

from replay_kit.measurements.adcp import turned_clockwise
from replay_kit.types import Observation
from tests.measurements.messages import fix, only, ping, run


def test_vectors_turn_clockwise():
    np.testing.assert_allclose(turned_clockwise(np.array([[0.0, 1.0], [1.0, 0.0]]), 90.0), [[1.0, 0.0], [0.0, -1.0]], atol=1e-15)


@pytest.mark.parametrize("applied", [False, 0, 0.0])
def test_a_declination_that_was_not_applied_is_applied(applied):
    # magnetic north points 30 degrees east of true north
    message = ping(velocity=[[0.0, 1.0]] * 3, magnetic_declination=30.0, declination_applied=applied)
    (profile,) = only(Observation, run([fix(0), message]))
    np.testing.assert_allclose(profile.velocity, [[0.5, np.sqrt(0.75)]] * 3, atol=1e-15)


@pytest.mark.parametrize(("declination", "applied"), [(30.0, True), (30.0, None), (30.0, float("nan")), (None, False), ("NaN", False)])
def test_one_that_was_applied_or_is_not_known_is_left(declination, applied):
    message = ping(velocity=[[0.0, 1.0]] * 3, magnetic_declination=declination, declination_applied=applied)
    (profile,) = only(Observation, run([fix(0), message]))
    np.testing.assert_array_equal(profile.velocity, [[0.0, 1.0]] * 3)
