"""The report: its sections in order, as a page."""

from collections.abc import Callable

from replay_kit.results.page import page_html
from replay_kit.results.page.section import Section
from replay_kit.results.report.sections.again import again_section
from replay_kit.results.report.sections.current_map import map_section
from replay_kit.results.report.sections.in_words import words_section
from replay_kit.results.report.sections.plan import plan_section
from replay_kit.results.report.sections.sections_along_track import along_track_section
from replay_kit.results.report.sections.trust import trust_section
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents

#: The sections from top to bottom; each is a pure function of the opened result.
SECTIONS: tuple[Callable[[Contents], Section], ...] = (
    words_section,
    map_section,
    along_track_section,
    trust_section,
    plan_section,
    again_section,
)


def report_html(result: ResultFile, notes: tuple[str, ...] = ()) -> str:
    """Return a result as one HTML page, with all scripts and data inside; the same result gives the same page.

    Args:
        result: An opened result.
        notes: What the reader should know of how it was opened.
    """
    contents = Contents(result, notes)
    return page_html(f"Report on {result.path.name}", [section(contents) for section in SECTIONS])
