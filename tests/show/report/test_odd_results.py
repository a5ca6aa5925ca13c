"""Results with something missing: the page shows what there is, and says what is not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.geodesy import heading_deg, to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, checked_outcome
from replay_kit.results.outcome.parts import plan_part
from replay_kit.show.notebook import read_result
from replay_kit.show.report.pages import report_html
from tests.results.cases import failed, placed, write_many
from tests.results.result_samples import CONFIG, METADATA
from tests.show.report.html_of import figures, table, text_of, track_of, unpacked
from tests.show.report.replays import peak_of_report
from tests.show.status.held_samples import plan as planned
from tests.synthetic_flow import TIME_NS

SECOND, CENTRE = 10**9, Projection(5.0, 62.0)


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a result with a function of its writer, and returns its page."""

    def make(fill=lambda writer: None, projection=CENTRE, estimate=None):
        with ResultWriter(tmp_path / "out.mcap", overwrite=True) as writer:
            writer.start(projection, TIME_NS, METADATA, CONFIG)
            fill(writer)
            if estimate is not None:
                writer.finish(estimate)
        page = report_html(read_result(tmp_path / "out.mcap"))
        assert str(tmp_path) not in page
        return page

    return make


def test_one_ping_without_an_estimate(write, state, innovation):
    page = write(
        lambda writer: (writer.fix(state), writer.innovations([replace(innovation, dive=0)]))
    )
    found, words = figures(page), text_of(page, "answer")
    assert list(found) == ["current-map", "profiles", "innovations"]
    for said in (
        "without dives",
        "Observations used: unknown.",
        "Replay the log again, to its end",
    ):
        assert said in words


def test_an_estimate_alone_is_drawn_at_its_levels(write, state, flow):
    page = write(estimate=flow)
    figure = figures(page)["current-map"]
    depths = ["mean to 200 m", "0.5 m", "50 m", "200 m"]
    assert figure["choices"] == [["speed", "standard error"], depths, ["2023-11-14 22:13"]]
    # the deepest level is dry in a corner, where the mean is over the water above it
    mean, shallow = unpacked(figure["packed"]["current"])[:2, -1, 0]
    np.testing.assert_array_equal(np.isfinite(mean), np.isfinite(shallow))

    def at(x, y):
        near = replace(state, longitude=x, latitude=y)
        return write(lambda writer: writer.fix(near), estimate=flow)

    # nor has a vehicle far from it a section
    assert "profiles" not in figures(at(-128.0, 51.7))
    here = flow.velocity_at(5.2, 62.03, np.linspace(0.0, state.depth))
    assert f"toward {heading_deg(here.u.mean(), here.v.mean()):03.0f}°" in at(5.2, 62.03)


@pytest.mark.parametrize(
    ("longitude", "latitude"), [(180.0, -40.0), (-179.9, 80.0), (5.0, 80.0), (0.0, 89.5)]
)
def test_anywhere_on_the_globe(write, state, longitude, latitude):
    projection = Projection(longitude, latitude)
    ends = np.transpose(to_geographic(projection, [-4e3, 4e3], [-2e3, 2e3])).tolist()

    def fill(writer: ResultWriter) -> None:
        for k, (x, y) in enumerate(ends):
            writer.fix(replace(state, time_ns=TIME_NS + k * SECOND, longitude=x, latitude=y))

    page = write(fill, projection, placed(longitude, latitude))
    drawn, track = figures(page)["current-map"]["map"], track_of(page)
    np.testing.assert_allclose([track["x"], track["y"]], [[-4.0, 4.0], [-2.0, 2.0]], atol=2e-3)
    west, east = drawn["views"]["region"][:2]
    assert west < -4.0 < 4.0 < east
    frame = drawn["frame"]
    nodes = np.array([frame["longitude"], frame["latitude"]]).reshape(2, frame["nodes"], -1)
    # between nodes the script interpolates
    middle = nodes.mean(axis=(1, 2)) if latitude < 85.0 else nodes[:, 16, 16]
    np.testing.assert_allclose(middle[1], latitude, atol=0.05)
    assert abs((middle[0] - longitude + 180.0) % 360.0 - 180.0) < 0.05
    assert "8.9 km travelled" in text_of(page, "answer")


def test_plans_that_failed_and_surfacings_with_and_without_ellipses(write, state, plan):
    last = failed(plan, "no <way>")

    def fill(writer: ResultWriter) -> None:
        writer.fix(state)
        for one in (plan, last):
            writer.plan(one, CENTRE)
        writer.summary(TIME_NS, checked_outcome({"plan": plan_part(last)}))
        for ellipse in (None, Ellipse(5.0, 62.0, 300.0, 200.0, 10.0)):
            predicted = Surfacing(TIME_NS + SECOND, 5.0, 62.0, ellipse)
            actual = TIME_NS + 5 * SECOND, 5.01, 62.01, 1234.5, 30.0
            writer.outcome(SurfacingOutcome(TIME_NS, predicted, *actual))

    page = write(fill)
    assert "No plan was found: no <way>." in text_of(page, "answer")
    assert "no <way>" not in page.split("<script")[0]
    found = figures(page)
    roles = [mark["role"] for mark in found["current-map"]["map"]["marks"]]
    assert (roles.count("past"), roles.count("plan")) == (1, 0)
    (errors,) = found["surfacing-errors"]["panels"][0]["marks"]
    assert errors["x"] == [0.61725] * 2


def test_a_million_positions_are_thinned_and_it_is_said(write, state):
    def fill(writer: ResultWriter) -> None:
        for k in range(4000):
            writer.fix(replace(state, time_ns=TIME_NS + k * SECOND, longitude=5.0 + 1e-5 * k))

    track = track_of(page := write(fill))
    assert len(track["x"]) == len(track["text"]) == 3000
    assert track["text"][-1].startswith("track 2023-11-14 23:19")
    assert "Of 4,000 positions 3,000 are drawn, evenly spread." in text_of(page, "map")


@pytest.mark.full
def test_a_report_of_a_million_pings_takes_less_than_600_mb(tmp_path, flow, state, innovation):
    write_many(tmp_path / "many.mcap", flow, state, innovation, 1_000_000)
    assert peak_of_report(tmp_path / "many.mcap", tmp_path / "many.html") < 600e3
    page = (tmp_path / "many.html").read_text(encoding="utf-8")
    assert "of 1,000,000 measurements are drawn, evenly spread." in text_of(page, "trust")


def test_a_verdict_keeps_its_capitals(write):
    said = "the forecast is of 2018-11-16T00:00Z"
    page = write(lambda writer: writer.summary(TIME_NS, Outcome(outside=(said,))))
    assert f"Do not use: no observation was used; {said}." in page


def test_a_plan_alone_is_drawn(write, plan):
    legs = planned(TIME_NS).legs
    page = write(lambda writer: writer.plan(replace(plan, legs=legs), CENTRE))
    found = figures(page)
    assert list(found) == ["current-map", "plan-profile"]
    (depth,) = found["plan-profile"]["panels"][0]["marks"]
    np.testing.assert_allclose(depth["x"], np.hypot([0.0, 0.5, 1.0], [0.0, 0.6, 1.2]), atol=1e-5)
    assert "--no-estimate" not in text_of(page, "answer")
    first, _ = table(page, "Legs of the last plan")
    shown = [re.sub(r"<[^>]+>", "", cell) for cell in first]
    assert shown == ["1", "80", "20.0", "500", "4.0", "5.1000", "62.0000"]
