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
from replay_kit.results.schemas import CONTRACT_VERSION
from replay_kit.results.views.contents import Contents
from replay_kit.show.export.export import ENDINGS, export
from replay_kit.show.figures.kinds import KINDS, drawn
from replay_kit.show.report.pages import report_html
from replay_kit.workflows.report import opened
from tests.results.cases import (
    across_the_antimeridian,
    at_80_north,
    of_nothing,
    of_one_ping,
    without_estimate,
    write,
)
from tests.results.result_samples import CONFIG, METADATA
from tests.show.report.html_of import elements, figures, text_of

#: Writes a result to a path.
Case = Callable[[Path, FlowEstimate, Innovation, Plan], object]


def of_another_version(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("replay_kit.results.mcap_writer.CONTRACT_VERSION", 4)
        write(path, flow, [innovation] * 3, plan)


def cut_short(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    write(path, flow, [innovation] * 3, plan)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])


def without_plan(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    write(path, flow, [innovation] * 3, None)


def of_a_vessel(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    write(path, flow, [replace(innovation, dive=0)] * 3, plan, depth=float("nan"))


def without_positions(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> None:
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, flow.time_ns or 0, METADATA, CONFIG)
        writer.innovations([innovation])
        writer.finish(flow)


#: Each case, what its page says of it, and which tables of its exports have rows.
CASES: list[tuple[Case, str, set[str]]] = [
    (
        of_another_version,
        f"The result has version 4 of the contract, this program version {CONTRACT_VERSION}",
        {"plans", "section", "track"},
    ),
    (without_estimate, "carries no estimate.npz", {"plans", "section", "track"}),
    (cut_short, "The result is damaged or truncated: ", {"section", "track"}),
    (without_plan, "The result holds no plan", {"section", "track"}),
    (of_one_ping, "1 measurement of the current used", {"section", "track"}),
    (
        of_a_vessel,
        "without dives",
        {"plans", "section", "track"},
    ),
    (across_the_antimeridian, "km travelled", {"plans", "section", "track"}),
    (at_80_north, "km travelled", {"plans", "section", "track"}),
    (without_positions, "Observations used: unknown", {"section"}),
    (of_nothing, "The result holds neither a position nor a measurement.", set()),
]
# the others take seconds each
QUICK = (cut_short, without_plan, without_positions, of_nothing)


@pytest.mark.parametrize(
    ("case", "said", "tables"),
    [
        pytest.param(*each, id=each[0].__name__, marks=() if each[0] in QUICK else pytest.mark.full)
        for each in CASES
    ],
)
def test_each_is_shown_and_exported(
    case,
    said,
    tables,
    flow,
    innovation,
    plan,
    tmp_path,
):
    case(tmp_path / "case.mcap", flow, innovation, plan)
    with opened(tmp_path / "case.mcap") as contents:
        page = report_html(contents.result, contents.notes)
        assert said in " ".join(text_of(page, section) for section in ("answer", "plan"))
        # a section without a figure says why
        for attrs, text in elements(page, "section"):
            assert len(text) > 60, attrs
        assert all(figure.get("panels") or figure.get("map") for figure in figures(page).values())
        for kind in KINDS:
            figure = drawn(contents, kind, columns=1)
            assert figure.axes
            # axes that are off hold the legend
            for axes in figure.axes:
                assert axes.has_data() or axes.texts or not axes.axison, (
                    kind,
                    axes.get_title(loc="left"),
                )
        _check_exports(contents, tmp_path, tables)


def _check_exports(contents: Contents, folder: Path, tables: set[str]) -> None:
    """See that each export has the rows that are there, that it can be read, and that it says so where there are none."""
    for ending in ENDINGS:
        rows = export(contents, folder / f"out{ending}")
        assert {name for name in ("plans", "section", "track") if rows.get(name)} == tables & set(
            rows
        ), ending
    with xr.open_dataset(folder / "out.nc") as found:
        assert {str(name) for name in found.sizes} >= tables
    track = pd.read_csv(folder / "out.csv")
    assert (len(track) > 0) == ("track" in tables)
    features = json.loads((folder / "out.geojson").read_text())["features"]
    assert bool(features) == bool(tables & {"track", "plans"})
    for feature in features:
        if feature["geometry"]["type"] == "LineString":
            longitudes = np.array(feature["geometry"]["coordinates"])[:, 0]
            assert np.all(np.abs(np.diff(longitudes)) < 1.0)
    ElementTree.parse(folder / "out.kml")
