"""Boxes of longitude and latitude."""

import numpy as np
import pytest

from replay_kit.core.geodesy import distance
from replay_kit.core.region import around, centre, depth_inside, inside, width


@pytest.mark.parametrize("middle", [(10.0, 0.0), (-179.9, 60.0), (179.95, -75.0)])
def test_a_box_around_places_holds_all_within_the_margin(middle):
    rng = np.random.default_rng(1)
    places = np.array(middle) + rng.uniform(-0.5, 0.5, (20, 2))
    box = around(places, 30_000.0)
    assert inside(box, *places.T).all()
    assert np.all(depth_inside(box, *places.T) > 29_000.0)
    for step in ((0.25, 0.0), (0.0, 0.25), (-0.25, 0.0), (0.0, -0.25)):
        others = places + step
        near = distance(*places.T, *others.T) < 29_000.0
        assert inside(box, *others[near].T).all()


def test_a_box_is_no_larger_than_it_must_be():
    box = around([(10.0, 45.0), (12.0, 46.0)], 0.0)
    assert box == (10.0, 45.0, 12.0, 46.0)
    assert centre(box) == (11.0, 45.5)
    assert width(around([(179.0, 0.0), (-179.0, 1.0)], 0.0)) == pytest.approx(2.0)


def test_how_far_a_place_lies_inside_is_the_distance_to_the_nearest_side():
    box = (9.0, 59.0, 11.0, 61.0)
    for *place, west, north in (
        (10.9, 60.0, 11.0, 60.0),
        (9.02, 60.3, 9.0, 60.3),
        (10.0, 60.9, 10.0, 61.0),
        (8.9, 60.0, 9.0, 60.0),
    ):
        sign = 1.0 if inside(box, *place) else -1.0
        # degrees of longitude are those of the box's middle, 1 % longer than at 60.3 N
        assert depth_inside(box, *place) == pytest.approx(
            sign * distance(*place, west, north), rel=0.015
        )


def test_places_round_the_globe_give_all_longitudes():
    longitude = np.arange(0.0, 360.0, 0.25)
    box = around(np.column_stack([longitude, np.zeros(longitude.size)]), 30_000.0)
    assert width(box) == 360.0
    assert inside(box, [0.0, 179.9, -180.0, 270.0], [0.0] * 4).all()


def test_the_poles_are_not_passed():
    assert around([(0.0, 89.9)], 50_000.0)[3] == 90.0
    assert around([(0.0, -89.9)], 50_000.0)[1] == -90.0
