"""Status as text: a summary of ten lines for 80 columns, details with ages, and a self-contained page that reloads itself.

Each number is a figure of the status.
"""

import math
import re
import textwrap
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any, NamedTuple

from replay_kit.core.words.colors import palette_css
from replay_kit.core.words.text import printable, time_text
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.numbers import Sentence, clock, hours_text, sentence
from replay_kit.show.sentences import vehicle_rows
from replay_kit.show.status.held import Values, course
from replay_kit.show.status.status import Status

#: Columns of a screen, and of its labels.
WIDTH, _LABEL = 80, 11
#: What a predicted surfacing relies on.
BASIS = {"plan": "if it flies this plan", "last_dive": "as the last dive"}

# Reasons that the odds of a plan say with numbers, and ends that a shortened text does not keep.
_OF_PLAN = re.compile("the plan |simulated flight")
_DANGLING = re.compile(
    "( (a|an|the|of|to|by|in|at|on|for|from|with|and|or|against|before|after))+$"
)


class Line(NamedTuple):
    """Line of the summary.

    Attributes:
        label: Label of one word.
        said: Text with numbers.
    """

    label: str
    said: Sentence

    def __str__(self) -> str:
        """Return the line with its label."""
        return f"{self.label:<{_LABEL}}{printable(str(self.said))}".rstrip()


def title(status: Status) -> str:
    """Return a line with dive, position and age of the last fix; the result's name without a fix."""
    name = printable(status.name.removesuffix(".mcap"))
    if (at := status.figures.get("position")) is None:
        return name
    old = f"{hours_text(at['age_s'])} ago" if at["age_s"] >= 60.0 else "now"
    for what in ("fix ", ""):
        form = f"[, dive {{dive}}]: {what}{{place}} {{since:clock}} UTC, {old}"
        text = str(sentence(form, at))
        if len(name) + len(text) <= WIDTH:
            break
    return f"{_shortened(name, WIDTH - len(text))}{text}"


def lines(status: Status, room: int = WIDTH - _LABEL) -> list[Line]:
    """Return the summary: verdict with reasons, then the answers.

    Args:
        status: Status.
        room: Most letters of what a line says; a page wraps its lines.
    """
    found = [_first(status, room)]
    for key, make in _LINES.items():
        if values := status.figures.get(key):
            for label, form, fields, at in make(values, room):
                found.append(Line(label, sentence(form, fields, f"{key}.{at}")))
    return found


def _first(status: Status, room: int) -> Line:
    """Return the first line: an alarm outside the verdict, otherwise the verdict, with the reasons that fit."""
    fit, odds = (status.figures.get(key, {}) for key in ("fit", "odds"))
    texts = [alarm.text for alarm in status.alarms if alarm.kind not in ("plan", "consistency")]
    label = "ALARM" if texts else (fit.get("verdict") or "no verdict").upper()
    findings, odds_said = fit.get("findings", ()), str(said := _odds_sentence(odds))
    plan = odds.get("status")
    severe = [one for one in findings if one["severity"] != "warning"]
    named = [one["name"] for one in findings]
    reasons = [text for text in fit.get("reasons", ()) if text not in named]
    of_plan = [text for text in reasons if _OF_PLAN.search(text)]
    others = [text for text in reasons if text not in of_plan]
    if not of_plan and plan not in (None, "reached"):
        of_plan = [f"plan {plan}"]
    # the odds say it with numbers, but not that a plan must not be flown
    if of_plan and odds_said and plan != "unsafe":
        of_plan = [odds_said]
    texts += [
        *(f"{one['name']}: {one['evidence']}" for one in severe),
        *others,
        *(one["name"] for one in findings if one not in severe),
        *of_plan,
    ]
    # odds that are no reason are said where they fit
    more = [odds_said] if odds_said and odds_said not in texts else []
    known = "no contradiction found" if fit.get("verdict") else fit.get("unjudged", "")
    whole = "; ".join([*texts, *more]) or known
    text = whole if len(whole) <= room else fitting_texts(texts or [whole], room)
    end = said.parts if odds_said and text.endswith(odds_said) else ()
    return Line(label, Sentence([text.removesuffix(odds_said) if end else text, *end]))


