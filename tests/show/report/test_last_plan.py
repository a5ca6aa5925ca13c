"""What a result holds of its last plan, and where it is shown: the page, figures, GeoJSON and KML."""

import json
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.grid import Seabed
from replay_kit.core.plan import Area
from replay_kit.core.region import feature
from replay_kit.results import ResultWriter
from replay_kit.results.geojson import features_of
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.views.contents import Contents
from replay_kit.show.export import export
from replay_kit.show.figures.kinds import drawn_figure
from replay_kit.show.notebook import read_result
from replay_kit.show.report.pages import report_html
from tests.results.result_samples import CONFIG, METADATA, decoded
from tests.show.figures.texts import words
from tests.show.report.html_of import figures, table, text_of
from tests.show.status.held_samples import plan as planned
from tests.synthetic_flow import TIME_NS, synthetic_flow

CORNERS = ((5.02, 62.01), (5.04, 62.01), (5.04, 62.03))
HOLE = ((5.03, 62.012), (5.036, 62.016), (5.036, 62.012))
AREAS = (Area("range", False, CORNERS, (HOLE,)), Area("lane", True, CORNERS))
EAST, NORTH = np.linspace(-15e3, 15e3, 7), np.linspace(-10e3, 10e3, 5)
DEPTH = np.add.outer(50.0 * np.arange(5.0), 20.0 * np.arange(7.0)) - 30.0
INPUTS = METADATA | {"replay_kit.inputs": {"bathymetry": "bottom.nc sha256:00ff"}}


def written(path, plan, depth=None, metadata=METADATA, estimate=False, outcome=None):
    flow = synthetic_flow()
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, TIME_NS, metadata, CONFIG)
        if depth is not None:
            writer.seabed(TIME_NS, Seabed(EAST, NORTH, depth))
        writer.plan(plan, flow.grid.projection)
        if outcome is not None:
            writer.summary(TIME_NS, outcome)
        if estimate:
            writer.finish(flow)
    return Contents(read_result(path))


@pytest.fixture
def full(plan):
    mission = planned(TIME_NS)
    known = {name: getattr(mission, name) for name in ("energy", "battery", "odds", "legs")}
    ground = np.array([300.0, np.nan, 130.0])
    return replace(plan, status="uncertain", areas=AREAS, bottom=ground, **known)


@pytest.fixture
def contents(full, tmp_path):
    return written(tmp_path / "out.mcap", full, DEPTH, INPUTS)


@pytest.mark.parametrize("energy", [np.nan, 0.0])
def test_a_plan_without_all_that_has_none_of_it(plan, tmp_path, energy):
    """A field that a message of an earlier version does not have reads as 0."""
    contents = written(tmp_path / "out.mcap", replace(plan, energy=energy, battery=energy))
    found = contents.last_plan
    assert np.isnan([found.energy, found.battery]).all()
    assert (found.odds, found.bottom, found.areas, contents.seabed) == (None, None, (), None)
    assert "battery" not in text_of(report_html(contents.result), "plan")


def test_all_goals_are_on_the_map_in_order_and_a_plan_alone_is_said_to_be_one(plan, tmp_path):
    outcome = Outcome(plan={"status": "reached", "message": ""}, complete=False)
    both = replace(plan, via=(replace(plan.goal, depth=0.0),))
    contents = written(tmp_path / "out.mcap", both, outcome=outcome)
    named = [one["properties"]["name"] for one in features_of(contents)]
    assert [name for name in named if "goal" in name] == ["goal 1, 0 m", "goal 2, 100 m"]
    page = report_html(contents.result)
    assert "No verdict: this is a plan alone" in page
    assert "the run did not finish" not in page
    assert "Check before use" not in page


