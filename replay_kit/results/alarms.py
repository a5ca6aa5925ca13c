"""What of a run should wake a person, the plan first: every answer to a person reads it here."""

from collections.abc import Mapping
from typing import Any, NamedTuple

#: Statuses of plans that must not be flown unread.
_BAD_PLANS = ("uncertain", "unreachable", "unsafe", "failed")


class RunAlarm(NamedTuple):
    """What should wake a person.

    Attributes:
        kind: ``plan`` or ``consistency``.
        text: What is wrong, as a sentence.
        about: Of which plan or finding.
    """

    kind: str
    text: str
    about: str


def plan_alarm(plan: Mapping[str, Any] | None) -> RunAlarm | None:
    """Return what is wrong with a plan; None where nothing is, or without a plan.

    Args:
        plan: As in the JSON of a summary: ``status``, ``message``, and ``odds`` where it was flown in samples of the estimate.
    """
    if plan is None:
        return None
    status, message, odds = plan["status"], plan["message"], plan.get("odds") or {}
    if status in _BAD_PLANS:
        return RunAlarm(
            "plan",
            f"{'the plan failed' if status == 'failed' else f'the plan is {status}'}: {message}",
            status,
        )
    return (
        RunAlarm("plan", f"no sample of the estimate arrives: {message}", "no sample arrives")
        if odds.get("reached") == 0.0
        else None
    )


def run_alarms(summary: Mapping[str, Any]) -> tuple[RunAlarm, ...]:
    """Return the alarms of a run from the JSON of its summary, of which ``plan`` and ``consistency`` count."""
    of_plan = plan_alarm(summary.get("plan"))
    found = (
        RunAlarm("consistency", f"{one['name']}: {one['evidence']}; {one['set']}", one["name"])
        for one in summary.get("consistency", ())
    )
    return (*((of_plan,) if of_plan else ()), *found)


def alarms_json(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the alarms of a run for JSON; the argument is that of ``run_alarms``."""
    return [{"kind": one.kind, "text": one.text} for one in run_alarms(summary)]
