"""Status of a result: answers for the pilot as figures, and alarms; ``lines`` writes the text."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.geodesy import distance, rotate_to_geographic
from replay_kit.core.plan import ORIGIN, share_interval
from replay_kit.core.words.quantities import parse_time
from replay_kit.core.words.text import count_text, time_text
from replay_kit.results.mcap.schemas import attributes
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.outcome.verdict import Alarm
from replay_kit.show.sentences import by_habit, profile_bins
from replay_kit.show.status.alarms import alarms_of, change_of
from replay_kit.show.status.held import Fix, Held, Values

_SECOND, _DAY_NS = 1_000_000_000, 86_400 * 10**9
_ENDS = ("east", "north")
_PLACE = "longitude latitude"
_ELLIPSE = "major_m=ellipse_major_m minor_m=ellipse_minor_m bearing_deg=ellipse_bearing_deg"
_FIGURES = (
    "duration_s=duration closest_approach_m=closest_approach energy_j=energy battery_j=battery"
)
#: A surfacing is overdue by this share of its leg's duration, at least by so many seconds; by all of it after fewer dives than these.
OVERDUE_SHARE, OVERDUE_LEAST, OVERDUE_FEW = 0.2, 1800.0, 3


class Status(NamedTuple):
    """Figures and alarms of a result.

    Attributes:
        name: Name of one of several vehicles, otherwise of the vehicle and its mission, or of the result.
        now_ns: Reference time of ages [ns, UTC].
        alarms: Alarms.
        figures: Known answers of ``status --json``: ``position``, ``goal``, ``current``, ``surfacing``, ``command``, ``odds``, ``forecast``
            and ``fit``, each with its time ``since``.
    """

    name: str
    now_ns: int
    alarms: tuple[Alarm, ...]
    figures: Mapping[str, Any]


def status_of(held: Held, now_ns: int | None = None, vehicle: str = "") -> Status:
    """Return the status of a result.

    Args:
        held: Data of the result.
        now_ns: Present time [ns, UTC]; None for the last time of the result.
        vehicle: Name of one of several vehicles; empty for a single one.
    """
    now = held.last_ns if now_ns is None else now_ns
    answers = {key: values for key, answer in _ANSWERS.items() if (values := answer(held, now))}
    if "command" in answers:
        answers["command"]["why"] = list(change_of(held, answers.get("current")))
    alarms = alarms_of(held, answers)
    mission = held.outcome.mission if held.outcome else ""
    about = {
        "result": held.name,
        "mission": mission,
        "now": time_text(now),
        "last": time_text(held.last_ns),
        "alarms": [alarm.record() for alarm in alarms],
    }
    return Status(vehicle or mission or held.name, now, alarms, {**about, **answers})


def _position(held: Held, now_ns: int) -> Values:
    if not held.fixes:
        return {}
    fix, at = held.fixes[-1], held.reckoned
    values = {
        "since": time_text(fix.time_ns),
        **attributes(fix, _PLACE),
        "error_m": held.fix_error or None,
        "age_s": (now_ns - fix.time_ns) / _SECOND,
    }
    if at is not None:
        values["dead_reckoned"] = attributes(at, _PLACE) | {"time": time_text(at.time_ns)}
    if held.dive is not None and (number := int(held.dive["dive"][-1])):
        values["dive"] = number
    return values


def _goal(held: Held, now_ns: int) -> Values:
    """Return the goal, and how fast it was approached over the last day, if known, and since the first fix."""
    goal = held.goal
    if goal is None or not held.fixes:
        return {}
    *before, last = held.fixes
    *others, far = (float(distance(*_at(fix), *goal[:2])) / 1e3 for fix in held.fixes)
    error = math.sqrt(2.0) * held.fix_error / 1e3
    rates = [
        {"days": days, "km_a_day": (away - far) / days, "error": error / days}
        for fix, away in zip(before[::-1], others[::-1], strict=True)
        if (days := (last.time_ns - fix.time_ns) / _DAY_NS)
    ]
    place = dict(zip(("longitude", "latitude", "depth_m"), goal, strict=True))
    return {"since": time_text(last.time_ns), **place, "distance_km": far, "made_good": rates}


def _at(fix: Fix) -> tuple[float, float]:
    return fix.longitude, fix.latitude


def _current(held: Held, now_ns: int) -> Values:
    """Return the current of the last dive as measured, corrected and predicted; of profiles their RMS difference alone."""
    dive = held.dive
    if dive is None:
        return {}
    means = np.flatnonzero(dive["mean_current_kind"] == "dac")
    row = int(means[-1]) if means.size else -1
    bins = slice(first := int(dive["bins"][:row].sum()), first + 1) if means.size else slice(None)
    off, spread = (
        np.stack([dive[f"{name}_{end}"][bins] for end in _ENDS])
        for name in ("innovation", "innovation_std")
    )
    difference = math.hypot(*off[:, 0]) if means.size else _rms(off)
    found: Values = {
        "since": time_text(int(dive["timestamp"][row])),
        "dive": int(dive["dive"][row]),
        "rejected": bool(means.size and math.isfinite(difference) and not dive["accepted"][row]),
        "difference_m_s": _finite(difference),
        "predicted_difference_m_s": _finite(_rms(spread)),
    }
    for name in ("measured", "corrected") if means.size else ():
        ends = [float(dive[f"mean_current_{name}_{end}"][row]) for end in _ENDS]
        if math.isfinite(ends[0]):
            error = _finite(float(dive[f"mean_current_{name}_standard_error"][row]))
            found[name] = _true(held, ends) | {"standard_error": error}
    used = found.get("corrected") or found.get("measured")
    if used and math.isfinite((less := _true(held, off[:, 0].tolist()))["east"]):
        found["predicted"] = {end: used[end] - less[end] for end in _ENDS}
        found["predicted"]["standard_error"] = None
    return found


def _true(held: Held, ends: Sequence[float]) -> dict[str, Any]:
    """Return a velocity along local axes as one towards true east and north."""
    if held.fixes:
        places = held.projection, *_at(held.fixes[-1])
        ends = [float(end) for end in rotate_to_geographic(*places, *ends)]
    return dict(zip(_ENDS, ends, strict=True))


def _rms(values: Array) -> float:
    """Return the RMS of finite values; NaN without any."""
    known = values[np.isfinite(values)].astype(np.float64)
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def _next_leg(held: Held) -> Mapping[str, Any]:
    """Return the leg of the last plan after the vehicle's last surfacing; empty without one."""
    for plan in held.plans[-1:]:
        planned = [one.planned_time.ToNanoseconds() for one in held.outcomes]
        return next(iter(plan.legs[planned.count(plan.start_time_ns) :]), {})
    return {}


