"""Whether a log was made with a usual fault: exchanged axes, wrong signs, a wrong unit, the declination, the sign of depth.

The ensemble states how currents are distributed and correlated before any measurement. Under that Gaussian, and the errors that the
profiles state, the profiles as logged have a likelihood; so have the profiles with each fault undone. A fault is named only when
undoing it makes the log very much more likely.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, Observation, Reason, VehicleState
from replay_kit.core.paths import Paths
from replay_kit.estimator import build_estimator
from replay_kit.estimator.static.filter import ReducedBasisEstimator
from replay_kit.estimator.static.likelihood import JointPrediction, Likelihood, predict_jointly
from replay_kit.estimator.update.screening import screen, usable
from replay_kit.forecast import read_ensemble
from replay_kit.logs import merge
from replay_kit.measurements import events_of
from replay_kit.measurements.quality.import_faults import Fault, Sounding, declination_of, depth_faults, direction_faults, scale_faults
from replay_kit.workflows.replay.inputs import look_ahead, open_readers

# profiles examined, spread over the log: their joint covariance is one matrix
_MOST_PROFILES = 200
# fewer for depths, where each fault has a matrix of its own and the gains are larger
_MOST_FOR_DEPTHS = 50
_LEAST_PROFILES = 3
# logarithm of the likelihood ratio from which a fault is named: sound twins stay below 7 (DECISIONS.md)
_LEAST_GAIN = 9.0
# of faults whose gains differ by less, both are named
_ALIKE = 3.0
# units are examined when speeds are this many times larger or smaller than expected
_ODD_SCALE = 8.0
# m; depths that a fault would have moved less look the same
_LEAST_SHIFT = 10.0
# of the bins
_MOSTLY, _HARDLY = 0.5, 0.1
_REPAIRABLE = Reason.GROSS_RANGE | Reason.ABOVE_SURFACE | Reason.HIGH_SPEED | Reason.OUTLIER


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A fault whose undoing makes the log more likely.

    Attributes:
        fault: Its name.
        advice: What to check.
        gain: Natural logarithm of the likelihood ratio to the log as it is; infinite when the log as it is cannot be.
    """

    fault: str
    advice: str
    gain: float


@dataclass(frozen=True, slots=True)
class _Trial:
    """One fault undone: the log-likelihood gained, and the misfit left, the normalised innovation squared per degree of freedom."""

    fault: Fault
    log_ratio: float
    misfit: float


@dataclass(frozen=True, slots=True)
class ImportCheck:
    """What the check of a mission's logs found.

    Attributes:
        profiles: Number of profiles examined; 0 when the check could not be made.
        suspicions: The likeliest fault first, then those that are nearly as likely; empty for a log that looks sound.
        undetermined: Of a log that looks sound, the faults that the profiles cannot exclude.
        note: Why the check could not be made, or what it cannot see in this log; empty otherwise.
    """

    profiles: int
    suspicions: tuple[Suspicion, ...]
    undetermined: tuple[str, ...] = ()
    note: str = ""


def check_logs(logs: Sequence[Path], ensemble: Paths, config: RunConfig) -> ImportCheck:
    """Return the check of a mission's logs, which may place each other's profiles, against an ensemble.

    Raises:
        LogError: A log cannot be opened.
        ForecastError: The ensemble cannot be used.
        MeasurementError: The ensemble is to be placed at the logs, and they hold no position.
    """
    with threadpool_limits(limits=config.output.threads):
        place_at, near_ns = look_ahead(logs, config)
        estimator = build_estimator(read_ensemble(ensemble, config.forecast, near_ns=near_ns, place_at=place_at), config.estimator)
        settings = config.logs
        messages = merge(open_readers(logs, config), settings.reorder_window, settings.start_ns, settings.end_ns)
        return check_import(soundings(messages, config.measurements), estimator)


def soundings(messages: Iterable[Message], config: MeasurementConfig) -> list[Sounding]:
    """Return the profiles among messages, each with the declination and the vehicle's depth that the messages state.

    Raises:
        LogError: A log cannot be read.
    """
    found: list[Sounding] = []
    declinations: dict[tuple[int, str], float] = defaultdict(lambda: math.nan)
    depth = math.nan

    def noted() -> Iterator[Message]:
        """Yield the messages, each after its declination is known."""
        for message in messages:
            declination = declination_of(message)
            if math.isfinite(declination):
                declinations[message.input, message.topic] = declination
            yield message

    for event in chain.from_iterable(events_of(noted(), config)):
        if isinstance(event, VehicleState):
            depth = event.depth
        elif isinstance(event, Observation):
            found.append(Sounding(event, declinations[event.source.input, event.source.topic], depth))
    return found


