"""What studies write as sections of a page: findings in words, tables, criteria, pictures, and how to make it again."""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from replay_kit.show.page import Figure, Section, page_html
from replay_kit.show.page.section import items_html, table_html
from replay_kit.studies.reports.pictures import Drawn
from replay_kit.studies.reports.tables import Table
from replay_kit.studies.reports.write import plain, to_text

PAGE = "index.html"


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
    """Return those tables that are shown as HTML."""
    return "".join(
        table_html(
            table.columns,
            [[_cell(to_text(cell)) for cell in row] for row in table.rows],
            table.title,
        )
        for table in tables
        if table.shown and table.rows
    )


def _cell(text: str) -> str:
    # what is not met is what a reader looks for
    return f"<strong>{escape(text)}</strong>" if text == "NOT MET" else escape(text)


def picture_figures(pictures: Sequence[tuple[str, str, Drawn]]) -> tuple[Figure, ...]:
    """Return finished pictures as figures of a page; those with surfaces in 3D alone, of which no data can be listed, stay files.

    Args:
        pictures: Of each the name of its file, its caption, and itself.
    """
    return tuple(
        _picture_figure(name, caption, picture)
        for name, caption, picture in pictures
        if picture.data
    )


def _picture_figure(name: str, caption: str, picture: Drawn) -> Figure:
    title = re.split(r"[,:;]", caption, maxsplit=1)[0]
    image = f"data:image/png;base64,{b64encode(picture.files['png']).decode()}"
    return Figure(
        name.replace("_", "-"),
        title,
        f"{escape(caption)}.",
        f"{caption}.",
        {"drawn": picture.data},
        (),
        {},
        image=image,
    )


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