def fitting_texts(texts: Sequence[str], room: int) -> str:
    """Return the texts that fit, the first one shortened if too long, and the number omitted."""
    for kept in range(len(texts), 0, -1):
        left = f"; {len(texts) - kept} more: -v" if kept < len(texts) else ""
        text = "; ".join(texts[:kept])
        if len(text) + len(left) <= room:
            return text + left
    left = left or ": -v"
    return f"{_shortened(texts[0], room - len(left))}{left}"


def _shortened(text: str, room: int) -> str:
    """Return a text, if too long its first clauses or words, with an ellipsis."""
    if len(text) <= room:
        return text
    room -= len(" ...")
    ends = [at.start() for at in re.finditer("[:;,]? ", text[: room + 2])] or [room]
    # what follows a colon says more of the same
    clauses = [end for end in ends if text[end] in ";," and 2 * end > room]
    return f"{_DANGLING.sub('', text[: (clauses or ends)[-1]])} ..."


def _odds_sentence(odds: Values) -> Sentence:
    """Return the odds of a plan; empty without any."""
    if "reached" not in odds:
        return Sentence([])
    asked = odds["asked"] and math.ceil(odds["asked"] * odds["samples"] - 1e-9)
    need = f" ({asked} required)" if asked else ""
    return sentence(f"{{arrived}} of {{samples}} simulated flights arrive{need}", odds, "odds.")


# Label, template, its fields and their path within the answer.
_Said = Iterator[tuple[str, str, Mapping[str, Any], str]]


def _steer(values: Values, room: int) -> _Said:
    form = (
        "{heading_deg:course}° true[, {magnetic_heading_deg:course}° magnetic][ to {place}][, {depth_m:,.0f} m]"
        "[, {glide_angle_deg:.0f}°][, {speed:.2f} m/s]"
    )
    whole = f"{form} ({values['dives'].partition(':')[0] or 'as set'})"
    fits = len(str(sentence(whole, values))) <= room
    if values["heading_deg"] is None:
        form = "{said}"
        said = fitting_texts([f"no command: {values['message']}"], room)
        yield "Steer", form, {"said": said}, ""
    else:
        yield "Steer", whole if fits and values["speed"] is not None else form, values, ""


def _arrival(values: Values, room: int) -> _Said:
    if values.get("duration_s") is None:
        return
    label, text = "Arrive", "{arrival:clock} UTC in the mean current"
    if not values["meets_goal"]:
        label, text = "Nearest", "{closest_approach_m:km} from the goal, {arrival:clock} UTC"
    elif half := values.get("arrival_median"):
        most = values["arrival_90_percent"]
        ninety = f"90 % by {clock(most, half)}" if most else "fewer than 90 % in time"
        text = f"50 % by {{arrival_median:clock}} UTC, {ninety}"
    elif "reached" in values:
        text = f"fewer than 50 % in time; {text}"
    legs = f", {values['legs']} legs" if values["legs"] else ""
    yield label, f"{text} ({{duration_s:span}}{legs})", values, ""


def _surfacing(values: Values, room: int) -> _Said:
    due, other = values.get("next"), values.get("other")
    form = "{} {{place}}[ ± {{major_m:km}}] {}".format
    if due is not None:
        late = "OVERDUE " if due.get("overdue_s") else ""
        yield "Next", form(f"{late}{{time:clock}} UTC", BASIS[due["basis"]]), due, "next."
    if due is not None and other is not None:
        at = clock(other["time"], due["time"])
        yield "  or", form(at, BASIS[other["basis"]]), other, "other."


