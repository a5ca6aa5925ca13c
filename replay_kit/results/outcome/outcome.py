"""The outcome of a replay: one frozen value, the same from the run that has just ended and from its result file.

Everything that is shown of a run (its summary, ``--json``, status, report, the table of a fleet, alarms) formats this value.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from replay_kit.results.outcome.verdict import (
    Decision,
    RunAlarm,
    decide,
    plan_alarm,
    run_alarms,
    verdict_sentences,
)

_STATUS = {0: "done", 4: "loss", 6: "inconsistent"}
Values = Mapping[str, Any]
# Of a run of several vehicles alone.
_OF_SEVERAL = ("vehicles", "value", "unused")
_NO_OBSERVATIONS = {
    "used": 0,
    "rejected": 0,
    "bins_used": 0,
    "mean_currents": 0,
    "bins_rejected": {},
}
_NO_RMS = dict.fromkeys(("before", "after", "prior"))


@dataclass(frozen=True, slots=True, repr=False)
class Outcome:
    """Outcome of a replay. Mappings are those of ``--json``; undefined figures are None.

    Attributes:
        observations: Profiles and mean currents used and rejected, bins used, and bins rejected by reason.
        rms_innovation: RMS component of measured minus estimated ``before`` and ``after`` each update, and against the ``prior`` [m/s].
        nis_per_dof: Mean normalised innovation squared per degree of freedom.
        by_dive: One row for each dive; empty for a surface vessel.
        plan: The last plan; of one that failed its message; None without a plan.
        consistency: Contradictions in the inputs.
        messages: One row for each topic; None where the result does not hold the counts.
        losses: Damage in the logs.
        late: Messages that came later than the reorder window allows.
        surfacings: Surfacings that plans predicted, beside the actual ones.
        expected_surfacings: Ends of dives predicted from the dives before, beside the actual ones, and the next one.
        evidence: Log evidence of the measurements; None where the estimator states no density.
        referee: How other forecasts explained the log.
        flight_correction: What was taken from mean currents for the flight model's error.
        notes: What the user should know.
        lost_pings: Which pings were not used, when they are many and a setting would keep them; empty otherwise.
        doubts: What the measurements cannot tell.
        outside: Why the forecast is not of this place or time.
        vehicles: The outcome of each vehicle as JSON, by its name, where several share the estimate; the other figures are then of all.
        value: What each vehicle gives to the estimate, by its name; see ``ReplaySummary``.
        unused: Vehicles that gave nothing to the estimate, and why.
        exit_codes: All that apply, the one that the run ends with first; empty where it is 0.
        error: Why the run failed; empty otherwise.
        complete: Whether the run ended: False for a result of which only tables are known.
        seconds: Wall time of each stage; of the run that has just ended alone.
        truth: Score against a truth; of the run that has just ended alone.
    """

    observations: Values = field(default_factory=lambda: _NO_OBSERVATIONS)
    rms_innovation: Values = field(default_factory=lambda: _NO_RMS)
    nis_per_dof: float | None = None
    by_dive: Sequence[Values] = ()
    plan: Values | None = None
    consistency: Sequence[Values] = ()
    messages: Sequence[Values] | None = None
    losses: Sequence[Values] = ()
    late: int = 0
    surfacings: Values | None = None
    expected_surfacings: Values | None = None
    evidence: Values | None = None
    referee: Values | None = None
    flight_correction: Values | None = None
    notes: Sequence[str] = ()
    lost_pings: str = ""
    doubts: Sequence[str] = ()
    outside: Sequence[str] = ()
    vehicles: Mapping[str, Values] = field(default_factory=dict)
    value: Mapping[str, Values] = field(default_factory=dict)
    unused: Mapping[str, str] = field(default_factory=dict)
    exit_codes: Sequence[int] = ()
    error: str = ""
    complete: bool = True
    seconds: Values = field(default_factory=dict, compare=False)
    truth: Values | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return how far to trust it, and the sentences of its verdict, each a line."""
        return "\n".join((str(self.decision), *self.verdict))

    @property
    def exit_code(self) -> int:
        """The first of ``exit_codes``, else 0."""
        return next(iter(self.exit_codes), 0)

    @property
    def alarms(self) -> tuple[RunAlarm, ...]:
        """What should wake a person, the plan first."""
        return run_alarms(self.plan, self.consistency)

    @property
    def plan_alarm(self) -> RunAlarm | None:
        """What is wrong with the plan; None where nothing is, or without a plan."""
        return plan_alarm(self.plan)

    @property
    def decision(self) -> Decision:
        """How far to trust the estimate and the plans, and why not further."""
        return decide(self)

    @property
    def verdict(self) -> tuple[str, ...]:
        """Share of the observations used, consistency, errors before and after, how far to trust the estimate; each a sentence."""
        return verdict_sentences(self)

    def to_json(self) -> dict[str, Any]:
        """Return it as the JSON object of ``--json``: its attributes, and what follows from them."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        values = {name: values[name] for name in values if name not in ("error", "complete")}
        made = {
            "status": "failed" if self.error else _STATUS[self.exit_code],
            **({"error": self.error} if self.error else {}),
            "exit_code": self.exit_code,
            "decision": self.decision.word,
            "reasons": list(self.decision.reasons),
            "alarms": [{"kind": one.kind, "text": one.text} for one in self.alarms],
            "verdict": list(self.verdict),
        }
        if not self.vehicles:
            values = {name: values[name] for name in values if name not in _OF_SEVERAL}
        return made | {name: _listed(value) for name, value in values.items()}

    def to_record(self) -> dict[str, Any]:
        """Return what a result keeps of it: ``to_json`` without wall times, the score, and what follows from the rest."""
        derived = ("seconds", "truth", "alarms", "decision", "reasons", "vehicles")
        return {name: value for name, value in self.to_json().items() if name not in derived}


def outcome_from(record: Values) -> Outcome:
    """Return the outcome that a result keeps; of an earlier version as much of it as it kept.

    Args:
        record: As ``Outcome.to_record`` returned it.
    """
    known = {one.name for one in fields(Outcome)}
    values = {name: value for name, value in record.items() if name in known}
    if "doubts" not in record:
        # kept among the sentences of the verdict, after those on use, consistency and gain
        told = record.get("verdict", ())[3:]
        values["doubts"] = [text for text in told if "per degree of freedom" not in text]
    return Outcome(**values)


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
