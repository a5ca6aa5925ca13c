"""No-go areas as people draw them: open, crossing, holed, far away, latitude first."""

import json
from dataclasses import replace

import pytest

from replay_kit.core.errors import PlanError
from replay_kit.workflows.planning.areas import area_notes, read_areas
from tests.planners.flow_samples import still_flow

GRID = still_flow().grid
RING = [[152.4, -40.1], [152.5, -40.1], [152.5, -40.0], [152.4, -40.0], [152.4, -40.1]]


def written(path, rings):
    polygon = {
        "type": "Feature",
        "properties": {"name": "range"},
        "geometry": {"type": "Polygon", "coordinates": rings},
    }
    path = path / "areas.geojson"
    path.write_text(json.dumps(polygon))
    return path


@pytest.mark.parametrize(
    ("rings", "note"),
    [
        ([RING], None),
        ([[[*corner, 12.0] for corner in RING]], None),
        ([[[x - 360.0, y] for x, y in RING]], None),
        ([RING[:-1]], "range: its outline is open; it is closed from the last corner to the first"),
        ([RING, RING[::-1]], None),
        (
            [[RING[0], RING[2], RING[1], RING[3], RING[0]]],
            "range: its outline crosses itself; filled by the even-odd rule",
        ),
        ([[[x - 30.0, y] for x, y in RING]], "range: lies outside the region"),
        ([[[x + 1.0, y] for x, y in RING]], "range: lies outside the region"),
    ],
)
def test_what_should_be_known_of_an_area_is_noted(rings, note, tmp_path):
    path = written(tmp_path, rings)
    notes = area_notes(path, GRID)
    assert len(notes) == (note is not None)
    assert note is None or notes[0].startswith(note)
    assert read_areas(path)[0].polygon[0] == tuple(rings[0][0][:2])


def test_latitude_first_is_found_by_where_the_region_is(tmp_path):
    with pytest.raises(
        PlanError,
        match=r"range has corners such as -40.1, 152.4, .* GeoJSON has longitude first: swap them",
    ):
        area_notes(written(tmp_path, [[[y, x] for x, y in RING]]), GRID)


AREA = {"type": "Polygon", "coordinates": [RING]}


@pytest.mark.parametrize(
    ("document", "count"),
    [
        (AREA, 1),
        ({"type": "MultiPolygon", "coordinates": [[RING], [RING]]}, 2),
        ({"type": "LineString", "coordinates": RING}, 1),
        ({"type": "MultiLineString", "coordinates": [RING, RING[:-1]]}, 2),
        (
            {
                "type": "GeometryCollection",
                "geometries": [AREA, {"type": "LineString", "coordinates": RING}],
            },
            2,
        ),
        (
            {
                "type": "Feature",
                "properties": None,
                "geometry": {"type": "LineString", "coordinates": RING},
            },
            1,
        ),
        (
            {
                "type": "FeatureCollection",
                "features": [{"type": "Feature", "properties": {}, "geometry": AREA}] * 3,
            },
            3,
        ),
    ],
)
def test_geometries_alone_and_lines_are_read_as_areas(document, count, tmp_path):
    path = tmp_path / "areas.geojson"
    # some programs begin their files with a byte order mark
    path.write_text(json.dumps(document), encoding="utf-8-sig")
    areas = read_areas(path)
    assert len(areas) == count
    assert all(set(area.polygon) == {tuple(corner) for corner in RING} for area in areas)
    drawn = "drawn as a line; the enclosed area is forbidden"
    assert any(drawn in note for note in area_notes(path, GRID)) == (
        "LineString" in json.dumps(document)
    )


