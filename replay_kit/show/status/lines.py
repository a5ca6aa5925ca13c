"""Text of a status: a summary of ten lines for 80 columns, and details with ages.

Each number is a figure of the status.
"""

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from replay_kit.core.words.text import printable
from replay_kit.show.numbers import (
    Sentence,
    clock,
    hours_text,
    minutes_text,
    sentence,
)
from replay_kit.show.status.held import Values, course
from replay_kit.show.status.status import Status

#: Columns of a screen, and of its labels.
WIDTH, _LABEL = 80, 11


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
    dive = f", dive {at['dive']}" if "dive" in at else ""
    old = f"{hours_text(at['age_s'])} ago" if at["age_s"] >= 60.0 else "now"
    text = f"{dive}: fix {_place(at)} {clock(at['since'])} UTC, {old}"
    return f"{name[: WIDTH - len(text)]}{text}"


def lines(status: Status) -> list[Line]:
    """Return the summary: verdict with reasons, then the answers."""
    makers = {
        "command": _steer,
        "odds": _arrival,
        "surfacing": _surfacing,
        "goal": _goal,
        "current": _current,
        "fit": _fit,
    }
    found = [(make, status.figures.get(key)) for key, make in makers.items()]
    return [_first(status), *(line for make, values in found if values for line in make(values))]


def _first(status: Status) -> Line:
    """Return the first line: an alarm outside the verdict, otherwise the verdict, with the reasons that fit."""
    fit, odds = (status.figures.get(key, {}) for key in ("fit", "odds"))
    texts = [alarm.text for alarm in status.alarms if alarm.kind not in ("plan", "consistency")]
    label = "ALARM" if texts else (fit.get("verdict") or "no verdict").upper()
    findings, said = fit.get("findings", ()), _odds_sentence(odds)
    severe = [one for one in findings if one["severity"] != "warning"]
    texts += [f"{one['name']}: {one['evidence']}" for one in severe]
    named = [one["name"] for one in findings]
    # the odds say it with numbers, but not that a plan must not be flown
    numbers = said.parts and odds["status"] != "unsafe"
    reasons = [text for text in fit.get("reasons", ()) if not (numbers and "plan" in text)]
    texts += [text for text in reasons if text not in named]
    texts += [one["name"] for one in findings if one not in severe]
    texts += [str(said)] if said.parts else []
    if not texts:
        known = fit.get("verdict") is not None
        texts = ["no contradiction found" if known else "the run did not finish"]
    text = fitting(texts, WIDTH - _LABEL)
    if not text.endswith(str(said)):
        return Line(label, Sentence([text]))
    return Line(label, Sentence([text.removesuffix(str(said)), *said.parts]))


def fitting(texts: Sequence[str], width: int) -> str:
    """Return the texts that fit into a width, the first one shortened if too long, to its first clause, and the number omitted."""
    for kept in range(len(texts), 0, -1):
        left = f"; {len(texts) - kept} more: -v" if kept < len(texts) else ""
        text = "; ".join(texts[:kept])
        if len(text) + len(left) <= width:
            return text + left
    cut = textwrap.shorten(texts[0].partition(";")[0], width - len(left) - 4, placeholder="")
    return f"{cut}: -v{left}" if len(texts) == 1 else f"{cut}{left}"


def _odds_sentence(odds: Values) -> Sentence:
    """Return the odds, or the status of a plan without them; empty without a plan or where the mean arrives."""
    if "reached" in odds:
        required = math.ceil(odds["asked"] * odds["samples"] - 1e-9) if odds["asked"] else None
        asked = "" if required is None else f" ({required} required)"
        return sentence(
            f"{{arrived}} of {{samples}} simulated flights arrive{asked}", odds, "odds."
        )
    lacks = odds.get("status") not in (None, "reached")
    return Sentence([f"plan {odds['status']}"] if lacks else [])


