"""No-go areas as people draw them: open, crossing, holed, far away, latitude first."""

import json

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
        ([RING, RING[::-1], RING[::-1]], "range: its 2 holes count as part of the area"),
        (
            [[RING[0], RING[2], RING[1], RING[3], RING[0]]],
            "range: its outline crosses itself; what it winds around an odd number",
        ),
        ([[[x - 30.0, y] for x, y in RING]], "range: it lies outside of the region"),
        ([[[x + 1.0, y] for x, y in RING]], "range: it lies outside of the region"),
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