def check_import(found: Sequence[Sounding], estimator: ReducedBasisEstimator) -> ImportCheck:
    """Return which usual fault a log was most likely made with, if any.

    Args:
        found: The log's profiles.
        estimator: Of the ensemble.
    """
    above = _above_surface([sounding.observation for sounding in found])
    if above > _MOSTLY:
        for fault in depth_faults():
            if _above_surface([fault.undo(sounding) for sounding in found]) < _HARDLY:
                return ImportCheck(len(found), (Suspicion(fault.name, fault.advice, math.inf),))
    inside = [sounding for sounding in found if _usable(sounding.observation, estimator).size]
    if len(inside) < _LEAST_PROFILES:
        return ImportCheck(0, (), note=f"fewer than {_LEAST_PROFILES} profiles lie in the ensemble's water")
    chosen = _spread(inside, _MOST_PROFILES)
    widened = [_widened(sounding, estimator) for sounding in chosen]
    trials = _trials_of(direction_faults(widened), widened, estimator)
    trials += _trials_of(_unit_faults(chosen, estimator), chosen, estimator)
    trials += _trials_of_depths(_spread(widened, _MOST_FOR_DEPTHS), estimator)
    best = max(trials, key=lambda trial: trial.log_ratio)
    # where the ensemble misfits the log even with the likeliest fault undone, all gains count for less in proportion
    gains = {}
    for trial in sorted(trials, key=lambda trial: trial.log_ratio):
        gains[trial.fault.name] = Suspicion(trial.fault.name, trial.fault.advice, trial.log_ratio / max(1.0, best.misfit))
    least = max(_LEAST_GAIN, gains[best.fault.name].gain - _ALIKE)
    named = sorted((s for s in gains.values() if s.gain >= least), key=lambda s: -s.gain)
    undetermined = () if named else tuple(s.fault for s in gains.values() if s.gain > -_LEAST_GAIN)
    return ImportCheck(min(len(inside), _MOST_PROFILES), tuple(named), undetermined, _blind_spot(inside))


def _spread(found: Sequence[Sounding], most: int) -> Sequence[Sounding]:
    return found[:: math.ceil(len(found) / most)]


def _blind_spot(chosen: Sequence[Sounding]) -> str:
    if any(math.isfinite(sounding.declination) for sounding in chosen):
        return ""
    return "the log states no magnetic declination, so that a missing or doubled one was not examined"


def _widened(sounding: Sounding, estimator: ReducedBasisEstimator) -> Sounding:
    """Return a profile whose errors are as large as the estimator takes them, where its bins repeat each other."""
    observation = sounding.observation
    good = np.zeros(observation.depth.size, np.int8) + Flag.FAIL
    good[_usable(observation, estimator)] = Flag.GOOD
    _, innovation = estimator.step(estimator.initial(), replace(observation, flags=good))
    factor = math.sqrt(innovation.error_inflation)
    return replace(sounding, observation=replace(observation, error_std=factor * observation.error_std))


def _unit_faults(chosen: Sequence[Sounding], estimator: ReducedBasisEstimator) -> list[Fault]:
    """Return the faults of units that could explain speeds which are odd at all."""
    as_is = [sounding.observation for sounding in chosen]
    odd = math.log(_relative_speed(as_is, [_usable(observation, estimator) for observation in as_is], estimator))
    return [fault for fault in scale_faults() if abs(odd) > math.log(_ODD_SCALE) and fault.log_scale * odd > 0.0]


def _trials_of(faults: Sequence[Fault], chosen: Sequence[Sounding], estimator: ReducedBasisEstimator) -> list[_Trial]:
    """Return what undoing each fault of velocities gains."""
    if not faults:
        return []
    as_is = [sounding.observation for sounding in chosen]
    prediction = predict_jointly(estimator, as_is, [_usable(observation, estimator) for observation in as_is])
    logged = prediction.of(as_is)
    return [_trial(fault, logged, _undone(fault, chosen, prediction)) for fault in faults]


