"""Alarms of a result, each with an action, and reasons for a changed command."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from replay_kit.core.geodesy import distance
from replay_kit.core.plan import plan_legs
from replay_kit.core.text import time_text
from replay_kit.results.outcome.verdict import plan_alarm, run_alarms
from replay_kit.show.numbers import clock_text, hours_text
from replay_kit.show.status import figures
from replay_kit.show.status.held import Held

# Changes that are worth a reason [degrees].
_SMALL_TURN = 2.0
# A current is a surprise when it is this many times the expected difference from the estimate.
_SURPRISE = 2.0


def change_of(held: Held) -> tuple[str, ...]:
    """Return the change of the command since the previous plan, and its reasons; empty for the first plan."""
    if len(held.plans) < 2:
        return ()
    before, now = held.plans
    old, new = (
        _heading(before, now.timestamp.ToNanoseconds()),
        _heading(now, now.timestamp.ToNanoseconds()),
    )
    if not (math.isfinite(old) and math.isfinite(new)):
        turned = f"was {before.status}, is {now.status}"
    else:
        turn = (new - old + 180.0) % 360.0 - 180.0
        turned = (
            "unchanged"
            if abs(turn) < _SMALL_TURN
            else f"was {old:.0f}°: {abs(turn):.0f}° to the {'right' if turn > 0.0 else 'left'}"
        )
    if turned == "unchanged":
        return ("heading unchanged since the previous plan",)
    reasons = list(_reasons(held, before, now)) or ["the estimate changed a little"]
    return (f"{turned}; {', '.join(reasons)}",)


def _reasons(held: Held, before: Any, now: Any) -> Iterator[str]:
    moved = float(
        distance(before.goal.longitude, before.goal.latitude, now.goal.longitude, now.goal.latitude)
    )
    if moved > 1.0:
        yield f"the goal moved {moved / 1e3:.1f} km"
    since = before.timestamp.ToNanoseconds()
    outcomes = [one for one in held.outcomes if one.timestamp.ToNanoseconds() >= since]
    if outcomes:
        one = outcomes[-1]
        when = f"{abs(one.delay) / 60.0:.0f} min {'late' if one.delay >= 0.0 else 'early'}"
        yield f"it surfaced {one.distance / 1e3:.1f} km from the plan toward {one.direction_deg:.0f}°, {when}"
    found = figures.dive_current(held)
    if (
        found is not None
        and found.time_ns >= since
        and found.difference > _SURPRISE * found.expected
    ):
        yield f"the current differed by {100.0 * found.difference:.0f} cm/s from the estimate"


def _heading(plan: Any, time_ns: int) -> float:
    """Return the planned heading at a time [degrees]; NaN for a failed plan."""
    since = (time_ns - plan.timestamp.ToNanoseconds()) / 1e9
    for leg in plan_legs(figures.statistics_of(plan)):
        if since < leg["surfacing_s"]:
            return float(leg["heading_deg"])
    return float(plan.heading_deg) if plan.status != "failed" else math.nan


_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Alarm:
    """Alarm of a result.

    Attributes:
        kind: ``surfacing overdue``, ``outside its ellipse``, ``current rejected``, ``consistency``, ``plan`` or ``forecast ended``.
        text: Problem and action, as a line.
        time_ns: Time of onset [ns, UTC].
        about: Key of the plan, surfacing, finding or forecast; each raises one alarm.
    """

    kind: str
    text: str
    time_ns: int
    about: str = ""

    def record(self) -> dict[str, Any]:
        """Return the alarm for JSON."""
        return {"kind": self.kind, "text": self.text, "since": time_text(self.time_ns)}


def alarms_of(held: Held, now_ns: int) -> tuple[Alarm, ...]:
    """Return the alarms of a result, those of the plan first.

    Args:
        held: Data of the result.
        now_ns: Present time [ns, UTC].
    """
    return tuple(
        alarm
        for find in (_bad_plan, _overdue, _outside, _rejected, _contradictions, _ended)
        for alarm in find(held, now_ns)
    )


def _overdue(held: Held, now_ns: int) -> Iterator[Alarm]:
    following = figures.next_surfacing(held)
    if following is not None and (late := following.late_s(now_ns)):
        due = following.time_ns + int(following.margin_s * _SECOND)
        text = (
            f"surfacing {hours_text(late)} late (due {clock_text(following.time_ns)} UTC): call it"
        )
        yield Alarm("surfacing overdue", text, due, str(following.time_ns))


def _outside(held: Held, now_ns: int) -> Iterator[Alarm]:
    """Yield an alarm if the last surfacing is outside its predicted ellipse."""
    found = held.outcome.predicted_surfacings if held.outcome else None
    planned = held.outcomes[-1] if held.outcomes else None
    since = 0 if planned is None else planned.timestamp.ToNanoseconds()
    last = found["each"][-1] if found and found["each"] else None
    shown = ((found or {}).get("record") or {}).get("shown", "plan")
    if planned is not None and (shown == "plan" or last is None):
        inside, size = planned.inside_ellipse, planned.ellipse_major
        far, toward, of = planned.distance, planned.direction_deg, "the plan"
    elif last is not None:
        inside, size = last["inside_90"], last["ellipse_90"]["major_m"]
        far, toward, of = last["distance_m"], last["direction_deg"], "the prediction"
        since = int(last["time_ns"])
    else:
        return
    if not inside and math.isfinite(size):
        text = (
            f"surfaced {far / 1e3:.1f} km from {of} toward {toward:.0f}°, outside its 90 % ellipse "
            f"({size / 1e3:.1f} km): plan again from here"
        )
        yield Alarm("outside its ellipse", text, since, str(since))


def _rejected(held: Held, now_ns: int) -> Iterator[Alarm]:
    """Yield an alarm if the DAC of the last dive was rejected."""
    found = figures.dive_current(held)
    if found is not None and found.rejected and found.measured is not None:
        text = (
            f"dive {found.dive}: its current of {100.0 * found.measured.speed:.0f} cm/s to {found.measured.toward:.0f}° was rejected, "
            f"{100.0 * found.difference:.0f} cm/s from the estimate: check the dive"
        )
        yield Alarm("current rejected", text, found.time_ns, str(found.time_ns))


def _contradictions(held: Held, now_ns: int) -> Iterator[Alarm]:
    for one in run_alarms(None, held.outcome.consistency if held.outcome else ()):
        yield Alarm(one.kind, one.text, held.last_ns, one.about)


def _bad_plan(held: Held, now_ns: int) -> Iterator[Alarm]:
    plan, since_ns = figures.last_plan(held)
    if (found := plan_alarm(plan)) is not None:
        yield Alarm(found.kind, found.text, since_ns, found.about)


def _ended(held: Held, now_ns: int) -> Iterator[Alarm]:
    times = figures.forecast_times(held)
    if times is not None and times[2] and now_ns > times[1]:
        yield Alarm(
            "forecast ended",
            f"the forecast ended {clock_text(times[1])} UTC: give a newer one",
            times[1],
            str(times[1]),
        )
