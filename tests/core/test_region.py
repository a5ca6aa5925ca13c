"""Boxes of longitude and latitude, and features cut at the antimeridian."""

import numpy as np
import pytest
import shapely

from replay_kit.core.geodesy import distance
from replay_kit.core.region import (
    box_around,
    centre_of,
    cut_at_antimeridian,
    depth_inside,
    feature,
    inside_box,
    width_of,
)


@pytest.mark.parametrize("middle", [(10.0, 0.0), (-179.9, 60.0), (179.95, -75.0)])
def test_a_box_around_places_holds_all_within_the_margin(middle):
    rng = np.random.default_rng(1)
    places = np.array(middle) + rng.uniform(-0.5, 0.5, (20, 2))
    box = box_around(places, 30_000.0)
    assert np.all(depth_inside(box, *places.T) > 29_000.0)
    for step in ((0.25, 0.0), (0.0, 0.25), (-0.25, 0.0), (0.0, -0.25)):
        others = places + step
        near = distance(*places.T, *others.T) < 29_000.0
        assert inside_box(box, *others[near].T).all()


def test_a_box_is_no_larger_than_it_must_be_and_passes_no_pole():
    box = box_around([(10.0, 45.0), (12.0, 46.0)], 0.0)
    assert (box, centre_of(box)) == ((10.0, 45.0, 12.0, 46.0), (11.0, 45.5))
    assert width_of(box_around([(179.0, 0.0), (-179.0, 1.0)], 0.0)) == pytest.approx(2.0)
    ends = box_around([(0.0, 89.9)], 50_000.0)[3], box_around([(0.0, -89.9)], 50_000.0)[1]
    assert ends == (90.0, -90.0)
    globe = box_around([(longitude, 0.0) for longitude in range(360)], 130_000.0)
    assert width_of(globe) == 360.0
    assert inside_box(globe, [0.0, 179.9, -180.0, 270.0], 0.0).all()


def test_how_far_a_place_lies_inside_is_the_distance_to_the_nearest_side():
    box = (9.0, 59.0, 11.0, 61.0)
    for sign, *place, west, north in (
        (1.0, 10.9, 60.0, 11.0, 60.0),
        (1.0, 9.02, 60.3, 9.0, 60.3),
        (1.0, 10.0, 60.9, 10.0, 61.0),
        (-1.0, 8.9, 60.0, 9.0, 60.0),
    ):
        # degrees of longitude are those of the box's middle, 1 % longer than at 60.3 N
        expected = sign * distance(*place, west, north)
        assert depth_inside(box, *place) == pytest.approx(expected, rel=0.015)


def cut(kind, coordinates):
    found = cut_at_antimeridian(feature(kind, coordinates, {"coordTimes": [1, 2, 3]}))
    # a value for each position of the whole is of no position of its parts
    assert (found["geometry"]["type"] == kind) == ("coordTimes" in found["properties"])
    return found["geometry"]


HALVES = [[[-180, 1], [-179, 2], [-178, 2]], [[179, 0], [180, 1]]]


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ([[179, 0], [181, 2], [182, 2]], HALVES),
        ([[-181, 0], [-179, 2], [-178, 2]], HALVES),
        # a place on the antimeridian stands once in each part
        ([[178, 0], [180, -1], [182, 0]], [[[-180, -1], [-178, 0]], [[178, 0], [180, -1]]]),
        (
            [[179, 0], [181, 0], [179, 2]],
            [[[-180, 0], [-179, 0], [-180, 1]], [[179, 0], [180, 0]], [[180, 1], [179, 2]]],
        ),
    ],
)
def test_a_line_is_cut_where_it_crosses(line, parts):
    assert sorted(cut("LineString", line)["coordinates"]) == parts


def test_a_polygon_is_cut_into_two_of_the_same_area_and_turn():
    ring = [[178, -1], [180, -2], [182, -1], [182, 3], [178, 3], [178, -1]]
    parts = cut("Polygon", [ring])
    # RFC 7946 wants the first place again at the end of a ring, and once
    assert all(ring[0] == ring[-1] != ring[-2] for (ring,) in parts["coordinates"])
    shapes = [shapely.Polygon(ring) for (ring,) in parts["coordinates"]]
    assert sum(shape.area for shape in shapes) == pytest.approx(18.0)
    assert all(shapely.is_ccw(shape.exterior) for shape in shapes)
    assert shapely.total_bounds(shapes)[[0, 2]].tolist() == [-180.0, 180.0]


@pytest.mark.parametrize(
    ("west", "kept"), [(179.0, 179.0), (-181.0, 179.0), (180.0, -180.0), (-180.0, -180.0)]
)
def test_what_touches_the_antimeridian_has_no_part_beyond(west, kept):
    ring = np.add([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], [west, 0.0]).tolist()
    for kind, coordinates in (("LineString", ring[:2]), ("Polygon", [ring])):
        moved = cut(kind, coordinates)
        np.testing.assert_array_equal(
            moved["coordinates"], np.subtract(coordinates, [west - kept, 0.0])
        )
    assert cut("MultiPoint", [[181.0, 2.0], [179.0, 2.0]])["coordinates"][0] == [-179.0, 2.0]
    within = feature("LineString", [[-180.0, 0.0], [179.9, 0.0]], {})
    assert cut_at_antimeridian(within) is within
