"""Self-contained HTML page of sections with text, figures and a map."""

import gzip
import json
import re
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from textwrap import shorten
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core import __version__
from replay_kit.core.words.colors import palette_css, scale
from replay_kit.show.figures.draw import panels_svg
from replay_kit.show.figures.figure import Figure, Panel

__all__ = ["Map", "Section", "figure_html", "items_html", "legend", "page_html", "table_html"]

#: Letters of a section in the menu.
_MENU = 32
_SCRIPTS = ("page", "map", "explore")
_DASHES = {"dash": "dashed", "dot": "dotted", "dashdot": "dashed", "longdash": "dashed"}


class Map(NamedTuple):
    """Map of a page, at most one.

    Attributes:
        key: Unique key in the page.
        title: Title.
        caption: Caption as HTML.
        alternative: Text alternative.
        choices: What to choose from as text, by name of the control: of the last one the last is chosen, otherwise the first.
        packed: Large numeric arrays, see ``pack_array``.
        drawn: Data for the script, see ``map.py``.
    """

    key: str
    title: str
    caption: str
    alternative: str
    choices: Mapping[str, Sequence[str]]
    packed: Mapping[str, Any]
    drawn: Mapping[str, Any]


class Section(NamedTuple):
    """Section of a page.

    Attributes:
        key: Unique key in the page.
        title: Heading.
        html: Escaped text before its figures.
        figures: Figures in order.
        missing: Sentences on missing data and how to obtain them.
        menu: Menu entry; empty for the title.
        answer: Summary sentence of a folded section, as HTML.
        beside: HTML next to a map that fills the first screen.
        parts: Summaries of folded parts, as HTML, with the keys of their figures.
    """

    key: str
    title: str
    html: str = ""
    figures: Sequence[Figure | Map] = ()
    missing: Sequence[str] = ()
    menu: str = ""
    answer: str = ""
    beside: str = ""
    parts: Mapping[str, Sequence[str]] = MappingProxyType({})


def page_html(title: str, sections: Sequence[Section], subtitle: str = "") -> str:
    """Return sections as one HTML page.

    Args:
        title: Title of the page.
        subtitle: Subtitle; may be empty.
        sections: Sections in order. Their keys and those of their figures are unique ids, also against ``page.html``.
    """
    data = list[dict[str, Any]]()
    body = "\n".join(_section_html(section, data) for section in sections)
    links = (
        f'<li><a href="#{one.key}">{escape(one.menu or shorten(one.title, _MENU, placeholder=" ..."))}</a></li>'
        for one in sections
    )
    packed = json.dumps(data, separators=(",", ":"), allow_nan=False).encode()
    parts = {
        "title": escape(title),
        "subtitle": escape(subtitle),
        "version": escape(__version__),
        "css": palette_css() + _text("page.css"),
        "links": "".join(links),
        "sections": body,
        # without the time of packing: the same data give the same bytes
        "figures": b64encode(gzip.compress(packed, 7, mtime=0)).decode(),
        "js": re.sub(r"(?m)^ *//.*\n|^ +", "", "".join(_text(f"{name}.js") for name in _SCRIPTS)),
    }
    page = _text("page.html")
    _check_ids(page + body)
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def _check_ids(html: str) -> None:
    """Check that element ids are unique, as the script finds figures and data by id."""
    ids = re.findall(r'<[a-z][^<>]*\sid="([^"]*)"', html)
    repeated = sorted({name for name in ids if ids.count(name) > 1})
    assert not repeated, (
        f"ids of a page: expected each once, got {', '.join(repeated)} again; give the section or figure another key"
    )


def _text(name: str) -> str:
    return files("replay_kit.show.page").joinpath(name).read_text(encoding="utf-8")


