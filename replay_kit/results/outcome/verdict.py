"""Verdict on a run with its reasons, the sentences of its basis, and the alarms.

Source of the interval: Wilson & Hilferty (1931), The distribution of chi-square.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

from replay_kit.core.errors import severity_word

if TYPE_CHECKING:
    from replay_kit.results.outcome.outcome import Outcome

# Standard deviations between which 99 % of a normal distribution lie.
_NINETY_NINE = 2.576
#: Normalised innovations squared per degree of freedom beyond which an estimate is used with care, where the count allows to say so.
LEAST_NIS, MOST_NIS = 0.5, 1.5
_CLOSER = "choose a goal within reach"
# what to do with a plan that does not arrive, by its status
_ACTIONS = {
    "uncertain": "allow more time or choose a nearer goal",
    "unreachable": _CLOSER,
    "unsafe": "do not fly it; change the goal or the areas",
    "failed": "keep the last command and mend what failed",
}
Word = Literal["trust", "with care", "do not use"]


class Verdict(NamedTuple):
    """Verdict on a run.

    Attributes:
        word: ``trust``, ``with care`` or ``do not use``.
        reasons: Reasons against ``trust`` as sentences; else empty.
    """

    word: Word
    reasons: tuple[str, ...]

    def __str__(self) -> str:
        """Return the verdict as a sentence."""
        return ": ".join([self.word, *filter(None, ["; ".join(self.reasons)])])


class Alarm(NamedTuple):
    """Alarm of a run or of a status.

    Attributes:
        kind: ``plan`` or ``consistency``; of a status also ``surfacing overdue``, ``outside its ellipse``, ``current rejected`` or
            ``forecast ended``.
        text: Problem and action, as a line.
        since: Time of onset; empty for a run.
        about: Key of the plan, surfacing, finding or forecast; each raises one alarm.
    """

    kind: str
    text: str
    since: str
    about: str

    def record(self) -> dict[str, str]:
        """Return the alarm for JSON."""
        return {"kind": self.kind, "text": self.text, "since": self.since}


def decide(outcome: "Outcome") -> Verdict:
    """Return the verdict on a run, the worst of several vehicles; the exit code does not depend on it."""
    error, plan = outcome.error, outcome.plan
    # findings of several vehicles are reasons of theirs
    found = () if outcome.vehicles else outcome.consistency
    warnings = [(finding["name"], finding["severity"] == "warning") for finding in found]
    against = (
        *((name, not warns) for name, warns in warnings if not error),
        (error or "no observation was used", error or not outcome.observations["used"]),
    )
    doubtful = (
        ("part of the log was lost", (4 in outcome.exit_codes and outcome.losses) or outcome.late),
        *((f"{name}: {why}", True) for name, why in outcome.unused.items()),
        (outcome.lost_pings, bool(outcome.lost_pings)),
        ("the requested risk cannot be met", 7 in outcome.exit_codes),
        (errors_text(outcome), doubtful_errors(outcome)),
        *warnings,
        *((text, True) for text in outcome.outside),
        (_plan_reason(plan), bool(_plan_reason(plan))),
    )
    worst, others = ([text for text, holds in each if holds] for each in (against, doubtful))
    word: Word = "do not use" if worst else "with care" if others else "trust"
    named = dict[str, list[str]]()
    for name, vehicle in outcome.vehicles.items():
        for reason in vehicle.verdict.reasons:
            named.setdefault(reason, []).append(name)
    of_vehicles = (f"{', '.join(names)}: {reason}" for reason, names in named.items())
    words = (word, *(vehicle.verdict.word for vehicle in outcome.vehicles.values()))
    reasons = tuple(dict.fromkeys((*worst, *others, *of_vehicles)))
    return Verdict(max(words, key=get_args(Word).index), reasons)


def _plan_reason(plan: Mapping[str, Any] | None) -> str:
    """Return the defect of a plan in a few words; empty if it arrives, or without a plan."""
    if plan is None:
        return ""
    if plan["status"] != "reached":
        return "the plan failed" if plan["status"] == "failed" else f"the plan is {plan['status']}"
    return "" if plan_alarm(plan) is None else "no simulated flight arrives"


def plan_alarm(plan: Mapping[str, Any] | None, since: str = "") -> Alarm | None:
    """Return the alarm of a plan, the defect and what to do; None without a defect or without a plan.

    Args:
        plan: As in an outcome: ``status``, ``message``, and ``odds`` from simulated flights.
        since: See ``Alarm``.
    """
    if plan is None:
        return None
    status, odds = plan["status"], plan.get("odds") or {}
    if status not in _ACTIONS and odds.get("reached") != 0.0:
        return None
    why = re.split(r"\. |;", plan["message"])[0]
    if odds and status in ("uncertain", "unreachable", "reached"):
        count = odds["n_samples"]
        why = f"{round(odds['reached'] * count)} of {count:.0f} simulated flights arrive"
    about = status if status in _ACTIONS else "no simulated flight arrives"
    in_mean = "the plan arrives in the mean current alone"
    first = in_mean if status == "reached" else _plan_reason(plan)
    return Alarm("plan", f"{first}: {why}: {_ACTIONS.get(status, _CLOSER)}", since, about)


def finding_alarms(findings: Sequence[Mapping[str, Any]], since: str = "") -> list[Alarm]:
    """Return an alarm for each finding."""
    return [
        Alarm("consistency", f"{one['name']}: {one['set']}", since, one["name"]) for one in findings
    ]


def basis_sentences(outcome: "Outcome") -> tuple[str, ...]:
    """Return the basis of the verdict as sentences: observations used, consistency, misfit, stated errors, and doubts."""
    used, rejected = outcome.observations["used"], outcome.observations["rejected"]
    usage = f"{used} of {used + rejected} observations used"
    trust = filter(None, (errors_text(outcome),))
    sentences = usage, _consistency(outcome.consistency), _gain(outcome.rms_innovation), *trust
    return (*sentences, *outcome.doubts, *outcome.outside)


def _consistency(findings: Sequence[Mapping[str, Any]]) -> str:
    """Return the consistency of the log, and of log and forecast, as one sentence."""
    named = dict.fromkeys(
        one["name"] for one in findings if severity_word(one["severity"]) == "contradiction"
    )
    others = [f"{one['name']}: {one['evidence']}" for one in findings if one["name"] not in named]
    if not named:
        return (
            f"the log does not contradict itself, but {'; '.join(others)}"
            if others
            else "no contradiction found"
        )
    return "; ".join(
        (f"{len(named)} contradiction{'s' * (len(named) > 1)}: {', '.join(named)}", *others)
    )


def _gain(rms: Mapping[str, Any]) -> str:
    if rms.get("prior") is None:
        return "no observation changed the estimate: it is the prior forecast"
    prior, before, after = (
        "unknown" if rms[name] is None else f"{100.0 * rms[name]:.1f}"
        for name in ("prior", "before", "after")
    )
    return f"misfit {before} cm/s before each update, {after} after it, forecast {prior}"


def errors_hold(outcome: "Outcome") -> bool | None:
    """Return whether the stated errors hold, by the 99 % interval of NIS for the number of observations; None without any.

    Errors of a profile's bins are correlated, so that an observation counts as two components.
    """
    nis, count = outcome.nis_per_dof, 2 * outcome.observations["used"]
    if nis is None or not count:
        return None
    size = 2.0 / (9.0 * count)
    low, high = (1.0 - size + side * math.sqrt(size) for side in (-_NINETY_NINE, _NINETY_NINE))
    return max(low, 0.0) ** 3 <= nis <= high**3 or abs(math.sqrt(nis) - 1.0) < 0.05


def errors_text(outcome: "Outcome") -> str:
    """Return the validity of the stated errors as text; empty without observations."""
    nis, hold = outcome.nis_per_dof, errors_hold(outcome)
    if nis is None or hold is None:
        return ""
    if hold:
        return "errors as stated"
    if nis > 4.0:
        return f"errors {math.sqrt(nis):.1f} times as large as stated"
    share = abs(math.sqrt(nis) - 1.0)
    return f"errors {100.0 * share:.0f} % {'larger' if nis > 1.0 else 'smaller'} than stated"


def doubtful_errors(outcome: "Outcome") -> bool:
    """Return whether the stated errors require the verdict ``with care``."""
    nis = outcome.nis_per_dof
    off = nis is not None and not LEAST_NIS <= nis <= MOST_NIS
    return off and errors_hold(outcome) is False