def _goal(values: Values, room: int) -> _Said:
    form = "{distance_km:,.1f} km away"
    if values["made_good"]:
        word = "receding" if values["made_good"][0]["km_a_day"] < 0.0 else "approaching"
        form += f"; {word} {{made_good.0.km_a_day:size}} km a day over {{made_good.0.days:days}}"
    yield "Goal", form, values, ""


def _current(values: Values, room: int) -> _Said:
    name = "corrected" if "corrected" in values else "measured"
    dive = f"dive {values['dive']}" if values["dive"] else "last"
    if (flow := values.get(name)) is not None:
        about = f"{' corrected' * (name == 'corrected')}{', rejected' * values['rejected']}"
        form = f"{dive}: {_velocity(flow)}{about}[, {{difference_m_s:cm/s}} from the estimate]"
        yield "Current", form, values, ""
    elif values["difference_m_s"] is not None:
        form = f"{dive}: profiles {{difference_m_s:cm/s}} cm/s from the estimate"
        yield "Current", form, values, ""


def _velocity(current: Mapping[str, float]) -> str:
    """Return speed and direction of a velocity."""
    speed, toward = course(current)
    return f"{100.0 * speed:.1f} cm/s to {round(toward) % 360:03d}°"


def _fit(values: Values, room: int) -> _Said:
    if values["verdict"] is None:
        return
    rms, counts = values["rms_innovation"], values["observations"]
    if rms["before"] is not None and rms["prior"] is not None:
        errors = f"; {values['errors']}" if values["errors"] else ""
        form = f"misfit {{before:cm/s}} cm/s, forecast {{prior:cm/s}}{errors}"
        yield "Trust", form, rms, "rms_innovation."
    if not (total := counts["used"] + counts["rejected"]):
        return
    form = f"{{used:,}} of {total:,} observations used"
    if counts["profile_bins"] and (why := counts["bins_rejected"]):
        out = sum(why.values())
        form += f"; of {out + counts['profile_bins']:,} bins "
        each = sorted(why, key=lambda name: -why[name])
        words = [f"{why[name]:,} {name.replace('_', ' ')}" for name in each]
        form += _listed(words, room - len(str(sentence(form, counts)))) or f"{out:,} not used"
    yield "Data", form, counts, "observations."


def _listed(words: Sequence[str], room: int) -> str:
    """Return the first words, as many as fit."""
    for kept in range(len(words), 0, -1):
        text = f"{', '.join(words[:kept])}{', ...' * (kept < len(words))}"
        if len(text) <= room:
            return text
    return ""


_LINES: Mapping[str, Callable[[Values, int], _Said]] = {
    **{"command": _steer, "odds": _arrival, "surfacing": _surfacing},
    **{"goal": _goal, "current": _current, "fit": _fit},
}


class Detail(NamedTuple):
    """Details of an answer.

    Attributes:
        key: Key of the answer.
        label: Name of the answer.
        since: Time of validity; may be empty.
        texts: Sentences of the details.
    """

    key: str
    label: str
    since: str
    texts: Sequence[str]


def details(status: Status) -> Iterator[Detail]:
    """Yield the details omitted in the summary."""
    makers: dict[str, tuple[str, Callable[[Values], Iterable[str]]]] = {
        "position": ("Position", _reckoned),
        "goal": ("Made good", _rates),
        "current": ("Current", _compared),
        "surfacing": ("Surfacing", _expected),
        "command": ("Steer", lambda values: values["why"]),
        "odds": ("Plan", _planned),
        "forecast": ("Forecast", _ages),
        "fit": ("Trust", lambda values: values.get("basis", ())),
    }
    for key, (label, make) in makers.items():
        values = status.figures.get(key)
        if values and (texts := [*make(values)]):
            yield Detail(key, label, values["since"], texts)


def _reckoned(values: Values) -> Iterator[str]:
    yield str(sentence("fix {place}[ ± {error_m:g} m]", values))
    if at := values.get("dead_reckoned"):
        yield str(sentence("dead reckoned {place} at {time:clock} UTC", at))


