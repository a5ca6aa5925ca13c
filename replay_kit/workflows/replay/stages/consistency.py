"""Consistency stage: events are checked before use, and findings change the input of the estimate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import replace
from replay_kit.core.errors import Finding, ForecastError, MeasurementError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import PathMean, kind_of
from replay_kit.core.observation.block import POSITION, Block
from replay_kit.core.observation.table import Integers
from replay_kit.measurements.checks import concluded as findings
from replay_kit.measurements.checks.causes import SCALE
from replay_kit.measurements.checks.check import Checked, check, unknowable
from replay_kit.measurements.checks.place import FROZEN, REPEATED, LogTracks
from replay_kit.measurements.checks.profile import (
    ENSEMBLE,
    UNIT,
    EnsembleSpeeds,
    ensemble_contradicts,
    ensemble_speeds,
    odd_ensemble_speeds,
)
from replay_kit.measurements.means import TOO_FAST
from replay_kit.measurements.track.reach import COLUMNS, THROWN
from replay_kit.workflows.replay.stages.counts import Counts
from replay_kit.workflows.replay.stages.estimation import Dive, Step, assimilate
from replay_kit.workflows.replay.stages.forecast_file import FileCheck

_UNDETERMINED = (
    "nothing here can tell whether directions are right; profiles beside mean currents that they were not computed from, or a bottom track "
    "would"
)
# Observations before which nothing is said of the forecast.
_LEAST_OBSERVATIONS = 3
# Rejected measurements of one source, and positions out of reach, before which nothing is said.
_LEAST_REJECTED = 5
# Values of another source, and their normalised innovation squared, before they are said not to fit.
_LEAST_VALUES, _MOST_NIS = 20, 3.0
# Measurements beyond the gate that are remembered.
_MOST_GATED = 256
_SHEAR_ALONE = "all profiles are relative to the platform, and give the shear only"


@dataclass(frozen=True, slots=True, eq=False)
class MonitoringState:
    """State of the consistency stage.

    Attributes:
        checks: Of the checks after the last block.
        findings: Findings up to the last event.
        contradict: Whether two sources of the current contradict each other, with neither known to be wrong.
        means: DACs so far, to rebuild an estimate without profiles.
        gated: Latest observations rejected by the gate, before a contradiction of two sources.
        tracks: Positions by log.
        decisions: Number of observations gated and rejected, by kind.
        left_out: Whether this vehicle of several is excluded.
    """

    checks: Checked = field(default_factory=Checked)
    findings: tuple[Finding, ...] = ()
    contradict: bool = False
    means: tuple[PathMean, ...] = ()
    gated: tuple[Any, ...] = ()
    tracks: LogTracks = field(default_factory=LogTracks)
    decisions: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    left_out: bool = False

    @property
    def explains_no_profile(self) -> bool:
        """Whether a finding can explain that no profile is used: such a run has a result, the estimate without profiles."""
        return any(
            finding.distrusts or (finding.name in (FROZEN, REPEATED) and self.checks.pings[0] > 0)
            for finding in self.findings
        )


#: What was found with an event, each with whether two sources of the current contradict each other since.
FoundWith = Sequence[tuple[Finding, bool]]


def checked(
    state: MonitoringState, block: Block, config: RunConfig, speeds: EnsembleSpeeds | None
) -> tuple[MonitoringState, Block, dict[int, FoundWith]]:
    """Return the state after the checks of a block, its usable form, and the findings by event.

    Args:
        state: State before the block.
        block: Measured block.
        config: The run's settings.
        speeds: Speeds of the ensemble.
    """
    if config.consistency.on_failure == "ignore":
        return state, block, {}
    through_water = config.measurements.dead_reckoning == "through_water"
    checks, block, new = check(state.checks, block, speeds, through_water)
    found: dict[int, FoundWith] = {}
    for event, finding, contradict in new:
        found[event] = (*found.get(event, ()), (_as_stated(finding, config), contradict))
    return replace(state, checks=checks), block, found


def tracked(state: MonitoringState, block: Block, events: Integers) -> MonitoringState:
    """Return the state with the positions among some events of a block, rows as in ``Block.events``."""
    rows = events[events[:, 1] == POSITION, 2]
    if not rows.size:
        return state
    positions = {name: block.position[name][rows] for name in COLUMNS}
    return replace(state, tracks=state.tracks.after(positions))


def noted(state: MonitoringState, found: FoundWith, config: RunConfig) -> MonitoringState:
    """Return the state with the findings of an event.

    Raises:
        MeasurementError: The log is unusable, or a contradiction is set to stop the run.
    """
    named = state.findings + tuple(finding for finding, _ in found)
    for finding, _ in found:
        stops = finding.severity == "inconsistent" and config.consistency.on_failure == "stop"
        if finding.severity == "unusable" or stops:
            raise MeasurementError(str(finding), named)
    return replace(state, findings=named, contradict=found[-1][1])


def require_one_vehicle(state: MonitoringState, names: Sequence[str]) -> None:
    """Raise MeasurementError if the logs of a run, by name, have the tracks of two vehicles."""
    if (found := state.tracks.two_vehicles) is not None:
        finding = findings.two_tracks(found, names)
        raise MeasurementError(str(finding), (*state.findings, finding))


def with_gated(state: MonitoringState, steps: Sequence[Step]) -> MonitoringState:
    """Return the state with the gate's decisions in some steps."""
    gated, decisions = [*state.gated], dict(state.decisions)
    for step in steps:
        if (found := step.innovation) is None:
            continue
        # Any: what has an innovation is a measurement
        event: Any = step.event
        if found.gate_statistic > found.gate and not found.accepted:
            gated.append(event)
        if found.decision != "unusable":
            asked, rejected = decisions.get(kind_of(event), (0, 0))
            again = rejected + found.profiles * (not found.accepted)
            decisions[kind_of(event)] = asked + found.profiles, again
    return replace(state, gated=tuple(gated[-_MOST_GATED:]), decisions=decisions)