def _surfacing(held: Held, now_ns: int) -> Values:
    """Return the next surfacing by the plan and by the last dive, the more reliable first, and the last surfacing."""
    found = (held.outcome and held.outcome.predicted_surfacings) or {}
    each = [_by_plan(held, now_ns), _as_last_dive(found.get("next"), held.fixes)]
    first, other = each[::-1] if not each[0] or by_habit(found) else each
    values: Values = {"since": time_text(held.last_ns)}
    if first:
        count = (found.get("record") or {}).get("count", 0)
        why = _why_first(first["basis"], bool(other), count, bool(held.plans))
        values |= {"next": first | {"why": why}, "other": other or None}
    for outcome in held.outcomes[-1:]:
        inside = bool(outcome.inside_ellipse) if math.isfinite(outcome.ellipse_major) else None
        about = attributes(outcome, "distance_m=distance direction_deg delay_s=delay")
        values["last"] = about | {"inside": inside}
    if found:
        values["predicted"] = attributes(found, "inside_50 inside_90 count")
    return values if len(values) > 1 else {}


def _why_first(basis: str, compared: bool, count: int, planned: bool) -> str:
    """Return a short reason for the choice between predicted surfacings."""
    if not compared:
        without = "the plan has no surfacing left" if planned else "no plan is flown"
        return "its dives are unknown" if basis == "plan" else without
    better = "past dives" if basis == "last_dive" else "plans"
    judged = f"{better} predicted {count_text(count, 'surfacing')} better"
    return judged if count else "no surfacing was predicted yet"


def _by_plan(held: Held, now_ns: int) -> Values:
    """Return the next surfacing if the plan is flown; empty without one.

    A dive is not late while the longest before it would have gone on, and of few dives the longest may be a short one.
    """
    leg, flown = _next_leg(held), AsFlown.in_metadata(held.metadata)
    if not leg:
        return {}
    lasts, longest, share = leg["surfacing_s"] - leg["start_s"], 0.0, OVERDUE_SHARE
    if flown is not None:
        longest = flown.longest or flown.duration
        share = 1.0 if flown.longest and flown.dives < OVERDUE_FEW else share
    margin = max(longest - lasts, 0.0) + max(share * max(longest, lasts), OVERDUE_LEAST)
    time_ns = held.plans[-1].start_time_ns + int(leg["surfacing_s"] * _SECOND)
    late = (now_ns - time_ns) / _SECOND
    return {
        "basis": "plan",
        "time": time_text(time_ns),
        "overdue_s": late if late > margin else 0.0,
        "margin_s": margin,
        **attributes(leg, f"{_PLACE} {_ELLIPSE}"),
    }


