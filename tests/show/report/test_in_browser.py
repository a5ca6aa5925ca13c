"""Reports in Debian's Chromium: every figure is drawn, nothing is fetched, controls change the picture."""

import json
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.results.views.steering import Dives, GriddedCurrents, fly_to_waypoints
from replay_kit.show.report.pages import report_html
from tests.browser import (
    MARKS,
    SCHEMES,
    WIDTHS,
    check_accessible,
    check_drawn,
    chromium,
    opened,
    unfold,
)
from tests.places import SAMPLES
from tests.results.cases import turned, write
from tests.show.report.html_of import elements, figures, unpacked
from tests.show.report.replays import month, peak_of_report, sample, seaglider
from tests.synthetic_flow import synthetic_flow

pytestmark = MARKS
# as functions: the page allows no eval of expressions
FITTED = """() => {
    const plots = [...document.querySelectorAll(".plot[data-drawn]")].filter((plot) => plot.clientWidth);
    return plots.every((plot) => (plot.querySelector("svg.main-svg, canvas")).clientWidth === plot.clientWidth);
}"""
FLIGHTS = """() => {
    const { flight, tables } = state.map.figure;
    return { waypoints: flight.waypoints, ...tables.flights };
}"""
LANDED = """(key) => {
    const part = document.getElementById(key);
    const off = part.getBoundingClientRect().top - document.querySelector("header").offsetHeight;
    const end = scrollY + innerHeight >= document.documentElement.scrollHeight - 2;
    return !part.querySelector("details.main:not([open])") && (end || Math.abs(off) < 40);
}"""
PLACES = """() => state.map.figure.flight.waypoints.map(([x, y]) => toScreen(state.map, x / 1e3, y / 1e3))"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as own:
        yield own


@pytest.mark.parametrize(("result", "largest"), [(sample, 2e6), (seaglider, 2e6), (month, 2.5e6)])
def test_a_report_is_written_draws_itself_and_obeys(browser, result, largest, tmp_path):
    page = tmp_path / "page.html"
    assert peak_of_report(result(tmp_path), page) < 600e3
    assert page.stat().st_size < largest
    for width, scheme in product(WIDTHS, SCHEMES):
        with opened(browser, page.read_text(encoding="utf-8"), width, scheme) as tab:
            check_accessible(tab)
            _check_controls(tab)
            _check_links(tab)
            unfold(tab)
            assert check_drawn(tab, width) >= 6
            check_accessible(tab)
            _check_data(tab)
            tab.set_viewport_size({"width": 700, "height": 900})
            tab.wait_for_function(FITTED)


def _check_controls(tab: Any) -> None:
    """Check that quantity, depth and time of the map each change its picture."""
    picture = tab.locator("#current-map .plot")
    pictures = [picture.screenshot()]
    for control, value in (("current-map-1", "1"), ("current-map-2", "0")):
        tab.locator(f"#{control}").fill(value)
        tab.wait_for_function(
            "([k, v]) => document.querySelector('#current-map .plot').dataset.choices.split(',')[k] === v",
            arg=[int(control[-1]), value],
        )
        pictures.append(picture.screenshot())
    tab.locator("#current-map-0").select_option("1")
    tab.wait_for_function(
        "() => document.querySelector('#current-map .plot').dataset.choices.startsWith('1')"
    )
    pictures.append(picture.screenshot())
    # by the keyboard alone
    picture.focus()
    picture.press("ArrowRight")
    pictures.append(picture.screenshot())
    picture.press("+")
    pictures.append(picture.screenshot())
    assert "°" in tab.locator(".tip").inner_text()
    tab.locator("[data-view=region]").press("Enter")
    pictures.append(picture.screenshot())
    assert len(set(pictures)) == 7
    last = int(tab.locator("#current-map-2").get_attribute("max"))
    tab.locator("#current-map-2").fill("0")
    assert tab.evaluate("() => state.map.until === state.map.drawn.times[0]")
    tab.locator("#current-map-2").fill(str(last))
    assert tab.evaluate("() => state.map.until === Infinity")


def _check_links(tab: Any) -> None:
    """Check that each link of the menu opens its part, and lands there below the header."""
    for link in tab.locator("nav a").all():
        link.click()
        key = (link.get_attribute("href") or "")[1:]
        tab.wait_for_function(
            LANDED,
            arg=key,
        )


def _check_data(tab: Any) -> None:
    """Check the CSV of a table of columns, and of one of packed fields."""
    with tab.expect_download() as download:
        tab.locator("button[data-table=track]").click()
    lines = Path(download.value.path()).read_text().splitlines()
    assert lines[0] == "time,longitude,latitude,depth_m,east_km,north_km,hours,dead_reckoned"
    assert len(lines) > 100
    with tab.expect_download() as download:
        tab.locator("button[data-table=current]").click()
    assert (
        Path(download.value.path())
        .read_text()
        .startswith("depth_m,time,longitude,latitude,u_m_s,v_m_s,")
    )


def flown(page: str, waypoints: list[list[float]]) -> list[tuple[float, float, bool]]:
    """Return duration [s], miss [m] and whether the goal is reached over waypoints in the estimate and its samples, flown in Python."""
    figure = figures(page)["current-map"]
    flight, axes = (
        figure["flight"],
        [np.array(figure["flight"][name]) for name in ("depths", "east", "north")],
    )
    currents, own = GriddedCurrents(*axes, unpacked(figure["packed"]["currents"])), flight["dives"]
    dives = Dives(
        own["speed"],
        np.rad2deg(own["angle"]),
        own["depth"],
        own["surfaceTime"],
        own["radius"],
        own["maxDuration"],
    )
    way = [np.array(place) for place in (*waypoints, flight["goal"])]
    found = [
        fly_to_waypoints(currents, k, dives, np.array(flight["start"]), way)
        for k in range(len(currents.velocity))
    ]
    return [(arrival.duration, arrival.miss, arrival.arrived) for arrival in found]


def test_the_moved_waypoint_is_flown_as_in_python(browser):
    settings = {"estimator": {"modes": 20}, "forecast": {"levels": [5, 150, 500]}}
    page = report_html(
        rk.replay(
            SAMPLES / "glider.mcap",
            SAMPLES / "ensemble.nc",
            goal=(152.8, -40.1, 300.0),
            settings=settings,
        )
    )
    (before,) = [text for attrs, text in elements(page, "p") if attrs.get("class") == "readout"]
    with opened(browser, page) as tab:
        _check_moves(tab, page, before)
        tab.locator(".play").click()
        assert tab.evaluate("() => state.map.playing")


def _check_moves(tab: Any, page: str, before: str) -> None:
    tab.locator("[data-edit]").click()
    readout, difference = tab.locator(".readout"), tab.locator(".difference")
    # drawn by the script, but the same words as Python's
    assert readout.text_content() == before
    plan = figures(page)["current-map"]["flight"]
    assert difference.text_content() == plan["untouched"]
    box = tab.locator("#current-map .plot").bounding_box()
    texts = [before]
    for move in ("pointer", "keys", "add", "remove"):
        if move == "pointer":
            x, y = tab.evaluate(PLACES)[3]
            tab.mouse.move(box["x"] + x, box["y"] + y)
            tab.mouse.down()
            tab.mouse.move(box["x"] + x - 60, box["y"] + y - 40, steps=3)
            tab.mouse.up()
        elif move == "keys":
            latitude = tab.locator("#edit-latitude")
            latitude.fill(str(float(latitude.input_value()) + 0.05))
            latitude.press("Enter")
        else:
            tab.locator(f"[data-action={move}]").press("Enter")
        texts.append(readout.text_content())
        figure = tab.evaluate(FLIGHTS)
        expected = np.array(flown(page, figure["waypoints"]))
        assert len(expected) == 17
        hours_flown = np.array(figure["duration_h"])
        np.testing.assert_allclose(3600.0 * hours_flown, expected[:, 0], rtol=1e-6)
        np.testing.assert_allclose(figure["miss_m"], expected[:, 1], atol=0.1)
        hours = (expected[0, 0] - flown(page, plan["waypoints"])[0][0]) / 3600.0
        assert f"{abs(hours):.1f} h on the plan's" in difference.text_content()
    assert len(set(texts)) >= 4
    for _ in range(4):
        tab.locator("[data-action=undo]").click()
    assert difference.text_content() == plan["untouched"]
    with tab.expect_download() as download:
        tab.locator("[data-action=save]").click()
    saved = json.loads(Path(download.value.path()).read_text())
    assert len(saved["features"][0]["geometry"]["coordinates"]) == len(plan["waypoints"]) + 2


KINDS = """() => {
    const { map } = state;
    const [read, out] = [fieldReader(map), new Float64Array(4)];
    return map.drawn.north.map((y) => map.drawn.east.map((x) => read(x, y, out)));
}"""


def test_no_cell_outside_of_a_turned_grid_is_drawn_as_land(browser, tmp_path):
    flow = turned(synthetic_flow(), 35.0)
    flow.grid.wet[:, 2, 2] = False
    write(tmp_path / "turned.mcap", flow, [], None)
    page = report_html(rk.open_result(tmp_path / "turned.mcap"))
    with opened(browser, page) as tab:
        kinds = np.array(tab.evaluate(KINDS))
    packed = figures(page)["current-map"]["packed"]
    outside = unpacked(packed["outside"]) == 1.0
    assert (kinds[outside] == "outside").all()
    assert (kinds == "dry").sum() >= 1
    assert outside.sum() > 10
