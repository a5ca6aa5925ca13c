"""Checks of a log for usual faults: those of a replay, and the likelihood of its profiles under the ensemble.

The checks of a replay find contradictions within the log. The ensemble states the distribution of currents before any observation.
Under that Gaussian and the stated errors the profiles have a likelihood, as logged and with each fault undone. A fault that makes the
log far less likely is reported as a warning, since the ensemble may be wrong instead.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.errors import (
    Finding,
    ForecastError,
    MeasurementError,
    ReplayKitError,
    finding_json,
    finding_line,
)
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, Observation, Profiles, usable
from replay_kit.core.region import around
from replay_kit.estimator import ReducedBasisEstimator, build
from replay_kit.estimator.update.screening import screen
from replay_kit.logs import merge
from replay_kit.measurements.checks.check import Checked, check
from replay_kit.measurements.checks.instrument import DEAD
from replay_kit.measurements.checks.profile import (
    ENSEMBLE,
    REPAIRABLE,
    SURFACE,
    UNIT,
    EnsembleSpeeds,
    ensemble_speeds,
)
from replay_kit.measurements.checks.slips import (
    Fault,
    Sounding,
    declination_of,
    direction_faults,
)
from replay_kit.measurements.observed import blocks, rows
from replay_kit.workflows.replay.inputs.checks import check_inputs
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.scan import Logs, open_readers

# profiles examined, spread over the log: their joint covariance is one matrix
_MOST_PROFILES = 200
_LEAST_PROFILES = 3
# logarithm of the likelihood ratio from which a fault is named: sound twins stay below 7 (DECISIONS.md)
_LEAST_GAIN = 9.0
# of faults whose gains differ by less, both are named
_ALIKE = 3.0
# findings after which a comparison with the ensemble says nothing
_GROSS = {UNIT, SURFACE, DEAD}


@dataclass(frozen=True, slots=True)
class ImportCheck:
    """Result of the check of a mission's logs.

    Attributes:
        profiles: Number of profiles compared with the ensemble; 0 without a comparison.
        findings: Contradictions within the log, then warnings of contradictions with the ensemble, the likeliest fault first.
        undetermined: Faults that the profiles of a log without findings cannot exclude.
        note: Reason for a missing comparison, or its limits for this log; empty otherwise.
        refusal: Error that would end a replay of the logs; None if a replay is possible.
    """

    profiles: int
    findings: tuple[Finding, ...]
    undetermined: tuple[str, ...] = ()
    note: str = ""
    refusal: ReplayKitError | None = None


def check_logs(logs: Sequence[Path], ensemble: tuple[Path, ...], config: RunConfig) -> ImportCheck:
    """Return the check of a mission's logs: the checks of a replay, then those against an ensemble.

    Raises:
        LogError: A log cannot be opened.
        ConfigError: The settings do not permit a replay.
    """
    with threadpool_limits(limits=config.output.threads):
        try:
            forecast = _checked(logs, ensemble, config)
        except (ForecastError, MeasurementError) as error:
            unit = any(finding.name == UNIT for finding in error.findings)
            what = "the directions were" if unit else "the log was"
            return ImportCheck(
                0, error.findings, note=f"{what} not compared with the ensemble", refusal=error
            )
        settings, speeds = config.logs, ensemble_speeds(forecast.grid.levels, forecast.velocity)
        messages = merge(
            open_readers(logs, config), settings.reorder_window, settings.start_ns, settings.end_ns
        )
        found, state = soundings(messages, config.measurements, speeds)
        if any(finding.name in _GROSS for finding in state.findings):
            return ImportCheck(
                0, state.findings, note="the directions were not compared with the ensemble"
            )
        compared = check_import(found, build([forecast], config.estimator))
        return replace(compared, findings=state.findings + compared.findings)


def _checked(logs: Sequence[Path], ensemble: tuple[Path, ...], config: RunConfig) -> Ensemble:
    """Return the part of an ensemble around logs, after the checks of a replay; for arguments and errors see there."""
    forecasts = check_inputs(ReplayJob(tuple(logs), ensemble), config).forecasts
    if forecasts.read is None or forecasts.region is None:
        return forecasts.ensemble
    # a replay would read windows that follow the vehicle
    return forecasts.read(around(Logs([logs], config).places, forecasts.region.margin))


def soundings(
    messages: Iterable[Message], config: MeasurementConfig, speeds: EnsembleSpeeds | None = None
) -> tuple[list[Sounding], Checked]:
    """Return the profiles among messages, each with its stated declination, and the checks of a replay.

    Args:
        messages: Messages in order of time.
        config: Settings of observations.
        speeds: Speeds of the ensemble; None for no comparison.

    Raises:
        LogError: A log cannot be read.
    """
    found: list[Sounding] = []
    declinations: dict[tuple[int, str], float] = defaultdict(lambda: math.nan)
    state = Checked()

    def noted() -> Iterator[Message]:
        """Yield the messages, each after its declination is noted."""
        for message in messages:
            declination = declination_of(message)
            if math.isfinite(declination):
                declinations[message.input, message.topic] = declination
            yield message

    for block in blocks(noted(), config):
        state, block, _ = check(state, block, speeds, config.dead_reckoning == "through_water")
        for event in rows(block):
            if isinstance(event, Observation):
                stated = declinations[event.source.input, event.source.topic]
                found.append(Sounding(event, stated))
    return found, state


def check_import(found: Sequence[Sounding], estimator: ReducedBasisEstimator) -> ImportCheck:
    """Return the faults whose correction makes the log likelier under an ensemble, if any.

    Args:
        found: Profiles of the log.
        estimator: Estimator of the ensemble.
    """
    inside = [sounding for sounding in found if _usable(sounding.observation, estimator).size]
    if len(inside) < _LEAST_PROFILES:
        return ImportCheck(
            0, (), note=f"fewer than {_LEAST_PROFILES} profiles lie in the ensemble's water"
        )
    chosen = inside[:: math.ceil(len(inside) / _MOST_PROFILES)]
    widened = [_widened(sounding, estimator) for sounding in chosen]
    logged, _ = _likelihood(estimator, [sounding.observation for sounding in widened])
    trials = [
        (fault, *_likelihood(estimator, [fault.undo(sounding) for sounding in widened]))
        for fault in direction_faults(widened)
    ]
    # where the ensemble misfits the log even with the likeliest fault undone, all gains count for less in proportion
    _, _, misfit = max(trials, key=lambda trial: trial[1])
    gains = sorted(
        (((log - logged) / max(1.0, misfit), fault) for fault, log, _ in trials),
        key=lambda each: -each[0],
    )
    least = max(_LEAST_GAIN, gains[0][0] - _ALIKE)
    named = tuple(_warning(fault, gain) for gain, fault in gains if gain >= least)
    undetermined = () if named else tuple(f.name for gain, f in gains[::-1] if gain > -_LEAST_GAIN)
    return ImportCheck(min(len(inside), _MOST_PROFILES), named, undetermined, _blind_spot(inside))


def _warning(fault: Fault, gain: float) -> Finding:
    evidence = f"with this undone the profiles are e^{gain:.0f} times as likely under the ensemble"
    return Finding(ENSEMBLE, 0, evidence, fault.name, fault.advice, "warning")


def _blind_spot(chosen: Sequence[Sounding]) -> str:
    if any(math.isfinite(sounding.declination) for sounding in chosen):
        return ""
    return (
        "the log states no magnetic declination, so that a missing or doubled one was not examined"
    )


def _widened(sounding: Sounding, estimator: ReducedBasisEstimator) -> Sounding:
    """Return a profile with the estimator's inflated errors where its bins repeat each other."""
    observation = sounding.observation
    offered = _offered(observation, _usable(observation, estimator))
    _, (stepped,) = estimator.assimilate(estimator.initial(), [offered])
    factor = math.sqrt(stepped.innovation.error_inflation)
    return replace(
        sounding, observation=replace(observation, error_std=factor * observation.error_std)
    )


