"""Alarms of a result, each with an action, and reasons for a changed command."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass

from replay_kit.core.geodesy import distance
from replay_kit.core.plan import Plan
from replay_kit.core.quantities import parse_time
from replay_kit.core.text import time_text
from replay_kit.results.outcome.verdict import plan_alarm, run_alarms
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
    outcomes = [one for one in held.outcomes if one.timestamp.ToNanoseconds() >= since]
    if outcomes:
        one = outcomes[-1]
        when = f"{abs(one.delay) / 60.0:.0f} min {'late' if one.delay >= 0.0 else 'early'}"
        yield f"it surfaced {one.distance / 1e3:.1f} km from the plan toward {one.direction_deg:.0f}°, {when}"
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


@dataclass(frozen=True, slots=True)
class Alarm:
    """Alarm of a result.

    Attributes:
        kind: ``surfacing overdue``, ``outside its ellipse``, ``current rejected``, ``consistency``, ``plan`` or ``forecast ended``.
        text: Problem and action, as a line.
        since: Time of onset.
        about: Key of the plan, surfacing, finding or forecast; each raises one alarm.
    """

    kind: str
    text: str
    since: str
    about: str

    def record(self) -> dict[str, str]:
        """Return the alarm for JSON."""
        return {name: text for name, text in asdict(self).items() if name != "about"}


def alarms_of(held: Held, answers: Mapping[str, Values]) -> tuple[Alarm, ...]:
    """Return the alarms of a result, those of the plan first.

    Args:
        held: Data of the result.
        answers: Known answers of its status.
    """
    return (
        *_bad_plan(answers.get("odds", {})),
        *_overdue(answers.get("surfacing", {})),
        *_outside(held),
        *_rejected(answers.get("current", {})),
        *_contradictions(held),
        *_ended(answers.get("forecast", {})),
    )


def _bad_plan(odds: Values) -> Iterator[Alarm]:
    flown = {"n_samples": odds["samples"], "reached": odds["reached"]} if "samples" in odds else {}
    if (found := plan_alarm({**odds, "odds": flown} if odds else None)) is not None:
        yield Alarm(found.kind, found.text, odds["since"], found.about)


def _overdue(surfacing: Values) -> Iterator[Alarm]:
    for one in (surfacing.get("next"), surfacing.get("other")):
        if one and (late := one.get("overdue_s")):
            due = parse_time(one["time"]) + int(1e9 * one["margin_s"])
            text = f"surfacing {hours_text(late)} late (due {clock(one['time'])} UTC): call it"
            yield Alarm("surfacing overdue", text, time_text(due), one["time"])


def _outside(held: Held) -> Iterator[Alarm]:
    """Yield an alarm if the last surfacing is outside the ellipse that was shown for it."""
    found = (held.outcome.predicted_surfacings if held.outcome else None) or {}
    last = found["each"][-1] if found.get("each") else None
    shown = (found.get("record") or {}).get("shown", "plan")
    if held.outcomes and (shown == "plan" or last is None):
        one, of = held.outcomes[-1], "the plan"
        inside, size, since = one.inside_ellipse, one.ellipse_major, one.timestamp.ToNanoseconds()
        far, toward = one.distance, one.direction_deg
    elif last is not None:
        of, inside, size = "the prediction", last["inside_90"], last["ellipse_90"]["major_m"]
        far, toward, since = last["distance_m"], last["direction_deg"], int(last["time_ns"])
    else:
        return
    if not inside and math.isfinite(size):
        text = (
            f"surfaced {far / 1e3:.1f} km from {of} toward {toward:.0f}°, outside its 90 % ellipse "
            f"({size / 1e3:.1f} km): plan again from here"
        )
        yield Alarm("outside its ellipse", text, time_text(since), str(since))


def _rejected(current: Values) -> Iterator[Alarm]:
    """Yield an alarm if the DAC of the last dive was rejected."""
    if current.get("rejected") and (one := current.get("measured")):
        speed, toward = course(one)
        text = (
            f"dive {current['dive']}: its current of {100.0 * speed:.0f} cm/s to {toward:.0f}° was rejected, "
            f"{100.0 * current['difference_m_s']:.0f} cm/s from the estimate: check the dive"
        )
        yield Alarm("current rejected", text, current["since"], current["since"])


def _contradictions(held: Held) -> Iterator[Alarm]:
    for one in run_alarms(None, held.outcome.consistency if held.outcome else ()):
        yield Alarm(one.kind, one.text, time_text(held.last_ns), one.about)


def _ended(forecast: Values) -> Iterator[Alarm]:
    if (left := forecast.get("ends_in_s")) is not None and left < 0.0:
        text = f"the forecast ended {clock(forecast['last'])} UTC: give a newer one"
        yield Alarm("forecast ended", text, forecast["last"], forecast["last"])
