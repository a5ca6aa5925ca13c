"""The report: its sections in order, as a page."""

from collections.abc import Callable
from pkgutil import resolve_name

from replay_kit.core.extensions import additions
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.page import page_html
from replay_kit.show.page.section import Section

# Module and function of each section, from top to bottom.
_LISTED = (
    "answer:words_section",
    "current_map:map_section",
    "sections_along_track:along_track_section",
    "trust:trust_section",
    "plan:plan_section",
    "again:again_section",
)
#: The sections in that order; each is a pure function of the opened result.
SECTIONS: tuple[Callable[[Contents], Section], ...] = tuple(
    resolve_name(f"{__package__}.sections.{name}") for name in _LISTED
)


def report_html(result: ResultFile, notes: tuple[str, ...] = ()) -> str:
    """Return a result as one HTML page, with all scripts and data inside; the same result gives the same page.

    Args:
        result: An opened result.
        notes: What the reader should know of how it was opened.
    """
    contents = Contents(result, notes)
    added = additions("sections", callable, "a function").values()
    return page_html(
        f"Report on {result.path.name}", [section(contents) for section in (*SECTIONS, *added)]
    )