def _likelihood(
    estimator: ReducedBasisEstimator, profiles: Sequence[Observation]
) -> tuple[float, float]:
    """Return the log density of all profiles under the prior, and the normalised innovation squared per value."""
    trusting = replace(estimator, evidence=None, probability=None)
    offered = [_offered(profile, _usable(profile, estimator)) for profile in profiles]
    _, steps = trusting.assimilate(trusting.initial(), offered)
    # one bin relative to a platform of unknown velocity says nothing
    said = [step.innovation for step in steps if step.innovation.accepted]
    log, nis, dof = np.sum([(each.log_likelihood, each.nis, each.dof) for each in said], axis=0)
    return log, nis / dof


def _offered(observation: Observation, bins: NDArray[Any]) -> Observation:
    """Return a profile with the given bins good and all others failed."""
    flags = np.full(observation.depth.size, Flag.FAIL, np.int8)
    flags[bins] = Flag.GOOD
    return replace(observation, flags=flags)


def _usable(observation: Observation, estimator: ReducedBasisEstimator) -> NDArray[np.intp]:
    """Return the bins in the ensemble's water that are good, or bad only as a fault could have made them."""
    possible = (
        (usable(observation.flags) | ((observation.reasons & ~np.int32(REPAIRABLE)) == 0))
        & np.isfinite(observation.velocity).all(axis=1)
        & (observation.depth >= 0.0)
    )
    offered = Profiles.of([_offered(observation, possible)])
    (flags,), _ = screen(offered.columns, estimator.grid, relative=False)
    return np.flatnonzero(flags == Flag.GOOD)


def import_check_json(found: ImportCheck) -> dict[str, Any]:
    """Return the result of a check for JSON."""
    return {
        "profiles": found.profiles,
        "consistency": [finding_json(finding) for finding in found.findings],
        "undetermined": list(found.undetermined),
        "note": found.note,
        "refusal": None if found.refusal is None else str(found.refusal),
    }


def print_import_check(found: ImportCheck, console: Console) -> None:
    """Print the result of a check."""
    for finding in found.findings:
        console.print(finding_line(finding_json(finding), evidence=False))
    if found.profiles and not found.findings:
        console.print(f"Import check: {found.profiles} profiles look sound against the ensemble")
    if found.undetermined:
        either = ", or ".join(found.undetermined)
        console.print(f"Import check: the profiles do not determine whether {either}")
    if found.note:
        console.print(f"Import check: {found.note}")
