"""Headings of true north, held by a compass: a leg ends where one flown on the ellipsoid does, through a current that is known there."""

import numpy as np
import pytest
from pyproj import Geod

from replay_kit.core.geodesy import rate_in_frame, rotate_to_geographic, to_geographic, to_local
from replay_kit.core.grid import Projection

ELLIPSOID = Geod(ellps="WGS84")


@pytest.mark.parametrize("latitude", [0.0, 35.0, -45.0, 60.0, 80.0])
def test_the_rate_in_the_frame_is_that_of_a_metre_on_the_ellipsoid(latitude):
    frame, rng = Projection(10.0, latitude), np.random.default_rng(3)
    for east, north in rng.uniform(-300e3, 300e3, (20, 2)):
        at = tuple(float(value) for value in to_geographic(frame, east, north))
        through, current = rng.normal(0.0, 0.5, (2, 2))
        water = np.array(rotate_to_geographic(frame, *at, *current))
        over_ground = through + water
        azimuth, metres = np.rad2deg(np.arctan2(*over_ground)), np.hypot(*over_ground)
        there = np.array(to_local(frame, *ELLIPSOID.fwd(*at, azimuth, metres)[:2]))
        rate = np.array(rate_in_frame(frame, east, north, tuple(through), tuple(current)))
        np.testing.assert_allclose(rate, there - [east, north], atol=5e-6)
