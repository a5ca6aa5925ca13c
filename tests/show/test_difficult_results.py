"""Results that lack something, or lie where maps are difficult: a page, every figure and every export of each shows what there is."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation
from replay_kit.core.plan import Plan
from replay_kit.results import ResultWriter
from replay_kit.results.views.contents import Contents
from replay_kit.show.export import ENDINGS, export
from replay_kit.show.figures.kinds import KINDS, drawn_figure
from replay_kit.show.report.pages import report_html
from replay_kit.workflows.report import opened_contents
from tests.results.cases import (
    across_the_antimeridian,
    failed,
    of_nothing,
    of_one_ping,
    without_estimate,
    write,
)
from tests.results.result_samples import CONFIG, METADATA
from tests.show.figures.texts import words
from tests.show.report.html_of import elements, figures

#: Writes a result to a path.
Case = Callable[[Path, FlowEstimate, Innovation, Plan], object]


def cut_short(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    write(path, flow, [innovation] * 3, plan)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])


def of_a_vessel(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    write(path, flow, [replace(innovation, dive=0)] * 3, plan, depth=float("nan"))


def without_positions(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, flow.time_ns or 0, METADATA, CONFIG)
        writer.innovations([innovation])
        writer.finish(flow)


def nothing_of_the_current(
    path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan
) -> None:
    write(path, flow, [innovation], None, grids=False, estimate=False)


def plan_failed(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    write(path, flow, [innovation], failed(plan))


ALL = {"plans", "section", "track"}
NO_CURRENT = "The result holds no published current."
#: Each case with what sections of its page and figures say of it, and which tables of its exports have rows.
CASES: dict[Case, tuple[dict[str, str], set[str]]] = {
    without_estimate: (
        {
            "answer": "carries no estimate.npz",
            "figure map": "The result holds no estimate: the map shows the last published current.",
        },
        ALL,
    ),
    cut_short: ({"answer": "The result is damaged or truncated: "}, {"section", "track"}),
    nothing_of_the_current: (
        {
            "figure map": "The result holds no current: the map shows only positions.",
            "figure series": NO_CURRENT,
            "figure trust": "Fewer than two grids with a standard error were published",
        },
        {"section", "track"},
    ),
    of_one_ping: (
        {
            "answer": "1 measurement of the current used",
            "figure plan": "The result holds no plan",
            "figure series": "The current was published once: there is no series.",
            "figure trust": "Fewer than two dives: none can be predicted from another.",
        },
        {"section", "track"},
    ),
    plan_failed: ({"figure plan": "The last plan has no track: no path."}, ALL),
    of_a_vessel: ({"answer": "without dives"}, ALL),
    across_the_antimeridian: ({"answer": "km travelled"}, ALL),
    without_positions: ({"answer": "Observations used: unknown"}, {"section"}),
    of_nothing: (
        {
            "answer": "The result holds neither a position nor a measurement.",
            "map": "no current",
            "section": "no profile",
            "trust": "no measurement",
            "plan": "no plan",
            "again": "does not name its inputs.",
            "figure map": "The result holds neither a current nor a position.",
            "figure series": NO_CURRENT,
            "figure trust": "The result holds no measurement to compare the estimate with.",
        },
        set(),
    ),
}
# the others take seconds each
QUICK = (nothing_of_the_current, plan_failed, of_nothing)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case in QUICK else pytest.mark.full, id=case.__name__)
        for case in CASES
    ],
)
def test_each_is_shown_and_exported(case, flow, innovation, plan, tmp_path):
    case(tmp_path / "case.mcap", flow, innovation, plan)
    said, tables = CASES[case]
    with opened_contents(tmp_path / "case.mcap") as contents:
        page = report_html(contents.result, contents.notes)
        # a section without a figure says why
        for attrs, text in elements(page, "section"):
            assert len(text) > 60, attrs
            assert said.get(attrs["id"], "") in text
        assert all(figure.get("panels") or figure.get("map") for figure in figures(page).values())
        for kind in KINDS:
            figure = drawn_figure(contents, kind, columns=1)
            assert said.get(f"figure {kind}", "") in words(figure)
            figure.draw_without_rendering()
            # axes that are off hold the legend
            for axes in filter(lambda axes: axes.axison, figure.axes):
                assert axes.has_data() or axes.texts, kind
                assert axes.get_position().height > 0.02
        _check_exports(contents, tmp_path, tables)


def _check_exports(contents: Contents, folder: Path, tables: set[str]) -> None:
    """See that each export has the rows that are there, that it can be read, and that it says so where there are none."""
    for ending in ENDINGS:
        rows = export(contents, folder / f"out{ending}")
        # of a failed plan a map has start and goal alone
        failed_plan = tables == ALL and ending in (".nc", ".csv") and not rows.get("plans", 1)
        expected = tables - ({"plans"} if failed_plan else set())
        assert {name for name in ALL if rows.get(name)} == expected & set(rows), ending
    with xr.open_dataset(folder / "out.nc") as found:
        assert {str(name) for name in found.sizes} >= tables - {"plans"}
    track = pd.read_csv(folder / "out.csv")
    assert (len(track) > 0) == ("track" in tables)
    features = json.loads((folder / "out.geojson").read_text())["features"]
    assert bool(features) == bool(tables & {"track", "plans"})
    for feature in features:
        if feature["geometry"]["type"] == "LineString":
            longitudes = np.array(feature["geometry"]["coordinates"])[:, 0]
            assert np.all(np.abs(np.diff(longitudes)) < 1.0)
    ElementTree.parse(folder / "out.kml")


def test_of_radars_alone_the_map_shows_the_first_depth(tmp_path, flow, innovation):
    radar = replace(innovation, mean_kind="radar")
    contents = write(tmp_path / "r.mcap", flow, [radar], None, depth=float("nan"))
    first, *_, last = contents.slices.depths
    assert contents.dive_depth == max(first, 1.0) < last
