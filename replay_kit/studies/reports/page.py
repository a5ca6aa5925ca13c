"""What a study says, for console, JSON and files, and the parts of its page: words, tables, how to repeat the study."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from replay_kit.show.page import Section, page_html
from replay_kit.show.page.section import items_html, table_html
from replay_kit.studies.reports.tables import (
    Criterion,
    Table,
    json_text,
    limits_text,
    plain,
    print_tables,
    to_text,
    write_files,
)

if TYPE_CHECKING:
    from rich.console import Console

PAGE = "index.html"


@dataclass(frozen=True, slots=True, eq=False)
class StudyReport:
    """What a study says so far.

    Attributes:
        name: Of its JSON file.
        answer: Its JSON object; undefined figures are null.
        tables: Printed, those that have rows.
        words: Printed below the tables.
        csv: The text of its tables by the name of the file.
        pages: Makes the other files by name; None while the study is unfinished.
        beside: What is in the folder beside the page, for the console; empty for what goes without saying.
    """

    name: str
    answer: Mapping[str, Any]
    tables: Sequence[Table]
    words: Sequence[str]
    csv: Mapping[str, str]
    pages: Callable[[], Mapping[str, str | bytes]] | None
    beside: str = ""

    def print(self, console: "Console") -> None:
        """Print it for people."""
        print_tables(console, self.tables)
        for text in self.words:
            console.print(text, soft_wrap=True, markup=False)

    def write(self, out: Path) -> None:
        """Write its files into a folder that exists, each whole or not at all; existing ones are replaced."""
        write_files(out, {**self.csv, f"{self.name}.json": json_text(self.answer)})
        write_files(out, self.pages() if self.pages else {})


def words_html(paragraphs: Sequence[str]) -> str:
    """Return paragraphs of Markdown that have `code` and *emphasis* at most as HTML."""
    return "".join(f"<p>{_marked(text)}</p>" for text in paragraphs)


def list_html(items: Sequence[str]) -> str:
    """Return such lines as a list."""
    return items_html([_marked(text) for text in items])


def _marked(text: str) -> str:
    coded = re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text, quote=False))
    return re.sub(r"\*([^*]+)\*", r"<em>\1</em>", coded)


def tables_html(tables: Sequence[Table]) -> str:
    """Return those tables that have rows as HTML."""
    return "".join(
        table_html(
            table.columns,
            [[_cell(to_text(cell)) for cell in row] for row in table.rows],
            table.title,
        )
        for table in tables
        if table.rows
    )


def _cell(text: str) -> str:
    # what is not met is what a reader looks for
    return f"<strong>{escape(text)}</strong>" if text == "NOT MET" else escape(text)


def criteria_html(criteria: Sequence[Criterion]) -> str:
    """Return how many criteria are met, and those that are not beside their limits; empty without any."""
    if not criteria:
        return ""
    not_met = [
        f"{one.what}: *{to_text(one.value)}*, required {limits_text(one.at_least, one.at_most)}"
        for one in criteria
        if not one.met
    ]
    met = f"{len(criteria) - len(not_met)} of {len(criteria)} criteria are met"
    if not not_met:
        return words_html([f"{met}."])
    return words_html([f"{met}; these are not:"]) + list_html(not_met)


def study_page(title: str, sections: Sequence[Section], answer: Mapping[str, Any]) -> str:
    """Return the page of a study: its sections, then how to make it again.

    Args:
        title: Of the page.
        sections: From top to bottom.
        answer: Options, ``job`` and ``versions`` of the JSON object of ``--json``; what else it holds is not shown.
    """
    return page_html(title, [*sections, _again(answer)])


def _again(answer: Mapping[str, Any]) -> Section:
    job = answer.get("job", {})
    shown = {**{name: value for name, value in answer.items() if _is_setting(value)}, **job}
    options = [
        [escape(name.replace("_", " ")), escape(_option(value))]
        for name, value in plain(shown).items()
    ]
    versions = [[escape(name), escape(version)] for name, version in answer["versions"].items()]
    html = table_html(("what", "value"), options, "Inputs and options") + table_html(
        ("package", "version"), versions, "Versions"
    )
    return Section("again", "Make it again", html)


def _is_setting(value: Any) -> bool:
    return isinstance(value, str | int | float) or (
        isinstance(value, list) and len(value) > 0 and not isinstance(value[0], dict | list)
    )


def _option(value: Any) -> str:
    return (
        ", ".join(map(to_text, value))
        if isinstance(value, list)
        else "none"
        if value is None
        else to_text(value)
    )
