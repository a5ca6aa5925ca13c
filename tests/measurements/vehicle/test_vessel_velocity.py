"""A vessel's velocity from its fixes, and its error against ordinary linear regression."""

import numpy as np
import pytest
from scipy.stats import linregress

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.vessel import Track, vessel_velocity

SECOND = 10**9
HOME = Projection(152.0, -40.0)


def track(since, east, north):
    longitude, latitude = to_geographic(HOME, east, north)
    return Track(np.round(since * SECOND).astype(np.int64), longitude, latitude)


@pytest.mark.parametrize("n", [3, 4, 11])
def test_the_error_counts_the_degrees_of_freedom_of_two_lines(n):
    rng = np.random.default_rng(n)
    since = np.linspace(-10.0, 10.0, n)
    east, north = 1.5 * since + 20.0 * rng.standard_normal(n), -0.7 * since + 20.0 * rng.standard_normal(n)
    # the projection of the function is about the first fix
    east, north = east - east[0], north - north[0]
    ((found,), (error,)) = vessel_velocity(np.array([0]), track(since, east, north))
    lines = [linregress(since, component) for component in (east, north)]
    np.testing.assert_allclose(found, [line.slope for line in lines], rtol=1e-4)
    # one variance for both components: each line has n - 2 degrees of freedom, the two together twice as many
    assert error == pytest.approx(np.sqrt(np.mean([line.stderr**2 for line in lines])), rel=1e-4)


def test_fixes_on_a_line_have_the_error_of_their_rounding():
    since = np.arange(-5.0, 6.0)
    (_, (error,)) = vessel_velocity(np.array([0]), track(since, 2.0 * since, 0.0 * since))
    assert error == pytest.approx(0.5 / np.sqrt(since @ since), rel=1e-6)
