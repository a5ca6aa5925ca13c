"""The summary of a replay: one frozen value, as the tables and sentences printed at the end of a run."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from rich.console import Console

from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.errors import Finding, finding_line
from replay_kit.core.evidence import Evidence
from replay_kit.core.message import Loss
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import DiveForecast, DiveOutcome, Outcome
from replay_kit.results.alarms import plan_alarm
from replay_kit.results.evidence.summary import Rival, evidence_json, referee_json
from replay_kit.results.evidence.words import evidence_sentence, referee_sentences
from replay_kit.results.flight_correction import flight_correction_json, flight_correction_sentence
from replay_kit.results.losses import loss_words
from replay_kit.results.summary_plan import outcomes_sentence, plan_json, plan_sentence
from replay_kit.results.surfacings.summary import surfacings_json
from replay_kit.results.surfacings.words import surfacings_sentences
from replay_kit.results.text import folded, not_used_lines, print_lines, print_table
from replay_kit.results.verdict import verdict

# Dives that the summary names.
_WORST = 3


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
        rms_innovation_prior: RMS component of measured minus predicted from the ensemble alone [m/s].
        nis_per_dof: Normalised innovation squared per degree of freedom, as updated profile by profile.
    """

    dive: int
    profiles: int
    bins: int
    rms_innovation_predicted: float
    rms_innovation_prior: float
    nis_per_dof: float


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


@dataclass(frozen=True, slots=True, repr=False)
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
        rms_prior: RMS component of measured minus predicted from the ensemble alone [m/s].
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
        doubts: What the measurements cannot tell, and why the forecast may not fit.
        lost_pings: Which pings were not used, when they are many and a setting would keep them; empty otherwise.
        mean_currents: Mean currents among the profiles used: each counts as one profile of one bin.
        flight_correction: What was taken from mean currents for the flight model's error; None where nothing was.
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
    outcomes: tuple[Outcome, ...] = ()
    surfacings: tuple[DiveOutcome, ...] = ()
    next_surfacing: DiveForecast | None = None
    evidence: Evidence | None = None
    ensemble: str = ""
    rivals: tuple[Rival, ...] = ()
    truth: TruthScore | None = None
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    doubts: tuple[str, ...] = ()
    lost_pings: str = ""
    mean_currents: int = 0
    flight_correction: FlightCorrection | None = None

    def __repr__(self) -> str:
        """Return the sentences on the estimate."""
        return "\n".join(_estimate_sentences(self))

    @property
    def verdict(self) -> tuple[str, ...]:
        """Share of the observations used, consistency, errors before and after, how far to trust the estimate; each a sentence."""
        used, rms = (
            (self.profiles_used, self.profiles_rejected),
            (self.rms_before, self.rms_after, self.rms_prior),
        )
        return verdict(used, self.lost_pings, self.findings, rms, (self.nis_per_dof, self.doubts))

    @property
    def exit_code(self) -> int:
        """The first of ``exit_codes``, else 0."""
        return next(iter(self.exit_codes), 0)

    @property
    def exit_codes(self) -> tuple[int, ...]:
        """All that apply: 4 when bytes, frames or late messages were lost, 6 when the inputs contradict each other or themselves."""
        lost, contradicted = (
            self.losses or self.late,
            any(finding.severity != "warning" for finding in self.findings),
        )
        return (4,) * bool(lost) + (6,) * contradicted


def print_summary(summary: ReplaySummary, console: Console, verbose: bool = False) -> None:
    """Print the tables and sentences of the end of a replay.

    Args:
        summary: What is printed.
        console: Where to.
        verbose: Whether each topic and each dive has a row of its own.
    """
    bad_plan = plan_alarm(plan_json(summary.plan, summary.plan_note))
    print_lines(console, [f"ALARM: {bad_plan.text}"] if bad_plan else [])
    print_lines(
        console, [f"Verdict: {'; '.join(summary.verdict)}", *map(finding_line, summary.findings)]
    )
    rows = ((row.topic, str(row.read), str(row.used), str(row.skipped)) for row in summary.messages)
    print_table(console, "Messages", ("topic", "read", "used", "skipped"), folded(rows, verbose))
    print_lines(
        console, not_used_lines({row.topic: row.reasons for row in summary.messages}, verbose)
    )
    print_lines(console, _estimate_sentences(summary))
    if verbose and summary.by_dive:
        columns = (
            "dive",
            "profiles",
            "bins",
            "predicted from earlier dives",
            "predicted from the ensemble alone",
            "NIS/dof",
        )
        print_table(
            console, "RMS innovation by dive [cm/s]", columns, map(_dive_cells, summary.by_dive)
        )
    elif summary.by_dive:
        print_lines(console, [_dive_sentence(summary.by_dive)])
    print_lines(console, _further_sentences(summary))