def readmitted(
    estimator: Any, current: Any, state: MonitoringState, counts: Counts
) -> tuple[Any, MonitoringState, Counts]:
    """Return estimate, state and counts with formerly rejected observations, once two sources contradict each other.

    Args:
        estimator: Estimator whose gate rejects neither source.
        current: Estimator's state before.
        state: Stage state with the observations.
        counts: Counts of the run.
    """
    if not (state.contradict and state.gated):
        return current, state, counts
    given = [(0, event) for event in state.gated]
    # they belong to dives before this one
    after, _, steps = assimilate([estimator], current, [Dive(current)], given)
    again = len(state.gated)
    before = replace(counts, rejected=counts.rejected - again, gated=counts.gated - again)
    return after, replace(state, gated=()), before.after([step for _, step in steps])


def _as_stated(finding: Finding, config: RunConfig) -> Finding:
    """Return a finding on units as a contradiction that the run survives, if the log states its unit."""
    stated = finding.name == UNIT and config.measurements.velocity_unit is not None
    return replace(finding, severity="inconsistent") if stated else finding


def checked_speeds(ensemble: Ensemble, config: RunConfig) -> EnsembleSpeeds | None:
    """Return the speeds of an ensemble; None if checks are off.

    Raises:
        ForecastError: The speeds are implausible for an ocean.
    """
    if config.consistency.on_failure == "ignore":
        return None
    if evidence := odd_ensemble_speeds(ensemble.velocity):
        wrong = findings.ensemble_unit(evidence, ensemble.source)
        raise ForecastError(str(wrong), (wrong,))
    return ensemble_speeds(ensemble.grid.levels, ensemble.velocity)


