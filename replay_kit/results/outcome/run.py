"""What a run has counted, estimated and planned when it ends: the values of which its outcome is made."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.errors import Finding
from replay_kit.core.evidence import Evidence
from replay_kit.core.message import Loss
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import DiveForecast, DiveOutcome, SurfacingOutcome


@dataclass(frozen=True, slots=True)
class TopicRow:
    """Messages of one topic.

    Attributes:
        topic: Its name.
        read: Number read.
        used: Number from which an observation or a position was made.
        skipped: Number of the others.
        reasons: Number skipped, by reason.
    """

    topic: str
    read: int
    used: int
    skipped: int
    reasons: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class DiveRow:
    """Profiles of one dive compared with their predictions.

    Attributes:
        dive: The dive's number.
        profiles: Profiles used.
        bins: Bins used.
        rms_innovation_predicted: RMS component of measured minus predicted from all dives before [m/s].
        rms_innovation_prior: RMS component of measured minus predicted from the prior forecast [m/s].
        nis_per_dof: Normalised innovation squared per degree of freedom, as updated profile by profile.
    """

    dive: int
    profiles: int
    bins: int
    rms_innovation_predicted: float
    rms_innovation_prior: float
    nis_per_dof: float


@dataclass(frozen=True, slots=True)
class SourceRow:
    """Measurements of one source beside the vehicle's own.

    Attributes:
        kind: ``shear``, ``radar``, ``drifters`` or ``sensors``.
        used: Number used.
        rejected: Number without a usable value, or rejected by the gate.
        values: Number of values used.
        rms_before: RMS component of measured minus estimated before each update [m/s].
        rms_after: After it [m/s].
        rms_prior: Of measured minus the prior forecast [m/s].
        nis_per_dof: Normalised innovation squared per value.
        doubts: What may be wrong with them, as sentences.
    """

    kind: str
    used: int
    rejected: int
    values: int
    rms_before: float
    rms_after: float
    rms_prior: float
    nis_per_dof: float
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TruthScore:
    """Errors of the estimate against a known truth.

    Attributes:
        rmse: RMS length of the error vector over the wet grid points scored [m/s].
        rel_error: ``rmse`` over the truth's RMS speed there.
        ensemble_mean_rmse: The same as ``rmse`` for the ensemble's mean [m/s].
        points: Grid points scored.
        closest_approach_m: Of the plan, flown in the truth; NaN without a goal.
        ensemble_mean_closest_approach_m: Of the plan made on the ensemble's mean, flown in the truth.
    """

    rmse: float
    rel_error: float
    ensemble_mean_rmse: float
    points: int
    closest_approach_m: float
    ensemble_mean_closest_approach_m: float


@dataclass(frozen=True, slots=True)
class Rival:
    """Another forecast that explained the same log.

    Attributes:
        name: Of its file.
        evidence: Of the log under it.
    """

    name: str
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class ReplaySummary:
    """Results of a replay apart from its output files.

    Attributes:
        messages: One row for each topic.
        losses: Damage in the logs, with the log's path.
        late: Number of messages that came later than the reorder window allows.
        profiles_used: Profiles the estimate was updated with.
        profiles_rejected: Profiles without a usable bin.
        bins_used: Bins used.
        bins_rejected: Number of bins not used, by reason; a bin can have several.
        rms_before: RMS component of the innovations [m/s].
        rms_after: RMS component of the residuals after each update [m/s].
        rms_prior: RMS component of measured minus predicted from the prior forecast [m/s].
        nis_per_dof: Mean normalised innovation squared per degree of freedom.
        by_dive: One row for each dive; empty for a surface vessel.
        seconds: Wall time of each stage.
        plan: The last plan.
        plan_note: Why there is no plan although a goal was given; empty otherwise.
        outcomes: Predicted surfacings with the actual ones.
        surfacings: Ends of dives that were expected from the dives before, with the actual ones.
        evidence: Log evidence of the measurements; None where the estimator states no density.
        ensemble: Name of the forecast's file, where it is compared with others.
        rivals: The log evidence under other forecasts.
        next_surfacing: The coming one, if the vehicle flies as in its last dive; None without a dive.
        truth: Score against a truth, if one was given.
        notes: What the user should know.
        findings: Contradictions in the inputs.
        doubts: What the measurements cannot tell.
        outside: Why the forecast is not of this place or time.
        lost_pings: Which pings were not used, when they are many and a setting would keep them; empty otherwise.
        mean_currents: Mean currents among the profiles used: each counts as one profile of one bin.
        flight_correction: What was taken from mean currents for the flight model's error; None where nothing was.
        sources: One row for each source beside the vehicle's own measurements; they are among the profiles used.
        inputs: Logs and forecasts, which the outcome names without their folders.
        vehicles: Those of each vehicle by its name, where several share the estimate; the other figures are then of all together.
        value: Of each vehicle: ``measurements`` it gave, RMS change of the estimate at the published depths without them
            (``rms_change``), and its standard error there with and without them [m/s] (data denial).
        unused: Vehicles that gave nothing to the estimate, and why.
    """

    messages: tuple[TopicRow, ...]
    losses: tuple[tuple[str, Loss], ...]
    late: int
    profiles_used: int
    profiles_rejected: int
    bins_used: int
    bins_rejected: Mapping[str, int]
    rms_before: float
    rms_after: float
    rms_prior: float
    nis_per_dof: float
    by_dive: tuple[DiveRow, ...]
    seconds: Mapping[str, float] = field(default_factory=dict)
    plan: Plan | None = None
    plan_note: str = ""
    outcomes: tuple[SurfacingOutcome, ...] = ()
    surfacings: tuple[DiveOutcome, ...] = ()
    next_surfacing: DiveForecast | None = None
    evidence: Evidence | None = None
    ensemble: str = ""
    rivals: tuple[Rival, ...] = ()
    truth: TruthScore | None = None
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    doubts: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    lost_pings: str = ""
    mean_currents: int = 0
    flight_correction: FlightCorrection | None = None
    sources: tuple[SourceRow, ...] = ()
    inputs: tuple[Path, ...] = ()
    vehicles: Mapping[str, "ReplaySummary"] = field(default_factory=dict)
    value: Mapping[str, Mapping[str, float | int | None]] = field(default_factory=dict)
    unused: Mapping[str, str] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """The first of ``exit_codes``, else 0."""
        return next(iter(self.exit_codes), 0)

    @property
    def exit_codes(self) -> tuple[int, ...]:
        """All that apply: 4 when bytes, frames or late messages were lost, 6 when the inputs contradict each other or themselves."""
        each = (self, *self.vehicles.values())
        lost, contradicted = (
            self.losses or self.late or self.unused,
            any(finding.severity != "warning" for one in each for finding in one.findings),
        )
        return (4,) * bool(lost) + (6,) * contradicted