def _steer(values: Values) -> Iterator[Line]:
    if values["heading_deg"] is None:
        said = fitting([f"no command: {values['message']}"], WIDTH - _LABEL)
        yield Line("Steer", Sentence([said]))
        return
    known = (
        ("heading_deg", "{heading_deg:course}° true"),
        ("magnetic_heading_deg", ", {magnetic_heading_deg:course}° magnetic"),
        ("longitude", f" to {_place(values) if values['longitude'] is not None else ''}"),
        ("depth_m", ", {depth_m:,.0f} m"),
        ("glide_angle_deg", ", {glide_angle_deg:.0f}°"),
        ("speed", ", {speed:.2f} m/s"),
    )
    form = "".join(text for name, text in known if values[name] is not None)
    basis = f" ({values['dives'].partition(':')[0] or 'as set'})"
    whole, line = (
        Line("Steer", sentence(text, values, "command.")) for text in (form + basis, form)
    )
    yield whole if values["speed"] is not None and len(str(whole)) <= WIDTH else line


def _arrival(values: Values) -> Iterator[Line]:
    if values.get("duration_s") is None:
        return
    legs = f", {values['legs']} legs" if values["legs"] else ""
    flown, label, end = f" ({{duration_s:span}}{legs})", "Arrive", clock(values["arrival"])
    if not values["meets_goal"]:
        label, text = "Nearest", f"{{closest_approach_m:km}} from the goal, {end} UTC"
    elif half := values.get("arrival_median"):
        most = values["arrival_90_percent"]
        ninety = f", 90 % by {clock(most, half)}" if most else ", fewer than 90 % in time"
        text = f"50 % by {clock(half)} UTC{ninety}"
    else:
        fewer = "fewer than 50 % in time; " if "reached" in values else ""
        text = f"{fewer}{end} UTC in the mean current"
    yield Line(label, sentence(text + flown, values, "odds."))


#: What a predicted surfacing relies on.
BASIS = {"plan": "if it flies this plan", "last_dive": "as the last dive"}


def _surfacing(values: Values) -> Iterator[Line]:
    one, other = values.get("next"), values.get("other")
    if one is None:
        return
    late = "OVERDUE " if one.get("overdue_s") else ""
    yield Line("Next", _within(f"{late}{clock(one['time'])} UTC", "next", one))
    if other is not None:
        yield Line("  or", _within(clock(other["time"], one["time"]), "other", other))


def _within(begin: str, name: str, one: Values) -> Sentence:
    """Return the position of a surfacing and the major semi-axis of its 90 % ellipse."""
    size = "" if one["major_m"] is None else " ± {major_m:km}"
    form = f"{begin} {_place(one)}{size} {BASIS[one['basis']]}"
    return sentence(form, one, f"surfacing.{name}.")


def _goal(values: Values) -> Iterator[Line]:
    form = "{distance_km:,.1f} km away"
    if values["made_good"]:
        word = "receding" if values["made_good"][0]["km_a_day"] < 0.0 else "approaching"
        form += f"; {word} {{made_good.0.km_a_day:size}} km a day over {{made_good.0.days:days}}"
    yield Line("Goal", sentence(form, values, "goal."))


def _current(values: Values) -> Iterator[Line]:
    name = "corrected" if "corrected" in values else "measured"
    apart = "" if values["difference_m_s"] is None else "{difference_m_s:cm/s}"
    dive = f"dive {values['dive']}" if values["dive"] else "last"
    form = f"{dive}: profiles {apart} cm/s from the estimate" if apart else ""
    if (one := values.get(name)) is not None:
        form = f"{dive}: {_velocity(one)}{' corrected' * (name == 'corrected')}"
        form += ", rejected" * values["rejected"] + f", {apart} from the estimate" * bool(apart)
    if form:
        yield Line("Current", sentence(form, values, "current."))


def _velocity(one: Mapping[str, float]) -> str:
    """Return speed and direction of a velocity."""
    speed, toward = course(one)
    return f"{100.0 * speed:.1f} cm/s to {round(toward) % 360:03d}°"


def _fit(values: Values) -> Iterator[Line]:
    if values["verdict"] is None:
        return
    rms, counts = values["rms_innovation"], values["observations"]
    if rms["before"] is not None and rms["prior"] is not None:
        errors = f"; {values['errors']}" if values["errors"] else ""
        form = f"misfit {{before:cm/s}} cm/s, forecast {{prior:cm/s}}{errors}"
        yield Line("Trust", sentence(form, rms, "fit.rms_innovation."))
    if not (total := counts["used"] + counts["rejected"]):
        return
    form = f"{{used:,}} of {total:,} observations used"
    if counts["profile_bins"] and (why := counts["bins_rejected"]):
        out = sum(why.values())
        form += f"; {out:,} of {out + counts['profile_bins']:,} bins "
        room = WIDTH - _LABEL - len(str(sentence(form, counts)))
        form += reasons_text(sorted(why, key=lambda name: -why[name]), room)
    yield Line("Data", sentence(form, counts, "fit.observations."))