def left_out(state: MonitoringState, found: FoundWith) -> tuple[MonitoringState, FoundWith]:
    """Return state and findings of one of several vehicles, excluded because its sources contradict each other."""
    advice = "this vehicle is excluded, the estimate is rebuilt from the others; check both of its sources"
    return replace(state, left_out=True), [
        (replace(finding, distrusts=True, advice=advice), contradict)
        for finding, contradict in found
    ]


def trusting(estimator: Any, state: MonitoringState) -> Any:
    """Return the estimator, with a gate that rejects neither source while two contradict each other."""
    if not state.contradict or getattr(estimator, "probability", None) is None:
        return estimator
    return replace(estimator, probability=None)


def conclusions(
    state: MonitoringState,
    counts: Counts,
    config: RunConfig,
    of_file: FileCheck = FileCheck(),  # noqa: B008 - a frozen value
) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Return all findings of a run, and questions that its observations cannot decide.

    Args:
        state: State at the end of the run.
        counts: Counts of its messages and observations.
        config: Settings of the run.
        of_file: Check of the forecast's file by DACs.
    """
    if config.consistency.on_failure == "ignore":
        return (), ("no consistency check was made (consistency.on_failure)",)
    found, blind = state.findings, []
    fast = sum(count for (_, reason), count in counts.skipped.items() if reason == TOO_FAST)
    used = len(state.means)
    if fast > 2 * used and not any(finding.name == SCALE for finding in found):
        found += (findings.too_fast(TOO_FAST, fast, fast + used),)
    thrown = {topic: n for (topic, reason), n in counts.skipped.items() if reason == THROWN}
    out, total = sum(thrown.values()), sum(counts.used.get(topic, 0) for topic in thrown)
    if out >= _LEAST_REJECTED and 3 * out > total:
        found += (findings.mixed_tracks(out, out + total),)
    if not found and (of_gate := _preferred(state)) is not None:
        found += (of_gate,)
    if not found:
        found += () if of_file.finding is None else (of_file.finding,)
        blind += [of_file.note] if of_file.note else []
    if not found:
        found += tuple(
            findings.source_misfit(kind, each.sums.nis_per_dof, each.sums.dof)
            for kind, each in counts.sources.items()
            if each.sums.dof >= _LEAST_VALUES and each.sums.nis_per_dof > _MOST_NIS
        )
    of_forecast = _of_forecast(counts, config.forecast.place)
    # faults of the log explain that it does not fit
    if all(finding.name in (ENSEMBLE, findings.FORECAST) for finding in found):
        found += tuple(finding for finding in of_forecast if not found or finding.name != ENSEMBLE)
    if not state.checks.can_tell_directions:
        blind.append(_UNDETERMINED)
    if state.checks.pings[0] and not state.checks.pings[1]:
        blind.append(_SHEAR_ALONE)
    return found, (*blind, *unknowable(state.checks))


def _preferred(state: MonitoringState) -> Finding | None:
    """Return a finding if the gate rejected most observations of one source in favour of another; None otherwise."""
    shares = {kind: rejected / asked for kind, (asked, rejected) in state.decisions.items()}
    for kind, (asked, rejected) in state.decisions.items():
        others = [other for other in shares if other != kind and shares[other] < 0.5]
        if rejected >= _LEAST_REJECTED and 2 * rejected > asked and others:
            evidence = f"{rejected} of {asked} rejected"
            return findings.preferred(kind, min(others, key=lambda other: shares[other]), evidence)
    return None


def _of_forecast(counts: Counts, moved: bool) -> tuple[Finding, ...]:
    """Return a finding if two thirds of the observations exceed the gate: the forecast does not fit."""
    beyond, total = counts.gated, counts.total.profiles + counts.gated
    evidence = f"{beyond} of {total} observations exceeded the gate"
    if total >= _LEAST_OBSERVATIONS and 3 * beyond >= 2 * total:
        return (findings.forecast_misfit(evidence, moved),)
    least = 0.2 if beyond >= _LEAST_REJECTED else 0.5
    return (ensemble_contradicts(evidence),) if beyond > least * total else ()
