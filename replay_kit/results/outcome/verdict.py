"""The verdict on a run: how far to trust it and why, the sentences that say so, and what should wake a person."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

from replay_kit.core.errors import severity_word

if TYPE_CHECKING:
    from replay_kit.results.outcome.outcome import Outcome

# Normalised innovations squared per degree of freedom between which stated errors are taken for right.
LEAST_NIS, MOST_NIS = 0.5, 2.0
#: Statuses of plans that must not be flown unread.
_BAD_PLANS = ("uncertain", "unreachable", "unsafe", "failed")
Word = Literal["trust", "with care", "do not use"]


class Decision(NamedTuple):
    """How far to trust a run.

    Attributes:
        word: ``trust``, ``with care`` or ``do not use``.
        reasons: Why not further, each a sentence; empty for ``trust``.
    """

    word: Word
    reasons: tuple[str, ...]

    def __str__(self) -> str:
        """Return it as a sentence."""
        return ": ".join([self.word, *filter(None, ["; ".join(self.reasons)])])


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


def decide(outcome: "Outcome") -> Decision:
    """Return how far to trust a run, of several vehicles as far as the least trusted. It never changes the exit code."""
    error, found, plan = outcome.error, outcome.consistency, outcome.plan
    nis = math.nan if outcome.nis_per_dof is None else outcome.nis_per_dof
    against = (
        (error, bool(error)),
        *((one["name"], one["severity"] != "warning" and not error) for one in found),
        ("no observation was used", not outcome.observations["used"] and not error),
    )
    doubtful = (
        ("part of the log was lost", 4 in outcome.exit_codes),
        ("the requested risk cannot be met", 7 in outcome.exit_codes),
        (nis_sentence(nis), not math.isnan(nis) and not LEAST_NIS <= nis <= MOST_NIS),
        *((one["name"], one["severity"] == "warning") for one in found),
        *((text, True) for text in outcome.outside),
        (_plan_reason(plan), bool(_plan_reason(plan))),
    )
    worst = tuple(text for text, holds in against if holds)
    others = tuple(text for text, holds in doubtful if holds)
    word: Word = "do not use" if worst else "with care" if others else "trust"
    named = dict[str, list[str]]()
    for name, one in outcome.vehicles.items():
        for reason in one.decision.reasons:
            named.setdefault(reason, []).append(name)
    own = (f"{', '.join(names)}: {reason}" for reason, names in named.items())
    words = (word, *(one.decision.word for one in outcome.vehicles.values()))
    reasons = tuple(dict.fromkeys((*worst, *others, *own)))
    return Decision(max(words, key=get_args(Word).index), reasons)


def _plan_reason(plan: Mapping[str, Any] | None) -> str:
    """Return how a plan ends that cannot be relied on, in a few words; empty for one that arrives, or without a plan."""
    if plan is None:
        return ""
    if plan["status"] != "reached":
        return "the plan failed" if plan["status"] == "failed" else f"the plan is {plan['status']}"
    return "" if plan_alarm(plan) is None else "no sample of the plan arrives"


def plan_alarm(plan: Mapping[str, Any] | None) -> RunAlarm | None:
    """Return what is wrong with a plan; None where nothing is, or without a plan.

    Args:
        plan: As in an outcome: ``status``, ``message``, and ``odds`` where it was flown in samples of the estimate.
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


def run_alarms(
    plan: Mapping[str, Any] | None, consistency: Sequence[Mapping[str, Any]]
) -> tuple[RunAlarm, ...]:
    """Return the alarms of a run, of its plan and its contradictions."""
    of_plan = plan_alarm(plan)
    found = (
        RunAlarm("consistency", f"{one['name']}: {one['evidence']}; {one['set']}", one["name"])
        for one in consistency
    )
    return (*((of_plan,) if of_plan else ()), *found)


def verdict_sentences(outcome: "Outcome") -> tuple[str, ...]:
    """Return the share of the observations used, consistency, errors before and after, and doubts; each a sentence, the last several."""
    used, rejected, nis = (
        outcome.observations["used"],
        outcome.observations["rejected"],
        outcome.nis_per_dof,
    )
    usage = "; ".join(
        filter(None, (f"{used} of {used + rejected} observations used", outcome.lost_pings))
    )
    trust = () if nis is None else (nis_sentence(nis),)
    sentences = usage, _consistency(outcome.consistency), _gain(outcome.rms_innovation), *trust
    return (*sentences, *outcome.doubts, *outcome.outside)


def _consistency(findings: Sequence[Mapping[str, Any]]) -> str:
    """Return whether the log contradicts itself, and then whether log and forecast fit, as one sentence."""
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
    return f"RMS misfit: forecast {prior}, estimate before update {before}, after {after} cm/s"


def nis_sentence(nis: float) -> str:
    """Return whether the stated errors hold, of a normalised innovation squared per degree of freedom, 1 expected."""
    if nis > MOST_NIS:
        return f"errors are larger than stated (NIS/dof {nis:.2f}, 1 expected)"
    if nis < LEAST_NIS:
        return f"errors are smaller than stated (NIS/dof {nis:.2f}, 1 expected)"
    return f"error bars consistent (NIS/dof {nis:.2f})"
