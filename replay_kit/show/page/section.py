"""What a section of a page is made of: text as HTML, figures as plotly traces on named columns of data, and small drawings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.colors import SYMBOLS

#: Significant digits of the data of figures: more than a screen can show.
_DIGITS = 5
#: Rows of a table that is open at first.
_ROWS_OPEN = 14


@dataclass(frozen=True, slots=True)
class Control:
    """A control of a figure.

    Attributes:
        name: Of what it chooses.
        kind: ``range`` for a slider, ``select`` for a list.
        choices: What can be chosen, as text.
        chosen: Position of the choice at first.
    """

    name: str
    kind: str
    choices: Sequence[str]
    chosen: int = 0


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure: the page's script draws it.

    Attributes:
        key: Unique in the page, also the name of its files of data.
        title: What it shows.
        caption: What to see in it, as HTML.
        alternative: What it shows, in words for who does not see it.
        tables: Data by name of the table, then of the column; offered as CSV. The table of a packed array says how its axes are named.
        traces: plotly traces; a value ``$table.column`` stands for a column.
        layout: plotly layout.
        controls: Controls; what they change is in the traces, see ``page.js``.
        packed: Large numeric arrays, see ``pack``.
        map: What the map's scripts draw: axes, frame, views, marks (``figures/on_canvas.py``); empty for charts.
    """

    key: str
    title: str
    caption: str
    alternative: str
    tables: Mapping[str, Mapping[str, Any]]
    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    controls: Sequence[Control] = ()
    packed: Mapping[str, Any] = field(default_factory=dict)
    map: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a page.

    Attributes:
        key: Unique in the page.
        title: Its heading.
        html: Text before its figures, already escaped.
        figures: In order.
        missing: What the result does not hold, and what would give it, as sentences.
        menu: In the menu; empty for the title.
        answer: The section in a sentence, as HTML; with it the section is folded, and opens on demand.
        beside: HTML beside a map, which then fills the first screen.
        placed: Whether ``html`` holds the figures already.
    """

    key: str
    title: str
    html: str = ""
    figures: Sequence[Figure] = ()
    missing: Sequence[str] = ()
    menu: str = ""
    answer: str = ""
    beside: str = ""
    placed: bool = False


def column(values: ArrayLike, digits: int = _DIGITS) -> list[float | None]:
    """Return numbers for JSON, rounded to some significant digits; what is not finite is None."""
    out: list[float | None] = []
    for value in np.asarray(values, dtype=np.float64).ravel().tolist():
        out.append(float(f"{value:.{digits}g}") if math.isfinite(value) else None)
    return out


def times(time_ns: NDArray[np.int64]) -> list[str]:
    """Return times [ns, UTC] as plotly reads them, to the second."""
    return [
        str(each).replace("T", " ")
        for each in np.asarray(time_ns, dtype=np.int64)
        .astype("datetime64[ns]")
        .astype("datetime64[s]")
    ]


def pack(values: NDArray[np.float64], scale: float, along: int = 0) -> dict[str, Any]:
    """Return an array as 16-bit integers in base64 for the page's script: half a ``scale`` is the largest error.

    What is kept are differences along an axis, all low bytes before all high ones: both make long runs that gzip shortens.

    Args:
        values: Any shape; NaN becomes -32768, which the script reads as missing.
        scale: Value of one step.
        along: Axis along which neighbours are most alike.
    """
    from base64 import b64encode

    whole = np.where(
        np.isfinite(values), np.clip(np.rint(np.nan_to_num(values) / scale), -32767, 32767), -32768
    ).astype("<i2")
    # modulo 65536, so that the sum restores every value
    steps = np.diff(whole, axis=along, prepend=np.zeros_like(whole.take([0], axis=along)))
    return {
        "scale": scale,
        "shape": list(values.shape),
        "along": along,
        "data": b64encode(steps.reshape(-1).view(np.uint8).reshape(-1, 2).T.tobytes()).decode(),
    }


def table_html(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> str:
    """Return a table as HTML that scrolls where it is too wide, and opens on demand where it is long.

    Args:
        heads: Of the columns.
        rows: Cells, already escaped.
        caption: What the table shows.
    """
    if len(rows) > _ROWS_OPEN:
        return f"<details><summary>{escape(caption)} ({len(rows)} rows)</summary>{_table(heads, rows, caption)}</details>"
    return _table(heads, rows, caption)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> str:
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
        f"<table><caption><span>{escape(caption)}</span></caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def items_html(items: Sequence[str]) -> str:
    """Return a list as HTML, its items already escaped."""
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>"


_WIDE, _HIGH, _EDGE = 360.0, 240.0, 22.0
Points = Sequence[tuple[float, float]]


def compass(bearing: float, what: str) -> str:
    """Return a compass with an arrow.

    Args:
        bearing: Clockwise from north [degrees].
        what: It shows, in words.
    """
    return (
        f'<svg class="compass" viewBox="-33 -33 66 66" role="img" aria-label="{escape(what)}"><circle r="31"/><text y="-20">N</text>'
        f'<path transform="rotate({bearing:.1f})" d="M0-25 L8 12 L0 6 L-8 12Z"/></svg>'
    )


def small_map(places: Mapping[str, Points]) -> str:
    """Return a map of the vehicle's way, the plan, its goal and the ellipse of the next surfacing; empty without two places.

    Args:
        places: Points (east, north) [m] of ``track``, ``plan``, ``goal`` and ``ellipse``, those that are known.
    """
    every = [point for points in places.values() for point in points]
    if len(set(every)) < 2:
        return ""
    west, east = (end(point[0] for point in every) for end in (min, max))
    south, north = (end(point[1] for point in every) for end in (min, max))
    scale = min(
        (_WIDE - 2.0 * _EDGE) / max(east - west, 1.0),
        (_HIGH - 2.0 * _EDGE) / max(north - south, 1.0),
    )

    def at(point: tuple[float, float]) -> tuple[float, float]:
        x = 0.5 * _WIDE + scale * (point[0] - 0.5 * (west + east))
        return x, 0.5 * _HIGH - scale * (point[1] - 0.5 * (south + north))

    def line(points: Points) -> str:
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, points))

    ink, plan = (f"var(--{SYMBOLS[name][0]})" for name in ("track", "plan"))
    track, legs = places.get("track", ()), places.get("plan", ())
    out = []
    if "ellipse" in places:
        out.append(f'<polygon points="{line(places["ellipse"])}" fill="{plan}" opacity=".25"/>')
    # of the way only some fixes are known here
    out.append(
        f'<polyline points="{line(track)}" fill="none" stroke="{ink}" stroke-width="2" stroke-dasharray="2 4"/>'
    )
    way = [*track[-1:], *legs]
    out.append(f'<polyline points="{line(way)}" fill="none" stroke="{plan}" stroke-width="2"/>')
    out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{plan}"/>' for x, y in map(at, legs)]
    for x, y in map(at, track[-1:]):
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="{ink}"/>')
    for x, y in map(at, places.get("goal", ())):
        arms = f"M{x - 11:.1f} {y:.1f}h22M{x:.1f} {y - 11:.1f}v22"
        out.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="none" stroke="{plan}" stroke-width="2"/>'
        )
        out.append(f'<path d="{arms}" stroke="{plan}" stroke-width="2"/>')
    km = next(
        each
        for each in (500, 200, 100, 50, 20, 10, 5, 2, 1, 0.5, 0.1)
        if each * 1e3 * scale < 130 or each == 0.1
    )
    out.append(
        f'<path d="M12 {_HIGH - 12}h{1e3 * km * scale:.1f}" stroke="{ink}" stroke-width="2"/>'
    )
    out.append(f'<text x="12" y="{_HIGH - 17}" fill="{ink}" font-size="12">{km:g} km</text>')
    what = f"Map, north up, {(east - west) / 1e3:.0f} by {(north - south) / 1e3:.0f} km: {', '.join(places)}"
    return f'<svg class="map" viewBox="0 0 {_WIDE:g} {_HIGH:g}" role="img" aria-label="{what}">{"".join(out)}</svg>'
