"""Reports in Debian's Chromium: every figure is drawn, nothing is fetched, controls change the picture."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import replay_kit as rk
from replay_kit.results.report import report_html
from tests.places import DATA, SAMPLES

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.full,
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium"),
]
DIVES = sorted(DATA.glob("seaglider/p17101*.nc"))
WIDTHS = (1280, 390)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
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
    tab.wait_for_function("document.querySelector('#current-map .plot').dataset.choices.startsWith('1')")
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
    assert errors == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == []
    tab.close()
