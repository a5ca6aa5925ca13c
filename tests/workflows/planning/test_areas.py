"""No-go areas as people draw them: open, crossing, holed, far away, latitude first."""

import json
from dataclasses import replace

import pytest

from replay_kit.core.errors import PlanError
from replay_kit.workflows.planning.areas import area_notes, read_areas
from tests.planners.flow_samples import still_flow

GRID = still_flow().grid
RING = [[152.4, -40.1], [152.5, -40.1], [152.5, -40.0], [152.4, -40.0], [152.4, -40.1]]
HOLE = [[152.43, -40.07], [152.47, -40.07], [152.47, -40.03], [152.43, -40.03], [152.43, -40.07]]
TIMES = {"begin": "2026-05-01T00:00Z", "end": "2026-05-02T00:00Z"}


def area(*rings, **properties):
    geometry = {"type": "Polygon", "coordinates": rings or [RING]}
    return {"type": "Feature", "properties": {"name": "range", **properties}, "geometry": geometry}


def written(folder, document):
    path = folder / "areas"
    # some programs begin their files with a byte order mark
    path.write_text(json.dumps(document), encoding="utf-8-sig")
    return path


def moved(east):
    return [[x + east, y] for x, y in RING]


@pytest.mark.parametrize(
    ("rings", "note"),
    [
        ([RING], None),
        ([[[*corner, 12.0] for corner in RING]], None),
        ([moved(-360.0)], None),
        ([RING, RING[::-1]], None),
        ([RING[:-1]], "range: its outline is open"),
        ([[RING[k] for k in (0, 2, 1, 3, 0)]], "range: its outline crosses itself"),
        ([moved(-30.0)], "range: lies outside the region"),
        ([moved(1.0)], "range: lies outside the region"),
    ],
)
def test_what_should_be_known_of_an_area_is_noted(rings, note, tmp_path):
    path = written(tmp_path, area(*rings))
    notes = area_notes(path, read_areas(path), GRID)
    assert len(notes) == (note is not None)
    assert note is None or notes[0].startswith(note)
    assert read_areas(path)[0].polygon[0] == tuple(rings[0][0][:2])


def test_latitude_first_is_found_by_where_the_region_is(tmp_path):
    path = written(tmp_path, area([[y, x] for x, y in RING]))
    with pytest.raises(PlanError, match=r"-40.1, 152.4, .* longitude first: swap them"):
        area_notes(path, read_areas(path), GRID)


LINE = {"type": "LineString", "coordinates": RING}
AREA = area()["geometry"]


@pytest.mark.parametrize(
    ("document", "count"),
    [
        (AREA, 1),
        ({"type": "MultiPolygon", "coordinates": [[RING], [RING]]}, 2),
        (LINE, 1),
        ({"type": "MultiLineString", "coordinates": [RING, RING[:-1]]}, 2),
        ({"type": "GeometryCollection", "geometries": [AREA, LINE]}, 2),
        ({"type": "Feature", "properties": None, "geometry": LINE}, 1),
        ({"type": "FeatureCollection", "features": [area()] * 3}, 3),
    ],
)
def test_geometries_alone_and_lines_are_read_as_areas(document, count, tmp_path):
    path = written(tmp_path, document)
    areas = read_areas(path)
    assert len(areas) == count
    assert all(set(one.polygon) == set(map(tuple, RING)) for one in areas)


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (b'<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark/></kml>', "got KML without"),
        (b"<kml", "KML"),
        (b"<!DOCTYPE kml [<!ENTITY a 'b'>]><kml/>", "KML"),
        (b"<gpx/>", "got XML;"),
        (b"PK\x03\x04areas", "got a zip file, such as KMZ;"),
        (b"SQLite format 3\0", "got a database, such as a GeoPackage"),
        (b"\x89" + bytes(1000), "expected GeoJSON or KML"),
        (b"", "got nothing;"),
        (b"152.4,-40.1\n152.5,-40.1\n", "got invalid JSON"),
        (b"{}", "got an object without a type as no-go area 1;"),
        (b'{"type": "FeatureCollection", "features": [{"type": "Polygon"}]}', "as feature 1;"),
        (b'{"type": "Feature", "geometry": null}', "got null as "),
        (b'{"type": "Point", "coordinates": [152.4, -40.1]}', "got Point as no-go area 1;"),
        (b'{"type": "Polygon"}', "got no-go area 1 without corners;"),
        (b'{"type": "Polygon", "coordinates": [[152.4, -40.1]]}', "not pairs of numbers;"),
        (b'{"type": "LineString", "coordinates": [[1, 2], [3, 4]]}', "fewer than 3 corners;"),
        (area(begin="soon"), "with the time 'soon'"),
        (area(begin=TIMES["end"], end=TIMES["begin"]), "ends before it begins"),
        (area(fence="perhaps"), "fence 'perhaps', neither true nor false"),
        (area(surface_only="false"), "neither true nor false"),
    ],
)
def test_what_is_no_area_is_refused_in_words(data, found, tmp_path):
    path = tmp_path / "areas"
    path.write_bytes(data if isinstance(data, bytes) else json.dumps(data).encode())
    with pytest.raises(PlanError) as refused:
        read_areas(path)
    told = str(refused.value)
    assert told.startswith(f"{path}: ")
    assert found in told
    assert len(told) < 400 + len(str(path))


def as_kml(path, properties):
    def ring(corners):
        line = " ".join(f"{x},{y},0" for x, y in corners)
        return f"<LinearRing><coordinates>{line}</coordinates></LinearRing>"

    data = "".join(
        f'<Data name="{name}"><value>{value}</value></Data>' for name, value in properties.items()
    )
    path.write_text(
        '<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
        f"<name>range</name><ExtendedData>{data}</ExtendedData><Polygon><outerBoundaryIs>{ring(RING)}"
        f"</outerBoundaryIs><innerBoundaryIs>{ring(HOLE)}</innerBoundaryIs></Polygon></Placemark></Document></kml>"
    )


@pytest.mark.parametrize("kml", [False, True])
def test_each_format_holds_the_same_area(kml, tmp_path):
    properties = {"fence": True, **TIMES}
    path = written(tmp_path, area(RING, HOLE, fence=True, **TIMES))
    if kml:
        as_kml(path, properties)
    (found,) = read_areas(path)
    assert found.polygon == tuple(map(tuple, RING))
    assert found.holes == (tuple(map(tuple, HOLE)),)
    assert (found.name, found.fence, found.surface_only) == ("range", True, False)
    assert found.end_ns - found.begin_ns == 86400 * 10**9
    assert found.holds(found.end_ns, found.end_ns + 1)
    assert not found.holds(found.end_ns + 1, found.end_ns + 2)
    assert not found.holds(0, found.begin_ns - 1)
    assert replace(found, begin_ns=None).holds(0, 1)
    assert "overlaps its time" in area_notes(path, read_areas(path), GRID)[0]


@pytest.mark.parametrize(("value", "below"), [(True, True), (0, False), (None, False)])
def test_an_area_is_of_the_surface_alone_where_it_says_so(value, below, tmp_path):
    (found,) = read_areas(written(tmp_path, area(surface_only=value)))
    assert found.surface_only == below
