"""``python -m tests.benchmarks faults``: faults x sound logs x seeds; what the consistency checks name, after how many pings.

The logs are twins in the sample ocean and in the shared ensembles, a vessel's and a glider's with and without a stated motion, and a
Seaglider's real dives. A fault is made in the messages, as a logger or an instrument would make it, or by the twin where it needs the
vehicle's motion. A row holds the runs of one fault: the share named as expected, and the median of the pings until then; a sound run
that names anything is a false alarm.
"""

import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from replay_kit.config.run import ForecastConfig, LogConfig, MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation, PathMean, VehicleState
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import merge, open_log
from replay_kit.measurements import finish, initial_state, interpret
from replay_kit.measurements.consistency.monitor import ConsistencyState, check
from replay_kit.measurements.consistency.speeds import EnsembleSpeeds, ensemble_speeds
from replay_kit.studies.twins import Faults, Twin, make_twin
from tests.benchmarks.fault_kinds import FAULTS, Edit, Fault
from tests.places import ROOT

_DATA = ROOT.parent / "shared" / "data"
_SAMPLES = ROOT / "sample_logs"
_SEEDS, _PINGS, _TINY_PINGS = 5, 240, 60
_PLATFORM_STD = 0.03


@dataclass(frozen=True)
class Log:
    """A sound log.

    Attributes:
        name: Of the log.
        paths: Its files.
        ensemble: Speeds of the ensemble that goes with it.
        vehicle: ``vessel``, ``glider`` or ``seaglider``.
        heading: The same log made with a compass that is off, by degrees.
        config: How its messages become observations.
    """

    name: str
    paths: tuple[Path, ...]
    ensemble: EnsembleSpeeds
    vehicle: str
    heading: Mapping[int, Path]
    config: MeasurementConfig = field(default_factory=MeasurementConfig)


