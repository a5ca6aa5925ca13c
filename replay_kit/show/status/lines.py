"""A status in words: in ten lines, an alarm first, each number one of the status's figures; and whole, on a screen of 80 columns."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from replay_kit.core.geodesy import heading_deg
from replay_kit.core.text import place_text, printable, time_text
from replay_kit.show.numbers import Sentence, Shown, fixed, hours_text, minutes_text
from replay_kit.show.status.status import Line, Status

_AGE = 8
_SECOND = 1_000_000_000


def age_text(seconds: float) -> str:
    """Return how old something is, such as ``now``, ``35 min``, ``4.2 h``, ``3.1 d``; of what lies ahead with ``in``."""
    if abs(seconds) < 60.0:
        return "now"
    text = hours_text(seconds).replace(" days", " d")
    return text if seconds > 0.0 else f"in {text}"


def line_age(status: Status, line: Line) -> str:
    """Return the age of an answer; empty for one without a time."""
    return "" if line.time_ns is None else age_text((status.now_ns - line.time_ns) / _SECOND)


def status_text(status: Status, width: int = 80) -> str:
    """Return a status as text: an alarm a line first, then the answers, each with its age.

    Args:
        status: The status.
        width: Columns of the terminal.
    """
    rows = [f"{printable(status.name)}, status for {time_text(status.now_ns)}"]
    for alarm in status.alarms:
        rows += _wrapped(f"! {alarm.kind.upper()}: ", printable(alarm.text), width, 2)
    rows.append(f"{'':{_LABEL}}{'age':>{_AGE}}  ")
    for line in status.lines:
        head = f"{'!' if line.alarms else ''}{line.label}"
        head = f"{head:<{_LABEL}}{line_age(status, line):>{_AGE}}  "
        for text in line.text:
            rows += _wrapped(head, printable(text), width, _LABEL + _AGE + 2)
            head = " " * (_LABEL + _AGE + 2)
    return "\n".join(row.rstrip() for row in rows) + "\n"


def _wrapped(head: str, text: str, width: int, indent: int) -> list[str]:
    return textwrap.wrap(
        text,
        max(width, 40),
        initial_indent=head,
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
    ) or [head]


_LABEL = 11
#: Lines of alarms: of more, the last says how many.
_ALARMS = 2


class Brief(NamedTuple):
    """A line of a brief status.

    Attributes:
        label: What it answers, in a word.
        parts: Texts, and numbers among them.
    """

    label: str
    parts: Sequence[str | Shown]

    @property
    def text(self) -> str:
        """The line without its label."""
        return str(Sentence(self.parts))

    @property
    def html(self) -> str:
        """The line without its label, each number with the figure that it shows."""
        return Sentence(self.parts).html


def brief_text(status: Status, width: int = 80) -> str:
    """Return a status in ten lines of a terminal.

    Args:
        status: The status.
        width: Columns of the terminal.
    """
    rows = []
    for alarm in status.alarms[:_ALARMS]:
        rows.append(f"! {alarm.kind.upper()}: {printable(alarm.text)}")
    if len(status.alarms) > _ALARMS:
        rows[-1] = f"! and {len(status.alarms) - _ALARMS + 1} more alarms; -v shows them"
    rows += [f"{line.label:<{_LABEL}}{printable(line.text)}" for line in brief_lines(status)]
    rows.append(f"{printable(status.name)}, {time_text(status.now_ns)}; -v shows all")
    return "".join(f"{_short(row, width)}\n" for row in rows)


def _short(row: str, width: int) -> str:
    if len(row) <= width:
        return row.rstrip()
    keep = 0 if row.startswith("!") else _LABEL
    return row[:keep] + textwrap.shorten(row[keep:], width - keep, placeholder=" ...")


def brief_lines(status: Status) -> Iterator[Brief]:
    """Yield the answers of a status, each in a line."""
    found = status.figures
    makers = {
        "command": _steer,
        "odds": _odds,
        "surfacing": _surfacing,
        "position": _position,
        "made_good": _goal,
        "current": _current,
        "fit": _trust,
    }
    for key, make in makers.items():
        if values := found.get(key):
            yield from make(values)


def _steer(values: Mapping[str, Any]) -> Iterator[Brief]:
    if values["heading_deg"] is None:
        yield Brief("Steer", (f"no command: {values['message']}",))
        return
    heading, angle = values["heading_deg"], values["glide_angle_deg"]
    parts: list[str | Shown] = [
        Shown("command.heading_deg", heading, f"{round(heading) % 360:03d}"),
        "° true, glide angle ",
        Shown("command.glide_angle_deg", angle, fixed(angle, 0)),
        "°",
    ]
    if values["depth_m"] is not None:
        parts += [", to ", Shown("command.depth_m", values["depth_m"], fixed(values["depth_m"], 0))]
        parts += [" m"]
    basis = values["dives"].partition(":")[0] or "as set"
    if values["speed"] is not None:
        parts += [", ", Shown("command.speed", values["speed"], fixed(values["speed"], 2))]
        parts += [f" m/s ({basis})"]
    yield Brief("Steer", parts)
    if values["longitude"] is not None:
        yield Brief("  for", _place("command", values))


def _place(key: str, values: Mapping[str, Any]) -> list[str | Shown]:
    """Return a place in degrees and minutes, and in degrees."""
    longitude, latitude = values["longitude"], values["latitude"]
    east, north = (part.strip() for part in place_text(longitude, latitude).split(","))
    return [
        f"{minutes_text(longitude, latitude)} (",
        Shown(f"{key}.longitude", longitude, east),
        ", ",
        Shown(f"{key}.latitude", latitude, north),
        ")",
    ]


def _odds(values: Mapping[str, Any]) -> Iterator[Brief]:
    if "reached" not in values:
        yield Brief("Odds", (f"plan {values['status']}: {values['message']}",))
        return
    share, (low, high) = values["reached"], values["reached_interval"]
    parts: list[str | Shown] = [
        Shown("odds.reached", share, f"{100.0 * share:.0f} %"),
        " (",
        Shown("odds.reached_interval.0", low, f"{100.0 * low:.0f}"),
        " to ",
        Shown("odds.reached_interval.1", high, f"{100.0 * high:.0f}"),
        ") of ",
        Shown("odds.samples", values["samples"], str(values["samples"])),
        " samples arrive",
    ]
    if values["duration_s"] is not None:
        hours, off = values["duration_s"], values["closest_approach_m"]
        parts += [f"; plan {values['status']}, "]
        parts += [Shown("odds.duration_s", hours, hours_text(hours))]
        parts += [", ", Shown("odds.closest_approach_m", off, f"{off:.0f} m"), " off"]
    yield Brief("Odds", parts)


def _surfacing(values: Mapping[str, Any]) -> Iterator[Brief]:
    if (one := values.get("next")) is None:
        return
    basis = "by the plan" if one["basis"] == "plan" else "as the last dive"
    parts: list[str | Shown] = [f"{one['time'][:16]} UTC {basis}"]
    if one["major_m"] is not None:
        axes = [
            Shown(f"surfacing.next.{name}", one[name], fixed(one[name] / 1e3, 1))
            for name in ("major_m", "minor_m")
        ]
        parts += ["; 90 % within ", axes[0], " x ", axes[1], " km"]
    if one.get("late_s"):
        parts.insert(0, "OVERDUE, ")
    yield Brief("Surfacing", parts)


def _position(values: Mapping[str, Any]) -> Iterator[Brief]:
    parts = _place("position", values)
    if values["error_m"]:
        parts += [
            " ± ",
            Shown("position.error_m", values["error_m"], f"{values['error_m']:g}"),
            " m",
        ]
    yield Brief("Position", parts)


def _goal(values: Mapping[str, Any]) -> Iterator[Brief]:
    far = values["to_goal_km"]
    parts: list[str | Shown] = [
        Shown("made_good.to_goal_km", far, fixed(far, 1)),
        " km to the goal",
    ]
    if values["km_a_day"]:
        rate = values["km_a_day"][0]
        made, key = rate["km_a_day"], "made_good.km_a_day.0"
        parts += ["; made good ", Shown(f"{key}.km_a_day", made, fixed(made, 1, True))]
        parts += [" km a day over "]
        parts += [Shown(f"{key}.days", rate["days"], hours_text(86_400.0 * rate["days"]))]
    yield Brief("Goal", parts)


def _current(values: Mapping[str, Any]) -> Iterator[Brief]:
    name = "corrected" if "corrected" in values else "measured"
    one = values.get(name)
    if one is None:
        return
    parts = [f"dive {values['dive']} {name} ", *_velocity(name, one)]
    if (other := values.get("predicted")) is not None:
        parts += [", predicted ", *_velocity("predicted", other)]
    yield Brief("Current", parts)


def _velocity(name: str, one: Mapping[str, float]) -> list[str | Shown]:
    """Return the length of a velocity, of its two figures, and where it leads."""
    speed = (one["east"] ** 2 + one["north"] ** 2) ** 0.5
    toward = f"{round(float(heading_deg(one['east'], one['north']))) % 360:03d}"
    return [
        Shown(f"current.{name}#speed", speed, fixed(100.0 * speed, 1)),
        f" cm/s to {toward}°",
    ]


def _trust(values: Mapping[str, Any]) -> Iterator[Brief]:
    if "decision" not in values:
        yield Brief("Trust", ("no verdict",))
        return
    reasons = "; ".join(values["reasons"])
    yield Brief("Trust", (": ".join(filter(None, [values["decision"], reasons])),))
