"""A study's page in Debian's Chromium, with charts and finished pictures."""

import pytest

from replay_kit.studies.missions.page import missions_page
from replay_kit.studies.planning.page import planning_page
from replay_kit.studies.reports.pictures import drawn
from tests.browser import MARKS, check_accessible, check_drawn, chromium, opened
from tests.studies.pages import mission_result, planning_result

pytestmark = MARKS


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_pages_of_studies_draw_themselves(width: int, scheme: str) -> None:
    planned = planning_result()
    pictures = {
        picture.name: drawn(picture) for report in planned.reports for picture in report.pictures
    }
    with chromium() as browser:
        for page, figures in (
            (missions_page(mission_result()), 3),
            (planning_page(planned, pictures), 2),
        ):
            with opened(browser, page, width, scheme) as tab:
                assert check_drawn(tab, width) == figures
                check_accessible(tab)
