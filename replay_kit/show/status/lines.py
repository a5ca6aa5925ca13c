"""Text of a status: a summary of ten lines for 80 columns, and details with ages.

Each number is a figure of the status.
"""

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from replay_kit.core.geodesy import heading_deg
from replay_kit.core.quantities import parse_time
from replay_kit.core.text import printable
from replay_kit.show.numbers import (
    Sentence,
    Shown,
    clock_text,
    fixed,
    hours_text,
    minutes_text,
    sentence,
)
from replay_kit.show.status.status import Status

#: Columns of a screen, and of its labels.
WIDTH, _LABEL = 80, 11
Values = Mapping[str, Any]
Parts = list[str | Shown]


class Line(NamedTuple):
    """Line of the summary.

    Attributes:
        label: Label of one word.
        parts: Texts and numbers.
    """

    label: str
    parts: Sequence[str | Shown]

    def __str__(self) -> str:
        """Return the line with its label."""
        return f"{self.label:<{_LABEL}}{printable(self.text)}".rstrip()

    @property
    def text(self) -> str:
        """Text of the line without its label."""
        return str(Sentence(self.parts))

    @property
    def html(self) -> str:
        """HTML of the line without its label, with the figure of each number."""
        return Sentence(self.parts).html


def title(status: Status) -> str:
    """Return a line with dive, position and age of the last fix; the result's name without a fix."""
    name = printable(status.name.removesuffix(".mcap"))
    if (at := status.figures.get("position")) is None:
        return name
    dive = f", dive {at['dive']}" if "dive" in at else ""
    place = minutes_text(at["longitude"], at["latitude"])
    old = f"{hours_text(at['age_s'])} ago" if at["age_s"] >= 60.0 else "now"
    text = f"{dive}: fix {place} {_clock(at['since'])} UTC, {old}"
    return f"{name[: WIDTH - len(text)]}{text}"


def lines(status: Status) -> list[Line]:
    """Return the summary: verdict with reasons, then the answers."""
    found, out = status.figures, [Line(*_first(status))]
    makers = {
        "command": _steer,
        "odds": _arrival,
        "surfacing": _surfacing,
        "goal": _goal,
        "current": _current,
        "fit": _fit,
    }
    for key, make in makers.items():
        if values := found.get(key):
            out += make(values)
    return out


def _first(status: Status) -> tuple[str, Parts]:
    """Return the first line: an alarm outside the verdict, otherwise the verdict, with the reasons that fit."""
    fit, odds = status.figures.get("fit", {}), status.figures.get("odds", {})
    texts = [alarm.text for alarm in status.alarms if alarm.kind not in ("plan", "consistency")]
    label = "ALARM" if texts else (fit.get("verdict") or "no verdict").upper()
    texts += [
        f"{one['name']}: {one['evidence']}"
        for one in fit.get("findings", ())
        if one["severity"] != "warning"
    ]
    said = _odds_text(odds)
    # the odds say it with numbers
    reasons = [text for text in fit.get("reasons", ()) if not (said and "plan" in text)]
    named = [one["name"] for one in fit.get("findings", ())]
    texts += [text for text in reasons if text not in named]
    texts += [one["name"] for one in fit.get("findings", ()) if one["severity"] == "warning"]
    texts += [said] if said else []
    if not texts:
        known = fit.get("verdict") is not None
        texts = ["no contradiction found"] if known else ["the run did not finish"]
    text = fitting(texts, WIDTH - _LABEL)
    if "reached" not in odds or not text.endswith(said):
        return label, [text]
    arrived, count = (odds[name] for name in ("arrived", "samples"))
    _, _, rest = said.partition(f" of {count}")
    numbers: Parts = [Shown("odds.arrived", arrived, f"{arrived}"), " of "]
    return label, [
        text.removesuffix(said),
        *numbers,
        Shown("odds.samples", count, f"{count}"),
        rest,
    ]


def fitting(texts: Sequence[str], width: int) -> str:
    """Return the texts that fit into a width, the first one shortened if too long, and the number omitted."""
    for kept in range(len(texts), 0, -1):
        left = f"; {len(texts) - kept} more: -v" if kept < len(texts) else ""
        text = "; ".join(texts[:kept])
        if len(text) + len(left) <= width:
            return text + left
    cut = textwrap.shorten(texts[0], width - len(left) - 4, placeholder="")
    return f"{cut}: -v{left}" if len(texts) == 1 else f"{cut}{left}"


