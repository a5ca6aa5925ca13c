"""Summary card of a report: verdict, command, next surfacing, odds and current at the vehicle."""

from collections.abc import Mapping
from html import escape
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.geodesy import distance, heading_deg, to_geographic
from replay_kit.core.plan import ORIGIN
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.track import LastPlan
from replay_kit.show.figures.draw import panels_svg
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.numbers import (
    clock_text,
    error_text,
    fixed,
    hours_text,
    leg_number,
    minutes_text,
    nice,
    number,
)
from replay_kit.show.page.page import legend
from replay_kit.show.page.parts import compass
from replay_kit.show.sentences import by_habit

_CLASSES = {"trust": "good", "with care": "care", "do not use": "stop"}
_WORDS = {"trust": "Trust", "with care": "Use with care", "do not use": "Do not use"}
#: Standard deviations of a band that holds 90 %.
_NINETY = 1.645


def card_html(contents: Contents) -> str:
    """Return the summary card as HTML."""
    plan = contents.last_plan
    steered = (
        plan is not None and plan.row["status"] != "failed" and np.isfinite(plan.row["heading_deg"])
    )
    answer = _steer(plan, contents.flown) + _arrival(plan) if steered and plan else _water(contents)
    parts = [
        *(_chip(contents), answer, _surfacing(contents), _profile(contents), _lights(contents)),
        _why(contents),
    ]
    return "".join(f"<div>{part}</div>" for part in parts if part)


def _chip(contents: Contents) -> str:
    outcome = contents.outcome
    if not outcome.complete:
        return '<p class="chip care">No verdict: the run did not finish, or an earlier version made the result</p>'
    verdict = outcome.verdict
    reason = f": {verdict.reasons[0]}" if verdict.reasons else ""
    text = escape(f"{_WORDS[verdict.word]}{reason}")
    return f'<p class="chip {_CLASSES[verdict.word]}"><a href="#trust">{text}</a></p>'


def _why(contents: Contents) -> str:
    """Return further reasons for care, the plan's message and the next step; empty for a trusted result."""
    verdict, plan = contents.outcome.verdict, contents.last_plan
    texts = [*verdict.reasons[1:]]
    if plan is not None and plan.row["status"] != "reached":
        why = str(plan.row["message"]).partition(". ")[0]
        texts.append(f"the plan failed: {why}" if plan.row["status"] == "failed" else why)
    said = "; ".join(texts)
    first = f'<p class="below">{escape(said[:1].upper() + said[1:])}.</p>' if texts else ""
    if verdict.word == "trust":
        return first
    from replay_kit.show.report.sections.answer import next_steps

    return f'{first}<p class="below">Next step: {next_steps(contents)[0]}</p>'


def _steer(plan: LastPlan, flown: AsFlown | None) -> str:
    """Return the command: heading, true and magnetic if known, target position and dive."""
    row, leg = plan.row, plan.legs[0] if plan.legs else {}
    heading, speed = float(row["heading_deg"]), float(row["speed"])
    place = _unbroken(minutes_text(leg["longitude"], leg["latitude"])) if leg else ""
    dive = (
        f"dive to {leg_number(1, 'depth_m', leg['depth_m'], fixed(leg['depth_m'], 0))} m, "
        if leg
        else ""
    )
    angle = number(
        "plan.glide_angle_deg", float(row["glide_angle_deg"]), fixed(row["glide_angle_deg"], 0)
    )
    origin = plan.statistics.get(ORIGIN, "").partition(":")[0]
    shown = number("plan.heading_deg", heading, f"{round(heading) % 360:03d}")
    magnetic = flown.magnetic(heading) if flown else None
    compass_text = "" if magnetic is None else f"{round(magnetic) % 360:03d}° magnetic, "
    return (
        f'<div class="steer">{compass(heading, f"Steer {heading:.0f} degrees true")}<div><p class="big">{shown}°</p>'
        f"<p>{compass_text}{f'for {place}, ' if place else ''}{dive}glide angle {angle}°, "
        f"{number('plan.speed', speed, fixed(speed, 2))} m/s through water{f' ({escape(origin)})' if origin else ''}</p></div></div>"
    )


def _unbroken(place: str) -> str:
    """Return a position with non-breaking spaces within coordinates."""
    return ", ".join(part.replace(" ", "\u00a0") for part in place.split(", "))


