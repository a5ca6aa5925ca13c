"""The report as a page: on one vehicle, or on several with one estimate, with a page of its own for each."""

from collections.abc import Callable, Mapping
from html import escape
from pkgutil import resolve_name

from replay_kit.core.errors import finding_line
from replay_kit.core.extensions import additions
from replay_kit.core.text import count_text, time_text
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.numbers import Sentence
from replay_kit.show.page import page_html
from replay_kit.show.page.section import Section, items_html, table_html
from replay_kit.show.report.sections.again import again_section
from replay_kit.show.report.sections.current_map import map_beside
from replay_kit.show.vehicles import ABOUT_VALUE, COLUMNS, vehicle_cells, vehicle_sentences
from replay_kit.show.words import estimate_sentences

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


def several_html(contents: Contents, pages: Mapping[str, str]) -> str:
    """Return the page on all vehicles of a result.

    Args:
        contents: Of the result.
        pages: Names of the pages of the vehicles, by theirs.
    """
    sections = [
        map_beside(contents, _card(contents, pages)),
        _vehicles(contents, pages),
        again_section(contents),
    ]
    span, outcome = contents.span_ns, contents.outcome
    begin, end = ("", "") if span is None else (time_text(each)[:16] for each in span)
    parts = [
        f"{begin} to {end} UTC",
        count_text(len(contents.each), "vehicle"),
        count_text(outcome.observations["used"], "measurement"),
    ]
    return page_html(f"Report on {contents.result.path.name}", sections, " · ".join(parts))


def _card(contents: Contents, pages: Mapping[str, str]) -> str:
    """Return how far to trust the estimate, and each vehicle in a line."""
    outcome = contents.outcome
    rows = [
        f"{_link(str(name), pages)}: {Sentence([used]).html} measurements; {Sentence([verdict]).html}"
        for name, used, *_, verdict in vehicle_cells(outcome)
    ]
    return (
        f"<h3>{escape(str(outcome.decision).capitalize())}</h3>"
        f"{items_html([escape(text) for text in outcome.verdict])}<h3>Vehicles</h3>{items_html(rows)}"
    )


def _vehicles(contents: Contents, pages: Mapping[str, str]) -> Section:
    """Return the table of the vehicles, what their measurements are worth, and what is to be known of each."""
    outcome = contents.outcome
    rows = [
        (_link(str(name), pages), *(Sentence([cell]).html for cell in rest))
        for name, *rest in vehicle_cells(outcome)
    ]
    before = (*contents.notes, *map(finding_line, outcome.consistency))
    after = (*outcome.notes, *vehicle_sentences(outcome))
    said = [
        *map(escape, before),
        *(each.html for each in estimate_sentences(outcome)),
        *map(escape, after),
    ]
    table = table_html(
        COLUMNS, rows, "Vehicles: what each measured, and what the estimate would be without it"
    )
    html = f"{table}<p>{escape(ABOUT_VALUE)}.</p>{items_html(said)}"
    return Section("vehicles", "Vehicles", html)


def _link(name: str, pages: Mapping[str, str]) -> str:
    page = pages.get(name)
    return escape(name) if page is None else f'<a href="{escape(page)}">{escape(name)}</a>'