def rows(tiny: bool) -> list[dict[str, Any]]:
    """Return a row for each fault, and one for the sound runs."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        runs: dict[str, list[tuple[tuple[str, ...], int]]] = {}
        alarms: list[str] = []
        counts = {"sound": 0, "pings": 0, "unfit": 0}
        seconds = 0.0
        for seed in range(1 if tiny else _SEEDS):
            logs = list(sound_logs(Path(folder), seed, tiny))
            for number, log in enumerate(logs):
                for ensemble in (log.ensemble,) if tiny else (log.ensemble, logs[(number + 3) % len(logs)].ensemble):
                    spent = time.process_time()
                    state = run(log, log.paths, None, ensemble)
                    counts["sound" if ensemble is log.ensemble else "unfit"] += 1
                    counts["pings"] += state.pings
                    seconds += time.process_time() - spent
                    alarms += [f"{log.name} seed {seed}: {finding}" for finding in state.findings]
                for fault in FAULTS:
                    if log.vehicle in fault.vehicles and (not fault.heading or fault.heading in log.heading):
                        paths = (log.heading[fault.heading],) if fault.heading else log.paths
                        runs.setdefault(fault.name, []).append(named(log, paths, fault))
    found = [_row(fault, runs[fault.name]) for fault in FAULTS if fault.name in runs]
    total = {"runs": counts["sound"] + counts["unfit"], "unfit": counts["unfit"], "false_alarms": len(alarms), "alarms": alarms}
    return [*found, _blank("sound logs") | total | {"ours_s": time.process_time() - began}]


def _blank(name: str) -> dict[str, Any]:
    return {"name": name, "ours_s": 0.0, "peer": "none", "peer_s": None, "ratio": None, "asked": None, "error": {}, "peak_mb": None}


def _row(fault: Fault, runs: list[tuple[tuple[str, ...], int]]) -> dict[str, Any]:
    hits = [pings for names, pings in runs if pings]
    return _blank(fault.name) | {
        "runs": len(runs),
        "share": len(hits) / len(runs),
        "median_pings": median(hits) if hits else None,
        "asked_pings": 2 * fault.asked,
        "otherwise": sum(bool(names) and not pings for names, pings in runs),
    }


def named(log: Log, paths: tuple[Path, ...], fault: Fault) -> tuple[tuple[str, ...], int]:
    """Return the names of what was found in a log with a fault, and the pings until it was named as expected; 0 when it was not."""
    state = run(log, paths, fault.edit, log.ensemble, fault.expected)
    names = tuple(finding.name for finding in state.findings)
    return names, max(1, state.pings) if set(names) & set(fault.expected) else 0


def run(log: Log, paths: tuple[Path, ...], edit: Edit | None, ensemble: EnsembleSpeeds, until: tuple[str, ...] = ()) -> ConsistencyState:
    """Return the state of the checks after a log, or as soon as one of some findings is there."""
    readers = [open_log(path, position, LogConfig()) for position, path in enumerate(paths)]
    messages: Iterator[Message] = iter(merge(readers, 1.0, None, None))
    state, measured = ConsistencyState(), initial_state()
    for message in edit(messages) if edit is not None else messages:
        measured, events = interpret(measured, message, log.config)
        state = _checked(state, events, ensemble)
        if any(finding.name in until for finding in state.findings):
            return state
    return _checked(state, finish(measured, log.config), ensemble)


def _checked(state: ConsistencyState, events: Iterable[object], ensemble: EnsembleSpeeds) -> ConsistencyState:
    for event in events:
        if isinstance(event, VehicleState | Observation | PathMean):
            state, _ = check(state, event, ensemble)
    return state


def sound_logs(folder: Path, seed: int, tiny: bool) -> Iterator[Log]:
    """Yield the sound logs of a seed; the real one comes once."""
    seas = {"sample": (_SAMPLES / "ensemble.nc", str(_SAMPLES / "truth.nc"))}
    if not tiny and _DATA.exists():
        seas |= {
            "nemo": (_DATA / "natl_nemo" / "ensemble.nc", str(_DATA / "natl_nemo" / "truth.nc")),
            "qg": (_DATA / "qg" / "climatology.nc", f"{_DATA / 'qg' / 'climatology.nc'}#{7 + seed}"),
            "qg-forecast": (_DATA / "qg" / "forecast.nc", f"{_DATA / 'qg' / 'forecast.nc'}#{11 + seed}"),
        }
    for name, (path, spec) in seas.items():
        ensemble = read_ensemble(path, ForecastConfig())
        speeds, truth = ensemble_speeds(ensemble.grid.levels, ensemble.velocity), read_truth(spec, ForecastConfig())
        for vehicle, moves in (("vessel", False), ("glider", False), ("glider", True)):
            twin = _Voyage(folder, f"{name}-{vehicle}{'-motion' * moves}-{seed}", truth, vehicle, moves, _TINY_PINGS if tiny else _PINGS)
            headings = {angle: twin.made(seed, angle) for angle in ((180,) if tiny else (30, 90, 180))}
            yield Log(twin.name, (twin.made(seed, 0),), speeds, vehicle, headings)
            if tiny and vehicle == "glider":
                return
    if not seed and (dives := tuple(sorted((_DATA / "seaglider").glob("p1710*.nc")))):
        yield Log("seaglider", dives, speeds, "seaglider", {}, MeasurementConfig(use_inverted=False))
        yield Log("seaglider inverted", dives, speeds, "inverted", {})


@dataclass(frozen=True)
class _Voyage:
    """A vehicle's log in a truth; ``moves`` is whether it states the platform's motion."""

    folder: Path
    name: str
    truth: Any
    vehicle: Any
    moves: bool
    pings: int

    def made(self, seed: int, heading: int) -> Path:
        """Return the log, with a compass that is off by some degrees."""
        out, bias = self.folder / f"{self.name}-{heading}.mcap", float(heading)
        faults = Faults("platform", _PLATFORM_STD, bias) if self.moves else Faults(heading_bias_deg=bias)
        make_twin(self.truth, Twin(self.vehicle, self.pings, 0.09, seed, faults), out, True)
        return out
