"""What of a result should wake a person."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from replay_kit.core.text import time_text
from replay_kit.results.outcome.verdict import plan_alarm, run_alarms
from replay_kit.show.status import figures
from replay_kit.show.status.held import Held

_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Alarm:
    """What should wake a person.

    Attributes:
        kind: ``surfacing overdue``, ``outside its ellipse``, ``consistency``, ``plan`` or ``forecast ended``.
        text: What is wrong, as a sentence.
        time_ns: Since when [ns, UTC].
        about: Of which plan, surfacing, finding or forecast: one alarm is given for each.
    """

    kind: str
    text: str
    time_ns: int
    about: str = ""

    def record(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"kind": self.kind, "text": self.text, "since": time_text(self.time_ns)}


def alarms_of(held: Held, now_ns: int) -> tuple[Alarm, ...]:
    """Return what of a result should wake a person, a plan that is not to be flown first.

    Args:
        held: What it holds.
        now_ns: The present time [ns, UTC].
    """
    return tuple(
        alarm
        for find in (_bad_plan, _overdue, _outside, _contradictions, _ended)
        for alarm in find(held, now_ns)
    )


def _overdue(held: Held, now_ns: int) -> Iterator[Alarm]:
    following = figures.next_surfacing(held)
    if following is not None and (late := following.late_s(now_ns)):
        due = following.time_ns + int(following.margin_s * _SECOND)
        text = f"the surfacing expected at {time_text(following.time_ns)} is {late / 3600.0:.1f} h late"
        yield Alarm("surfacing overdue", text, due, str(following.time_ns))


def _outside(held: Held, now_ns: int) -> Iterator[Alarm]:
    if (
        held.outcomes
        and not held.outcomes[-1].inside_ellipse
        and math.isfinite(held.outcomes[-1].ellipse_major)
    ):
        one, since = held.outcomes[-1], held.outcomes[-1].timestamp.ToNanoseconds()
        text = f"the vehicle surfaced {one.distance / 1e3:.1f} km toward {one.direction_deg:.0f} degrees of the predicted place"
        yield Alarm("outside its ellipse", f"{text}, outside its 90 % ellipse", since, str(since))


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
            f"the forecast ended at {time_text(times[1])}; give a newer one",
            times[1],
            str(times[1]),
        )
