"""The report on several vehicles with one estimate: all on one map, a table, and a page of its own for each."""

from collections.abc import Mapping
from html import escape

from replay_kit.core.errors import finding_line
from replay_kit.core.text import count_text, time_text
from replay_kit.results.views.contents import Contents
from replay_kit.show.numbers import Sentence
from replay_kit.show.page import page_html
from replay_kit.show.page.section import Section, items_html, table_html
from replay_kit.show.report.sections.again import again_section
from replay_kit.show.report.sections.current_map import map_beside
from replay_kit.show.vehicles import ABOUT_VALUE, COLUMNS, vehicle_cells, vehicle_sentences
from replay_kit.show.words import estimate_sentences


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