def _arrival(plan: LastPlan) -> str:
    begin, duration = int(plan.row.name.value), float(plan.row["duration"])
    odds, key, text = plan.odds, "plan.duration_s", f"in the mean current, {hours_text(duration)}"
    if odds is not None and np.isfinite(half := odds["arrival_median"]):
        duration, key, most = half, "plan.odds.arrival_median", odds["arrival_90_percent"]
        late = clock_text(begin + round(1e9 * most)) if np.isfinite(most) else ""
        ninety = number("plan.odds.arrival_90_percent", most, late) if late else ""
        text = f"half of the flights; 90 % by {ninety}" if late else "half; fewer than 90 % in time"
    end = clock_text(begin + round(1e9 * duration))
    status, miss = str(plan.row["status"]), float(plan.row["closest_approach"])
    arrives = status in ("reached", "uncertain")
    title = "Arrives (UTC)" if arrives else "Nearest to the goal (UTC)"
    off = number(
        "plan.closest_approach_m", miss, f"{miss:.0f} m" if miss < 2e3 else f"{miss / 1e3:.1f} km"
    )
    below = text if arrives else f"{off} from it"
    first = _fact(title, number(key, duration, end), below)
    if odds is None:
        return f'<div class="facts">{first}{_fact("Odds of arriving", "unknown", "no samples were flown")}</div>'
    share = float(odds["reached"])
    count = number("plan.odds.n_samples", odds["n_samples"], str(odds["n_samples"]))
    text = number("plan.odds.reached", share, f"{100.0 * share:.0f} %")
    bar = f'of {count} samples<span class="meter"><i style="width:{100.0 * share:.0f}%"></i></span>'
    return f'<div class="facts">{first}{_fact("Odds of arriving", text, bar)}</div>'


def _fact(title: str, value: str, below: str = "") -> str:
    return f'<div><p class="title">{title}</p><p class="value">{value}</p><p class="below">{below}</p></div>'


class _Surfacing(NamedTuple):
    """Predicted surfacing: time [ns, UTC], basis, and numbers as HTML."""

    time_ns: int
    basis: str
    shown: str
    size: str


def _surfacing(contents: Contents) -> str:
    """Return time and ellipse of the next surfacing, by the plan and by persistence, the more reliable first."""
    predicted = contents.outcome.predicted_surfacings
    each = [_by_plan(contents), _as_last_dive(predicted or {})]
    known = [one for one in (each[::-1] if by_habit(predicted) else each) if one is not None]
    if not known:
        return ""
    first, *others = known
    when = ""
    if contents.track.time_ns.size:
        ahead = (first.time_ns - int(contents.track.time_ns[-1])) / 1e9
        when = f"in {hours_text(ahead)}, " if ahead >= 0.0 else f"{hours_text(-ahead)} ago, "
    below = "".join(f"{one.shown} {one.basis}, {one.size}" for one in others) or "semi-axes"
    return (
        f'<div class="facts">{_fact("Next surfacing (UTC)", first.shown, f"{when}{first.basis}")}'
        f"{_fact('Within (90 %)', first.size, ''.join(below) or 'semi-axes')}</div>"
    )


def _by_plan(contents: Contents) -> _Surfacing | None:
    plan = contents.last_plan
    if plan is None or not plan.legs:
        return None
    table, count = contents.result.surfacings, len(plan.legs)
    done = int((table["planned_time"] == plan.row.name).sum()) if len(table) else 0
    leg = plan.legs[min(done, count - 1)]
    time = int(plan.row.name.value) + round(1e9 * leg["surfacing_s"])
    shown = leg_number(leg["leg"], "surfacing_s", leg["surfacing_s"], clock_text(time))
    axes = {
        f"plan.statistics.leg_{leg['leg']:03d}#ellipse_{name}_m": leg.get(f"ellipse_{name}_m")
        for name in ("major", "minor")
    }
    return _Surfacing(time, "if it flies this plan", shown, _size(axes))


def _as_last_dive(predicted: Mapping[str, Any]) -> _Surfacing | None:
    following, at = predicted.get("next"), "predicted_surfacings.next"
    if not following:
        return None
    time, ellipse = following["time_ns"], following["ellipse_90"]
    axes = {f"{at}.ellipse_90.{name}_m": ellipse[f"{name}_m"] for name in ("major", "minor")}
    shown = number(f"{at}.time_ns", time, clock_text(time))
    return _Surfacing(time, "as the last dive", shown, _size(axes))


