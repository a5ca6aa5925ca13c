"""``python -m tests.benchmarks faults``: faults x sound logs x seeds; what the consistency checks name, after how many pings.

The logs are twins in the sample ocean and in the shared ensembles, a vessel's and a glider's with and without a stated motion, and a
Seaglider's real dives. A fault is made in the messages, as a logger or an instrument would make it, or by the twin where it needs the
vehicle's motion. A row holds the runs of one fault, by what came of them: the fault is named, and after how many pings; the contradiction
is named with the odds of its causes; a note says that it cannot be known here; nothing is said; another cause is named. Of those that are
not named, ``unknowable`` are those in which one who knew the errors could not be sure either (``knowable.py``). Forecasts of right and of
wrong files are judged by the mean currents of the gliders' logs. Sound logs are checked against the ensembles of all seas, and, of each
seed, with another noise: a run that names anything is a false alarm.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from statistics import median
from typing import Any

import numpy as np

from replay_kit.config.run import (
    EstimatorConfig,
    ForecastConfig,
    LogConfig,
    MeasurementConfig,
    RunConfig,
)
from replay_kit.core.errors import Finding
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.core.observation import PathMean
from replay_kit.core.observation.table import PING, Block
from replay_kit.estimator import build
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import merge, open_log
from replay_kit.measurements.checks.causes import COMPASS, DRIFT, OFFSET, SCALE, UNDECIDED
from replay_kit.measurements.checks.check import Checked, check
from replay_kit.measurements.checks.profile import EnsembleSpeeds, ensemble_speeds
from replay_kit.measurements.checks.sensors import CLOCK, DEPTHS
from replay_kit.measurements.observed import blocks
from replay_kit.measurements.observed import rows as events_of
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.mission import dives as glider_dives
from replay_kit.studies.twins.mission import survey
from replay_kit.workflows.replay.consistency import MonitoringState, check_file, conclusions
from replay_kit.workflows.replay.steps import Counts
from tests.benchmarks.fault_kinds import FAULTS, Fault, in_beams
from tests.benchmarks.knowable import probability
from tests.benchmarks.measure import Row, row
from tests.faulty import Faults, Flight, measured_on, messages_of
from tests.places import DATA, SAMPLES

_SEEDS, _PINGS, _TINY_PINGS, _BLOCK = 5, 250, 60, 256
#: What may come of a log with a fault: it is named, or the contradiction with the odds of its causes; a note says that it cannot be known;
#: nothing; another cause.
ENDS = ("named", "odds", "said", "silent", "wrong")
#: How a run ended, the pings until the fault was named, and whether one who knew the errors would be sure of it.
Run = tuple[str, int, bool]
_SURE = 0.98
# What is done to the currents of a forecast, and words of what is then found.
_FILES: Mapping[str, tuple[Callable[[np.ndarray], np.ndarray], tuple[str, ...]]] = {
    "as it is": (lambda u: u, ()),
    "with u and v exchanged": (lambda u: u[:, ::-1], ("exchanged",)),
    "negated": (lambda u: -u, ("both signs",)),
    "in knots": (lambda u: 1.943844 * u, ("knots", "times too fast")),
    "x 10": (lambda u: 10.0 * u, ("times too fast",)),
}
# The word of such a note, by the finding that is expected.
_NOTES = {
    COMPASS: "directions",
    SCALE: "scale",
    OFFSET: "offset",
    DRIFT: "drift",
    CLOCK: "clock",
    DEPTHS: "depth",
}
# m/s: of the platform's stated velocity; of the bins of the seeds' twins
_PLATFORM_STD, _NOISE = 0.03, (0.09, 0.05, 0.15, 0.09, 0.25)


@dataclass(frozen=True)
class Log:
    """A sound log.

    Attributes:
        name: Of the log.
        messages: Its messages, when the compass is off by some degrees.
        ensemble: Speeds of the ensemble that goes with it.
        vehicle: ``vessel``, ``glider``, ``seaglider`` or ``inverted``.
        headings: By how much the compass can be off [degrees].
        config: How its messages become observations.
    """

    name: str
    messages: Callable[[float], Iterable[Message]]
    ensemble: EnsembleSpeeds
    vehicle: str
    headings: Sequence[int] = ()
    config: MeasurementConfig = field(default_factory=MeasurementConfig)


def rows(tiny: bool) -> list[Row]:
    """Return a row for each fault, and one for the sound runs."""
    began = time.process_time()
    seas = _seas(tiny)
    runs: dict[str, list[Run]] = {}
    of_files: dict[str, list[Run]] = {}
    alarms: list[str] = []
    counts = {"sound": 0, "unfit": 0, "mute": 0}
    for seed in range(1 if tiny else _SEEDS):
        for log in sound_logs(seas, seed, tiny):
            measured, own = list(_blocks(log)), Checked()
            for sea, (speeds, _, estimators) in seas.items():
                state, found, _, _ = _after(measured, speeds, log.config)
                counts["sound" if log.ensemble is speeds else "unfit"] += 1
                alarms += [f"{log.name} with {sea}: {finding}" for finding in found]
                if log.ensemble is speeds:
                    own = state
                    if log.vehicle == "glider" and "motion" not in log.name:
                        _judge_files(of_files, estimators(), measured)
            counts["mute"] += not state.can_tell_directions
            for fault in FAULTS:
                if log.vehicle in fault.vehicles and (
                    not fault.heading or fault.heading in log.headings
                ):
                    runs.setdefault(fault.name, []).append(named(log, fault, own))
    found = [_row(fault, runs[fault.name]) for fault in FAULTS if fault.name in runs]
    total = {
        "runs": counts["sound"] + counts["unfit"],
        **counts,
        "false_alarms": len(alarms),
        "alarms": alarms,
    }
    found += [_row(Fault(name, iter, (), (), 0), of_files[name]) for name in of_files]
    return [*found, row("sound logs", time.process_time() - began, **total)]


def _row(fault: Fault, runs: list[Run]) -> Row:
    hits = [pings for ended, pings, _ in runs if ended == "named"]
    return row(
        fault.name,
        0.0,
        runs=len(runs),
        **{ended: sum(one == ended for one, *_ in runs) for ended in ENDS},
        unknowable=sum(not sure for ended, _, sure in runs if ended != "named"),
        median_pings=median(hits) if hits else None,
        asked_pings=2 * fault.asked,
    )


def _judge_files(
    found: dict[str, list[Run]], estimators: Mapping[str, Any], measured: Iterable[Block]
) -> None:
    """Add what the mean currents of a log say of files of right and wrong forecasts."""
    means = [e for block in measured for e in events_of(block) if isinstance(e, PathMean)]
    for name, estimator in estimators.items():
        findings, notes = check_file(estimator, means)
        ended = "said" if notes or not _FILES[name][1] else "silent"
        if findings:
            right = any(words in findings[0].evidence for words in _FILES[name][1])
            ended = "named" if right else "wrong"
        found.setdefault(f"forecast {name}", []).append((ended, 0, ended == "silent"))


def named(log: Log, fault: Fault, sound: Checked) -> Run:
    """Return what came of a log with a fault, one of ``ENDS``, and the pings until it was named, else 0.

    Args:
        log: The sound log.
        fault: Is made in it.
        sound: What is known after the log without the fault.
    """
    state, found, notes, pings = _after(
        _blocks(log, fault), log.ensemble, log.config, fault.expected
    )
    names = {finding.name for finding in found if finding.severity != "warning"}
    if set(fault.expected) & {finding.name for finding in found}:
        return "named", max(1, pings), True
    sure = any(
        # of what no pairs tell nothing is known
        not probability(sound.memory.get(key, {}), memory, fault.expected) < _SURE
        for key, memory in state.memory.items()
        if key[0] == "means" and sound.memory.get(key)
    )
    if UNDECIDED in names:
        return "odds", 0, sure
    if names:
        return "wrong", 0, sure
    words = [word for name, word in _NOTES.items() if name in fault.expected]
    said = any(word in note for word in words for note in notes)
    return "said" if said else "silent", 0, sure


def _blocks(log: Log, fault: Fault | None = None) -> Iterator[Block]:
    """Yield what a log measured, with a fault."""
    messages = iter(_messages(log, fault))
    return blocks(messages if fault is None else fault.edit(messages), log.config, _BLOCK)


def _messages(log: Log, fault: Fault | None) -> Iterable[Message]:
    """Return the messages of a log whose compass is off, from some hour on."""
    if fault is None or not fault.heading:
        return log.messages(0.0)
    sound, wrong = list(log.messages(0.0)), log.messages(fault.heading)
    until_ns = sound[0].time_ns + int(fault.from_hour * 3.6e12)
    return [a if a.time_ns < until_ns else b for a, b in zip(sound, wrong, strict=True)]


def _after(
    measured: Iterable[Block],
    ensemble: EnsembleSpeeds,
    config: MeasurementConfig,
    until: tuple[str, ...] = (),
) -> tuple[Checked, tuple[Finding, ...], tuple[str, ...], int]:
    """Return the state of the checks after a log, what a replay would conclude, and the pings until one of some findings."""
    state, means, skipped, pings, named_at = Checked(), list[PathMean](), Counter(), 0, 0
    for block in measured:
        skipped.update(block.counts())
        before = pings + np.cumsum(block.events[:, 1] == PING)
        state, block, new = check(state, block, ensemble)
        means += [event for event in events_of(block) if isinstance(event, PathMean)]
        at = [int(before[event]) for event, finding, _ in new if finding.name in until]
        named_at, pings = named_at or min(at, default=0), state.pings[0]
    whole = MonitoringState(checks=state, findings=state.findings, means=tuple(means))
    said = conclusions(whole, Counts(skipped), RunConfig(measurements=config))
    return state, *said, named_at or pings


Seas = Mapping[str, tuple[EnsembleSpeeds, str, Callable[[], Mapping[str, Any]]]]


def _seas(tiny: bool) -> Seas:
    """Return the speeds of the ensembles, each with where its truths are and the estimators of its right and wrong files."""
    paths = {"sample": (SAMPLES / "ensemble.nc", str(SAMPLES / "truth.nc"))}
    if not tiny and DATA.exists():
        paths |= {
            "nemo": (DATA / "natl_nemo" / "ensemble.nc", str(DATA / "natl_nemo" / "truth.nc")),
            "qg": (DATA / "qg" / "climatology.nc", f"{DATA / 'qg' / 'climatology.nc'}#"),
            "qg-forecast": (DATA / "qg" / "forecast.nc", f"{DATA / 'qg' / 'forecast.nc'}#"),
        }
    found = {}
    for name, (path, spec) in paths.items():
        ensemble = read_ensemble(path, ForecastConfig())
        found[name] = _speeds(ensemble), spec, cache(partial(_estimators, ensemble))
    return found


def _estimators(ensemble: Ensemble) -> dict[str, Any]:
    return {
        name: build(
            [replace(ensemble, velocity=np.ascontiguousarray(change(ensemble.velocity)))],
            EstimatorConfig(),
        )
        for name, (change, _) in _FILES.items()
    }


def _speeds(ensemble: Ensemble) -> EnsembleSpeeds:
    return ensemble_speeds(ensemble.grid.levels, ensemble.velocity)


def sound_logs(seas: Seas, seed: int, tiny: bool) -> Iterator[Log]:
    """Yield the sound logs of a seed; the real one comes once."""
    for name, (speeds, spec, _) in seas.items():
        truth = read_truth(
            f"{spec}{7 + 4 * seed}" if spec.endswith("#") else spec, ForecastConfig()
        )
        sea, pings = build_field(truth), _TINY_PINGS if tiny else _PINGS
        for vehicle, fly in (("vessel", survey), ("glider", glider_dives)):
            rng = np.random.default_rng(seed)
            flight = measured_on(fly(sea, pings, rng), sea, _NOISE[seed], rng)
            for moves in (False, True) if vehicle == "glider" else (False,):
                label = f"{name} {vehicle}{' with motion' * moves} {seed}"
                yield Log(
                    label,
                    _logged(flight, moves, seed),
                    speeds,
                    vehicle,
                    (180,) if tiny else (25, 30, 60, 90, 180),
                )
                if moves:
                    yield Log(f"{label} in beams", _in_beams(flight, seed), speeds, "beams")
                if tiny and vehicle == "glider":
                    return
    dives = sorted((DATA / "seaglider").glob("p1710*.nc"))
    if not seed and dives:
        messages = list(
            merge(
                [open_log(path, position, LogConfig()) for position, path in enumerate(dives)],
                1.0,
                None,
                None,
            )
        )
        for vehicle, config in (
            ("seaglider", MeasurementConfig(use_inverted=False)),
            ("inverted", MeasurementConfig()),
        ):
            yield Log(f"{vehicle} dives", lambda heading: messages, speeds, vehicle, (), config)


def _in_beams(flight: Flight, seed: int) -> Callable[[float], Sequence[Message]]:
    """Return a flight's messages with pings in beam coordinates."""
    of = _logged(flight, True, seed)
    return lru_cache(1)(lambda heading: tuple(in_beams(iter(of(heading)))))


def _logged(flight: Flight, moves: bool, seed: int) -> Callable[[float], Sequence[Message]]:
    """Return a flight's messages by the error of the compass, with the platform's motion if it ``moves``."""

    @lru_cache(8)
    def messages(heading: float) -> Sequence[Message]:
        bias = float(heading)
        return tuple(
            messages_of(
                flight,
                Faults("platform", _PLATFORM_STD, bias) if moves else Faults(heading_bias_deg=bias),
                seed,
            )
        )

    return messages
