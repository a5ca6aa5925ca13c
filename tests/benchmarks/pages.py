"""A report: processor time of its writing, its size, and in a browser the time to its first picture."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.measure import Row, of_children, row, seconds
from tests.browser import CHROMIUM, chromium, seconds_to_first_picture
from tests.show.report.replays import month, peak_of_report, sample

# asked: a report of 30 days, its first picture [s]
_WRITTEN, _FIRST = 30.0, 1.5


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
                    first = seconds_to_first_picture(browser, page)
                    found.append(row(f"{page.stem}: first picture", first, asked=_FIRST))
    return found


def _written(make: Callable[[Path], Path], folder: Path, found: list[Row]) -> Path:
    """Return the page of a result, and add the row of its writing."""
    result, page = make(folder), folder / f"{make.__name__}.html"
    spent, peak = seconds(lambda: peak_of_report(result, page), clock=of_children)
    name = f"report of {make.__name__}"
    size = page.stat().st_size / 1e6
    found.append(row(name, spent, asked=_WRITTEN, page_mb=size) | {"peak_mb": peak / 1024.0})
    return page