def _as_last_dive(following: Mapping[str, Any] | None, fixes: Sequence[Fix]) -> Values:
    """Return the next surfacing by persistence of the last dive; empty without one, and after a later fix."""
    if not following or any(fix.time_ns > following["time_ns"] for fix in fixes):
        return {}
    about = {"basis": "last_dive", "time": time_text(following["time_ns"])}
    place = dict(zip(("longitude", "latitude"), following["expected"], strict=True))
    return {**about, **place, **following["ellipse_90"]}


def _command(held: Held, now_ns: int) -> Values:
    if not held.plans:
        return {}
    plan, leg = held.plans[-1], _next_leg(held)
    # a failed plan may state where its search ended
    failed = plan.status == "failed"
    heading = None if failed else _finite(leg.get("heading_deg", plan.heading_deg))
    flown = AsFlown.in_metadata(held.metadata)
    return {
        "since": time_text(plan.start_time_ns),
        "heading_deg": heading,
        "magnetic_heading_deg": flown.magnetic(heading) if flown and heading is not None else None,
        "glide_angle_deg": _finite(leg.get("glide_angle_deg", plan.glide_angle_deg)),
        "speed": _finite(plan.speed),
        "message": plan.message,
        "dives": plan.statistics.get(ORIGIN, ""),
        **attributes(leg, f"depth_m {_PLACE}"),
    }


def _odds(held: Held, now_ns: int) -> Values:
    """Return outcome and odds of the last plan; of an attempt that failed since, for which no plan was written, its message."""
    said = None if held.outcome is None else held.outcome.plan
    if said is not None and said["status"] == "failed":
        return {"since": time_text(held.last_ns), **attributes(said, "status message")}
    if not held.plans:
        return {}
    plan = held.plans[-1]
    begin, odds, statistics = plan.start_time_ns, plan.odds, plan.statistics
    values = {"since": time_text(begin), **attributes(plan, "status message")}
    if plan.status == "failed":
        return values
    asked = statistics.get("arrive")
    values |= {name: _finite(value) for name, value in attributes(plan, _FIGURES).items()}
    values |= {
        "arrival": _time_after(begin, plan.duration),
        "legs": len(plan.legs),
        "dives": statistics.get(ORIGIN, ""),
        "asked": None if asked is None else float(asked),
        "meets_goal": plan.status in ("reached", "uncertain"),
    }
    if odds is not None:
        # an unsafe plan may meet its goal all the same
        values["meets_goal"] |= plan.status == "unsafe" and plan.closest_approach <= odds.radius
        times = attributes(odds, "arrival_median arrival_90_percent")
        values |= attributes(odds, "reached safe samples=n_samples") | {
            "arrived": round(odds.reached * odds.n_samples),
            "reached_interval": [*share_interval(odds.reached, odds.n_samples)],
            **{name: _time_after(begin, seconds) for name, seconds in times.items()},
        }
    return values


def _time_after(begin_ns: int, seconds: float) -> str | None:
    """Return the time after a duration [s] as text; None if not finite."""
    return time_text(begin_ns + round(seconds * _SECOND)) if math.isfinite(seconds) else None


def _forecast(held: Held, now_ns: int) -> Values:
    record = held.metadata.get("replay_kit.forecast", {})
    if "first" not in record:
        return {}
    first, last = (parse_time(record[end]) for end in ("first", "last"))
    evolves = record.get("evolves") == "true"
    return {
        "since": time_text(first),
        "last": time_text(last),
        "evolves": evolves,
        "age_s": (now_ns - first) / _SECOND,
        "ends_in_s": (last - now_ns) / _SECOND if evolves else None,
    }


def _fit(held: Held, now_ns: int) -> Values:
    outcome, since = held.outcome or Outcome(complete=False), time_text(held.last_ns)
    if outcome.unjudged:
        return {"since": since, "verdict": None, "unjudged": outcome.unjudged}
    counts = attributes(outcome.observations, "used rejected bins_rejected")
    named = "verdict=verdict.word reasons=verdict.reasons findings=consistency basis rms_innovation nis_per_dof errors=errors_text"
    found = attributes(outcome, named)
    lists = {name: list(found[name]) for name in ("reasons", "findings", "basis")}
    counts["profile_bins"] = profile_bins(outcome.observations)
    return {"since": since, **found, **lists, "observations": counts}


#: By its key how an answer is made.
_ANSWERS: Mapping[str, Callable[[Held, int], Values]] = {
    **{"position": _position, "goal": _goal, "current": _current, "surfacing": _surfacing},
    **{"command": _command, "odds": _odds, "forecast": _forecast, "fit": _fit},
}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
