"""A status as a page that fetches nothing and loads itself again."""

from html import escape
from importlib.resources import files

from replay_kit.core.text import time_text
from replay_kit.show.status.status import Line, Status
from replay_kit.show.status.text import line_age


def status_page(status: Status, refresh_s: int = 60) -> str:
    """Return a status as HTML.

    Args:
        status: The status.
        refresh_s: After how many seconds a browser loads the page again.
    """
    page = files("replay_kit.show.status").joinpath("status.html").read_text(encoding="utf-8")
    parts = {
        "refresh": str(refresh_s),
        "title": escape(status.name),
        "now": escape(time_text(status.now_ns)),
        "iso": escape(time_text(status.now_ns).replace(" ", "T")),
        "alarms": "".join(
            f"<li><b>{escape(alarm.kind)}</b> {escape(alarm.text)}</li>" for alarm in status.alarms
        ),
        "lines": "\n".join(_line_html(status, line) for line in status.lines),
    }
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def _line_html(status: Status, line: Line) -> str:
    first, *more = line.text
    rest = "".join(f"<p>{escape(text)}</p>" for text in more)
    age = line_age(status, line)
    shown = f'<span class="age">{escape(age)}</span>' if age else ""
    kind = ' class="alarm"' if line.alarms else ""
    return f'<section id="{line.key}"{kind}><h2>{escape(line.label)}{shown}</h2><p class="first">{escape(first)}</p>{rest}</section>'