def _size(axes: Mapping[str, float | None]) -> str:
    """Return the semi-axes of an ellipse by their fields."""
    known = {key: axis for key, axis in axes.items() if axis is not None}
    texts = [number(key, axis, fixed(axis / 1e3, 1)) for key, axis in known.items()]
    return f"± {' × '.join(texts)} km" if texts else "unknown"


def _water(contents: Contents) -> str:
    """Return the current at the vehicle, its error, and where to measure next."""
    flow, track, depth = contents.estimate, contents.track, contents.dive_depth
    if contents.dive_mean is None:
        return ""
    mean = contents.dive_mean[-1]
    parts = ""
    if track.time_ns.size:
        here = _cell(contents, mean, float(track.east[-1]), float(track.north[-1]))
        if np.isfinite(here[0]):
            bearing, speed = float(heading_deg(here[0], here[1])), float(np.hypot(*here[:2]))
            error = float(np.hypot(*here[2:]) / np.sqrt(2.0))
            said = f"± {error_text(error)} cm/s at most" if np.isfinite(error) else "error unknown"
            parts = (
                f'<div class="steer">{compass(bearing, f"The water goes toward {bearing:.0f} degrees")}<div>'
                f'<p class="big">{fixed(100.0 * speed, 1)}<small> cm/s</small></p><p>the water goes toward {round(bearing) % 360:03d}°, '
                f"{said}; mean to {depth:.0f} m at the vehicle</p></div></div>"
            )
    rms, facts = contents.outcome.rms_innovation, ""
    if rms["before"] is not None and rms["prior"]:
        gain = 100.0 * (1.0 - rms["before"] / rms["prior"])
        value = f"{abs(gain):.0f} % {'closer' if gain >= 0.0 else 'farther'}"
        missed = number("rms_innovation.before", rms["before"], f"{100.0 * rms['before']:.1f}")
        prior = number("rms_innovation.prior", rms["prior"], f"{100.0 * rms['prior']:.1f}")
        facts = _fact("Against the forecast", value, f"misfit {missed} cm/s, forecast {prior}")
    facts += _least_known(contents, mean) if flow is not None else ""
    return parts + (f'<div class="facts">{facts}</div>' if facts else "")


def _cell(contents: Contents, fields: Array, east: float, north: float) -> Array:
    """Return the values of the cell that contains a position [m, local frame]; NaN outside."""
    slices = contents.slices
    assert slices is not None
    i, j = (int(np.argmin(np.abs(a - v))) for a, v in ((slices.east, east), (slices.north, north)))
    far = abs(slices.east[i] - east) > slices.east[1] - slices.east[0]
    return np.full(4, np.nan) if far else np.asarray(fields[:, j, i])


def _least_known(contents: Contents, mean: Array) -> str:
    """Return the position of the largest standard error as text."""
    error, slices = np.hypot(mean[2], mean[3]) / np.sqrt(2.0), contents.slices
    assert slices is not None
    if not np.isfinite(error).any():
        return ""
    j, i = np.unravel_index(int(np.nanargmax(error)), error.shape)
    place = [
        float(each) for each in to_geographic(contents.projection, slices.east[i], slices.north[j])
    ]
    track = contents.track
    far = ""
    if track.time_ns.size:
        away = float(distance(track.longitude[-1], track.latitude[-1], *place)) / 1e3
        far = f", {fixed(away, 0)} km away"
    return _fact(
        "Measure next at",
        _unbroken(minutes_text(*place)),
        f"± {error_text(error[j, i])} cm/s, least known{far}",
    )


def _lights(contents: Contents) -> str:
    from replay_kit.show.report.sections.trust import lights

    return (
        '<p class="lights">'
        + "".join(
            f'<a href="#trust" class="{light.color}">{escape(light.name)}</a>'
            for light in lights(contents)
        )
        + "</p>"
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
    ends = nice(reach, True)
    axes = Axis("", ends=(-ends, ends)), Axis("depth", "m", (max(float(depth[-1]), 1.0), 0.0))
    panel = Panel("", *axes, marks, 0.52)
    (svg, _), *_ = panels_svg(Figure("at-the-vehicle", "", [panel]), 350.0)
    said = f"Current from {depth[0]:g} to {depth[-1]:g} m: {', '.join(words)}"
    return (
        '<p class="title">Current at the vehicle by depth [cm/s] (bands: 90 %)</p>'
        f'<div class="profile" role="img" aria-label="{said}">{svg}{legend(panel)}</div>'
    )