def reasons_text(reasons: Iterable[str], room: int) -> str:
    """Return the reasons for excluded bins that fit into a width."""
    words = [name.replace("_", " ") for name in reasons]
    for count in range(len(words), 0, -1):
        text = ", ".join(words[:count]) + ("" if count == len(words) else ", ...")
        if len(text) <= room:
            return text
    return "excluded"


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
    makers = {
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
    error = f" ± {values['error_m']:g} m" if values["error_m"] else ""
    yield f"fix {_place(values)}{error}"
    if at := values.get("dead_reckoned"):
        yield f"dead reckoned {_place(at)} at {clock(at['time'])} UTC"


def _rates(values: Values) -> Iterator[str]:
    yield f"goal {_place(values)}, {values['depth_m']:g} m"
    for one in values["made_good"]:
        over = hours_text(86_400.0 * one["days"])
        # over a long time the fixes' errors are far below the digit that is shown
        yield f"{one['km_a_day']:+.1f} ± {max(one['error'], 0.01):.1g} km a day over {over}"


def _compared(values: Values) -> Iterator[str]:
    off = values["predicted_difference_m_s"]
    if off is not None:
        yield f"difference from the estimate expected: {100.0 * off:.1f} cm/s a component"
    for name in ("measured", "corrected", "predicted"):
        if one := values.get(name):
            error = one["standard_error"]
            yield f"{name} {_velocity(one)}" + (f" ± {100.0 * error:.1f} cm/s" if error else "")


def _expected(values: Values) -> Iterator[str]:
    for one in filter(None, (values.get("next"), values.get("other"))):
        yield f"{BASIS[one['basis']]}: {clock(one['time'])} UTC{_ellipse_text(one)}"
        if late := one.get("overdue_s"):
            yield f"OVERDUE by {hours_text(late)}"
        elif "margin_s" in one:
            yield f"overdue {hours_text(one['margin_s'])} after that"
        if "why" in one:
            yield one["why"]
    if one := values.get("last"):
        side = {True: ", inside its ellipse", False: ", outside its ellipse", None: ""}
        late = f"{hours_text(one['delay_s'])} {'late' if one['delay_s'] >= 0.0 else 'early'}"
        yield (
            f"surfaced {one['distance_m'] / 1e3:.1f} km from the plan toward {one['direction_deg']:.0f}°, {late}"
            + side[one["inside"]]
        )


def _ellipse_text(one: Values) -> str:
    if one["major_m"] is None:
        return "; no ellipse without samples of the estimate (planner.samples)"
    axes = " x ".join(f"{one[f'{name}_m'] / 1e3:.2f}" for name in ("major", "minor"))
    return f"; 90 % ellipse {axes} km along {one['bearing_deg']:.0f}°"


def _planned(values: Values) -> Iterator[str]:
    yield f"{values['status']}: {values['message']}"
    yield from filter(None, [values.get("dives")])
    if energy := values.get("energy_j"):
        battery = values["battery_j"]
        yield f"energy {energy / 1e3:.0f} kJ" + (f" of {battery / 1e3:.0f} kJ" if battery else "")


def _ages(values: Values) -> Iterator[str]:
    ahead = values["ends_in_s"]
    if ahead is None:
        yield f"of {values['since']}, held constant"
        return
    ends = f"ends in {hours_text(ahead)}" if ahead >= 0.0 else f"ENDED {hours_text(ahead)} ago"
    yield f"{values['since']} to {values['last']}; {ends}"


def _place(values: Mapping[str, Any]) -> str:
    return minutes_text(values["longitude"], values["latitude"])


def detail_lines(status: Status) -> Iterator[str]:
    """Yield ``details`` as lines for a terminal."""
    for one in details(status):
        head = f"{one.label:<{_LABEL}}"
        for text in one.texts:
            yield from textwrap.wrap(
                printable(text),
                WIDTH,
                initial_indent=head,
                subsequent_indent=" " * _LABEL,
                break_on_hyphens=False,
            )
            head = " " * _LABEL