def _odds_text(odds: Values) -> str:
    """Return the odds as text, or the status of a plan without them; empty without a plan."""
    if "reached" in odds:
        count = odds["samples"]
        asked = f" ({math.ceil(odds['asked'] * count - 1e-9)} required)" if odds["asked"] else ""
        return f"{odds['arrived']} of {count} simulated flights arrive{asked}"
    return f"plan {odds['status']}" if odds.get("status") not in (None, "reached") else ""


def _steer(values: Values) -> Iterator[Line]:
    if values["heading_deg"] is None:
        yield Line("Steer", [fitting([f"no command: {values['message']}"], WIDTH - _LABEL)])
        return
    heading, angle = values["heading_deg"], values["glide_angle_deg"]
    parts: Parts = [Shown("command.heading_deg", heading, f"{round(heading) % 360:03d}"), "° true"]
    if (magnetic := values["magnetic_heading_deg"]) is not None:
        shown = Shown("command.magnetic_heading_deg", magnetic, f"{round(magnetic) % 360:03d}")
        parts += [", ", shown, "° magnetic"]
    if values["longitude"] is not None:
        parts.append(f" to {minutes_text(values['longitude'], values['latitude'])}")
    if values["depth_m"] is not None:
        parts += [", ", Shown("command.depth_m", values["depth_m"], fixed(values["depth_m"], 0))]
        parts.append(" m")
    parts += [", ", Shown("command.glide_angle_deg", angle, fixed(angle, 0)), "°"]
    basis = values["dives"].partition(":")[0] or "as set"
    if values["speed"] is not None:
        parts += [", ", Shown("command.speed", values["speed"], fixed(values["speed"], 2))]
        parts.append(" m/s")
        said = f" ({basis})"
        parts += [said] if len(str(Line("Steer", [*parts, said]))) <= WIDTH else []
    yield Line("Steer", parts)


def _arrival(values: Values) -> Iterator[Line]:
    if values.get("duration_s") is None:
        return
    seconds, legs = values["duration_s"], values["legs"]
    flown: Parts = [Shown("odds.duration_s", seconds, hours_text(seconds))]
    flown += [f", {legs} legs"] if legs else []
    if values["status"] not in ("reached", "uncertain"):
        off = values["closest_approach_m"]
        far = Shown("odds.closest_approach_m", off, f"{off / 1e3:.1f} km")
        yield Line(
            "Nearest", [far, f" from the goal, {_clock(values['arrival'])} UTC (", *flown, ")"]
        )
    elif values.get("arrival_median"):
        half, most = values["arrival_median"], values["arrival_90_percent"]
        ninety = f", 90 % by {_clock(most, half)}" if most else ", fewer than 90 % in time"
        yield Line("Arrive", [f"50 % by {_clock(half)} UTC{ninety} (", *flown, ")"])
    else:
        fewer = "fewer than 50 % in time; " if "reached" in values else ""
        yield Line(
            "Arrive", [f"{fewer}{_clock(values['arrival'])} UTC in the mean current (", *flown, ")"]
        )


_BASIS = {"plan": "if it flies this plan", "last_dive": "as the last dive"}


def _surfacing(values: Values) -> Iterator[Line]:
    one, other = values.get("next"), values.get("other")
    if one is None:
        return
    late = "OVERDUE " if one.get("overdue_s") else ""
    parts = [late, _clock(one["time"]), " UTC ", *_within("next", one), f" {_BASIS[one['basis']]}"]
    yield Line("Next", parts)
    if other is not None:
        parts = [_clock(other["time"], one["time"]), " ", *_within("other", other)]
        yield Line("  or", [*parts, f" {_BASIS[other['basis']]}"])


def _within(name: str, one: Values) -> Parts:
    """Return the position of a surfacing and the major semi-axis of its 90 % ellipse."""
    parts: Parts = [minutes_text(one["longitude"], one["latitude"])]
    if (size := one["major_m"]) is not None:
        text = f"{fixed(size / 1e3, 1)} km" if size >= 1e3 else f"{fixed(size, 0)} m"
        parts += [" ± ", Shown(f"surfacing.{name}.major_m", size, text)]
    return parts


def _goal(values: Values) -> Iterator[Line]:
    far = values["distance_km"]
    parts: Parts = [Shown("goal.distance_km", far, fixed(far, 1)), " km away"]
    if values["made_good"]:
        rate = values["made_good"][0]
        made, key = rate["km_a_day"], "goal.made_good.0"
        word = "receding" if made < 0.0 else "approaching"
        parts += [f"; {word} ", Shown(f"{key}.km_a_day", abs(made), fixed(abs(made), 1))]
        days = Shown(f"{key}.days", rate["days"], hours_text(86_400.0 * rate["days"]))
        parts += [" km a day over ", days]
    yield Line("Goal", parts)


