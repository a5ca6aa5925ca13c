"""Checks of a log for usual faults: those of a replay, and the likelihood of its profiles under the ensemble.

The checks of a replay find contradictions within the log. The ensemble states the distribution of currents before any observation.
Under that Gaussian and the stated errors the profiles have a likelihood, as logged and with each fault undone. A fault that makes the
log far less likely is reported as a warning, since the ensemble may be wrong instead.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import (
    Finding,
    ForecastError,
    MeasurementError,
    ReplayKitError,
    finding_json,
    finding_line,
)
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, Profiles, usable
from replay_kit.core.region import around
from replay_kit.estimator import ReducedBasisEstimator, build
from replay_kit.estimator.update.screening import screen
from replay_kit.measurements.checks.instrument import DEAD
from replay_kit.measurements.checks.profile import (
    ENSEMBLE,
    REPAIRABLE,
    SURFACE,
    UNIT,
)
from replay_kit.measurements.checks.slips import (
    Sounding,
    declination_of,
    direction_faults,
)
from replay_kit.workflows.replay.inputs.checks import check_inputs
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.scan import Logs

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
    found: list[Sounding] = []
    declinations: dict[tuple[int, str], float] = defaultdict(lambda: math.nan)

    def note(message: Message) -> None:
        if math.isfinite(declination := declination_of(message)):
            declinations[message.input, message.topic] = declination

    def keep(profile: Profiles, used: bool) -> None:
        source = profile.source
        found.append(Sounding(profile, declinations[source.input, source.topic]))

    with threadpool_limits(limits=config.output.threads):
        try:
            job = ReplayJob(tuple(logs), ensemble)
            forecasts, findings = check_inputs(job, config, on_message=note, on_profile=keep)
        except (ForecastError, MeasurementError) as error:
            unit = any(finding.name == UNIT for finding in error.findings)
            what = "the directions were" if unit else "the log was"
            return ImportCheck(
                0, error.findings, note=f"{what} not compared with the ensemble", refusal=error
            )
        if any(finding.name in _GROSS for finding in findings):
            return ImportCheck(
                0, findings, note="the directions were not compared with the ensemble"
            )
        forecast, region = forecasts.ensemble, forecasts.region
        if forecasts.read is not None and region is not None:
            # a replay would read windows that follow the vehicle
            forecast = forecasts.read(around(Logs([logs], config).reach.places, region.margin))
        compared = check_import(found, build([forecast], config.estimator))
        return replace(compared, findings=findings + compared.findings)


def check_import(found: Sequence[Sounding], estimator: ReducedBasisEstimator) -> ImportCheck:
    """Return the faults whose correction makes the log likelier under an ensemble, if any.

    Args:
        found: Profiles of the log.
        estimator: Estimator of the ensemble.
    """
    inside = [one for one in found if usable(_offered(one.profile, estimator)["flags"]).any()]
    if len(inside) < _LEAST_PROFILES:
        return ImportCheck(
            0, (), note=f"fewer than {_LEAST_PROFILES} profiles lie in the ensemble's water"
        )
    chosen = inside[:: math.ceil(len(inside) / _MOST_PROFILES)]
    widened = [_widened(sounding, estimator) for sounding in chosen]
    logged, _ = _likelihood(estimator, [sounding.profile for sounding in widened])
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
    likely = "with this undone the profiles are e^{:.0f} times as likely under the ensemble"
    named = tuple(
        Finding(ENSEMBLE, 0, likely.format(gain), fault.name, fault.advice, "warning")
        for gain, fault in gains
        if gain >= least
    )
    undetermined = () if named else tuple(f.name for gain, f in gains[::-1] if gain > -_LEAST_GAIN)
    note = (
        "the log states no magnetic declination, so that a missing or doubled one was not examined"
    )
    stated = any(math.isfinite(sounding.declination) for sounding in inside)
    used = min(len(inside), _MOST_PROFILES)
    return ImportCheck(used, named, undetermined, "" if stated else note)


def _widened(sounding: Sounding, estimator: ReducedBasisEstimator) -> Sounding:
    """Return a profile with the estimator's inflated errors where its bins repeat each other."""
    profile = sounding.profile
    _, (stepped,) = estimator.assimilate(estimator.initial(), [_offered(profile, estimator)])
    factor = math.sqrt(stepped.innovation.error_inflation)
    return replace(sounding, profile=profile.changed(error_std=factor * profile["error_std"]))


def _likelihood(
    estimator: ReducedBasisEstimator, profiles: Sequence[Profiles]
) -> tuple[float, float]:
    """Return the log density of all profiles under the prior, and the normalised innovation squared per value."""
    trusting = replace(estimator, evidence=None, probability=None)
    offered = [_offered(profile, estimator) for profile in profiles]
    _, steps = trusting.assimilate(trusting.initial(), offered)
    # one bin relative to a platform of unknown velocity says nothing
    said = [step.innovation for step in steps if step.innovation.accepted]
    log, nis, dof = np.sum([(each.log_likelihood, each.nis, each.dof) for each in said], axis=0)
    return log, nis / dof


def _offered(profile: Profiles, estimator: ReducedBasisEstimator) -> Profiles:
    """Return a profile whose bins in the ensemble's water are good, or bad only as a fault could have made them; others failed."""
    possible = (
        (usable(profile["flags"]) | ((profile["reasons"] & ~np.int32(REPAIRABLE)) == 0))
        & np.isfinite(profile["velocity"]).all(axis=2)
        & (profile["depth"] >= 0.0)
    )
    offered = _with_good(profile, possible)
    flags, _ = screen(offered.columns, estimator.grid, relative=False)
    return _with_good(offered, flags == Flag.GOOD)


def _with_good(profile: Profiles, good: NDArray[np.bool_]) -> Profiles:
    """Return a profile with some bins good, shape (1, m), and all others failed."""
    return profile.changed(flags=np.where(good, Flag.GOOD, Flag.FAIL).astype(np.int8))


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
