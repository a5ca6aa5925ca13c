"""Status as a self-contained HTML page that reloads itself and keeps focus and unfolded parts."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from hashlib import sha256
from html import escape
from importlib.resources import files

import numpy as np

from replay_kit.core.colors import SYMBOLS, palette_css
from replay_kit.core.text import time_text
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.page.parts import compass
from replay_kit.show.status.held import course
from replay_kit.show.status.lines import Detail, details, lines, title
from replay_kit.show.status.status import Status
from replay_kit.show.vehicles import vehicle_rows

# What is focused and unfolded is kept for the next look; nothing is loaded while no one looks.
_SCRIPT = """
const parts = () => [...document.querySelectorAll("details")];
const kept = history.state || {};
parts().forEach((part) => { part.open = (kept.open || []).includes(part.id); });
document.getElementById(kept.focus)?.focus({ preventScroll: true });
scrollTo(0, kept.top || 0);
setInterval(() => {
  if (document.hidden) return;
  const open = parts().filter((part) => part.open).map((part) => part.id);
  history.replaceState({ open, focus: document.activeElement.id, top: scrollY }, "");
  location.reload();
}, 1000 * document.documentElement.dataset.again);
"""


def status_page(status: Status, refresh_s: int = 60) -> str:
    """Return a status as HTML.

    Args:
        status: Status.
        refresh_s: Reload interval of the page [s].
    """
    parts = {
        "title": escape(title(status)),
        "alarms": "".join(
            f"<li><b>{escape(alarm.kind)}</b> {escape(alarm.text)}</li>" for alarm in status.alarms
        ),
        "map": _drawn(status),
        "brief": "".join(
            f"<dt>{escape(one.label)}</dt><dd>{one.said.html}</dd>" for one in lines(status)
        ),
        "lines": "\n".join(map(_detail_html, details(status))),
    }
    return _filled(parts, status.now_ns, refresh_s)


def several_page(
    statuses: Mapping[str, Status],
    outcome: Outcome | None,
    pages: Mapping[str, str],
    refresh_s: int = 60,
) -> str:
    """Return the status of several vehicles as HTML: alarms, and a line for each linked to its page.

    Args:
        statuses: Status of each vehicle, at least one.
        outcome: Outcome of the run; None if unfinished.
        pages: File names of their pages.
        refresh_s: Reload interval of the page [s].
    """
    alarms = [(name, alarm) for name, status in statuses.items() for alarm in status.alarms]
    briefs = {name: lines(status) for name, status in statuses.items()}
    rows = {} if outcome is None else {row[0]: row[-1] for row in vehicle_rows(outcome)}
    parts = {
        "title": escape(", ".join(statuses)),
        "alarms": "".join(
            f"<li><b>{escape(name)}: {escape(alarm.kind)}</b> {escape(alarm.text)}</li>"
            for name, alarm in alarms
        ),
        "map": "",
        "brief": "".join(
            f'<dt><a href="{escape(pages[name])}">{escape(name)}</a></dt>'
            f"<dd>{escape(rows.get(name, ''))}</dd>"
            + "".join(
                f"<dt>{escape(one.label)}</dt><dd>{escape(str(one.said))}</dd>" for one in each
            )
            for name, each in briefs.items()
        ),
        "lines": "".join(
            f'<p><a href="{escape(pages[name])}">All answers of {escape(name)}</a></p>'
            for name in statuses
        ),
    }
    now_ns = max(status.now_ns for status in statuses.values())
    return _filled(parts, now_ns, refresh_s)


def _filled(parts: Mapping[str, str], now_ns: int, refresh_s: int) -> str:
    page = files("replay_kit.show.status").joinpath("status.html").read_text(encoding="utf-8")
    common = {
        "refresh": str(refresh_s),
        "digest": b64encode(sha256(_SCRIPT.encode()).digest()).decode(),
        "palette": palette_css(),
        "script": _SCRIPT,
        "now": escape(time_text(now_ns)),
        "iso": escape(time_text(now_ns).replace(" ", "T")),
    }
    for name, text in {**common, **parts}.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def _drawn(status: Status) -> str:
    """Return a small map and the current at the vehicle as HTML."""
    current = status.figures.get("current", {})
    one = current.get("corrected") or current.get("measured") or current.get("predicted")
    arrow = ""
    if one:
        _, toward = course(one)
        what = f"The current at the vehicle goes toward {toward:.0f} degrees"
        arrow = f"<figure>{compass(toward, what)}<figcaption>current</figcaption></figure>"
    return small_map(status.places) + arrow


def _detail_html(one: Detail) -> str:
    first, *more = one.texts
    rest = "".join(f"<p>{escape(text)}</p>" for text in more)
    return (
        f'<section id="{one.key}"><h2>{escape(one.label)}<span class="age">{escape(one.since)}</span></h2>'
        f'<p class="first">{escape(first)}</p>{rest}</section>'
    )


Points = Sequence[tuple[float, float]]
# Of the way only some fixes are known here.
_LOOKS = {
    "ellipse": ("ring", SYMBOLS["plan"][0], "circle", "solid", 6.0),
    "track": ("line", SYMBOLS["track"][0], "circle", "dot", 6.0),
    "plan": ("joined", SYMBOLS["plan"][0], "circle", "solid", 5.0),
    "goal": ("points", *SYMBOLS["goal"], "solid", 18.0),
    "vehicle": ("points", *SYMBOLS["vehicle"], "solid", 11.0),
}


def small_map(places: Mapping[str, Points]) -> str:
    """Return a map of track, plan, goal and the ellipse of the next surfacing; empty with fewer than two points.

    Args:
        places: Points (east, north) [m] of ``track``, ``plan``, ``goal`` and ``ellipse``, if known.
    """
    # its library loads slowly, and a status in words needs none
    from replay_kit.show.figures.draw import panels_svg

    every = np.array([point for points in places.values() for point in points]) / 1e3
    if len(np.unique(every, axis=0)) < 2:
        return ""
    vehicle = list(places.get("track", ())[-1:])
    drawn = {**places, "plan": [*vehicle, *places.get("plan", ())], "vehicle": vehicle}
    marks = []
    for name, (kind, color, symbol, dash, size) in _LOOKS.items():
        if drawn.get(name):
            x, y = np.array(drawn[name]).T / 1e3
            marks.append(Mark(kind, x, y, name, color, symbol, dash, size=size))  # type: ignore[arg-type]
    least, most = every.min(axis=0), every.max(axis=0)
    shape = np.array([1.5, 1.0])
    half = 0.6 * shape * max(((most - least) / shape).max(), 0.1)
    ends = [*zip(*(0.5 * (least + most) + side * half for side in (-1.0, 1.0)), strict=True)]
    axes = Axis("east", "km", ends[0]), Axis("north", "km", ends[1])
    (svg, _), *_ = panels_svg(Figure("small", "", [Panel("", *axes, marks, 1.0 / 1.5)]), 320.0)
    wide, high = most - least
    what = f"Map, north up, {wide:.0f} by {high:.0f} km: {', '.join(places)}"
    return f'<div class="map" role="img" aria-label="{what}">{svg}</div>'
