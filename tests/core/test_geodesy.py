"""The local frame, directions and the outline of a grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.core.geodesy import (
    distance,
    grid_bearing_of_true_north,
    heading_deg,
    rotate_to_geographic,
    rotate_to_local,
    to_geographic,
    to_local,
)
from replay_kit.core.grid import Projection

CENTRE = Projection(152.5, -40.0)


@given(st.floats(-3e5, 3e5), st.floats(-3e5, 3e5))
def test_local_frame_round_trip_and_distance_from_its_centre(east, north):
    place = to_geographic(CENTRE, east, north)
    # PROJ takes points within 1e-10 radian of the centre for the centre itself
    np.testing.assert_allclose(to_local(CENTRE, *place), (east, north), atol=1e-3)
    assert distance(152.5, -40.0, *place) == pytest.approx(np.hypot(east, north), abs=1e-2)


@pytest.mark.parametrize("longitude", [151.0, 152.5, 154.0 - 360.0])
def test_true_north_and_east_turn_as_the_map_does(longitude):
    latitude, step = -39.2, 1e-5
    ends = (to_local(CENTRE, longitude, at) for at in (latitude + step, latitude))
    northward = np.subtract(*ends)
    found = rotate_to_local(CENTRE, longitude, latitude, 0.0, 1.0)
    np.testing.assert_allclose(found, northward / np.hypot(*northward), atol=1e-6)
    here = CENTRE, longitude, latitude
    back = rotate_to_geographic(*here, *rotate_to_local(*here, 0.3, -0.2))
    np.testing.assert_allclose(back, (0.3, -0.2), atol=1e-15)


def test_the_bearing_of_true_north_of_no_place_and_of_places_that_are_not_numbers():
    found = grid_bearing_of_true_north(CENTRE, [152.0, np.nan, 153.0], [-40.0] * 3)
    assert np.isnan(found).tolist() == [False, True, False]
    assert found[2] == grid_bearing_of_true_north(CENTRE, 153.0, -40.0)
    assert np.shape(rotate_to_local(CENTRE, *[np.empty(0)] * 4)) == (2, 0)


def test_headings_are_clockwise_from_north():
    found = heading_deg([0, 1, 0, -1, -1e-9], [1, 0, -1, 0, 1])
    np.testing.assert_allclose(found, [0, 90, 180, 270, 360], atol=1e-6)
