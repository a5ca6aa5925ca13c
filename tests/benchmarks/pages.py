"""A report: processor time of its writing, its size, and in a browser the time to its first picture and of a frame of its animation."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.benchmarks.measure import Row, of_children, row, seconds
from tests.browser import CHROMIUM, chromium, opened, seconds_a_frame, seconds_to_first_picture
from tests.show.report.replays import month, peak_of_report, sample

# asked: a report of 30 days, its first picture, a frame of what moves [s]
_WRITTEN, _FIRST, _FRAME = 30.0, 1.5, 1.0 / 30.0


def rows(tiny: bool) -> list[Row]:
    """Return rows of the sample's report, and of one of 30 days unless tiny; without a browser only of their writing."""
    found: list[Row] = []
    with TemporaryDirectory() as folder:
        pages = [
            _written(make, Path(folder), found) for make in ((sample,) if tiny else (sample, month))
        ]
        if not tiny and CHROMIUM is not None and find_spec("playwright") is not None:
            with chromium() as browser:
                for page in pages:
                    found += _shown(browser, page)
    return found


def _written(make: Callable[[Path], Path], folder: Path, found: list[Row]) -> Path:
    """Return the page of a result, and add the row of its writing."""
    result, page = make(folder), folder / f"{make.__name__}.html"
    spent, peak = seconds(lambda: peak_of_report(result, page), clock=of_children)
    name = f"report of {make.__name__}"
    size = page.stat().st_size / 1e6
    found.append(row(name, spent, asked=_WRITTEN, page_mb=size) | {"peak_mb": peak / 1024.0})
    return page


def _shown(browser: Any, page: Path) -> list[Row]:
    """Return the rows of a page's first picture, and of a frame of its particles while time plays."""
    first = seconds_to_first_picture(browser, page)
    with opened(browser, page.read_text(encoding="utf-8")) as tab:
        frame = seconds_a_frame(tab)
    return [
        row(f"{page.stem}: first picture", first, asked=_FIRST),
        row(f"{page.stem}: frame", frame, asked=_FRAME),
    ]
