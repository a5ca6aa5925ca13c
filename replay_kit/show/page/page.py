"""Sections as one page: they and everything that draws them, in one file that fetches nothing."""

import gzip
import json
import re
from base64 import b64encode
from html import escape
from importlib.resources import files
from textwrap import shorten
from typing import Any

from replay_kit.core.colors import palette_css
from replay_kit.core.version import __version__
from replay_kit.show.page.section import Control, Figure, Section

#: Letters of a section in the menu.
_MENU = 32
_SCRIPTS = ("page", "map", "marks", "particles", "explore")


def page_html(title: str, sections: list[Section], subtitle: str = "") -> str:
    """Return sections as one HTML page.

    Args:
        title: Of the page.
        subtitle: Beside the title; empty for none.
        sections: From top to bottom. Their keys and those of their figures are ids of the page: none is another's, or one of ``page.html``.
    """
    figures = [figure for section in sections for figure in section.figures]
    parts = {
        "title": escape(title),
        "subtitle": escape(subtitle),
        "version": escape(__version__),
        "css": palette_css() + _text("page.css"),
        "links": "".join(
            f'<li><a href="#{section.key}">{escape(section.menu or shorten(section.title, _MENU, placeholder=" ..."))}</a></li>'
            for section in sections
        ),
        "sections": "\n".join(map(_section_html, sections)),
        "figures": _packed(
            json.dumps(
                [_figure_data(figure) for figure in figures], separators=(",", ":"), allow_nan=False
            ).encode()
        ),
        "plotly": b64encode(
            files("replay_kit.show.page").joinpath("plotly-cartesian.min.js.gz").read_bytes()
        ).decode(),
        "js": "".join(_text(f"{name}.js") for name in _SCRIPTS),
    }
    page = _text("page.html")
    _check_ids(page + parts["sections"])
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def _check_ids(html: str) -> None:
    """Check that no two elements have the same id: the script finds the data of the figures, and their places, by it."""
    ids = re.findall(r'<[a-z][^<>]*\sid="([^"]*)"', html)
    repeated = sorted({name for name in ids if ids.count(name) > 1})
    assert not repeated, (
        f"ids of a page: expected each once, got {', '.join(repeated)} again; give the section or figure another key"
    )


def _text(name: str) -> str:
    return files("replay_kit.show.page").joinpath(name).read_text(encoding="utf-8")


def _packed(data: bytes) -> str:
    # without the time of packing: the same data give the same bytes
    return b64encode(gzip.compress(data, mtime=0)).decode()


def _section_html(section: Section) -> str:
    missing = "".join(f'<p class="missing">{escape(text)}</p>' for text in section.missing)
    figures = "" if section.placed else "".join(map(figure_html, section.figures))
    title = escape(section.title)
    if section.beside:
        return (
            f'<section id="{section.key}" class="first"><h2 class="unseen">{title}</h2>'
            f'<div class="seen">{figures}{missing}</div><div class="card">{section.beside}</div></section>'
        )
    if section.answer:
        return (
            f'<section id="{section.key}"><details class="main"><summary><h2>{title}</h2><span>{section.answer}</span></summary>'
            f"{section.html}{missing}{figures}</details></section>"
        )
    return f'<section id="{section.key}"><h2>{title}</h2>{section.html}{missing}{figures}</section>'


def figure_html(figure: Figure) -> str:
    """Return a figure with its controls, its caption and its data, for the script to draw."""
    controls = "".join(
        _control_html(figure.key, number, control) for number, control in enumerate(figure.controls)
    )
    buttons = "".join(
        f'<button type="button" data-figure="{figure.key}" data-table="{escape(name)}">Data: {escape(name)} (CSV)</button>'
        for name in figure.tables
    )
    about = f'<figcaption>{figure.caption}</figcaption><div class="data">{buttons}</div>'
    if figure.map:
        return _map_html(figure, controls, about)
    return (
        f'<figure id="{figure.key}"><h3>{escape(figure.title)}</h3><div class="controls">{controls}</div>{_shown_html(figure)}'
        f"{about}</figure>"
    )


_VIEWS = {"plan": "Vehicle and plan", "track": "Track", "region": "Region"}


def _map_html(figure: Figure, controls: str, about: str) -> str:
    """Return a map with its controls above and below, and what it shows in words as a folded part."""
    views = "".join(
        f'<button type="button" data-view="{key}" aria-pressed="false">{text}</button>'
        for key, text in _VIEWS.items()
        if key in figure.map["views"]
    )
    zoom = "".join(
        f'<button type="button" data-zoom="{factor}" aria-label="{text}">{sign}</button>'
        for factor, text, sign in ((1.5, "Zoom in", "+"), (0.6667, "Zoom out", "−"))
    )
    play = (
        '<button type="button" class="play" aria-label="Play" aria-pressed="false">▶</button>'
        if controls
        else ""
    )
    return (
        f'<figure id="{figure.key}" class="map"><h3 class="unseen">{escape(figure.title)}</h3>'
        f'<div class="stage">{_shown_html(figure)}<div class="tools">{views}{zoom}'
        '<details class="layers"><summary>Layers</summary><ul></ul></details></div>'
        f'<div class="keys" aria-hidden="true"></div><div class="controls">{play}{controls}</div></div>'
        f'<details class="about"><summary>About this map, and its data</summary>{about}</details></figure>'
    )


def _shown_html(figure: Figure) -> str:
    height = "" if figure.map else f' style="height:{figure.layout.get("height", 420)}px"'
    return (
        f'<div class="plot" tabindex="0" role="group" aria-label="{escape(figure.alternative)}"{height}>'
        '<p class="waiting">This figure is drawn by JavaScript.</p></div>'
    )


def _control_html(key: str, number: int, control: Control) -> str:
    name = f"{key}-{number}"
    if control.kind == "select":
        options = "".join(
            f'<option value="{k}"{" selected" if k == control.chosen else ""}>{escape(text)}</option>'
            for k, text in enumerate(control.choices)
        )
        return f'<label for="{name}">{escape(control.name)} <select id="{name}" data-figure="{key}">{options}</select></label>'
    last = len(control.choices) - 1
    return (
        f'<label for="{name}">{escape(control.name)} <input type="range" id="{name}" data-figure="{key}" min="0" max="{last}" '
        f'value="{control.chosen}"{" disabled" if last == 0 else ""} aria-valuetext="{escape(control.choices[control.chosen])}">'
        f'<output for="{name}">{escape(control.choices[control.chosen])}</output></label>'
    )


def _figure_data(figure: Figure) -> dict[str, Any]:
    return {
        "key": figure.key,
        "tables": figure.tables,
        "traces": figure.traces,
        "layout": figure.layout,
        "choices": [list(control.choices) for control in figure.controls],
        "packed": figure.packed,
        "map": figure.map,
    }
