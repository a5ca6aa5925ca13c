"""The outcome of a replay: one frozen value, made when the run ends, kept in its result and read back as the same.

Everything that is shown of a run (its summary, ``--json``, status, report, the table of a fleet, alarms) formats this value.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_json

from replay_kit.core.errors import ReplayKitError, finding_json
from replay_kit.results.outcome.verdict import (
    RunAlarm,
    Verdict,
    basis_sentences,
    decide,
    errors_text,
    plan_alarm,
    run_alarms,
)

_STATUS = {0: "done", 4: "loss", 6: "inconsistent"}
Values = Mapping[str, Any]
# Of a run of several vehicles alone.
_OF_SEVERAL = ("vehicles", "value", "unused")
# Of the run that has just ended alone: no result has the same bytes with them.
_OF_RUN = ("seconds", "truth")
# Names of attributes in results of version 0.3.
_EARLIER = {"expected_surfacings": "predicted_surfacings", "referee": "comparison"}
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
        predicted_surfacings: Ends of dives predicted from the dives before, beside the actual ones, and the next one.
        evidence: Log evidence of the measurements; None where the estimator states no density.
        comparison: How other forecasts explained the log.
        flight_correction: What was taken from mean currents for the flight model's error.
        notes: What the user should know.
        lost_pings: Which pings were not used, when they are many and a setting would keep them; empty otherwise.
        doubts: What the measurements cannot tell.
        outside: Why the forecast is not of this place or time.
        vehicles: The outcome of each vehicle by its name, where several share the estimate; the other figures are then of all.
        value: Of each vehicle, by its name: ``measurements`` it gave, RMS change of the estimate at the published depths without them
            (``rms_change``), and its standard error there with and without them [m/s] (data denial).
        unused: Vehicles that gave nothing to the estimate, and why.
        exit_codes: All that apply, the one that the run ends with first; empty where it is 0.
        error: Why the run failed; empty otherwise.
        mission: Vehicle and mission as the logs name them; empty where they do not.
        complete: Whether the run ended: False for a result of which only tables are known.
        seconds: Wall time of each stage; of the run that has just ended alone.
        truth: Score against a truth; of the run that has just ended alone.
    """

    observations: Values = field(default_factory=lambda: _NO_OBSERVATIONS)
    rms_innovation: Values = field(default_factory=lambda: _NO_RMS)
    nis_per_dof: float | None = None
    by_dive: tuple[Values, ...] = ()
    plan: Values | None = None
    consistency: tuple[Values, ...] = ()
    messages: tuple[Values, ...] | None = None
    losses: tuple[Values, ...] = ()
    late: int = 0
    surfacings: Values | None = None
    predicted_surfacings: Values | None = None
    evidence: Values | None = None
    comparison: Values | None = None
    flight_correction: Values | None = None
    notes: tuple[str, ...] = ()
    lost_pings: str = ""
    doubts: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    vehicles: Mapping[str, "Outcome"] = field(default_factory=dict)
    value: Mapping[str, Values] = field(default_factory=dict)
    unused: Mapping[str, str] = field(default_factory=dict)
    exit_codes: tuple[int, ...] = ()
    error: str = ""
    mission: str = ""
    complete: bool = True
    seconds: Values = field(default_factory=dict, compare=False)
    truth: Values | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return how far to trust it, and the sentences of its verdict, each a line."""
        return "\n".join((str(self.verdict), *self.basis))

    @property
    def exit_code(self) -> int:
        """The first of ``exit_codes``, else 0."""
        return next(iter(self.exit_codes), 0)

    @property
    def alarms(self) -> tuple[RunAlarm, ...]:
        """Alarms, the plan's first."""
        return run_alarms(self.plan, self.consistency)

    @property
    def plan_alarm(self) -> RunAlarm | None:
        """What is wrong with the plan; None where nothing is, or without a plan."""
        return plan_alarm(self.plan)

    @property
    def verdict(self) -> Verdict:
        """How far to trust the estimate and the plans, and why not further."""
        return decide(self)

    @property
    def basis(self) -> tuple[str, ...]:
        """What the verdict rests on: observations used, consistency, misfit, whether the stated errors hold; each a sentence."""
        return basis_sentences(self)

    @property
    def errors_text(self) -> str:
        """Whether the stated errors hold, in a few words; empty without observations."""
        return errors_text(self)

    def to_json(self) -> dict[str, Any]:
        """Return it as the JSON object of ``--json``: its attributes, and what follows from them."""
        left = ("error", "complete", *(() if self.vehicles else _OF_SEVERAL))
        values: dict[str, Any] = _codec().dump_python(self, mode="json", exclude={*left})
        if self.vehicles:
            values["vehicles"] = {name: one.to_json() for name, one in self.vehicles.items()}
        return {
            "status": "failed" if self.error else _STATUS[self.exit_code],
            **({"error": self.error} if self.error else {}),
            "exit_code": self.exit_code,
            "verdict": self.verdict.word,
            "reasons": list(self.verdict.reasons),
            "alarms": [{"kind": one.kind, "text": one.text} for one in self.alarms],
            "basis": list(self.basis),
        } | values

    def to_record(self) -> bytes:
        """Return what a result keeps of it: its attributes as JSON, without wall times and the score against a truth."""
        return _codec().dump_json(self, exclude={*_OF_RUN}, indent=1) + b"\n"


@cache
def _codec() -> TypeAdapter[Outcome]:
    return TypeAdapter(Outcome)


def made(values: Values, inputs: Iterable[Path] = ()) -> Outcome:
    """Return the outcome with some values: numbers that are not finite are None, and its exit codes follow from the others.

    Args:
        values: Attributes by name, of anything that JSON has a form for.
        inputs: Files that texts name without their folders, which change no byte of a result.
    """
    text = to_json(values, inf_nan_mode="null", fallback=lambda number: number.item())
    for path in inputs:
        text = text.replace(to_json(str(path))[1:-1], to_json(path.name)[1:-1])
    return _with_codes(_codec().validate_json(text))


def outcome_from(record: Values) -> Outcome:
    """Return the outcome of a record or of a JSON object, what else these hold left out; of an earlier version as much as it kept."""
    if "doubts" not in record:
        # kept among the sentences of the verdict, after those on use, consistency and gain
        told = record.get("verdict", ())[3:]
        doubts = [text for text in told if "per degree of freedom" not in text]
        record = {**record, "doubts": doubts}
    named = {_EARLIER.get(name, name): value for name, value in record.items()}
    return _codec().validate_python(named)


def failed(error: ReplayKitError, so_far: Outcome | None = None) -> Outcome:
    """Return the outcome of a run that ended with an error.

    Args:
        error: What ended it.
        so_far: What it had found; None when it had not begun.
    """
    found = tuple(finding_json(one) for one in error.findings)
    ended = _with_codes(replace(so_far or Outcome(), consistency=found))
    codes = (error.exit_code, *(ended.exit_codes if so_far else ()))
    return replace(ended, exit_codes=codes, error=str(error), complete=False)


def _with_codes(outcome: Outcome) -> Outcome:
    """Return an outcome with 4 when bytes, frames or late messages were lost, and 6 when inputs contradict each other or themselves."""
    each = (outcome, *outcome.vehicles.values())
    lost = outcome.losses or outcome.late or outcome.unused
    found = any(one["severity"] != "warning" for of in each for one in of.consistency)
    return replace(outcome, exit_codes=(4,) * bool(lost) + (6,) * found)
