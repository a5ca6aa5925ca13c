"""Summary card of a report: verdict, command, next surfacing, odds and current at the vehicle."""

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import distance, heading_deg, to_geographic
from replay_kit.core.words.quantities import parse_time
from replay_kit.core.words.text import capitalized
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import KEPT, CurrentSlices, published_at
from replay_kit.show.figures.draw import panels_svg
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.numbers import (
    clock,
    error_text,
    fixed,
    hours_text,
    minutes_text,
    nice_number,
    sentence,
)
from replay_kit.show.page.page import compass, legend
from replay_kit.show.report.answer import NO_STEP, lights, next_steps
from replay_kit.show.status.held import Values, read_held
from replay_kit.show.status.lines import BASIS
from replay_kit.show.status.status import status_of

_CLASSES = {"trust": "good", "with care": "care", "do not use": "stop"}
_WORDS = {"trust": "Trust", "with care": "Use with care", "do not use": "Do not use"}
#: Standard deviations of a band that holds 90 %.
_NINETY = 1.645


def card_html(contents: Contents) -> str:
    """Return the summary card as HTML."""
    figures = status_of(read_held(contents.result.reader)).figures
    command = figures.get("command", {})
    steered = command.get("heading_deg") is not None
    answer = _steer(command) + _arrival(figures["odds"]) if steered else _water(contents)
    each = (
        f'<a href="#trust" class="{one.color}">{escape(one.name)}</a>' for one in lights(contents)
    )
    marks = f'<p class="lights">{"".join(each)}</p>'
    first, last = _verdict(contents)
    parts = first, answer, _surfacing(figures), _profile(contents), marks, last
    return "".join(f"<div>{part}</div>" for part in parts if part)


def _verdict(contents: Contents) -> tuple[str, str]:
    """Return the verdict with its first reason; and further reasons, the plan's message and the next step, empty for a trusted result."""
    outcome, plan = contents.outcome, contents.last_plan
    (word, reasons), (step, *_) = outcome.verdict, next_steps(contents)
    text = escape(": ".join([_WORDS[word], *reasons[:1]]))
    chip = f'<p class="chip {_CLASSES[word]}"><a href="#trust">{text}</a></p>'
    if outcome.unjudged:
        chip = f'<p class="chip care">No verdict: {outcome.unjudged}</p>'
    texts = list(reasons[1:])
    if plan is not None and plan.status != "reached":
        why = plan.message.partition(". ")[0]
        texts.append(f"the plan failed: {why}" if plan.status == "failed" else why)
    said = escape("; ".join(texts))
    more = [f"{capitalized(said)}."] * bool(texts) + [f"Next step: {step}"] * (
        word != "trust" and step != NO_STEP
    )
    return chip, "".join(f'<p class="below">{one}</p>' for one in more)


def _steer(command: Values) -> str:
    """Return the command: heading, true and magnetic if known, target position and dive."""
    heading, origin = command["heading_deg"], command["dives"].partition(":")[0]
    place = "" if command["depth_m"] is None else sentence("{place}", command)
    # with spaces at which no line breaks
    target = (
        f"for {str(place).replace(' ', chr(160))}, dive to {{depth_m:,.0f}} m, " if place else ""
    )
    form = (
        f"[{{magnetic_heading_deg:course}}° magnetic, ]{target}"
        f"glide angle {{glide_angle_deg:.0f}}°, {{speed:.2f}} m/s through water{f' ({origin})' if origin else ''}"
    )
    shown, said = (_said(text, command, "command") for text in ("{heading_deg:course}", form))
    arrow = compass(heading, f"Steer {heading:.0f} degrees true")
    return f'<div class="steer">{arrow}<div><p class="big">{shown}°</p><p>{said}</p></div></div>'


def _said(template: str, values: Values, answer: str) -> str:
    """Return a sentence on an answer of the status as HTML."""
    return sentence(template, values, f"status.{answer}.").html


def _arrival(odds: Values) -> str:
    if odds.get("duration_s") is None:
        return ""
    title, end, below = "Arrives (UTC)", odds["arrival"], "in the mean current, {duration_s:span}"
    if not odds["meets_goal"]:
        title, below = "Nearest to the goal (UTC)", "{closest_approach_m:km} from it"
    elif half := odds.get("arrival_median"):
        end, most = half, odds["arrival_90_percent"]
        in_time = f"half of the flights; 90 % by {clock(most)}" if most else ""
        below = in_time or "half; fewer than 90 % in time"
    first = _fact(title, clock(end), _said(below, odds, "odds"))
    if "reached" not in odds:
        return _facts(first, _fact("Odds of arriving", "unknown", "no samples were flown"))
    share, count = (
        _said(form, odds, "odds") for form in ("{reached:share}", "of {samples} samples")
    )
    wide = f"{100.0 * odds['reached']:.0f}%"
    bar = f'{count}<span class="meter"><i style="width:{wide}"></i></span>'
    return _facts(first, _fact("Odds of arriving", share, bar))


def _facts(*facts: str) -> str:
    return f'<div class="facts">{"".join(facts)}</div>'


def _fact(title: str, value: str, below: str = "") -> str:
    return f'<div><p class="title">{title}</p><p class="value">{value}</p><p class="below">{below}</p></div>'