def pack_array(values: NDArray[np.float64], step: float, along: int = 0) -> dict[str, Any]:
    """Return an array as 16-bit integers in base64 for the page's script, rounded to a step.

    Differences along an axis are stored, low bytes before high bytes, for better compression by gzip.

    Args:
        values: Values of any shape; NaN becomes -32768, the missing value of the script.
        step: Quantisation step.
        along: Axis of the differences.
    """
    rounded = np.clip(np.rint(np.nan_to_num(values) / step), -32767, 32767)
    whole = np.where(np.isfinite(values), rounded, -32768).astype("<i2")
    # modulo 65536, so that the sum restores every value
    steps = np.diff(whole, axis=along, prepend=np.zeros_like(whole.take([0], axis=along)))
    data = b64encode(steps.reshape(-1).view(np.uint8).reshape(-1, 2).T.tobytes()).decode()
    return {"scale": step, "shape": list(values.shape), "along": along, "data": data}


def _section_html(section: Section, data: list[dict[str, Any]]) -> str:
    """Return a section as HTML, and append the data of its figures."""
    missing = "".join(f'<p class="missing">{escape(text)}</p>' for text in section.missing)
    each = {one.key: figure_html(one, data) for one in section.figures}
    folded = "".join(
        f'<details class="lit"><summary>{head}</summary>{"".join(each.pop(key, "") for key in keys)}</details>'
        for head, keys in section.parts.items()
    )
    title, figures = escape(section.title), "".join(each.values())
    if section.beside:
        return (
            f'<section id="{section.key}" class="first"><h2 class="unseen">{title}</h2>'
            f'<div class="seen">{figures}{missing}</div><div class="card">{section.beside}</div></section>'
        )
    inside = f"{section.html}{folded}{missing}{figures}"
    if section.answer:
        return (
            f'<section id="{section.key}"><details class="main"><summary><h2>{title}</h2><span>{section.answer}</span></summary>'
            f"{inside}</details></section>"
        )
    return f'<section id="{section.key}"><h2>{title}</h2>{inside}</section>'


def figure_html(figure: Figure | Map, data: list[dict[str, Any]]) -> str:
    """Return a figure as HTML with its caption, and append its data for the script."""
    notes = () if isinstance(figure, Map) else map(escape, figure.notes)
    caption = " ".join([figure.caption, *notes])
    about = f"<figcaption>{caption}</figcaption>"
    held: dict[str, Any] = {"key": figure.key}
    plot = f'<div class="plot" tabindex="0" role="group" aria-label="{escape(figure.alternative)}">'
    data.append(held)
    if isinstance(figure, Map):
        held |= {"packed": figure.packed, "map": figure.drawn}
        held["choices"] = [list(choices) for choices in figure.choices.values()]
        return _map_html(figure, plot, about)
    panels, held["panels"] = [], []
    for panel, (svg, said) in zip(figure.panels, panels_svg(figure), strict=True):
        held["panels"].append(said)
        head = (
            "" if panel.title.lower() == figure.title.lower() else f"<h4>{escape(panel.title)}</h4>"
        )
        panels.append(f'<div class="panel">{head}{svg}{legend(panel)}</div>')
    return f'<figure id="{figure.key}"><h3>{escape(figure.title)}</h3>{plot}{"".join(panels)}</div>{about}</figure>'


def legend(panel: Panel) -> str:
    """Return the legend of a panel, if it has several marks, and its colour scale."""
    named = {mark.name: _swatch(mark) for mark in panel.marks if mark.name and mark.scale is None}
    if panel.band is not None:
        named[panel.band[2]] = '<i class="band"></i>'
    rows = [f"<span>{look}{escape(name)}</span>" for name, look in named.items()]
    for mark in panel.marks:
        if mark.scale is not None:
            name, least, most, unit = mark.scale
            ends = ",".join(color for _, color in scale(name))
            rows = [
                f'<span class="bar-color"><i style="background:linear-gradient(to right,{ends})"></i><span>{least:g}</span>'
                f"<span></span><span>{most:g} {unit}</span></span>"
            ]
    return (
        f'<div class="legend">{"".join(rows)}</div>'
        if len(named) > 1 or (not named and rows)
        else ""
    )


