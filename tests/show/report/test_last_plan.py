"""What a result holds of its last plan, and where it is shown: the page, figures, GeoJSON and KML."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from replay_kit.core.grid import Seabed
from replay_kit.core.plan import Area, Odds
from replay_kit.core.region import feature
from replay_kit.results import ResultWriter
from replay_kit.results.geojson import features_of
from replay_kit.results.views.contents import Contents
from replay_kit.show.export.export import export
from replay_kit.show.figures.kinds import drawn
from replay_kit.show.figures.map import Extent, bottom_lines, contour_step
from replay_kit.show.figures.plan import profile_floor
from replay_kit.show.notebook import read_result
from replay_kit.show.report.pages import report_html
from tests.results.result_samples import CONFIG, METADATA, decoded
from tests.show.figures.texts import words
from tests.show.report.html_of import figures, table, text_of
from tests.synthetic_flow import TIME_NS, synthetic_flow

ODDS = Odds(40, 0.725, 0.9, 250.0, 9e4, 7e4, 8e4)
AREAS = (
    Area("range", False, ((5.02, 62.01), (5.04, 62.01), (5.04, 62.03))),
    Area("lane", True, ((5.1, 62.0), (5.12, 62.0), (5.12, 62.02))),
)
LEGS = [
    {
        "leg": 1,
        "heading_deg": 45.4,
        "glide_angle_deg": 15.0,
        "depth_m": 100.0,
        "start_s": 0.0,
        "surfacing_s": 1800.0,
        "longitude": 5.01,
        "latitude": 62.0,
    }
]
ELLIPSE = {
    "ellipse_longitude": 5.01,
    "ellipse_latitude": 62.0,
    "ellipse_major_m": 900.0,
    "ellipse_minor_m": 300.0,
    "ellipse_bearing_deg": 30.0,
}
SEABED = Seabed(
    np.linspace(-15e3, 15e3, 7),
    np.linspace(-10e3, 10e3, 5),
    np.add.outer(50.0 * np.arange(5.0), 20.0 * np.arange(7.0)) - 30.0,
)
INPUTS = {"replay_kit.inputs": {"bathymetry": "bottom.nc sha256:00ff"}}


def written(path, plan, seabed=None, metadata=METADATA, estimate=False):
    flow = synthetic_flow()
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, TIME_NS, metadata, CONFIG)
        if seabed is not None:
            writer.seabed(TIME_NS, seabed)
        writer.plan(plan, flow.grid.projection)
        if estimate:
            writer.finish(flow)
    return Contents(read_result(path))


@pytest.fixture
def full(plan):
    legs = ({**LEGS[0], **ELLIPSE}, {**LEGS[0], "leg": 2})
    known = {
        "energy": 92_400.0,
        "battery": 2e6,
        "odds": ODDS,
        "areas": AREAS,
        "bottom": np.array([300.0, np.nan, 130.0]),
    }
    return replace(plan, status="uncertain", legs=legs, **known)


@pytest.fixture
def contents(full, tmp_path):
    return written(tmp_path / "out.mcap", full, SEABED, METADATA | INPUTS)


def test_what_was_written_is_read_back(contents, full):
    found = contents.last_plan
    for one in fields(found):
        if one.name not in ("areas", "statistics"):
            np.testing.assert_equal(getattr(found, one.name), getattr(full, one.name), one.name)
    assert [(area.name, area.surface_only) for area in found.areas] == [
        ("range", False),
        ("lane", True),
    ]
    np.testing.assert_allclose(found.areas[0].corners, AREAS[0].corners, atol=1e-7)
    seabed = contents.seabed
    for name in ("east", "north", "depth"):
        np.testing.assert_allclose(getattr(seabed, name), getattr(SEABED, name), atol=1e-6)


@pytest.mark.parametrize("energy", [np.nan, 0.0])
def test_a_plan_without_all_that_has_none_of_it(plan, tmp_path, energy):
    """A field that a message of an earlier version does not have reads as 0."""
    contents = written(tmp_path / "out.mcap", replace(plan, energy=energy, battery=energy))
    found = contents.last_plan
    assert np.isnan([found.energy, found.battery]).all()
    assert (found.odds, found.bottom, found.areas, contents.seabed) == (None, None, (), None)
    assert "battery" not in text_of(report_html(contents.result), "plan")


def test_the_page_shows_them(contents):
    page = report_html(contents.result)
    rows = dict(table(page, "The last plan"))
    assert (
        "<strong>uncertain</strong>: the predicted path passes the goal, but fewer flights"
        in rows["status"]
    )
    assert ">92 kJ<" in rows["energy"]
    assert "4.6 % of" in rows["energy"]
    assert ">2 MJ<" in rows["energy"]
    for part in (">72 %<", ">90 %<", ">250<"):
        assert part in rows["odds of arriving"], part
    assert rows["no-go areas"] == "range, lane (surface only)"
    assert rows["bathymetry"] == "bottom.nc, SHA-256 <code>00ff</code>"
    assert rows["least height above the bottom"] == "30 m"
    assert "The result holds no" not in text_of(page, "plan")
    assert "Odds of arriving72 %of 40 samples" in text_of(page, "map")
    found = figures(page)
    profile = found["plan-profile"]
    (panel,) = profile["panels"]
    assert panel["marks"][0]["y"] == [300.0, None, 130.0]
    assert panel["ends"][1] == [1.05 * 250.0, 0.0]
    assert [mark["name"] for mark in panel["marks"]] == ["bottom", "planned depth"]
    assert "Where it is not shown it is deeper than 262 m: it is 130 to 300 m deep." in text_of(
        page, "plan"
    )
    marks = found["current-map"]["map"]["marks"]
    depths = {mark["label"] for mark in marks if mark["role"] == "bottom"}
    # of what the map shows of the bottom
    assert {"130 m", "190 m"} <= depths <= {f"{depth} m" for depth in range(130, 200, 10)}
    areas = [(len(mark["x"]), set(mark["text"])) for mark in marks if mark["role"] == "no_go"]
    assert areas == [(4, {"no-go area range"}), (4, {"no-go area lane<br>surface only"})]
    assert [len(mark["x"]) for mark in marks if mark["role"] == "ellipse"] == [37]
    assert "Labelled lines: depth of the bottom, from bottom.nc." in text_of(page, "map")


@pytest.mark.full
def test_the_figures_show_them(full, tmp_path):
    contents = written(tmp_path / "out.mcap", full, SEABED, METADATA | INPUTS, estimate=True)
    figure = drawn(contents, "plan")
    assert "last plan: uncertain" in words(figure)
    assert "Energy 92 kJ, 4.6 % of 2 MJ. 72 % of 40 simulated flights arrive" in words(figure)
    lines = {line.get_label(): line for line in [*figure.axes[0].lines, *figure.axes[1].lines]}
    assert {"no-go area", "90 % of planned surfacings", "bottom"} <= set(lines)
    np.testing.assert_array_equal(lines["bottom"].get_ydata(), full.bottom)
    assert figure.axes[1].get_ylim() == (1.05 * 250.0, 0.0)
    axes = drawn(contents, "map").axes[0]
    labels = contour_labels(axes)
    assert labels
    assert labels <= {"50 m", "100 m", "150 m", "200 m", "250 m"}


def test_a_bottom_that_is_flat_or_out_of_sight_has_no_contours(plan, tmp_path):
    flat = replace_depth(np.full(SEABED.depth.shape, 100.0))
    contents = written(tmp_path / "flat.mcap", plan, flat, estimate=True)
    axes = drawn(contents, "map").axes[0]
    assert not contour_labels(axes)
    assert not bottom_lines(contents, Extent(100.0, 101.0, 0.0, 1.0))
    unknown = written(
        tmp_path / "unknown.mcap", plan, replace_depth(np.full(SEABED.depth.shape, np.nan))
    )
    assert "current-map" in figures(report_html(unknown.result))


def contour_labels(axes):
    return {text.get_text() for text in axes.texts if text.get_text().endswith("0 m")}


def replace_depth(depth):
    return Seabed(SEABED.east, SEABED.north, depth)


@pytest.mark.parametrize(
    ("span", "step"),
    [
        (0.0, 2.0),
        (14.0, 2.0),
        (14.1, 5.0),
        (35.0, 5.0),
        (70.0, 10.0),
        (3500.0, 500.0),
        (4000.0, 1000.0),
    ],
)
def test_contours_are_few_and_round(span, step):
    assert contour_step(span) == step


@pytest.mark.parametrize(
    ("depth", "ground", "floor"),
    [
        ([100.0], None, 105.0),
        ([100.0], [180.0], 189.0),
        ([100.0], [900.0], 262.5),
        ([100.0], [60.0, np.nan], 105.0),
        ([0.0], None, 1.05),
    ],
)
def test_a_profile_ends_below_the_bottom_or_in_sight_of_the_dives(depth, ground, floor):
    assert profile_floor(
        np.array(depth), None if ground is None else np.array(ground)
    ) == pytest.approx(floor)


def test_geojson_kml_and_the_channel_hold_areas_and_ellipses(contents, tmp_path):
    export(contents, tmp_path / "x.geojson")
    features = json.loads((tmp_path / "x.geojson").read_text())["features"]
    names = [feature["properties"]["name"] for feature in features]
    areas = ["no-go area range", "no-go area lane", "90 % ellipse of planned surfacing 1"]
    assert names == [*areas, "last plan", "planned surfacing 1", "start", "goal, 100 m"]
    about = features[3]["properties"]
    assert (
        about["status"],
        about["energy_j"],
        about["battery_j"],
        about["samples"],
        about["reached_share"],
    ) == (
        "uncertain",
        92_400.0,
        2e6,
        40,
        0.725,
    )
    (ring,) = features[0]["geometry"]["coordinates"]
    assert ring == [[5.02, 62.01], [5.04, 62.01], [5.04, 62.03], [5.02, 62.01]]
    assert features[1]["properties"]["surface_only"] is True
    export(contents, tmp_path / "x.kml")
    assert "5.0200000,62.0100000 5.0400000,62.0100000" in (tmp_path / "x.kml").read_text()
    ((_, value),) = decoded(contents.result.path)["/plan/geojson"]
    drawn = sorted(json.loads(value.geojson)["features"], key=str)
    assert drawn == sorted(features_of(contents), key=str)


def test_areas_of_earlier_results_are_known_by_their_kind(full, tmp_path, monkeypatch):
    about = {"name": "lane", "kind": "no_go", "surface_only": True}
    ring = [[5.0, 62.0], [5.1, 62.0], [5.1, 62.1], [5.0, 62.0]]
    one = feature("Polygon", [ring], about)
    monkeypatch.setattr("replay_kit.results.messages.plan_features", lambda *_: [one])
    (area,) = written(tmp_path / "out.mcap", full).last_plan.areas
    assert area == Area("lane", True, tuple(map(tuple, ring[:-1])))
