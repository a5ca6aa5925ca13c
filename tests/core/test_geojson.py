"""Features across the antimeridian, cut there."""

import numpy as np
import pytest
import shapely

from replay_kit.core.region import cut_at_antimeridian, feature

RING = [[178.0, -1.0], [182.0, -1.0], [182.0, 3.0], [178.0, 3.0], [178.0, -1.0]]


def cut(kind, coordinates):
    return cut_at_antimeridian(feature(kind, coordinates, {"name": "one"}))["geometry"]


def test_what_is_within_180_degrees_stays_as_it_is():
    one = feature("LineString", [[-180.0, 0.0], [179.9, 0.0]], {})
    assert cut_at_antimeridian(one) is one


@pytest.mark.parametrize("offset", [0.0, -360.0])
def test_a_line_is_cut_where_it_crosses(offset):
    line = [[179.0 + offset, 0.0], [181.0 + offset, 2.0], [182.0 + offset, 2.0]]
    parts = cut("LineString", line)
    assert parts["type"] == "MultiLineString"
    assert sorted(parts["coordinates"]) == [
        [[-180.0, 1.0], [-179.0, 2.0], [-178.0, 2.0]],
        [[179.0, 0.0], [180.0, 1.0]],
    ]


def test_a_polygon_is_cut_into_two_of_the_same_area_and_turn():
    parts = cut("Polygon", [RING])
    assert parts["type"] == "MultiPolygon"
    # RFC 7946 wants the first place again at the end of a ring, and once
    assert all(ring[0] == ring[-1] != ring[-2] for (ring,) in parts["coordinates"])
    shapes = [shapely.Polygon(ring) for (ring,) in parts["coordinates"]]
    assert sum(shape.area for shape in shapes) == pytest.approx(16.0)
    assert all(shapely.is_ccw(shape.exterior) for shape in shapes)
    assert shapely.total_bounds(shapes)[[0, 2]].tolist() == [-180.0, 180.0]


@pytest.mark.parametrize(
    ("west", "kept"), [(179.0, 179.0), (-181.0, 179.0), (180.0, -180.0), (-180.0, -180.0)]
)
def test_what_touches_the_antimeridian_has_no_part_beyond(west, kept):
    ring = np.add([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], [west, 0.0]).tolist()
    for kind, coordinates in (("LineString", ring[:2]), ("Polygon", [ring])):
        moved = cut(kind, coordinates)
        assert moved["type"] == kind
        wanted = np.subtract(coordinates, [west - kept, 0.0])
        np.testing.assert_array_equal(moved["coordinates"], wanted)
    assert cut("MultiPoint", [[181.0, 2.0], [179.0, 2.0]])["coordinates"][0] == [-179.0, 2.0]


def test_a_place_on_the_antimeridian_stands_once_in_each_part():
    ring = [[178.0, 0.0], [180.0, -1.0], [182.0, 0.0], [180.0, 1.0], [178.0, 0.0]]
    assert sorted(cut("LineString", ring[:3])["coordinates"]) == [
        [[-180.0, -1.0], [-178.0, 0.0]],
        [[178.0, 0.0], [180.0, -1.0]],
    ]
    assert [len(part) for (part,) in cut("Polygon", [ring])["coordinates"]] == [4, 4]


def test_a_line_that_crosses_again_has_a_part_each_time():
    line = [[179.0, 0.0], [181.0, 0.0], [181.0, 2.0], [179.0, 2.0]]
    parts = cut("LineString", line)["coordinates"]
    assert sorted(map(len, parts)) == [2, 2, 4]