def _swatch(mark: Any) -> str:
    color = mark.color if mark.color.startswith("#") else f"var(--{mark.color})"
    if mark.kind in ("bars", "band", "ring"):
        return f'<i class="band" style="background:{color}"></i>'
    dash = _DASHES.get(mark.dash, "solid")
    line = f'<i style="border-top:2px {dash} {color}"></i>' if mark.kind != "points" else ""
    sign = {"square": "■", "diamond": "◆", "triangle-up": "▲", "triangle-down": "▼", "x": "✕"}
    sign |= {"star": "★", "cross": "✚", "pentagon": "⬟", "circle-open": "○"}
    dot = (
        f'<b style="color:{color}">{sign.get(mark.symbol, "●")}</b>' if mark.kind != "line" else ""
    )
    return line + dot


_VIEWS = {"plan": "Vehicle and plan", "track": "Track", "region": "Region"}


def _map_html(figure: Map, plot: str, about: str) -> str:
    """Return a map as HTML with its controls and folded text alternative."""
    views = "".join(
        f'<button type="button" data-view="{key}" aria-pressed="false">{text}</button>'
        for key, text in _VIEWS.items()
        if key in figure.drawn["views"]
    )
    zoom = "".join(
        f'<button type="button" data-zoom="{factor}" aria-label="{text}">{sign}</button>'
        for factor, text, sign in ((1.5, "Zoom in", "+"), (0.6667, "Zoom out", "−"))
    )
    button = '<button type="button" class="play" aria-label="Play" aria-pressed="false">▶</button>'
    controls = "".join(_controls_html(figure))
    names = {mark["name"]: mark.get("off", False) for mark in figure.drawn["marks"]}
    names |= {"drift": False} if controls else {}
    layers = "".join(
        f'<li><label><input type="checkbox" name="{escape(name)}"{"" if off else " checked"}> {escape(name)}</label></li>'
        for name, off in names.items()
        if name
    )
    plot += '<p class="waiting">This map is drawn by JavaScript, in a browser of 2023 or later.</p>'
    return (
        f'<figure id="{figure.key}" class="map"><h3 class="unseen">{escape(figure.title)}</h3>'
        f'<div class="stage">{plot}</div><div class="tools">{views}{zoom}'
        f'<details class="layers"><summary>Layers</summary><ul>{layers}</ul></details></div>'
        f'<div class="keys" aria-hidden="true"></div><div class="controls">{button if controls else ""}{controls}</div></div>'
        f'<details class="about"><summary>About this map</summary>{about}</details></figure>'
    )


def _controls_html(figure: Map) -> Iterator[str]:
    """Yield a list for the first control and sliders for the others."""
    for number, (title, choices) in enumerate(figure.choices.items()):
        name, last = f"{figure.key}-{number}", len(choices) - 1
        if number == 0:
            options = (
                f'<option value="{k}">{escape(text)}</option>' for k, text in enumerate(choices)
            )
            yield f'<label for="{name}">{title} <select id="{name}">{"".join(options)}</select></label>'
            continue
        chosen = last if number == len(figure.choices) - 1 else 0
        text, fixed = escape(choices[chosen]), " disabled" if last == 0 else ""
        yield (
            f'<label for="{name}">{title} <input type="range" id="{name}" min="0" max="{last}" '
            f'value="{chosen}"{fixed} aria-valuetext="{text}"><output for="{name}">{text}</output></label>'
        )


#: Rows of a table that is open at first.
_ROWS_OPEN = 14


def table_html(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> str:
    """Return a table as HTML, scrollable if wide and folded if long.

    Args:
        heads: Column headings.
        rows: Rows of escaped cells.
        caption: Caption.
    """
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    table = (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
        f"<table><caption><span>{escape(caption)}</span></caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )
    if len(rows) <= _ROWS_OPEN:
        return table
    return f"<details><summary>{escape(caption)} ({len(rows)} rows)</summary>{table}</details>"


def items_html(items: Sequence[str]) -> str:
    """Return a list of escaped items as HTML."""
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>"


def compass(bearing: float, what: str) -> str:
    """Return a compass with an arrow as SVG.

    Args:
        bearing: Bearing clockwise from north [degrees].
        what: Text alternative.
    """
    return (
        f'<svg class="compass" viewBox="-33 -33 66 66" role="img" aria-label="{escape(what)}"><circle r="31"/><text y="-20">N</text>'
        f'<path transform="rotate({bearing:.1f})" d="M0-25 L8 12 L0 6 L-8 12Z"/></svg>'
    )
