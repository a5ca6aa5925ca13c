"""Every kind of page in Debian's Chromium: its figures are drawn, nothing is fetched, and nothing is complained of."""

from typing import Any

import pytest

from tests.browser import MARKS, check_accessible, check_drawn, chromium, opened, unfold
from tests.show.page.kinds import QUICK, SLOW
from tests.show.report.html_of import figures

pytestmark = MARKS


@pytest.mark.parametrize("kind", [*QUICK, *SLOW])
def test_a_page_draws_itself(kind, tmp_path, request):
    page = {**QUICK, **SLOW}[kind](tmp_path, request)
    # the status has pictures that need no script, and a fleet a table
    expected = len(figures(page)) if 'id="figures"' in page else 0
    assert (expected == 0) == (kind in ("show/status", "workflows/fleet"))
    with chromium() as browser:
        for width, scheme in ((1280, "light"), (390, "dark")):
            with opened(browser, page, width, scheme) as tab:
                if expected:
                    assert check_drawn(tab, width) == expected
                assert tab.evaluate("() => document.documentElement.scrollWidth") <= width
                assert len(tab.locator("main").inner_text()) > 200
                if expected:
                    check_accessible(tab)
                    unfold(tab)
                check_keyboard(tab)


# what can be used and is seen, and its place among the elements of the page
_USABLE = """() => {
    const all = [...document.querySelectorAll("a[href], button, input, select, summary, [role=group], [role=region]")];
    window.usable = all.filter((one) => one.checkVisibility({ visibilityProperty: true }) && !one.disabled && !one.closest(".modebar"));
    document.activeElement.blur();
    return window.usable.length;
}"""
_FOCUSED = "() => window.usable.indexOf(document.activeElement)"


def check_keyboard(tab: Any) -> None:
    """Check that the tabulator reaches all that can be used, in the order of the page."""
    count, reached = tab.evaluate(_USABLE), list[int]()
    # charts have buttons of their own between these
    for _ in range(20 * count):
        tab.keyboard.press("Tab")
        place = tab.evaluate(_FOCUSED)
        if place in reached:
            break
        reached += [place] if place >= 0 else []
    missed = [
        tab.evaluate("(k) => window.usable[k].outerHTML.slice(0, 200)", k)
        for k in range(count)
        if k not in reached
    ]
    assert missed == []
    assert reached == sorted(reached)