def _dive_cells(row: DiveRow) -> tuple[str, ...]:
    rms = (
        f"{100.0 * value:.2f}" for value in (row.rms_innovation_predicted, row.rms_innovation_prior)
    )
    return str(row.dive), str(row.profiles), str(row.bins), *rms, f"{row.nis_per_dof:.2f}"


def _dive_sentence(dives: Sequence[DiveRow]) -> str:
    """Return how well dives were predicted, and the worst of them."""
    bins = sum(row.bins for row in dives)
    squares = (
        (row.bins * row.rms_innovation_predicted**2, row.bins * row.rms_innovation_prior**2)
        for row in dives
        if row.bins
    )
    predicted, prior = (
        _cm(math.sqrt(sum(part) / bins)) if bins else "none" for part in zip(*squares, strict=True)
    )
    worst = sorted(
        (row for row in dives if row.bins), key=lambda row: -row.rms_innovation_predicted
    )[:_WORST]
    named = ", ".join(f"{row.dive} ({_cm(row.rms_innovation_predicted)})" for row in worst)
    return (
        f"Dives: {len(dives)}; RMS innovation {predicted} predicted from earlier dives, {prior} from the ensemble alone; "
        f"worst: {named}; -v shows all"
    )


def _further_sentences(summary: ReplaySummary) -> Iterator[str]:
    """Yield plan, surfacings, truth, times, notes and losses, each as a sentence."""
    if summary.plan is not None:
        yield f"Plan: {plan_sentence(summary.plan)}"
    elif summary.plan_note:
        yield f"Plan: none; {summary.plan_note}"
    if summary.outcomes:
        yield f"Plan vs. actual surfacings: {outcomes_sentence(summary.outcomes)}"
    if summary.evidence is not None:
        yield f"Log evidence: {evidence_sentence(evidence_json(summary.evidence))}"
        if summary.rivals:
            yield from (
                f"Referee: {text}"
                for text in referee_sentences(
                    referee_json(summary.ensemble, summary.evidence, summary.rivals)
                )
            )
    if summary.surfacings:
        yield f"Predicted surfacings: {'; '.join(surfacings_sentences(surfacings_json(summary.surfacings, summary.next_surfacing)))}"
    if summary.truth is not None:
        yield from _truth_sentences(summary.truth)
    yield "Time: " + ", ".join(
        f"{stage} {seconds:.2f} s" for stage, seconds in summary.seconds.items()
    )
    yield from (f"Note: {note}" for note in summary.notes)
    yield from (f"LOST: {path}: {loss_words(loss)}" for path, loss in summary.losses)
    if summary.late:
        yield f"LOST: {summary.late} messages came later than the reorder window allows; widen logs.reorder_window"


def _estimate_sentences(summary: ReplaySummary) -> Iterator[str]:
    rejected = (
        ", ".join(f"{count} {name}" for name, count in summary.bins_rejected.items()) or "none"
    )
    means = summary.mean_currents
    profiles = f"{summary.profiles_used - means} profiles used ({summary.bins_used - means} bins)"
    currents = f"{means} mean {'current' if means == 1 else 'currents'} used"
    used = [
        *([profiles] if means < summary.profiles_used or not means else []),
        *([currents] if means else []),
    ]
    yield (
        f"Observations: {', '.join(used)}, {summary.profiles_rejected} rejected; bins not used: {rejected}"
    )
    yield (
        f"RMS innovation: {_cm(summary.rms_before)} before each update, {_cm(summary.rms_after)} after it, "
        f"{_cm(summary.rms_prior)} against the ensemble alone; NIS per degree of freedom {summary.nis_per_dof:.2f}"
    )
    if summary.flight_correction is not None:
        yield f"Flight model: {flight_correction_sentence(flight_correction_json(summary.flight_correction))}"


def _truth_sentences(truth: TruthScore) -> Iterator[str]:
    yield (
        f"Against the truth over {truth.points} grid points: RMSE {_cm(truth.rmse)} (relative error {truth.rel_error:.3f}); "
        f"ensemble mean {_cm(truth.ensemble_mean_rmse)}"
    )
    if math.isfinite(truth.closest_approach_m):
        yield (
            f"Flown in the truth, the plan passes {truth.closest_approach_m:.0f} m from the goal; "
            f"the ensemble mean's plan {truth.ensemble_mean_closest_approach_m:.0f} m"
        )


def _cm(value: float) -> str:
    return f"{100.0 * value:.2f} cm/s"
