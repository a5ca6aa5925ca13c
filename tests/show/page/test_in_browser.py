"""Every kind of page in Debian's Chromium: its figures are drawn, nothing is fetched, and nothing is complained of."""

import pytest

from tests.browser import MARKS, check_accessible, check_drawn, chromium, opened
from tests.show.page.kinds import QUICK, SLOW
from tests.show.report.html_of import figures

pytestmark = MARKS


@pytest.mark.parametrize("kind", [*QUICK, *SLOW])
def test_a_page_draws_itself(kind, tmp_path, request):
    page = {**QUICK, **SLOW}[kind](tmp_path, request)
    # the status has pictures that need no script
    expected = len(figures(page)) if 'id="figures"' in page else 0
    assert (expected == 0) == (kind == "show/status")
    with chromium() as browser:
        for width, scheme in ((1280, "light"), (390, "dark")):
            with opened(browser, page, width, scheme) as tab:
                if expected:
                    assert check_drawn(tab, width) == expected
                assert tab.evaluate("() => document.documentElement.scrollWidth") <= width
                assert len(tab.locator("main").inner_text()) > 200
                if expected:
                    check_accessible(tab)
