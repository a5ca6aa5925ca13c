"""Consistency stage: events are checked before use, findings change the input of the estimate, and DACs check the forecast's file.

The file is checked by the joint density of DACs under the prior, as it is and with each fault undone. The prior gives the means p of the
currents along dive paths and their covariance C; R is the observation-error covariance. A file with currents M f in place of f gives means
M p and covariance M C M'. The densities N(M p, M C M' + R) of the DACs compare the faults. C accounts for dives in one eddy; for a forecast
without skill no fault is found or excluded.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array, replace
from replay_kit.core.errors import Finding, ForecastError, MeasurementError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import PathMean
from replay_kit.core.observation.table import POSITION, Block, Integers
from replay_kit.estimator import ReducedBasisEstimator
from replay_kit.estimator.update.screening import screened
from replay_kit.measurements.checks import causes as findings
from replay_kit.measurements.checks.causes import SCALE
from replay_kit.measurements.checks.check import Checked, check, unknowable
from replay_kit.measurements.checks.likelihood import LEAST_GAIN
from replay_kit.measurements.checks.place import FROZEN, REPEATED, LogTracks
from replay_kit.measurements.checks.profile import (
    ENSEMBLE,
    UNIT,
    EnsembleSpeeds,
    ensemble_contradicts,
    ensemble_speeds,
    odd_ensemble_speeds,
)
from replay_kit.measurements.checks.slips import slips
from replay_kit.measurements.means import TOO_FAST
from replay_kit.measurements.track.reach import COLUMNS, THROWN
from replay_kit.workflows.replay.steps import Counts, Dive, Step, Sums, assimilate

_UNDETERMINED = (
    "nothing here can tell whether directions are right; profiles beside mean currents that they were not computed from, or a bottom track "
    "would"
)
_SHEAR_ALONE = "all profiles are relative to the platform, and give the shear only"
# Observations before which nothing is said of the forecast.
_LEAST_OBSERVATIONS = 3
# Rejected measurements of one source, and positions out of reach, before which nothing is said.
_LEAST_REJECTED = 5
# Values of another source, and their normalised innovation squared, before they are said not to fit.
_LEAST_VALUES, _MOST_NIS = 20, 3.0
# Measurements beyond the gate that are remembered.
_MOST_GATED = 256
# Dives before which nothing is said of the file, and those that are compared at most, evenly spread.
_LEAST_DIVES, _MOST_DIVES = 8, 40
# Logarithm of the likelihood ratio of a fault below which it is excluded; faults whose gains differ by less are named together.
_EXCLUDED, _ALIKE = -3.0, 3.0

#: Findings, and sentences on what cannot be known.
Concluded = tuple[tuple[Finding, ...], tuple[str, ...]]
#: What was found with an event, each with whether two sources of the current contradict each other since.
FoundWith = Sequence[tuple[Finding, bool]]


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
        left_out: Whether this vehicle of several is excluded.
    """

    checks: Checked = field(default_factory=Checked)
    findings: tuple[Finding, ...] = ()
    contradict: bool = False
    means: tuple[PathMean, ...] = ()
    gated: tuple[Any, ...] = ()
    tracks: LogTracks = field(default_factory=LogTracks)
    left_out: bool = False

    @property
    def explains_no_profile(self) -> bool:
        """Whether a finding can explain that no profile is used: such a run has a result, the estimate without profiles."""
        of_positions = (FROZEN, REPEATED) if self.checks.pings[0] > 0 else ()
        return any(one.distrusts or one.name in of_positions for one in self.findings)


