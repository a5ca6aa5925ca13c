"""Status of a result: figures for the pilot, and alarms; ``lines`` writes the text."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from replay_kit.core.as_flown import AsFlown
from replay_kit.core.geodesy import to_local
from replay_kit.core.plan import ORIGIN, plan_legs, share_interval
from replay_kit.core.surfacing import planned_ellipses
from replay_kit.core.text import time_text
from replay_kit.show.sentences import profile_bins
from replay_kit.show.status import figures
from replay_kit.show.status.alarms import Alarm, alarms_of, change_of
from replay_kit.show.status.held import Held

_SECOND = 1_000_000_000
Values = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Status:
    """Figures and alarms of a result.

    Attributes:
        name: Name of the vehicle and its mission, otherwise of the result.
        now_ns: Reference time of ages [ns, UTC].
        alarms: Alarms.
        figures: Known answers of ``status --json``: ``position``, ``goal``, ``current``, ``surfacing``, ``command``, ``odds``, ``forecast``
            and ``fit``, each with its time ``since``.
        places: Points (east, north) [m, local frame] of ``track``, ``plan``, ``goal`` and ``ellipse``, if known.
    """

    name: str
    now_ns: int
    alarms: tuple[Alarm, ...]
    figures: Mapping[str, Any]
    places: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)


def status_of(held: Held, now_ns: int | None = None) -> Status:
    """Return the status of a result.

    Args:
        held: Data of the result.
        now_ns: Present time [ns, UTC]; None for the last time of the result.
    """
    now = held.last_ns if now_ns is None else now_ns
    alarms = alarms_of(held, now)
    answers = {key: answer(held, now) for key, answer in _ANSWERS.items()}
    mission = held.outcome.mission if held.outcome else ""
    about = {
        "result": held.name,
        "mission": mission,
        "now": time_text(now),
        "last": time_text(held.last_ns),
        "alarms": [alarm.record() for alarm in alarms],
    }
    known = {key: values for key, values in answers.items() if values}
    return Status(mission or held.name, now, alarms, {**about, **known}, _places(held))


def _places(held: Held) -> dict[str, Sequence[tuple[float, float]]]:
    """Return the points of the small map, see ``Status``."""
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


def _position(held: Held, now_ns: int) -> Values:
    if not held.fixes:
        return {}
    fix, error = held.fixes[-1], held.settings.get("measurements", {}).get("fix_std")
    values: Values = {
        "since": time_text(fix.time_ns),
        "longitude": fix.longitude,
        "latitude": fix.latitude,
        "error_m": error or None,
        "age_s": (now_ns - fix.time_ns) / _SECOND,
    }
    if (at := held.reckoned) is not None:
        place = {"longitude": at.longitude, "latitude": at.latitude}
        values["dead_reckoned"] = {**place, "time": time_text(at.time_ns)}
    if held.dive is not None and (number := int(held.dive["dive"][-1])):
        values["dive"] = number
    return values


def _goal(held: Held, now_ns: int) -> Values:
    goal = figures.goal_of(held)
    if goal is None or not held.fixes:
        return {}
    return {
        "since": time_text(held.fixes[-1].time_ns),
        "longitude": goal[0],
        "latitude": goal[1],
        "depth_m": goal[2],
        "distance_km": figures.far(held.fixes[-1], goal) / 1e3,
        "made_good": [
            {"days": rate.days, "km_a_day": rate.km_a_day, "error": rate.error}
            for rate in figures.made_good(held)
        ],
    }


def _current(held: Held, now_ns: int) -> Values:
    found = figures.dive_current(held)
    if found is None:
        return {}
    values: Values = {
        "since": time_text(found.time_ns),
        "dive": found.dive,
        "rejected": found.rejected,
        "difference_m_s": _finite(found.difference),
        "predicted_difference_m_s": _finite(found.expected),
    }
    for name in ("measured", "corrected", "predicted"):
        if (current := getattr(found, name)) is not None:
            both = {"east": current.east, "north": current.north}
            values[name] = both | {"standard_error": _finite(current.error)}
    return values


def _surfacing(held: Held, now_ns: int) -> Values:
    following = figures.next_surfacing(held)
    found = held.outcome.predicted_surfacings if held.outcome else None
    by_plan = None if following is None else _by_plan(following, now_ns)
    by_dive = None if not (found and found["next"]) else _as_last_dive(found["next"])
    record = (found or {}).get("record") or {}
    first, other = by_plan, by_dive
    if by_plan is None or (by_dive is not None and record.get("shown") == "habit"):
        first, other = by_dive, by_plan
    values: Values = {"since": time_text(held.last_ns)}
    if first is not None:
        why = _why_first(first["basis"], other, record.get("count", 0), bool(held.plans))
        values |= {"next": first | {"why": why}, "other": other}
    if held.outcomes:
        one, size = held.outcomes[-1], held.outcomes[-1].ellipse_major
        values["last"] = {
            "distance_m": one.distance,
            "direction_deg": one.direction_deg,
            "delay_s": one.delay,
            "inside": bool(one.inside_ellipse) if math.isfinite(size) else None,
        }
    if found:
        values["predicted"] = {name: found[name] for name in ("inside_50", "inside_90", "count")}
    return values if len(values) > 1 else {}


def _why_first(basis: str, other: Values | None, count: int, planned: bool) -> str:
    """Return a short reason for the choice between predicted surfacings."""
    if other is None:
        if basis == "plan":
            return "its dives are unknown"
        return "the plan has no surfacing left" if planned else "no plan is flown"
    judged = f"{count} surfacing{'s' * (count != 1)}"
    better = "past dives" if basis == "last_dive" else "plans"
    return f"{better} predicted {judged} better" if count else "no surfacing was predicted yet"


def _by_plan(following: figures.NextSurfacing, now_ns: int) -> Values:
    """Return the next surfacing if the plan is flown."""
    leg, axes = following.leg, ("major_m", "minor_m", "bearing_deg")
    return {
        "basis": "plan",
        "time": time_text(following.time_ns),
        "overdue_s": following.late_s(now_ns),
        "margin_s": following.margin_s,
        "longitude": leg["longitude"],
        "latitude": leg["latitude"],
        **{name: leg.get(f"ellipse_{name}") for name in axes},
    }


def _as_last_dive(following: Mapping[str, Any]) -> Values:
    """Return the next surfacing by persistence of the last dive."""
    longitude, latitude = following["expected"]
    return {
        "basis": "last_dive",
        "time": time_text(following["time_ns"]),
        "longitude": longitude,
        "latitude": latitude,
        **following["ellipse_90"],
    }


def _command(held: Held, now_ns: int) -> Values:
    if not held.plans:
        return {}
    plan, following = held.plans[-1], figures.next_surfacing(held)
    leg = following.leg if following else {}
    heading = _finite(leg.get("heading_deg", plan.heading_deg))
    flown = AsFlown.in_metadata(held.metadata)
    return {
        "since": time_text(plan.timestamp.ToNanoseconds()),
        "heading_deg": heading,
        "magnetic_heading_deg": flown.magnetic(heading) if flown and heading is not None else None,
        "glide_angle_deg": _finite(leg.get("glide_angle_deg", plan.glide_angle_deg)),
        "depth_m": leg.get("depth_m"),
        "speed": _finite(plan.speed),
        "message": plan.message,
        "dives": figures.statistics_of(plan).get(ORIGIN, ""),
        "longitude": leg.get("longitude"),
        "latitude": leg.get("latitude"),
        "why": list(change_of(held)),
    }


def _odds(held: Held, now_ns: int) -> Values:
    said, since_ns = figures.last_plan(held)
    if said is None:
        return {}
    values: Values = {
        "since": time_text(since_ns),
        "status": said["status"],
        "message": said["message"],
    }
    if said["status"] == "failed":
        return values
    plan = held.plans[-1]
    begin, odds = plan.timestamp.ToNanoseconds(), plan.odds
    statistics = figures.statistics_of(plan)
    values |= {
        "duration_s": _finite(plan.duration),
        "arrival": _time_after(begin, plan.duration),
        "closest_approach_m": _finite(plan.closest_approach),
        "legs": len(plan_legs(statistics)),
        "energy_j": _finite(plan.energy),
        "battery_j": _finite(plan.battery),
        "dives": statistics.get(ORIGIN, ""),
        "asked": _number(statistics.get("arrive")),
    }
    if plan.HasField("odds") and odds.n_samples:
        values |= {
            "reached": odds.reached,
            "arrived": round(odds.reached * odds.n_samples),
            "reached_interval": [*share_interval(odds.reached, odds.n_samples)],
            "safe": odds.safe,
            "samples": odds.n_samples,
            "arrival_median": _time_after(begin, odds.arrival_median),
            "arrival_90_percent": _time_after(begin, odds.arrival_90_percent),
        }
    return values


def _time_after(begin_ns: int, seconds: float) -> str | None:
    """Return the time after a duration [s] as text; None if not finite."""
    return time_text(begin_ns + round(seconds * _SECOND)) if math.isfinite(seconds) else None


def _forecast(held: Held, now_ns: int) -> Values:
    times = figures.forecast_times(held)
    if times is None:
        return {}
    first, last, evolves = times
    return {
        "since": time_text(first),
        "last": time_text(last),
        "evolves": evolves,
        "age_s": (now_ns - first) / _SECOND,
        "ends_in_s": (last - now_ns) / _SECOND if evolves else None,
    }


def _fit(held: Held, now_ns: int) -> Values:
    outcome, since = held.outcome, time_text(held.last_ns)
    if outcome is None or not outcome.complete:
        return {"since": since, "verdict": None}
    return {
        "since": since,
        "verdict": outcome.verdict.word,
        "reasons": list(outcome.verdict.reasons),
        "findings": list(outcome.consistency),
        "basis": list(outcome.basis),
        "rms_innovation": dict(outcome.rms_innovation),
        "nis_per_dof": outcome.nis_per_dof,
        "errors": outcome.errors_text,
        "observations": {
            **{name: outcome.observations[name] for name in ("used", "rejected", "bins_rejected")},
            "profile_bins": profile_bins(outcome.observations),
        },
    }


#: By its key how an answer is made.
_ANSWERS: Mapping[str, Callable[[Held, int], Values]] = {
    "position": _position,
    "goal": _goal,
    "current": _current,
    "surfacing": _surfacing,
    "command": _command,
    "odds": _odds,
    "forecast": _forecast,
    "fit": _fit,
}


def _number(text: str | None) -> float | None:
    return None if text is None else float(text)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