def _undone(fault: Fault, chosen: Sequence[Sounding], prediction: JointPrediction) -> Likelihood:
    """Return the likelihood of the velocities logged, if they were made by a fault."""
    undone = [fault.undo(sounding) for sounding in chosen]
    if fault.moves:
        prediction = predict_jointly(prediction.estimator, undone, prediction.bins)
    found = prediction.of(undone)
    return replace(found, log=found.log - fault.log_scale * found.dof)


def _trials_of_depths(chosen: Sequence[Sounding], estimator: ReducedBasisEstimator) -> list[_Trial]:
    """Return what undoing each fault of depth gains, over the bins that are in the water either way."""
    found = []
    as_is = [sounding.observation for sounding in chosen]
    for fault in depth_faults():
        undone = [fault.undo(sounding) for sounding in chosen]
        if max(float(np.nanmax(np.abs(b.depth - a.depth), initial=0.0)) for a, b in zip(as_is, undone, strict=True)) < _LEAST_SHIFT:
            continue
        bins = [np.intersect1d(_usable(a, estimator), _usable(b, estimator)) for a, b in zip(as_is, undone, strict=True)]
        if sum(used.size for used in bins) >= _HARDLY * sum(_usable(observation, estimator).size for observation in as_is):
            logged, other = (predict_jointly(estimator, profiles, bins).of(profiles) for profiles in (as_is, undone))
            found.append(_trial(fault, logged, other))
    return found


def _trial(fault: Fault, logged: Likelihood, undone: Likelihood) -> _Trial:
    return _Trial(fault, undone.log - logged.log, undone.nis / undone.dof)


def _above_surface(observations: Sequence[Observation]) -> float:
    """Return the share of bins with a velocity that lie above the surface."""
    depth = [observation.depth[np.isfinite(observation.velocity).all(axis=1)] for observation in observations]
    return float(np.mean(np.concatenate(depth) < 0.0)) if sum(part.size for part in depth) else 0.0


def _relative_speed(observations: Sequence[Observation], bins: Sequence[NDArray[np.intp]], estimator: ReducedBasisEstimator) -> float:
    """Return how many times as fast the bins are as the ensemble's members, root mean square."""
    measured = np.concatenate([observation.velocity[used] for observation, used in zip(observations, bins, strict=True)])
    # water at rest to the last digit is slow beyond any unit
    return max(float(np.sqrt(np.mean(measured**2)) / estimator.basis.kernel.speed), np.finfo(float).tiny)


def _usable(observation: Observation, estimator: ReducedBasisEstimator) -> NDArray[np.intp]:
    """Return the bins in the ensemble's water that are good, or bad only in a way that a fault could have made them."""
    repairable = (observation.reasons & ~np.int32(_REPAIRABLE)) == 0
    possible = (usable(observation.flags) | repairable) & np.isfinite(observation.velocity).all(axis=1) & (observation.depth >= 0.0)
    flags, _ = screen(replace(observation, flags=np.where(possible, Flag.GOOD, Flag.FAIL).astype(np.int8)), estimator.basis.grid)
    return np.flatnonzero(flags == Flag.GOOD)


def import_check_json(check: ImportCheck) -> dict[str, Any]:
    """Return a check for JSON; an infinite gain is null."""
    return {
        "profiles": check.profiles,
        "faults": [
            {"fault": s.fault, "advice": s.advice, "log_likelihood_ratio": s.gain if math.isfinite(s.gain) else None}
            for s in check.suspicions
        ],
        "undetermined": list(check.undetermined),
        "note": check.note,
    }


def print_import_check(check: ImportCheck, console: Console) -> None:
    """Print what a check found."""
    for suspicion in check.suspicions:
        how = "the log as it is cannot be" if math.isinf(suspicion.gain) else f"likelihood ratio e^{suspicion.gain:.0f}"
        console.print(f"LIKELY FAULT: {suspicion.fault} ({how}); {suspicion.advice}", soft_wrap=True)
    if check.profiles and not check.suspicions:
        console.print(f"Import check: {check.profiles} profiles look sound against the ensemble", soft_wrap=True)
    if check.undetermined:
        console.print(f"Import check: the profiles do not determine whether {', or '.join(check.undetermined)}", soft_wrap=True)
    if check.note:
        console.print(f"Import check: {check.note}", soft_wrap=True)
