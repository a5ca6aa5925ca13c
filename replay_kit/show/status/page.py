"""Status as a self-contained HTML page that reloads itself and keeps focus and unfolded parts."""

from base64 import b64encode
from collections.abc import Mapping
from hashlib import sha256
from html import escape
from importlib.resources import files

from replay_kit.core.words.colors import palette_css
from replay_kit.core.words.text import time_text
from replay_kit.results.outcome.outcome import Outcome
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
    inside = "\n".join(map(_detail_html, details(status)))
    folded = f'<details id="all"><summary id="unfold">All answers, with their ages</summary>\n{inside}\n</details>'
    return _filled(title(status), {"": status}, _brief(status) + folded, refresh_s)


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
    verdicts = {} if outcome is None else {row[0]: row[-1] for row in vehicle_rows(outcome)}
    parts = [
        f'<h2><a href="{escape(pages[name])}">{escape(name)}</a> {escape(verdicts.get(name, ""))}</h2>{_brief(status)}'
        for name, status in statuses.items()
    ]
    return _filled(", ".join(statuses), statuses, "".join(parts), refresh_s)


def _brief(status: Status) -> str:
    rows = (f"<dt>{escape(one.label)}</dt><dd>{one.said.html}</dd>" for one in lines(status))
    return f"<dl>{''.join(rows)}</dl>"


def _filled(name: str, statuses: Mapping[str, Status], body: str, refresh_s: int) -> str:
    """Return the page of a body below the alarms of vehicles."""
    now = escape(time_text(max(status.now_ns for status in statuses.values())))
    alarms = (
        f"<li><b>{escape(f'{vehicle}: ' if vehicle else '')}{escape(alarm.kind)}</b> {escape(alarm.text)}</li>"
        for vehicle, status in statuses.items()
        for alarm in status.alarms
    )
    page = files("replay_kit.show.status").joinpath("status.html").read_text(encoding="utf-8")
    parts = {
        "refresh": str(refresh_s),
        "digest": b64encode(sha256(_SCRIPT.encode()).digest()).decode(),
        "palette": palette_css(),
        "script": _SCRIPT,
        "now": now,
        "iso": now.replace(" ", "T"),
        "title": escape(name),
        "alarms": "".join(alarms),
        "body": body,
    }
    for key, text in parts.items():
        page = page.replace(f"<!--{key}-->", text)
    return page


def _detail_html(one: Detail) -> str:
    first, *more = one.texts
    rest = "".join(f"<p>{escape(text)}</p>" for text in more)
    return (
        f'<section id="{one.key}"><h2>{escape(one.label)}<span class="age">{escape(one.since)}</span></h2>'
        f'<p class="first">{escape(first)}</p>{rest}</section>'
    )
