"""Alarms of a result, each with an action, and reasons for a changed command."""

import math
from collections.abc import Iterator, Mapping

from replay_kit.core.geodesy import distance
from replay_kit.core.plan import Plan
from replay_kit.core.words.quantities import parse_time
from replay_kit.core.words.text import time_text
from replay_kit.results.outcome.verdict import Alarm, finding_alarms, plan_alarm
from replay_kit.show.numbers import clock, hours_text
from replay_kit.show.status.held import Held, Values, course

# Changes that are worth a reason [degrees].
_SMALL_TURN = 2.0
# A current is a surprise when it is this many times the expected difference from the estimate.
_SURPRISE = 2.0


def change_of(held: Held, current: Values | None) -> Iterator[str]:
    """Yield the change of the command since the previous plan, and its reasons; nothing for the first plan.

    Args:
        held: Data of the result.
        current: Answer on the current.
    """
    if len(held.plans) < 2:
        return
    before, now = held.plans
    old, new = (_heading(plan, now.start_time_ns) for plan in held.plans)
    turn = (new - old + 180.0) % 360.0 - 180.0
    if abs(turn) < _SMALL_TURN:
        yield "heading unchanged since the previous plan"
        return
    turned = f"was {old:.0f}°: {abs(turn):.0f}° to the {'right' if turn > 0.0 else 'left'}"
    if math.isnan(turn):
        turned = f"was {before.status}, is {now.status}"
    reasons = [*_reasons(held, before, now, current)] or ["the estimate changed a little"]
    yield f"{turned}; {', '.join(reasons)}"


def _reasons(held: Held, before: Plan, now: Plan, current: Values | None) -> Iterator[str]:
    goals = [(plan.goal.longitude, plan.goal.latitude) for plan in (before, now)]
    if (moved := float(distance(*goals[0], *goals[1]))) > 1.0:
        yield f"the goal moved {moved / 1e3:.1f} km"
    since = before.start_time_ns
    outcomes = [outcome for outcome in held.outcomes if outcome.timestamp.ToNanoseconds() >= since]
    if outcomes:
        last = outcomes[-1]
        when = f"{abs(last.delay) / 60.0:.0f} min {'late' if last.delay >= 0.0 else 'early'}"
        yield f"it surfaced {last.distance / 1e3:.1f} km from the plan toward {last.direction_deg:.0f}°, {when}"
    if current is None or current["since"] < time_text(since):
        return
    off, expected = current["difference_m_s"], current["predicted_difference_m_s"]
    if None not in (off, expected) and off > _SURPRISE * expected:
        yield f"the current differed by {100.0 * off:.0f} cm/s from the estimate"


def _heading(plan: Plan, time_ns: int) -> float:
    """Return the planned heading at a time [degrees]; NaN for a failed plan."""
    since = (time_ns - plan.start_time_ns) / 1e9
    for leg in plan.legs:
        if since < leg["surfacing_s"]:
            return float(leg["heading_deg"])
    return plan.heading_deg if plan.status != "failed" else math.nan


def alarms_of(held: Held, answers: Mapping[str, Values]) -> tuple[Alarm, ...]:
    """Return the alarms of a result, those of the plan first.

    Args:
        held: Data of the result.
        answers: Known answers of its status.
    """
    odds, current, forecast = (answers.get(key, {}) for key in ("odds", "current", "forecast"))
    flown = {"n_samples": odds["samples"], "reached": odds["reached"]} if "samples" in odds else {}
    findings = held.outcome.consistency if held.outcome else ()
    found = (
        plan_alarm({**odds, "odds": flown} if odds else None, odds.get("since", "")),
        _overdue(answers.get("surfacing", {})),
        _outside(held),
        _rejected(current),
        *finding_alarms(findings, time_text(held.last_ns)),
        _ended(forecast),
    )
    return tuple(alarm for alarm in found if alarm is not None)


def _overdue(surfacing: Values) -> Alarm | None:
    for each in filter(None, (surfacing.get("next"), surfacing.get("other"))):
        if late := each.get("overdue_s"):
            due = time_text(parse_time(each["time"]) + int(1e9 * each["margin_s"]))
            text = f"surfacing {hours_text(late)} late (due {clock(each['time'])} UTC): call it"
            return Alarm("surfacing overdue", text, due, each["time"])
    return None


def _outside(held: Held) -> Alarm | None:
    """Return an alarm if the last surfacing is outside the ellipse that was shown for it."""
    found = (held.outcome.predicted_surfacings if held.outcome else None) or {}
    last = found["each"][-1] if found.get("each") else None
    if held.outcomes and (last is None or (found.get("record") or {}).get("shown") != "habit"):
        last_one, expected = held.outcomes[-1], "the plan"
        inside = last_one.inside_ellipse
        size = last_one.ellipse_major
        since = last_one.timestamp.ToNanoseconds()
        far, toward = last_one.distance, last_one.direction_deg
    elif last is not None:
        expected, inside, size = "the prediction", last["inside_90"], last["ellipse_90"]["major_m"]
        far, toward, since = last["distance_m"], last["direction_deg"], int(last["time_ns"])
    else:
        return None
    if inside or not math.isfinite(size):
        return None
    text = (
        f"surfaced {far / 1e3:.1f} km from {expected} toward {toward:.0f}°, outside its 90 % ellipse "
        f"({size / 1e3:.1f} km): plan again from here"
    )
    return Alarm("outside its ellipse", text, time_text(since), str(since))


def _rejected(current: Values) -> Alarm | None:
    """Return an alarm if the DAC of the last dive was rejected."""
    if not current.get("rejected") or not current.get("measured"):
        return None
    speed, toward = course(current["measured"])
    text = (
        f"dive {current['dive']}: its current of {100.0 * speed:.0f} cm/s to {toward:.0f}° was rejected, "
        f"{100.0 * current['difference_m_s']:.0f} cm/s from the estimate: check the dive"
    )
    return Alarm("current rejected", text, current["since"], current["since"])


def _ended(forecast: Values) -> Alarm | None:
    if (left := forecast.get("ends_in_s")) is None or left >= 0.0:
        return None
    text = f"the forecast ended {clock(forecast['last'])} UTC: give a newer one"
    return Alarm("forecast ended", text, forecast["last"], forecast["last"])
