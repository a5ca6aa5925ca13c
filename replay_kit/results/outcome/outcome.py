"""Outcome of a replay: a frozen value, made at the end of the run, stored in its result and read back equal.

Summary, ``--json``, status, report, fleet table and alarms format this value.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_json

from replay_kit.core.errors import ReplayKitError, finding_json
from replay_kit.results.outcome.verdict import (
    Alarm,
    Verdict,
    basis_sentences,
    decide,
    errors_text,
    finding_alarms,
    plan_alarm,
)

_STATUS = {0: "done", 4: "loss", 6: "inconsistent"}
Values = Mapping[str, Any]
# Of a run of several vehicles alone.
_OF_SEVERAL = ("vehicles", "unused")
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
        observations: Profiles and mean currents used and rejected, bins used, and bins excluded by reason.
        rms_innovation: RMS component of measured minus estimated ``before`` and ``after`` each update, and against the ``prior`` [m/s].
        nis_per_dof: Mean normalised innovation squared per degree of freedom.
        by_dive: One row per dive; empty for a surface vessel.
        plan: Last plan; its message if it failed; None without a plan.
        consistency: Findings on the inputs.
        messages: One row per topic; None if the result does not hold the counts.
        losses: Damage in the logs.
        late: Number of messages later than the reorder window allows.
        surfacings: Surfacings predicted by plans, with the actual ones.
        predicted_surfacings: Surfacings predicted from earlier dives, with the actual ones, and the next one.
        evidence: Log evidence of the measurements; None if the estimator gives no density.
        comparison: Comparison with other forecasts.
        flight_correction: Correction of mean currents for the flight-model error.
        notes: Notes for the user.
        lost_pings: Description of excluded pings, if they are many and a setting would keep them; else empty.
        doubts: Questions that the measurements cannot answer.
        outside: Reasons why the forecast is not of this region or time, or hardly covers the current.
        vehicles: Outcome of each vehicle by name, if several share the estimate; the other figures then cover all.
        unused: Vehicles without influence on the estimate, with the reason.
        exit_codes: All that apply, that of the run first; empty for 0.
        error: Reason of a failed run; else empty.
        mission: Vehicle and mission named in the logs; else empty.
        complete: Whether the run ended; False for a result with tables alone.
        seconds: Wall time of each stage; only of a run that has just ended.
        truth: Score against a truth; only of a run that has just ended.
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
    unused: Mapping[str, str] = field(default_factory=dict)
    exit_codes: tuple[int, ...] = ()
    error: str = ""
    mission: str = ""
    complete: bool = True
    seconds: Values = field(default_factory=dict, compare=False)
    truth: Values | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return the verdict and the sentences of its basis, one per line."""
        return "\n".join((str(self.verdict), *self.basis))

    @property
    def exit_code(self) -> int:
        """First of ``exit_codes``, else 0."""
        return next(iter(self.exit_codes), 0)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """Alarms, the plan's first."""
        of_plan = self.plan_alarm
        return (*((of_plan,) if of_plan else ()), *finding_alarms(self.consistency))

    @property
    def plan_alarm(self) -> Alarm | None:
        """Alarm of the plan; None without one."""
        return plan_alarm(self.plan)

    @property
    def verdict(self) -> Verdict:
        """Verdict on the estimate and the plans, with reasons."""
        return decide(self)

    @property
    def unjudged(self) -> str:
        """Reason for which there is no verdict; empty for a run that ended."""
        if self.complete:
            return ""
        if self.plan is not None and not self.error:
            return "this is a plan alone, without a log"
        return "the run did not finish, or an earlier version made the result"

    @property
    def basis(self) -> tuple[str, ...]:
        """Basis of the verdict as sentences: observations used, consistency, misfit, validity of the stated errors."""
        return basis_sentences(self)

    @property
    def errors_text(self) -> str:
        """Validity of the stated errors as text; empty without observations."""
        return errors_text(self)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of ``--json``: attributes and derived values."""
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
        """Return the record in a result: the attributes as JSON, without wall times and the score against a truth."""
        return _codec().dump_json(self, exclude={*_OF_RUN}, indent=1) + b"\n"


@cache
def _codec() -> TypeAdapter[Outcome]:
    return TypeAdapter(Outcome)


def checked_outcome(values: Values, inputs: Iterable[Path] = ()) -> Outcome:
    """Return the outcome of some values: numbers that are not finite become None, exit codes are derived.

    Args:
        values: Attributes by name, of any type with a JSON form.
        inputs: Files whose folders are removed from texts, so that a result does not depend on them.
    """
    text = to_json(values, inf_nan_mode="null", fallback=lambda number: number.item())
    for path in inputs:
        text = text.replace(to_json(str(path))[1:-1], to_json(path.name)[1:-1])
    return _with_codes(_codec().validate_json(text))


def outcome_from(record: Values) -> Outcome:
    """Return the outcome of a record or JSON object, ignoring other keys; earlier versions give what they kept."""
    if "doubts" not in record:
        # kept among the sentences of the verdict, after those on use, consistency and gain
        told = record.get("verdict", ())[3:]
        doubts = [text for text in told if "per degree of freedom" not in text]
        record = {**record, "doubts": doubts}
    named = {_EARLIER.get(name, name): value for name, value in record.items()}
    return _codec().validate_python(named)


def failed_outcome(error: ReplayKitError, so_far: Outcome | None = None) -> Outcome:
    """Return the outcome of a failed run.

    Args:
        error: Error that ended it.
        so_far: Outcome up to then; None if it had not begun.
    """
    found = tuple(finding_json(one) for one in error.findings)
    ended = _with_codes(replace(so_far or Outcome(), consistency=found))
    codes = (error.exit_code, *(ended.exit_codes if so_far else ()))
    return replace(ended, exit_codes=codes, error=str(error), complete=False)


def _with_codes(outcome: Outcome) -> Outcome:
    """Return an outcome with exit codes: 4 for lost bytes, frames or late messages, 6 for findings."""
    each = (outcome, *outcome.vehicles.values())
    lost = outcome.losses or outcome.late or outcome.unused
    found = any(one["severity"] != "warning" for vehicle in each for one in vehicle.consistency)
    return replace(outcome, exit_codes=(4,) * bool(lost) + (6,) * found)


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each single value of nested mappings and lists with its path, such as ``by_dive.0.bins``."""
    if isinstance(value, Mapping):
        items = list(value.items())
    elif isinstance(value, list):
        items = [(str(number), item) for number, item in enumerate(value)]
    else:
        yield path, value
        return
    for key, item in items:
        yield from leaves(item, f"{path}.{key}" if path else str(key))