def checked_block(
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
    settings, found = config.measurements, dict[int, FoundWith]()
    through_water = settings.dead_reckoning == "through_water"
    checks, block, new = check(state.checks, block, speeds, through_water)
    for event, finding, contradict in new:
        # a run survives a contradiction of the unit that the log states
        if finding.name == UNIT and settings.velocity_unit is not None:
            finding = replace(finding, severity="inconsistent")
        found[event] = (*found.get(event, ()), (finding, contradict))
    return replace(state, checks=checks), block, found


def with_tracks(state: MonitoringState, block: Block, events: Integers) -> MonitoringState:
    """Return the state with the positions among some events of a block, rows as in ``Block.events``."""
    rows = events[events[:, 1] == POSITION, 2]
    if not rows.size:
        return state
    positions = {name: block.position[name][rows] for name in COLUMNS}
    return replace(state, tracks=state.tracks.after(positions))


def with_findings(state: MonitoringState, found: FoundWith, config: RunConfig) -> MonitoringState:
    """Return the state with the findings of an event.

    Raises:
        MeasurementError: The log is unusable, or a contradiction is set to stop the run.
    """
    named = state.findings + tuple(finding for finding, _ in found)
    stops = ["unusable", *["inconsistent"] * (config.consistency.on_failure == "stop")]
    for finding, _ in found:
        if finding.severity in stops:
            raise MeasurementError(str(finding), named)
    return replace(state, findings=named, contradict=found[-1][1])


def require_one_vehicle(state: MonitoringState, names: Sequence[str]) -> None:
    """Raise MeasurementError if the logs of a run, by name, have the tracks of two vehicles."""
    if (found := state.tracks.two_vehicles) is not None:
        finding = findings.two_tracks(found, names)
        raise MeasurementError(str(finding), (*state.findings, finding))


def with_gated(state: MonitoringState, steps: Sequence[Step]) -> MonitoringState:
    """Return the state with the observations of some steps that the gate rejected."""
    gated = [
        step.event
        for step in steps
        if (innovation := step.innovation) is not None
        and innovation.gate_statistic > innovation.gate
        and not innovation.accepted
    ]
    return replace(state, gated=(*state.gated, *gated)[-_MOST_GATED:]) if gated else state


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
    # they belong to dives before this one
    given = [(0, event) for event in state.gated]
    after, _, steps = assimilate([estimator], current, [Dive(current)], given)
    before = counts.plus(Sums(rejected=-len(given), gated=-len(given)))
    return after, replace(state, gated=()), before.after([step for _, step in steps])


def checked_speeds(ensemble: Ensemble, config: RunConfig) -> EnsembleSpeeds | None:
    """Return the speeds of an ensemble; None if checks are off.

    Raises:
        ForecastError: The speeds are implausible for an ocean.
    """
    if config.consistency.on_failure == "ignore":
        return None
    if evidence := odd_ensemble_speeds(ensemble.velocity):
        wrong = findings.ensemble_unit(evidence=evidence, source=ensemble.source)
        raise ForecastError(str(wrong), (wrong,))
    return ensemble_speeds(ensemble.grid.levels, ensemble.velocity)


def left_out(state: MonitoringState, found: FoundWith) -> tuple[MonitoringState, FoundWith]:
    """Return state and findings of one of several vehicles, excluded because its sources contradict each other."""
    advice = "this vehicle is excluded, the estimate is rebuilt from the others; check both of its sources"
    return replace(state, left_out=True), [
        (replace(finding, distrusts=True, advice=advice), contradict)
        for finding, contradict in found
    ]


def conclusions(
    state: MonitoringState, counts: Counts, config: RunConfig, of_file: Concluded = ((), ())
) -> Concluded:
    """Return all findings of a run, and questions that its observations cannot decide.

    Args:
        state: State at the end of the run.
        counts: Counts of its messages and observations.
        config: Settings of the run.
        of_file: Check of the forecast's file by DACs.
    """
    if config.consistency.on_failure == "ignore":
        return (), ("no consistency check was made (consistency.on_failure)",)
    found, blind, messages = state.findings, list[str](), counts.messages
    fast = sum(count for (_, reason), count in messages.items() if reason == TOO_FAST)
    used = len(state.means)
    if fast > 2 * used and not any(finding.name == SCALE for finding in found):
        found += (findings.too_fast(reason=TOO_FAST, number=fast, total=fast + used),)
    thrown = {topic: n for (topic, reason), n in messages.items() if reason == THROWN}
    out, total = sum(thrown.values()), sum(messages.get((topic, ""), 0) for topic in thrown)
    if out >= _LEAST_REJECTED and 3 * out > total:
        found += (findings.mixed_tracks(thrown=out, total=out + total),)
    found = found or _preferred(counts)
    if not found:
        found, notes = of_file
        blind += notes
    found = found or tuple(
        findings.source_misfit(kind, sums.nis_per_dof, sums.dof)
        for kind, sums in counts.sources.items()
        if sums.dof >= _LEAST_VALUES and sums.nis_per_dof > _MOST_NIS
    )
    # faults of the log explain that it does not fit
    if all(finding.name in (ENSEMBLE, findings.FORECAST) for finding in found):
        of_forecast = _forecast_findings(counts.total, config.forecast.place)
        found += tuple(one for one in of_forecast if not found or one.name != ENSEMBLE)
    if not state.checks.can_tell_directions:
        blind.append(_UNDETERMINED)
    if state.checks.pings[0] and not state.checks.pings[1]:
        blind.append(_SHEAR_ALONE)
    return found, (*blind, *unknowable(state.checks))


def _preferred(counts: Counts) -> tuple[Finding, ...]:
    """Return a finding if the gate rejected most observations of one source in favour of another."""
    asked = {kind: n for kind, sums in counts.kinds.items() if (n := sums.profiles + sums.refused)}
    shares = {kind: counts.kinds[kind].refused / n for kind, n in asked.items()}
    for kind, share in shares.items():
        rejected = counts.kinds[kind].refused
        others = [other for other in shares if other != kind and shares[other] < 0.5]
        if rejected >= _LEAST_REJECTED and share > 0.5 and others:
            evidence = f"{rejected} of {asked[kind]} rejected"
            return (findings.preferred_source(kind, min(others, key=shares.__getitem__), evidence),)
    return ()


def _forecast_findings(sums: Sums, moved: bool) -> tuple[Finding, ...]:
    """Return a finding if two thirds of the observations exceed the gate: the forecast does not fit."""
    beyond, total = sums.gated, sums.profiles + sums.gated
    evidence = f"{beyond} of {total} observations exceeded the gate"
    if total >= _LEAST_OBSERVATIONS and 3 * beyond >= 2 * total:
        return (findings.forecast_misfit[moved](evidence=evidence),)
    many = 5 * beyond > total if beyond >= _LEAST_REJECTED else 2 * beyond >= total
    return (ensemble_contradicts(evidence),) if beyond and many else ()


def check_file(estimator: Any, means: Iterable[PathMean]) -> Concluded:
    """Return the check of a forecast's file by DACs: a warning, or a sentence on faults neither found nor excluded.

    Args:
        estimator: Estimator with the prior; the check is empty if that is not a single Gaussian of weights.
        means: DACs of dives.
    """
    has_prior = isinstance(estimator, ReducedBasisEstimator)
    dives = [*filter(estimator.usable, means)] if has_prior else []
    if len(dives) < _LEAST_DIVES:
        return (), ()
    dives = dives[:: math.ceil(len(dives) / _MOST_DIVES)]
    measured, predicted, covariance, variance = _under_prior(estimator, dives)
    as_is, _ = _density(measured, predicted, covariance, variance)
    gains = dict[str, float]()
    for name, matrix in slips().items():
        turn = np.kron(np.eye(len(dives)), matrix)
        density, misfit = _density(measured, turn @ predicted, turn @ covariance @ turn.T, variance)
        # of a forecast that is too sure of itself all gains count for less
        gains[name] = (density - as_is) / max(1.0, misfit)
    best = max(gains.values())
    if best >= LEAST_GAIN:
        likely = ", or ".join(name for name, gain in gains.items() if gain > best - _ALIKE)
        return (findings.forecast_fault(faults=likely, gain=best, dives=len(dives)),), ()
    left = sorted(name for name, gain in gains.items() if gain > _EXCLUDED)
    listed = ", ".join(f"{name} e^{gains[name]:z.0f}" for name in left)
    about = f"(likelihood ratios to none by {len(dives)} mean currents: {listed})"
    note = f"cannot be known here: some faults of the forecast's file {about}"
    return (), (note,) if left else ()


def _under_prior(
    estimator: ReducedBasisEstimator, dives: Sequence[PathMean]
) -> tuple[Array, Array, Array, Array]:
    """Return measured and predicted DACs, shape (2 k,) [m/s], the covariance of the prediction, and the observation-error variances."""
    columns = estimator.observer.columns(screened(dives, estimator.grid)[0])
    design = np.concatenate([column.design for column in columns])
    parts = [column.parts[0] for column in columns]
    innovation = np.concatenate([part.about[0].ravel() for part in parts])
    variance = np.repeat([part.layout.std[0] ** 2 for part in parts], 2)
    measured = np.concatenate([mean.used for mean in dives])
    return measured, measured - innovation, design @ design.T, variance


def _density(
    measured: Array, predicted: Array, covariance: Array, variance: Array
) -> tuple[float, float]:
    """Return the log density without the constant of 2 pi, and the normalised innovation squared per value."""
    lower = np.linalg.cholesky(covariance + np.diag(variance))
    nis = float(np.sum(solve_triangular(lower, measured - predicted, lower=True) ** 2))
    return -0.5 * nis - float(np.log(np.diag(lower)).sum()), nis / len(measured)
