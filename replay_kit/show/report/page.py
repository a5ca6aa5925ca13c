"""The report: its sections in order, as a page."""

from collections.abc import Callable
from pkgutil import resolve_name

from replay_kit.core.extensions import additions
from replay_kit.core.text import count_text, time_text
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.page import page_html
from replay_kit.show.page.section import Section

# Module and function of each section, from top to bottom.
_LISTED = (
    "current_map:map_section",
    "answer:words_section",
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
    sections = [section(contents) for section in (*SECTIONS, *added)]
    return page_html(f"Report on {result.path.name}", sections, _subtitle(contents))


def _subtitle(contents: Contents) -> str:
    span, dives = contents.span_ns, int((contents.result.dives.index > 0).sum())
    if span is None:
        return ""
    begin, end = (time_text(each)[:16] for each in span)
    parts = [f"{begin} to {end} UTC", *([count_text(dives, "dive")] if dives else [])]
    return " · ".join([*parts, count_text(contents.outcome.observations["used"], "measurement")])
