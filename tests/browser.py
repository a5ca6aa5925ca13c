"""Pages opened in Debian's Chromium: what they ask for, complain of, and how soon they show their first picture."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

#: Chromium to drive: the one that the environment names, or the one of the search path.
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium")
WIDTHS = (1280, 390)
SCHEMES = ("light", "dark")
#: Of the tests that need it.
MARKS = [
    pytest.mark.full,
    pytest.mark.browser,
    pytest.mark.skipif(
        CHROMIUM is None,
        reason="needs chromium: install Debian's, or name another in the environment as CHROMIUM",
    ),
]
# Holds the page as soon as its first figure is drawn: what it waits for until the next one does not come.
_HOLD = """
const next = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (task) => (document.querySelector("[data-drawn]") ? 0 : next(task));
"""
_AXE = """async () => {
  const { violations, passes } = await axe.run();
  return [passes.length, violations.map(({ impact, id, nodes }) => [impact, id, nodes[0].html])];
}"""


@contextmanager
def chromium() -> Iterator[Any]:
    """Yield a browser; without playwright the test is skipped."""
    # here, so that a run without the extra does not count it as skipped
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed (extra 'browser')"
    )
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@contextmanager
def opened(
    browser: Any, page: str, width: int = WIDTHS[0], scheme: str = SCHEMES[0]
) -> Iterator[Any]:
    """Yield a tab with a page, all its figures drawn; at the end nothing may have been asked for or complained of.

    Args:
        browser: Of ``chromium``.
        page: HTML.
        width: Of the window [px].
        scheme: ``light`` or ``dark``.
    """
    said: list[str] = []
    asked: list[str] = []
    tab = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    tab.on(
        "console",
        lambda message: said.append(message.text) if message.type in ("error", "warning") else None,
    )
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.route("**/*", lambda route: (asked.append(route.request.url), route.abort()))
    # set, not visited: every request is aborted
    tab.set_content(page)
    if 'id="figures"' in page:
        tab.wait_for_selector("body[data-ready]", timeout=120_000)
    yield tab
    assert said == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == []
    tab.close()


def thread_clock(tab: Any) -> Callable[[], float]:
    """Return a function that returns the processor time of a tab's thread so far [s]."""
    session = tab.context.new_cdp_session(tab)
    session.send("Performance.enable")

    def spent() -> float:
        metrics = session.send("Performance.getMetrics")["metrics"]
        return float(next(each["value"] for each in metrics if each["name"] == "ThreadTime"))

    return spent


def seconds_to_first_picture(browser: Any, path: Path) -> float:
    """Return the processor time [s] that a page's thread takes from its opening to its first figure.

    On an idle machine that is the time that passes; on a busy one the clock measures the others.

    Args:
        browser: Of ``chromium``.
        path: Of the page.
    """
    tab = browser.new_page(viewport={"width": WIDTHS[0], "height": 900})
    spent = thread_clock(tab)
    began = spent()
    tab.add_init_script(_HOLD)
    tab.goto(path.as_uri(), wait_until="commit")
    tab.wait_for_selector(".plot[data-drawn]:has(canvas)", timeout=120_000)
    found = spent() - began
    assert len(tab.query_selector_all(".plot[data-drawn]")) == 1
    tab.close()
    return found


def unfold(tab: Any) -> None:
    """Open all folded parts of a page."""
    tab.evaluate(
        "() => document.querySelectorAll('details').forEach((part) => { part.open = true; })"
    )


def check_drawn(tab: Any, width: int) -> int:
    """Return the number of figures of a page, each of them drawn and within the window."""
    shown = tab.query_selector_all("figure")
    for figure in shown:
        pictures = figure.query_selector_all(".plot[data-drawn] canvas, .panel > svg")
        assert pictures, figure.get_attribute("id")
        for picture in pictures:
            box = picture.bounding_box()
            assert box["height"] > 100
            assert box["width"] <= width
    assert tab.evaluate("() => document.documentElement.scrollWidth") <= width
    return len(shown)


def check_accessible(tab: Any) -> None:
    """Check that axe-core finds nothing serious or critical in a page; skips without it."""
    pytest.importorskip(
        "axe_playwright_python", reason="axe-core is not installed (extra 'browser')"
    )
    script = files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    tab.evaluate(
        "(text) => { const own = document.createElement('script'); own.textContent = text; document.head.append(own); }",
        script,
    )
    passed, found = tab.evaluate(_AXE)
    assert passed > 15
    assert [each for each in found if each[0] in ("serious", "critical")] == []
