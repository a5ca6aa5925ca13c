"""Checks of a replay's inputs without an estimate; they raise the errors of the replay.

They are the replay with an estimator that only screens observations; used by ``info``, ``replay --dry-run`` and ``fleet --dry-run``. A dry
run also estimates memory and time. ``info`` with an ensemble adds the likelihood of the log's profiles, as logged and with each usual fault
undone: under the ensemble's Gaussian and the stated errors. A fault that makes the log far less likely is a warning, since the ensemble
may be wrong instead.
"""

import math
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import (
    ConfigError,
    Finding,
    ForecastError,
    MeasurementError,
    ReplayKitError,
    finding_json,
    finding_line,
)
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, Measurement, Profiles, usable
from replay_kit.core.region import box_around, inside_box
from replay_kit.core.words.progress import silent
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import build as build_reduced
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.update.screening import Screened, columns_of, screen, screened
from replay_kit.measurements.checks.instrument import DEAD
from replay_kit.measurements.checks.profile import ENSEMBLE, REPAIRABLE, SURFACE, UNIT
from replay_kit.measurements.checks.slips import Sounding, declination_of, direction_faults
from replay_kit.workflows.replay.conclude import useless_of
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts, build
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.planner import PlannerFactory
from replay_kit.workflows.replay.inputs.prepare import prepare
from replay_kit.workflows.replay.inputs.scan import Logs


def _ignore(*_: Any) -> None: ...


def check_inputs(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None = None,
    on_message: Callable[[Message], None] = _ignore,
    on_profile: Callable[[Profiles, bool], None] = _ignore,
) -> tuple[Forecasts, tuple[Finding, ...]]:
    """Return the part of the forecast that a replay reads, and contradictions within the first vehicle's logs; reads all logs.

    Args:
        job: The replay.
        config: Settings of the replay.
        planner_of: Factory of the planner for a job with a goal; None leaves the goal unchecked.
        on_message: Called with each message, before the profiles that it completes.
        on_profile: Called with each profile after the checks, and whether it has a usable bin in the region.

    Raises:
        ReplayKitError: The replay would refuse the inputs.
    """

    def screen_of(forecasts: Forecasts, config: RunConfig) -> Estimator[None]:
        kind = _Screen if config.estimator.name == OWN else _OfProfiles
        return kind(forecasts, on_profile)

    job = replace(job, out=None, truth=None, estimator=screen_of)
    run, inputs = prepare(job, config, planner_of, silent)

    def messages() -> Iterator[Message]:
        for message in inputs.messages():
            on_message(message)
            yield message

    deque(inputs.played(run, messages()), 0)
    useless_of(run, inputs)
    return inputs.forecasts, run.vehicles[0].monitoring.findings


class _Screen(Estimator[None]):
    """Estimator that only screens observations."""

    supports_path_means = True
    block_size = ReducedBasisEstimator.block_size

    def __init__(self, forecasts: Forecasts, on_profile: Callable[[Profiles, bool], None]) -> None:
        self._forecasts, self._on_profile = forecasts, on_profile

    def initial(self) -> None:
        """Return the only state, None."""

    def assimilate(
        self, state: None, block: Sequence[Measurement]
    ) -> tuple[None, list[Stepped[None]]]:
        """Return the screened observations."""
        grid, found = self._forecasts.ensemble.grid, list[Stepped[None]]()
        for event in block:
            ((group,), _) = screened([event], grid, relative=self.supports_path_means)
            accepted = group.is_used or _in_later_window(group, self._forecasts)
            found.append(Stepped(event, None, None, replace(group.unused(0), accepted=accepted)))
            if isinstance(event, Profiles):
                self._on_profile(event, accepted)
        return None, found

    def innovation(self, state: None, event: Measurement) -> Array:
        """Return an unknown innovation, shape (n, 2)."""
        return np.full((len(columns_of(event)["flags"][0]), 2), np.nan)

    def flow(self, state: None) -> Any:
        """Return None in place of an estimate."""


class _OfProfiles(_Screen):
    """Protocol of an estimator that accepts profiles only."""

    supports_path_means = False