def _rates(values: Values) -> Iterator[str]:
    yield str(sentence("goal {place}, {depth_m:g} m", values))
    for rate in values["made_good"]:
        # over a long time the fixes' errors are far below the digit that is shown
        form = f"{{km_a_day:+.1f}} ± {max(rate['error'], 0.01):.1g} km a day over {{days:days}}"
        yield str(sentence(form, rate))


def _compared(values: Values) -> Iterator[str]:
    if values["predicted_difference_m_s"] is not None:
        form = "difference from the estimate expected: {predicted_difference_m_s:cm/s} cm/s a component"
        yield str(sentence(form, values))
    for name in ("measured", "corrected", "predicted"):
        if flow := values.get(name):
            error = {"error": flow["standard_error"] or None}
            yield str(sentence(f"{name} {_velocity(flow)}[ ± {{error:cm/s}} cm/s]", error))


def _expected(values: Values) -> Iterator[str]:
    for due in filter(None, (values.get("next"), values.get("other"))):
        ellipse = "; no ellipse without samples of the estimate (planner.samples)"
        if due["major_m"] is not None:
            axes = " x ".join(f"{due[f'{name}_m'] / 1e3:.2f}" for name in ("major", "minor"))
            ellipse = f"; 90 % ellipse {axes} km along {due['bearing_deg']:.0f}°"
        yield f"{BASIS[due['basis']]}: {clock(due['time'])} UTC{ellipse}"
        if due.get("overdue_s"):
            yield str(sentence("OVERDUE by {overdue_s:span}", due))
        elif "margin_s" in due:
            yield str(sentence("overdue {margin_s:span} after that", due))
        if "why" in due:
            yield due["why"]
    if last := values.get("last"):
        side = {True: ", inside its ellipse", False: ", outside its ellipse", None: ""}
        late = f"{'late' if last['delay_s'] >= 0.0 else 'early'}{side[last['inside']]}"
        form = f"surfaced {{distance_m:far}} km from the plan toward {{direction_deg:.0f}}°, {{delay_s:span}} {late}"
        yield str(sentence(form, last))


def _planned(values: Values) -> Iterator[str]:
    yield f"{values['status']}: {values['message']}"
    if dives := values.get("dives"):
        yield dives
    if values.get("energy_j"):
        energies = {
            name: value / 1e3 for name in ("energy_j", "battery_j") if (value := values[name])
        }
        yield str(sentence("energy {energy_j:.0f} kJ[ of {battery_j:.0f} kJ]", energies))


def _ages(values: Values) -> Iterator[str]:
    ahead = values["ends_in_s"]
    if ahead is None:
        yield f"of {values['since']} alone"
        return
    ends = f"ends in {hours_text(ahead)}" if ahead >= 0.0 else f"ENDED {hours_text(ahead)} ago"
    yield f"{values['since']} to {values['last']}; {ends}"


def detail_lines(status: Status) -> Iterator[str]:
    """Yield ``details`` as lines for a terminal."""
    for detail in details(status):
        for text, label in zip(
            detail.texts, (detail.label, *[""] * len(detail.texts)), strict=False
        ):
            yield from textwrap.wrap(
                printable(text),
                WIDTH,
                initial_indent=f"{label:<{_LABEL}}",
                subsequent_indent=" " * _LABEL,
                break_on_hyphens=False,
            )


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
    rows = (
        f"<dt>{escape(line.label)}</dt><dd>{line.said.html}</dd>" for line in lines(status, 10_000)
    )
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


def _detail_html(detail: Detail) -> str:
    first, *more = detail.texts
    rest = "".join(f"<p>{escape(text)}</p>" for text in more)
    return (
        f'<section id="{detail.key}"><h2>{escape(detail.label)}<span class="age">{escape(detail.since)}</span></h2>'
        f'<p class="first">{escape(first)}</p>{rest}</section>'
    )