def test_the_page_shows_them(contents):
    page = report_html(contents.result)
    rows = dict(table(page, "The last plan"))
    for name, parts in (
        ("status", ["<strong>uncertain</strong>: the predicted path passes the goal, but fewer"]),
        ("energy", [">250 kJ<", "25.0 % of", ">1 MJ<"]),
        ("odds of arriving", [">90 %<", ">100 %<", ">250<"]),
        ("bathymetry", ["bottom.nc, SHA-256 <code>00ff</code>"]),
        ("least height above the bottom", ["30 m"]),
    ):
        assert all(part in rows[name] for part in parts), name
    said = text_of(page, "plan")
    assert "Where it is not shown it is deeper than 262 m: it is 130 to 300 m deep." in said
    found = figures(page)
    (panel,) = found["plan-profile"]["panels"]
    assert panel["marks"][0]["y"] == [300.0, None, 130.0]
    marks = found["current-map"]["map"]["marks"]
    depths = {mark["label"] for mark in marks if mark["role"] == "bottom"}
    # of what the map shows of the bottom
    assert {"130 m", "190 m"} <= depths <= {f"{depth} m" for depth in range(110, 220, 10)}
    areas = [(len(mark["x"]), set(mark["text"])) for mark in marks if mark["role"] == "no_go"]
    # the way to the hole and back is part of the ring
    assert areas == [(9, {"no-go area range"}), (4, {"no-go area lane<br>surface only"})]
    assert [len(mark["x"]) for mark in marks if mark["role"] == "ellipse"] == [37, 37]


@pytest.mark.full
def test_the_figures_show_them(full, tmp_path):
    contents = written(tmp_path / "out.mcap", full, DEPTH, INPUTS, estimate=True)
    figure = drawn_figure(contents, "plan")
    assert "Energy 250 kJ, 25.0 % of 1 MJ. 90 % of 10 simulated flights" in words(figure)
    labels = contour_labels(drawn_figure(contents, "map"))
    assert set() < labels <= {"50 m", "100 m", "150 m", "200 m", "250 m"}


def contour_labels(figure):
    texts = [text.get_text() for text in figure.axes[0].texts]
    return {text for text in texts if text.endswith("0 m")}


def test_a_bottom_that_is_flat_unknown_or_out_of_sight_has_no_contours(plan, tmp_path):
    flat = written(tmp_path / "flat.mcap", plan, np.full_like(DEPTH, 100.0), estimate=True)
    assert not contour_labels(drawn_figure(flat, "map"))
    unknown = written(tmp_path / "unknown.mcap", plan, np.full_like(DEPTH, np.nan))
    assert "current-map" in figures(report_html(unknown.result))


def test_geojson_kml_and_the_channel_hold_areas_and_ellipses(contents, tmp_path):
    export(contents, tmp_path / "x.geojson")
    found = json.loads((tmp_path / "x.geojson").read_text())["features"]
    kinds = [one["properties"]["name"].rstrip(" 12") for one in found]
    assert (
        kinds[:4]
        == ["no-go area range", "no-go area lane"] + ["90 % ellipse of planned surfacing"] * 2
    )
    numbers = {"energy_j": 250_000.0, "battery_j": 1e6, "samples": 10, "reached_share": 0.9}
    assert found[4]["properties"].items() >= numbers.items()
    rings = [[[*at] for at in (*ring, ring[0])] for ring in (CORNERS, HOLE)]
    assert found[0]["geometry"]["coordinates"] == rings
    assert found[1]["properties"]["surface_only"] is True
    export(contents, tmp_path / "x.kml")
    outer, _, inner = (tmp_path / "x.kml").read_text().partition("<innerBoundaryIs>")
    assert "5.0200000,62.0100000 5.0400000,62.0100000" in outer
    assert "5.0300000,62.0120000" in inner
    # an ellipse is shown when the glider comes up
    assert f"<when>{found[3]['properties']['surfaces']}<" in inner
    ((_, value),) = decoded(contents.result.path)["/plan/geojson"]
    drawn_ones = sorted(json.loads(value.geojson)["features"], key=str)
    assert drawn_ones == sorted(features_of(contents), key=str)


def test_areas_of_earlier_results_are_known_by_their_kind(full, tmp_path, monkeypatch):
    ring = [*map(list, CORNERS), [*CORNERS[0]]]
    one = feature("Polygon", [ring], {"name": "lane", "kind": "no_go", "surface_only": True})
    monkeypatch.setattr("replay_kit.results.mcap.writer.plan_features", lambda *_: [one])
    assert written(tmp_path / "out.mcap", full).last_plan.areas == AREAS[1:]