def _in_later_window(group: Screened, forecasts: Forecasts) -> bool:
    """Return whether an observation lies in a window that is read once the vehicle reaches it."""
    region, place = forecasts.region, tuple(group.columns[n][-1] for n in ("longitude", "latitude"))
    if group.linear is not None:
        place = group.linear.longitude[-1], group.linear.latitude[-1]
    if (
        region is None
        or not region.follows
        or inside_box(region.region, *place)
        or not inside_box(region.bounds, *place)
    ):
        return False
    in_reach = group.columns["depth"] <= forecasts.ensemble.grid.levels[-1]
    return not group.at_one_place or bool(np.any(usable(group.columns["flags"]) & in_reach))


# What the interpreter and the libraries take before the first array.
_BASE_MB = 250.0
# The covariance before an update, after it, and the half gains' product between them, with one to spare for the output.
_COVARIANCES = 4


@dataclass(frozen=True, slots=True)
class DryRun:
    """Expected inputs, memory and time of a replay.

    Attributes:
        profiles: Number of profiles in the logs.
        profiles_used: Number of profiles with a usable bin in the region.
        members: Number of ensemble members.
        grid: Number of points along the grid's two axes.
        levels: Levels used [m].
        modes: Number of modes per level.
        state_size: Number of weights in the filter's state.
        memory_mb: Expected peak memory [MB].
        seconds: Expected time of all updates [s], extrapolated from a few.
    """

    profiles: int
    profiles_used: int
    members: int
    grid: tuple[int, int]
    levels: tuple[float, ...]
    modes: int
    state_size: int
    memory_mb: float
    seconds: float

    def __str__(self) -> str:
        """Return the dry run as a sentence."""
        (rows, columns), levels = self.grid, self.levels
        return (
            f"Would use {self.profiles_used} of {self.profiles} profiles with {self.members} members "
            f"on {rows} x {columns} points and {len(levels)} levels ({levels[0]:g} to {levels[-1]:g} m): "
            f"{self.modes} modes a level, a state of {self.state_size} unknowns. "
            f"Expected: {self.memory_mb:.0f} MB, {self.seconds:.0f} s for the updates"
        )


def dry_run(job: ReplayJob, config: RunConfig, planner_of: PlannerFactory | None = None) -> DryRun:
    """Return the expected inputs, memory and time of a replay; reads the logs completely, with only a few updates.

    Args:
        job: The replay.
        config: Settings of the replay.
        planner_of: Factory of the planner for a job with a goal.

    Raises:
        ReplayKitError: The replay would refuse the logs or the ensemble.
    """
    if config.estimator.name != "reduced_basis":
        raise ConfigError(
            f"--dry-run describes the reduced basis, not {config.estimator.name}; leave one of the two out"
        )
    seen, some = Counter[bool](), list[Profiles]()

    def note(profile: Profiles, used: bool) -> None:
        seen[used] += 1
        if used and len(some) < ReducedBasisEstimator.block_size:
            some.append(profile)

    with threadpool_limits(limits=config.output.threads):
        forecasts, _ = check_inputs(job, config, planner_of, on_profile=note)
        ensemble = forecasts.ensemble
        # Any: a baseline was refused above, and the two that are left have what is asked for here
        estimator: Any = build(forecasts, config)
        timed = list(filter(estimator.usable, some))
        began = time.perf_counter()
        if timed:
            estimator.assimilate(estimator.initial(), timed)
        spent = time.perf_counter() - began
    size = estimator.unknowns
    return DryRun(
        profiles=seen.total(),
        profiles_used=seen[True],
        members=ensemble.n_members,
        grid=(ensemble.grid.east.shape[0], ensemble.grid.east.shape[1]),
        levels=tuple(float(level) for level in ensemble.grid.levels),
        modes=estimator.flow(estimator.initial()).n_modes,
        state_size=size,
        memory_mb=_BASE_MB + _COVARIANCES * 8e-6 * size**2 + 2e-6 * ensemble.velocity.nbytes,
        seconds=seen[True] * spent / len(timed) if timed else 0.0,
    )


def dry_run_json(result: DryRun) -> dict[str, Any]:
    """Return the dry run for JSON."""
    return {"status": "dry run", "exit_code": 0, **asdict(result)}


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
            forecast = forecasts.read(box_around(Logs([logs], config).reach.places, region.margin))
        compared = check_import(found, build_reduced([forecast], config.estimator))
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
