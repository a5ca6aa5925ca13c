"""Reports in Debian's Chromium: every figure is drawn, nothing is fetched, controls change the picture."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest

import replay_kit as rk
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
from tests.results.cases import turned, write
from tests.show.report.html_of import figures, unpacked
from tests.show.report.replays import month, peak_of_report, sample, seaglider
from tests.synthetic_flow import synthetic_flow

pytestmark = MARKS
# as functions: the page allows no eval of expressions
FITTED = """() => {
    const pictures = [...document.querySelectorAll(".plot canvas, .panel > svg")].filter((one) => one.clientWidth);
    return pictures.length > 5 && pictures.every((one) => one.clientWidth === one.parentElement.clientWidth);
}"""
MENU = """() => {
    const menu = document.querySelector("nav");
    return innerWidth < 861 || menu.scrollWidth <= menu.clientWidth;
}"""
LANDED = """(key) => {
    const part = document.getElementById(key);
    const off = part.getBoundingClientRect().top - document.querySelector("header").offsetHeight;
    const end = scrollY + innerHeight >= document.documentElement.scrollHeight - 2;
    return !part.querySelector("details.main:not([open])") && (end || Math.abs(off) < 40);
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as own:
        yield own


# real dives contradict the sample's ensemble, which a page shows as well
@pytest.mark.filterwarnings("ignore:the gate prefers")
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
            _check_values(tab)
            tab.set_viewport_size({"width": 700, "height": 900})
            tab.wait_for_function(FITTED)


def _check_controls(tab: Any) -> None:
    """Check that quantity, depth and time of the map each change its picture."""
    picture = tab.locator("#current-map .plot")
    pictures = [picture.screenshot()]
    for control, value in (("current-map-1", "1"), ("current-map-2", "0")):
        tab.locator(f"#{control}").fill(value)
        tab.wait_for_function(
            "([k, v]) => state.choices[k] === v", arg=[int(control[-1]), int(value)]
        )
        pictures.append(picture.screenshot())
    tab.locator("#current-map-0").select_option("1")
    tab.wait_for_function("() => state.choices[0] === 1")
    pictures.append(picture.screenshot())
    # by the keyboard alone
    picture.focus()
    picture.press("ArrowRight")
    pictures.append(picture.screenshot())
    picture.press("+")
    pictures.append(picture.screenshot())
    assert "°" in tab.locator("#current-map .tip").inner_text()
    tab.locator("[data-view=region]").press("Enter")
    pictures.append(picture.screenshot())
    assert len(set(pictures)) == 7
    last = int(tab.locator("#current-map-2").get_attribute("max"))
    tab.locator("#current-map-2").fill("0")
    assert tab.evaluate("() => state.map.until === state.map.drawn.times[0]")
    tab.locator("#current-map-2").fill(str(last))
    assert tab.evaluate("() => state.map.until === Infinity")


def _check_links(tab: Any) -> None:
    """Check that each link of the menu is seen, opens its part, and lands there below the header."""
    assert tab.evaluate(MENU)
    for link in tab.locator("nav a").all():
        link.click()
        key = (link.get_attribute("href") or "")[1:]
        tab.wait_for_function(LANDED, arg=key)


def _check_values(tab: Any) -> None:
    """Check that a chart and a section say the values under the pointer."""
    for key, said in (("error", "RMS standard error"), ("profiles", " m/s")):
        picture = tab.locator(f"#{key} svg").first
        picture.scroll_into_view_if_needed()
        tip = tab.locator(f"#{key} .tip").first
        box = picture.bounding_box()
        for across, down in product(range(12, 100, 6), range(4, 90, 6)):
            place = box["x"] + 0.01 * across * box["width"], box["y"] + 0.01 * down * box["height"]
            tab.mouse.move(*place)
            if tip.is_visible():
                break
        assert said in tip.inner_text()


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