KML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><name>range</name></Placemark></kml>"""


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (KML, "got KML without polygons or lines; convert it"),
        ("<gpx/>", "got XML;"),
        ("PK\x03\x04areas", "got a zip file, such as KMZ;"),
        ("", "got nothing;"),
        ("152.4,-40.1\n152.5,-40.1\n", "got invalid JSON (Extra data"),
        ("{}", "got an object without a type as no-go area 1;"),
        (
            '{"type": "FeatureCollection", "features": [{"type": "Polygon"}]}',
            "got Polygon as feature 1;",
        ),
        (
            '{"type": "Feature", "properties": {"name": "range"}, "geometry": null}',
            "got null as range;",
        ),
        ('{"type": "Point", "coordinates": [152.4, -40.1]}', "got Point as no-go area 1;"),
        ('{"type": "Polygon"}', "got no-go area 1 without corners;"),
        (
            '{"type": "Polygon", "coordinates": [[152.4, -40.1]]}',
            "got no-go area 1 with corners that are not pairs of numbers;",
        ),
        (
            '{"type": "LineString", "coordinates": [[152.4, -40.1], [152.5, -40.1]]}',
            "got no-go area 1 with fewer than 3 corners;",
        ),
    ],
)
def test_what_is_no_area_is_refused_in_words(text, found, tmp_path):
    path = tmp_path / "areas.txt"
    path.write_text(text)
    with pytest.raises(PlanError) as refused:
        read_areas(path)
    assert (
        f"{path}: expected GeoJSON or KML with polygons of longitude and latitude, or lines around areas, {found}"
        in str(refused.value)
    )
    assert "Error" not in str(refused.value)


HOLE = [[152.43, -40.07], [152.47, -40.07], [152.47, -40.03], [152.43, -40.03], [152.43, -40.07]]
TIMES = {"begin": "2026-05-01T00:00Z", "end": "2026-05-02T00:00Z"}


def as_geojson(path, properties):
    geometry = {"type": "Polygon", "coordinates": [RING, HOLE]}
    path.write_text(json.dumps({"type": "Feature", "properties": properties, "geometry": geometry}))


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


@pytest.mark.parametrize("write", [as_geojson, as_kml])
def test_each_format_holds_the_same_area(write, tmp_path):
    path = tmp_path / "areas"
    write(path, {"name": "range", "fence": True, **TIMES})
    (area,) = read_areas(path)
    assert area.polygon == tuple(map(tuple, RING))
    assert area.holes == (tuple(map(tuple, HOLE)),)
    assert (area.name, area.fence, area.surface_only) == ("range", True, False)
    assert area.end_ns - area.begin_ns == 86400 * 10**9
    assert area.holds(area.end_ns, area.end_ns + 1)
    assert not area.holds(area.end_ns + 1, area.end_ns + 2)
    assert not area.holds(0, area.begin_ns - 1)
    assert replace(area, begin_ns=None).holds(0, 1)
    assert "overlaps its time" in area_notes(path, GRID)[0]


@pytest.mark.parametrize(
    ("properties", "found"),
    [
        ({"begin": "soon"}, "with the time 'soon'"),
        ({"begin": TIMES["end"], "end": TIMES["begin"]}, "ends before it begins"),
        ({"fence": "perhaps"}, "fence 'perhaps', neither true nor false"),
        ({"surface_only": "false"}, "neither true nor false"),
    ],
)
def test_properties_that_are_none_are_refused(properties, found, tmp_path):
    as_geojson(tmp_path / "areas", properties)
    with pytest.raises(PlanError, match=found):
        read_areas(tmp_path / "areas")


@pytest.mark.parametrize(("value", "below"), [(True, True), (0, False), (None, False)])
def test_an_area_is_of_the_surface_alone_where_it_says_so(value, below, tmp_path):
    as_geojson(tmp_path / "areas", {"surface_only": value})
    assert read_areas(tmp_path / "areas")[0].surface_only == below


def test_damaged_files_of_areas_are_refused(tmp_path):
    path = tmp_path / "areas"
    for data, words in (
        (b"SQLite format 3\0", "got a database, such as a GeoPackage"),
        (b"\x89" + bytes(1000), "^.{,400}$"),
    ):
        path.write_bytes(data)
        with pytest.raises(PlanError, match=words):
            read_areas(path)
    for text in ("<kml", "<!DOCTYPE kml [<!ENTITY a 'b'>]><kml/>"):
        path.write_text(text)
        with pytest.raises(PlanError, match="KML"):
            read_areas(path)
