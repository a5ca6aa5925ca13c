"""Reports in Debian's Chromium: every figure is drawn, nothing is fetched, controls change the picture."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.results.report import report_html
from replay_kit.results.views.steering import Dives, GriddedCurrents, fly_to_waypoints
from tests.places import DATA, SAMPLES
from tests.results.report.html_of import figures, unpacked

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.full,
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium"),
]
DIVES = sorted(DATA.glob("seaglider/p17101*.nc"))
WIDTHS = (1280, 390)
# as functions: the page allows no eval of expressions
FITTED = """() => {
    const plots = [...document.querySelectorAll(".plot")];
    return plots.every((plot) => plot.querySelector("svg.main-svg").clientWidth === plot.clientWidth);
}"""
FLIGHTS = """() => {
    const { flight, tables } = state.figures.find(({ key }) => key === "waypoint");
    return { waypoints: flight.waypoints, ...tables.flights };
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    # here, so that a run without the extra does not count it as skipped
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module", params=["sample", "seaglider"])
def report_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("browser") / f"{request.param}.html"
    settings: dict[str, Any] = {"estimator": {"modes": 40}}
    if request.param == "seaglider":
        if not DIVES:
            pytest.skip("needs the Seaglider dives in ../shared/data")
        logs: Any = DIVES
        settings["forecast"] = {"place": True}
    else:
        logs = SAMPLES / "glider.mcap"
    result = rk.replay(
        logs, SAMPLES / "ensemble.nc", goal=None if request.param == "seaglider" else (152.8, -40.1, 300.0), settings=settings
    )
    page.write_text(report_html(result))
    return page


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_a_report_draws_itself(browser: Any, report_path: Path, width: int, scheme: str) -> None:
    errors: list[str] = []
    asked: list[str] = []
    tab = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    tab.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.route("**/*", lambda route: (asked.append(route.request.url), route.abort()))
    # set, not visited: every request is aborted
    tab.set_content(report_path.read_text())
    tab.wait_for_selector("body[data-ready]", timeout=60_000)
    figures = tab.query_selector_all("figure")
    assert len(figures) >= 6
    for figure in figures:
        assert figure.query_selector(".plot[data-drawn] svg.main-svg"), figure.get_attribute("id")
        box = figure.query_selector(".plot").bounding_box()
        assert box["height"] > 200
        assert box["width"] <= width
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    picture = tab.locator("#current-map .plot")
    pictures = [picture.screenshot()]
    for control, value in (("current-map-1", "1"), ("current-map-2", "0")):
        tab.locator(f"#{control}").fill(value)
        tab.wait_for_function(
            "([k, v]) => document.querySelector('#current-map .plot').dataset.choices.split(',')[k] === v", arg=[int(control[-1]), value]
        )
        pictures.append(picture.screenshot())
    tab.locator("#current-map-0").select_option("1")
    tab.wait_for_function("() => document.querySelector('#current-map .plot').dataset.choices.startsWith('1')")
    pictures.append(picture.screenshot())
    assert len(set(pictures)) == 4
    with tab.expect_download() as download:
        tab.locator("button[data-table=track]").click()
    lines = Path(download.value.path()).read_text().splitlines()
    assert lines[0] == "time,longitude,latitude,depth_m,east_km,north_km,hours,dead_reckoned"
    assert len(lines) > 100
    with tab.expect_download() as download:
        tab.locator("button[data-table=current]").click()
    assert Path(download.value.path()).read_text().startswith("depth_m,time,longitude,latitude,u_m_s,v_m_s,")
    tab.set_viewport_size({"width": 700, "height": 900})
    tab.wait_for_function(FITTED)
    assert errors == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == []
    tab.close()


def flown(page: str, waypoints: list[list[float]]) -> list[tuple[float, float]]:
    """Return duration [s] and miss [m] over waypoints in the estimate and its samples, flown in Python."""
    figure = figures(page)["waypoint"]
    flight, axes = figure["flight"], [np.array(figure["flight"][name]) for name in ("depths", "east", "north")]
    currents, own = GriddedCurrents(*axes, unpacked(figure["packed"]["currents"])), flight["dives"]
    dives = Dives(own["speed"], np.rad2deg(own["angle"]), own["depth"], own["surfaceTime"], own["radius"], own["maxDuration"])
    way = [np.array(place) for place in (*waypoints, flight["goal"])]
    found = [fly_to_waypoints(currents, k, dives, np.array(flight["start"]), way) for k in range(len(currents.velocity))]
    return [(arrival.duration, arrival.miss) for arrival in found]


def test_the_moved_waypoint_is_flown_as_in_python(browser: Any, tmp_path: Path) -> None:
    settings = {"estimator": {"modes": 20}, "forecast": {"levels": [5, 150, 500]}}
    page = report_html(rk.replay(SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc", goal=(152.8, -40.1, 300.0), settings=settings))
    tab = browser.new_page(viewport={"width": 1280, "height": 900})
    tab.route("**/*", lambda route: route.abort())
    tab.set_content(page)
    before = tab.locator("#waypoint .readout").text_content()
    tab.wait_for_selector("body[data-ready]", timeout=60_000)
    # drawn by the script, but the same words as Python's
    assert tab.locator("#waypoint .readout").text_content() == before
    plot = tab.locator("#waypoint .plot")
    plot.scroll_into_view_if_needed()
    texts, places = [before], []
    for move in ("keys", "pointer"):
        if move == "keys":
            tab.locator("#waypoint-0").select_option("1")
            for _ in range(5):
                tab.locator("#waypoint-1").press("ArrowRight")
        else:
            box = plot.bounding_box()
            tab.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.4 * box["height"])
            tab.mouse.down()
            tab.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 0.45 * box["height"], steps=3)
            tab.mouse.up()
        tab.wait_for_timeout(500)
        texts.append(tab.locator("#waypoint .readout").text_content())
        figure = tab.evaluate(FLIGHTS)
        places.append(figure["waypoints"])
        expected = np.array(flown(page, figure["waypoints"]))
        assert len(expected) == 17
        np.testing.assert_allclose(np.array(figure["duration_h"]) * 3600.0, expected[:, 0], rtol=0.01)
        np.testing.assert_allclose(figure["miss_m"], expected[:, 1], atol=50.0)
    assert len(set(texts)) == 3
    assert places[0] != places[1]
    tab.close()