def _surfacing(figures: Mapping[str, Any]) -> str:
    """Return time and ellipse of the next surfacing, by the plan and by persistence, the more reliable first."""
    values, at = figures.get("surfacing", {}), figures.get("position")
    if (first := values.get("next")) is None:
        return ""
    when, below, size = "", "semi-axes", "[± {major_m:far} × {minor_m:far} km]"
    sizes = {
        name: _said(size, one, f"surfacing.{name}") or "unknown"
        for name in ("next", "other")
        if (one := values[name])
    }
    if at is not None:
        ahead = (parse_time(first["time"]) - parse_time(at["since"])) / 1e9
        when = f"in {hours_text(ahead)}, " if ahead >= 0.0 else f"{hours_text(ahead)} ago, "
    if (other := values["other"]) is not None:
        below = f"{clock(other['time'])} {BASIS[other['basis']]}, {sizes['other']}"
    return _facts(
        _fact("Next surfacing (UTC)", clock(first["time"]), f"{when}{BASIS[first['basis']]}"),
        _fact("Within (90 %)", sizes["next"], below),
    )


def _water(contents: Contents) -> str:
    """Return the current at the vehicle, its error, and where to measure next."""
    slices, parts = contents.slices, ""
    if slices is None or contents.dive_mean is None:
        return ""
    mean = contents.dive_mean[-1]
    if (here := _at_vehicle(contents, slices, mean)).size:
        east, north, *errors = here.mean(axis=1)
        bearing, error = float(heading_deg(east, north)), np.hypot(*errors) / np.sqrt(2.0)
        said = f"± {error_text(error)} cm/s at most" if np.isfinite(error) else "error unknown"
        parts = (
            f'<div class="steer">{compass(bearing, f"The water goes toward {bearing:.0f} degrees")}<div>'
            f'<p class="big">{fixed(100.0 * np.hypot(east, north), 1)}<small> cm/s</small></p><p>the water goes '
            f"toward {round(bearing) % 360:03d}°, {said}; mean to {contents.dive_depth:.0f} m at the vehicle</p></div></div>"
        )
    rms, facts = contents.outcome.rms_innovation, ""
    if rms["before"] is not None and rms["prior"]:
        gain = 100.0 * (1.0 - rms["before"] / rms["prior"])
        value = f"{abs(gain):.0f} % {'closer' if gain >= 0.0 else 'farther'}"
        form = "misfit {before:cm/s} cm/s, forecast {prior:cm/s}"
        facts = _fact("Against the forecast", value, sentence(form, rms, "rms_innovation.").html)
    facts += _least_known(contents, slices, mean) if contents.estimate is not None else ""
    return parts + (_facts(facts) if facts else "")


def _at_vehicle(contents: Contents, slices: CurrentSlices, mean: Array) -> Array:
    """Return true east and north current at the vehicle and its standard errors at depths of its dives, shape (4, n) [m/s].

    It is that of the last estimate, without one that of the published ``mean``; n is 0 where none is known.
    """
    track, flow = contents.track, contents.estimate
    if not track.time_ns.size:
        return np.empty((4, 0))
    at = track.longitude[-1], track.latitude[-1]
    flat = slices._replace(depths=np.zeros(1), time_ns=slices.time_ns[-1:], fields=mean[None, None])
    if flow is None:
        each = published_at(flat, contents.projection, (*at, 0.0))[1].T
    else:
        deep = np.linspace(0.0, min(contents.dive_depth, flow.levels[-1]))
        found = flow.velocity_at(*at, deep)
        each = np.stack([getattr(found, name) for name in KEPT])
    return each[:, np.isfinite(each[0])]


def _least_known(contents: Contents, slices: CurrentSlices, mean: Array) -> str:
    """Return the position of the largest standard error as text."""
    error = np.hypot(*mean[2:]) / np.sqrt(2.0)
    if not np.isfinite(error).any():
        return ""
    j, i = np.unravel_index(np.nanargmax(error), error.shape)
    place = [*map(float, to_geographic(contents.projection, slices.east[i], slices.north[j]))]
    track, far = contents.track, ""
    if track.time_ns.size:
        far = f", {distance(track.longitude[-1], track.latitude[-1], *place) / 1e3:.0f} km away"
    return _fact(
        "Measure next at",
        minutes_text(*place),
        f"± {error_text(error[j, i])} cm/s, least known{far}",
    )


def _profile(contents: Contents) -> str:
    """Return the current profile at the vehicle, with 90 % bands, as SVG."""
    flow, track = contents.estimate, contents.track
    if flow is None or not track.time_ns.size:
        return ""
    found = flow.velocity_at(track.longitude[-1], track.latitude[-1], flow.levels)
    known = np.isfinite(found.u)
    if not known.any():
        return ""
    depth, marks, words, reach = flow.levels[known], list[Mark](), list[str](), 0.1
    for name, color, each, error in (
        ("east", "two", found.u, found.u_standard_error),
        ("north", "one", found.v, found.v_standard_error),
    ):
        value, band = 100.0 * each[known], np.nan_to_num(100.0 * _NINETY * error[known])
        both = np.append(value - band, (value + band)[::-1])
        marks.append(Mark("band", both, np.append(depth, depth[::-1]), "", color))
        marks.append(Mark("line", value, depth, name, color))
        words.append(f"{name} {fixed(value[0], 1)} to {fixed(value[-1], 1)} cm/s")
        reach = max(reach, float(np.abs(both).max()))
    ends = nice_number(reach, True)
    axes = Axis("", ends=(-ends, ends)), Axis("depth", "m", (max(float(depth[-1]), 1.0), 0.0))
    panel = Panel("", *axes, marks, 0.52)
    (svg, _), *_ = panels_svg(Figure("at-the-vehicle", "", [panel]), 350.0)
    said = f"Current from {depth[0]:g} to {depth[-1]:g} m: {', '.join(words)}"
    return (
        '<p class="title">Current at the vehicle by depth [cm/s] (bands: 90 %)</p>'
        f'<div class="profile" role="img" aria-label="{said}">{svg}{legend(panel)}</div>'
    )