def _current(values: Values) -> Iterator[Line]:
    name = "corrected" if "corrected" in values else "measured"
    off = values["difference_m_s"]
    apart: Parts = (
        [] if off is None else [Shown("current.difference_m_s", off, fixed(100.0 * off, 1))]
    )
    dive = f"dive {values['dive']}" if values["dive"] else "last"
    if (one := values.get(name)) is None:
        if apart:
            yield Line("Current", [f"{dive}: profiles ", *apart, " cm/s from the estimate"])
        return
    parts: Parts = [f"{dive}: ", *_velocity(name, one)]
    parts += [" corrected"] if name == "corrected" else []
    parts += [", rejected"] if values["rejected"] else []
    yield Line("Current", [*parts, *([", ", *apart, " from the estimate"] if apart else [])])


def _velocity(name: str, one: Mapping[str, float]) -> Parts:
    """Return speed and direction of a velocity, with its two figures."""
    speed = math.hypot(one["east"], one["north"])
    toward = f"{round(float(heading_deg(one['east'], one['north']))) % 360:03d}"
    return [Shown(f"current.{name}#speed", speed, fixed(100.0 * speed, 1)), f" cm/s to {toward}°"]


def _fit(values: Values) -> Iterator[Line]:
    if values["verdict"] is None:
        return
    rms = values["rms_innovation"]
    if rms["before"] is not None and rms["prior"] is not None:
        said = sentence(
            "misfit {before:cm/s} cm/s, forecast {prior:cm/s}", rms, "fit.rms_innovation."
        )
        yield Line("Trust", [*said.parts, *([f"; {values['errors']}"] if values["errors"] else [])])
    counts = values["observations"]
    total = counts["used"] + counts["rejected"]
    if not total:
        return
    parts: Parts = [Shown("fit.observations.used", counts["used"], f"{counts['used']:,}")]
    parts.append(f" of {total:,} observations used")
    if counts["profile_bins"] and (why := counts["bins_rejected"]):
        out = sum(why.values())
        parts.append(f"; {out:,} of {out + counts['profile_bins']:,} bins ")
        room = WIDTH - _LABEL - len(str(Sentence(parts)))
        parts.append(reasons_text(sorted(why, key=lambda name: -why[name]), room))
    yield Line("Data", parts)


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
    yield f"fix {minutes_text(values['longitude'], values['latitude'])}{error}"
    if at := values.get("dead_reckoned"):
        place = minutes_text(at["longitude"], at["latitude"])
        yield f"dead reckoned {place} at {_clock(at['time'])} UTC"


def _rates(values: Values) -> Iterator[str]:
    yield f"goal {minutes_text(values['longitude'], values['latitude'])}, {values['depth_m']:g} m"
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
            of = f" ± {100.0 * error:.1f} cm/s" if error else ""
            yield f"{name} {Sentence(_velocity(name, one))}{of}"


def _expected(values: Values) -> Iterator[str]:
    for name in ("next", "other"):
        if one := values.get(name):
            yield f"{_BASIS[one['basis']]}: {_clock(one['time'])} UTC{_ellipse_text(one)}"
            if "margin_s" in one:
                late = one["overdue_s"]
                yield (
                    f"OVERDUE by {hours_text(late)}"
                    if late
                    else f"overdue {hours_text(one['margin_s'])} after that"
                )
            yield from (one["why"] for _ in (1,) if "why" in one)
    if one := values.get("last"):
        side = {True: ", inside its ellipse", False: ", outside its ellipse", None: ""}
        late = f"{hours_text(abs(one['delay_s']))} {'late' if one['delay_s'] >= 0.0 else 'early'}"
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
    if (energy := values.get("energy_j")) is not None and energy > 0.0:
        battery = values["battery_j"]
        yield f"energy {energy / 1e3:.0f} kJ" + (f" of {battery / 1e3:.0f} kJ" if battery else "")


def _ages(values: Values) -> Iterator[str]:
    ahead = values["ends_in_s"]
    if ahead is None:
        yield f"of {values['since']}, held constant"
        return
    ends = f"ends in {hours_text(ahead)}" if ahead >= 0.0 else f"ENDED {hours_text(-ahead)} ago"
    yield f"{values['since']} to {values['last']}; {ends}"


def _clock(text: str, beside: str = "") -> str:
    """Return a time as by ``clock_text``, without the day if the text before it has the same."""
    clock = clock_text(parse_time(text))
    return clock.rpartition(" ")[2] if text[:10] == beside[:10] else clock


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
