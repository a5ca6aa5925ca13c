"""A status: the answers to a pilot's questions as lines of text, as alarms, and as figures for JSON."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from replay_kit.core.errors import severity_word
from replay_kit.core.geodesy import to_local
from replay_kit.core.plan import ORIGIN, plan_legs, share_interval
from replay_kit.core.surfacing import planned_ellipses
from replay_kit.core.text import place_text, time_text
from replay_kit.results.outcome.verdict import plan_alarm
from replay_kit.show.numbers import hours_text
from replay_kit.show.sentences import by_habit, past_sentences, place_of_next
from replay_kit.show.status import figures
from replay_kit.show.status.alarms import Alarm, alarms_of, change_of, command_text
from replay_kit.show.status.held import Held

_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Line:
    """An answer.

    Attributes:
        key: Of what it answers, the same in every status.
        label: The question in a word or two.
        text: The answer, numbers with their errors; several sentences are each a text.
        time_ns: When what it says was so [ns, UTC]; None for what has no time.
        alarms: Whether an alarm belongs to it.
    """

    key: str
    label: str
    text: tuple[str, ...]
    time_ns: int | None = None
    alarms: bool = False


@dataclass(frozen=True, slots=True)
class Status:
    """A result on one screen.

    Attributes:
        name: Of the result.
        now_ns: The time for which ages are given [ns, UTC].
        lines: The answers.
        alarms: What should wake a person.
        figures: The numbers of the answers, for JSON.
        places: Of ``track``, ``plan``, ``goal`` and ``ellipse`` that are known, each (east, north) [m] of points, local frame.
    """

    name: str
    now_ns: int
    lines: tuple[Line, ...]
    alarms: tuple[Alarm, ...]
    figures: Mapping[str, Any]
    places: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)


def status_of(held: Held, now_ns: int | None = None) -> Status:
    """Return the status of a result.

    Args:
        held: What it holds.
        now_ns: The present time [ns, UTC]; None for the last time of the result.
    """
    now = held.last_ns if now_ns is None else now_ns
    alarms, numbers = alarms_of(held, now), dict[str, Any]()
    kinds, lines = {alarm.kind for alarm in alarms}, list[Line]()
    for key, (label, answer_of, of_it) in _ANSWERS.items():
        text, values, time_ns = answer_of(held, now)
        if text:
            lines.append(Line(key, label, tuple(text), time_ns, not kinds.isdisjoint(of_it)))
        if values:
            numbers[key] = values
    about = {
        "result": held.name,
        "now": time_text(now),
        "last": time_text(held.last_ns),
        "alarms": [alarm.record() for alarm in alarms],
    }
    return Status(held.name, now, tuple(lines), alarms, {**about, **numbers}, _places(held))


def _places(held: Held) -> dict[str, Sequence[tuple[float, float]]]:
    """Return what a small map shows; see ``Status``."""
    goal, following = figures.goal_of(held), figures.next_surfacing(held)
    legs = plan_legs(figures.statistics_of(held.plans[-1])) if held.plans else []
    known = {
        "track": [(fix.longitude, fix.latitude) for fix in held.fixes],
        "plan": [(leg["longitude"], leg["latitude"]) for leg in legs],
        "goal": [goal[:2]] if goal else [],
    }
    found: dict[str, Sequence[tuple[float, float]]] = {}
    for name, points in known.items():
        if points:
            east, north = to_local(held.projection, *zip(*points, strict=True))
            found[name] = list(zip(east.tolist(), north.tolist(), strict=True))
    if following is not None and (ellipses := planned_ellipses([following.leg])):
        found["ellipse"] = [
            (east, north) for east, north in ellipses[0].outline(held.projection).tolist()
        ]
    return found


#: Sentences, figures for JSON, and when they were so [ns, UTC]; None for what has no time.
_Answer = tuple[Sequence[str], dict[str, Any], int | None]


def _where(held: Held, now_ns: int) -> _Answer:
    if not held.fixes:
        return ["no measured position"], {}, None
    fix, error = held.fixes[-1], held.settings.get("measurements", {}).get("fix_std")
    text = [
        f"{place_text(fix.longitude, fix.latitude)}"
        + (f" ± {error:g} m" if error else "")
        + f", since {time_text(fix.time_ns)}"
    ]
    values: dict[str, Any] = {
        "longitude": fix.longitude,
        "latitude": fix.latitude,
        "since": time_text(fix.time_ns),
        "error_m": error,
    }
    if held.reckoned is not None:
        at = held.reckoned
        text.append(
            f"dead reckoned {place_text(at.longitude, at.latitude)} at {time_text(at.time_ns)}"
        )
        values["dead_reckoned"] = {
            "longitude": at.longitude,
            "latitude": at.latitude,
            "time": time_text(at.time_ns),
        }
    if held.dive is not None and (number := int(held.dive["dive"][-1])):
        text.append(f"after dive {number}")
        values["dive"] = number
    return text, values, fix.time_ns


def _rate(held: Held, now_ns: int) -> _Answer:
    goal, rates = figures.goal_of(held), figures.made_good(held)
    if goal is None:
        return ["no goal was given"], {}, None
    if not held.fixes:
        return ["no fix, no distance to the goal"], {}, None
    left = figures.far(held.fixes[-1], goal) / 1e3
    text = [f"{left:.1f} km to the goal {place_text(goal[0], goal[1])}, {goal[2]:g} m"]
    # over a long time the fixes' errors are far below the digit that is shown
    text += [
        f"{rate.km_a_day:+.1f} ± {max(rate.error, 0.01):.1g} km a day over {hours_text(86_400.0 * rate.days)}"
        for rate in rates
    ]
    values = {
        "to_goal_km": left,
        "km_a_day": [
            {"days": rate.days, "km_a_day": rate.km_a_day, "error": rate.error} for rate in rates
        ],
    }
    return text, values, held.fixes[-1].time_ns


def _current(held: Held, now_ns: int) -> _Answer:
    found = figures.dive_current(held)
    if found is None:
        return ["nothing measured"], {}, None
    values: dict[str, Any] = {
        "time": time_text(found.time_ns),
        "dive": found.dive,
        "difference_m_s": _finite(found.difference),
        "expected_m_s": _finite(found.expected),
    }
    expected = (
        f"{100.0 * found.expected:.1f} cm/s expected a component"
        if math.isfinite(found.expected)
        else "expected unknown"
    )
    if found.measured is None and found.corrected is None:
        text = [
            f"no mean current in the last dive; profiles differ {100.0 * found.difference:.1f} cm/s RMS from the estimate ({expected})"
        ]
        return text, values, found.time_ns
    text = []
    for name, words, current in (
        ("measured", "measured", found.measured),
        ("corrected", _CORRECTED, found.corrected),
    ):
        if current is not None:
            text.append(f"dive {found.dive} {words} {_current_text(current)}")
            values[name] = {
                "east": current.east,
                "north": current.north,
                "standard_error": _finite(current.error),
            }
    if found.predicted is not None:
        text.append(
            f"predicted {_current_text(found.predicted)}; apart {100.0 * found.difference:.1f} cm/s ({expected})"
        )
        values["predicted"] = {"east": found.predicted.east, "north": found.predicted.north}
    return text, values, found.time_ns


def _surfacing(held: Held, now_ns: int) -> _Answer:
    following, found = (
        figures.next_surfacing(held),
        held.outcome.expected_surfacings if held.outcome else None,
    )
    text, values = (
        _next_surfacing(following, now_ns)
        if following is not None and not by_habit(found)
        else _next_as_last_dive(held, found, now_ns)
    )
    if held.outcomes:
        one = held.outcomes[-1]
        inside = (
            "inside"
            if one.inside_ellipse
            else "outside"
            if math.isfinite(one.ellipse_major)
            else ""
        )
        side = f", {inside} its ellipse" if inside else ""
        text.append(
            f"the last was {one.distance / 1e3:.1f} km toward {one.direction_deg:.0f}° and {_late(one.delay)}{side}"
        )
        values["last"] = {
            "distance_m": one.distance,
            "direction_deg": one.direction_deg,
            "delay_s": one.delay,
            "inside": inside,
        }
    if found:
        text += map(str, past_sentences(found))
        values["expected"] = {
            "inside_50": found["inside_50"],
            "inside_90": found["inside_90"],
            "count": found["count"],
            "next": found["next"],
        }
    return text, values, following.planned_ns if following else None


def _next_surfacing(
    following: figures.NextSurfacing, now_ns: int
) -> tuple[list[str], dict[str, Any]]:
    """Return the next surfacing in words and as figures."""
    leg, late = following.leg, following.late_s(now_ns)
    when = (
        f"OVERDUE by {hours_text(late)}"
        if late
        else f"in {hours_text(max(0.0, (following.time_ns - now_ns) / _SECOND))}"
    )
    text = [
        f"next, by the plan: {time_text(following.time_ns)} "
        f"({when}; overdue after {hours_text(following.margin_s)} more)"
    ]
    place = place_text(leg["longitude"], leg["latitude"])
    ellipse = {name: leg.get(f"ellipse_{name}") for name in ("major_m", "minor_m", "bearing_deg")}
    if "ellipse_major_m" in leg:
        axes = " x ".join(f"{leg[f'ellipse_{name}_m'] / 1e3:.1f}" for name in ("major", "minor"))
        text.append(f"at {place}; 90 % ellipse {axes} km along {leg['ellipse_bearing_deg']:.0f}°")
    else:
        text.append(f"at {place}; no ellipse without samples of the estimate (planner.samples)")
    when_where = {
        "time": time_text(following.time_ns),
        "late_s": late,
        "longitude": leg["longitude"],
        "latitude": leg["latitude"],
    }
    return text, {"next": {"basis": "plan", **when_where, **ellipse}}


def _next_as_last_dive(
    held: Held, found: Mapping[str, Any] | None, now_ns: int
) -> tuple[list[str], dict[str, Any]]:
    """Return the next surfacing of a vehicle that flies no plan, as the last dive tells it, in words and as figures."""
    following, why = figures.next_surfacing(held), "no plan is being flown"
    if held.plans:
        why = (
            "the dives before predicted better" if following else "the plan has no surfacing ahead"
        )
    following = found["next"] if found else None
    if following is None:
        return [why] if held.plans else [], {}
    seconds = (following["time_ns"] - now_ns) / _SECOND
    when = f"in {hours_text(seconds)}" if seconds >= 0.0 else f"{hours_text(-seconds)} ago"
    text = f"next, from the last dive, as {why}: {time_text(following['time_ns'])} ({when}), {place_of_next(following)}"
    (longitude, latitude), ellipse = following["expected"], following["ellipse_90"]
    values = {
        "time": time_text(following["time_ns"]),
        "longitude": longitude,
        "latitude": latitude,
        **ellipse,
    }
    return [text], {"next": {"basis": "last_dive", **values}}


def _command(held: Held, now_ns: int) -> _Answer:
    if not held.plans:
        return ["no plan"] if figures.goal_of(held) else [], {}, None
    plan, change = held.plans[-1], change_of(held)
    following = figures.next_surfacing(held)
    leg = following.leg if following else {}
    text = [command_text(plan, leg), *change]
    values = {
        "heading_deg": _finite(leg.get("heading_deg", plan.heading_deg)),
        "glide_angle_deg": _finite(leg.get("glide_angle_deg", plan.glide_angle_deg)),
        "depth_m": leg.get("depth_m"),
        "speed": _finite(plan.speed),
        "message": plan.message,
        "dives": figures.statistics_of(plan).get(ORIGIN, ""),
        "longitude": leg.get("longitude"),
        "latitude": leg.get("latitude"),
        "why": list(change),
    }
    return text, values, plan.timestamp.ToNanoseconds()


def _odds(held: Held, now_ns: int) -> _Answer:
    said, since_ns = figures.last_plan(held)
    if said is None:
        return [], {}, None
    values: dict[str, Any] = {"status": said["status"], "message": said["message"]}
    if said["status"] == "failed":
        return [f"plan failed: {said['message']}"], values, since_ns
    plan = held.plans[-1]
    text = [_outcome(plan, said)]
    if plan.HasField("odds") and plan.odds.n_samples:
        odds = plan.odds
        low, high = share_interval(odds.reached, odds.n_samples)
        text.append(
            f"{100.0 * odds.reached:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f}) of {odds.n_samples} simulated flights arrive, "
            f"{100.0 * odds.safe:.0f} % safe"
        )
        values |= {
            "duration_s": _finite(plan.duration),
            "closest_approach_m": _finite(plan.closest_approach),
            "reached": odds.reached,
            "reached_interval": [low, high],
            "safe": odds.safe,
            "samples": odds.n_samples,
        }
    else:
        text.append("odds unknown without samples (planner.samples)")
    if origin := figures.statistics_of(plan).get(ORIGIN):
        text.append(origin)
        values["dives"] = origin
    if math.isfinite(plan.energy) and plan.energy > 0.0:
        share = (
            f" of {plan.battery / 1e3:.0f} kJ"
            if math.isfinite(plan.battery) and plan.battery > 0.0
            else ""
        )
        text.append(f"energy {plan.energy / 1e3:.0f} kJ{share}")
        values |= {"energy_j": plan.energy, "battery_j": _finite(plan.battery)}
    return text, values, since_ns


def _outcome(plan: Any, said: Mapping[str, Any]) -> str:
    """Return how a plan ends; only one that reaches its goal, and without an alarm, is said to arrive."""
    if not math.isfinite(plan.duration):
        return f"plan {plan.status}: {plan.message}"
    hours, off = f"{plan.duration / 3600.0:.1f} h", f"{plan.closest_approach:.0f} m"
    if plan.status == "reached" and plan_alarm(said) is None:
        return f"plan reached: arrives after {hours}, {off} off"
    return f"plan {plan.status}: in {hours} it comes within {off} of the goal"


def _forecast(held: Held, now_ns: int) -> _Answer:
    times = figures.forecast_times(held)
    if times is None:
        return ["states no time: its age is unknown"], {}, None
    first, last, evolves = times
    values = {
        "first": time_text(first),
        "last": time_text(last),
        "age_s": (now_ns - first) / _SECOND,
    }
    if not evolves:
        return [f"of {time_text(first)}, held constant"], values, first
    ahead = (last - now_ns) / _SECOND
    ends = f"ends in {hours_text(ahead)}" if ahead >= 0.0 else f"ENDED {hours_text(-ahead)} ago"
    return [f"{time_text(first)} to {time_text(last)}; {ends}"], values, first


def _fit(held: Held, now_ns: int) -> _Answer:
    outcome = held.outcome
    if outcome is None or not outcome.complete:
        why = "no verdict: the run did not finish, or an earlier version made the result"
        return [why], {"findings": [], "verdict": [], "nis_per_dof": None}, held.last_ns
    text = [
        str(outcome.decision),
        *(
            f"{severity_word(one['severity'])}: {one['name']}, {one['evidence']}; {one['set']}"
            for one in outcome.consistency
        ),
        *(text for text in outcome.verdict if text not in outcome.decision.reasons),
    ]
    values = {
        "decision": outcome.decision.word,
        "reasons": list(outcome.decision.reasons),
        "findings": list(outcome.consistency),
        "verdict": list(outcome.verdict),
        "nis_per_dof": outcome.nis_per_dof,
    }
    return text, values, held.last_ns


#: By the key of its figures what an answer is called, how it is made, and the alarms that belong to it.
_ANSWERS: Mapping[str, tuple[str, Callable[[Held, int], _Answer], Sequence[str]]] = {
    "position": ("Position", _where, ()),
    "made_good": ("Made good", _rate, ()),
    "current": ("Current", _current, ()),
    "surfacing": ("Surfacing", _surfacing, ("surfacing overdue", "outside its ellipse")),
    "command": ("Steer", _command, ()),
    "odds": ("Odds", _odds, ("plan",)),
    "forecast": ("Forecast", _forecast, ("forecast ended",)),
    "fit": ("Fit", _fit, ("consistency",)),
}
_CORRECTED = "corrected for the flight model's error"


def _current_text(current: figures.Current) -> str:
    error = f" ± {100.0 * current.error:.1f}" if math.isfinite(current.error) else ""
    return f"{100.0 * current.speed:.1f}{error} cm/s toward {current.toward:.0f}°"


def _late(seconds: float) -> str:
    return f"{hours_text(abs(seconds))} {'late' if seconds >= 0.0 else 'early'}"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
