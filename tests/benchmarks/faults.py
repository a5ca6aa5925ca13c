"""``python -m tests.benchmarks faults``: faults x sound logs x seeds; what the consistency checks name, after how many pings.

The logs are twins in the sample ocean and in the shared ensembles, a vessel's and a glider's with and without a stated motion, and a
Seaglider's real dives. A fault is made in the messages, as a logger or an instrument would make it, or by the twin where it needs the
vehicle's motion. A row holds the runs of one fault: the share named as expected, and the median of the pings until then; a sound run
that names anything is a false alarm.
"""

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from replay_kit.config.run import ForecastConfig, LogConfig, MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation, PathMean, VehicleState
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.logs import merge, open_log
from replay_kit.measurements import finish, initial_state, interpret
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.monitor import ConsistencyState, check
from replay_kit.measurements.consistency.speeds import EnsembleSpeeds, ensemble_speeds
from replay_kit.studies.twins.faults import Faults
from replay_kit.studies.twins.make import Options, make_twin
from tests.places import ROOT

_DATA = ROOT.parent / "shared" / "data"
_SAMPLES = ROOT / "sample_logs"
_SEEDS, _PINGS, _TINY_PINGS = 5, 200, 60
_PLATFORM_STD = 0.03
Edit = Callable[[Iterator[Message]], Iterator[Message]]


@dataclass(frozen=True)
class Log:
    """A sound log.

    Attributes:
        name: Of the log.
        paths: Its files.
        ensemble: Speeds of the ensemble that goes with it.
        vehicle: ``vessel``, ``glider`` or ``seaglider``.
        heading: The same log made with a compass that is off, by degrees.
        through_water: Not used by any of the logs.
    """

    name: str
    paths: tuple[Path, ...]
    ensemble: EnsembleSpeeds
    vehicle: str
    heading: Mapping[int, Path]
    config: MeasurementConfig = MeasurementConfig()


@dataclass(frozen=True)
class Fault:
    """A fault, and what may be found of it.

    Attributes:
        name: Of the fault.
        edit: Makes it.
        expected: Names of findings, any of which counts.
        vehicles: Of the logs in which something can tell.
        heading: Of the compass, where the twin makes the fault [degrees].
        asked: Median number of pings of the prototype.
    """

    name: str
    edit: Edit
    expected: tuple[str, ...]
    vehicles: tuple[str, ...]
    asked: int
    heading: int = 0


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
    return {"name": name, "ours_s": 0.0, "peer": "none", "peer_s": None, "ratio": None, "asked": None, "error": {}}


def _row(fault: Fault, runs: list[tuple[tuple[str, ...], int]]) -> dict[str, Any]:
    hits = [pings for names, pings in runs if pings]
    return _blank(fault.name) | {
        "runs": len(runs),
        "share": len(hits) / len(runs),
        "median_pings": median(hits) if hits else math.nan,
        "asked_pings": fault.asked,
        "otherwise": sum(bool(names) and not pings for names, pings in runs),
    }


def named(log: Log, paths: tuple[Path, ...], fault: Fault) -> tuple[tuple[str, ...], int]:
    """Return the names of what was found in a log with a fault, and the pings until it was named as expected; 0 when it was not."""
    at = 0

    def watch(state: ConsistencyState) -> None:
        nonlocal at
        if not at and any(finding.name in fault.expected for finding in state.findings):
            at = max(1, state.pings)

    state = run(log, paths, fault.edit, log.ensemble, watch)
    return tuple(finding.name for finding in state.findings), at


def run(
    log: Log, paths: tuple[Path, ...], edit: Edit | None, ensemble: EnsembleSpeeds, watch: Callable[[ConsistencyState], None] | None = None
) -> ConsistencyState:
    """Return the state of the checks after a log."""
    readers = [open_log(path, position, LogConfig()) for position, path in enumerate(paths)]
    messages: Iterator[Message] = iter(merge(readers, 1.0, None, None))
    state, measured = ConsistencyState(), initial_state()
    for message in edit(messages) if edit is not None else messages:
        measured, events = interpret(measured, message, log.config)
        state = _checked(state, events, ensemble)
        if watch is not None and state.findings:
            watch(state)
    state = _checked(state, finish(measured, log.config), ensemble)
    if watch is not None:
        watch(state)
    return state


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
            kind = f"{vehicle}{'-motion' if moves else ''}"

            def made(heading: float, vehicle: Any = vehicle, moves: bool = moves, kind: str = kind, name: str = name, truth: Any = truth) -> Path:
                out = folder / f"{name}-{kind}-{seed}-{heading:g}.mcap"
                stated = {"reference": "platform", "platform_std": _PLATFORM_STD} if moves else {}
                faults = Faults(heading_bias_deg=heading, **stated)  # type: ignore[arg-type]
                make_twin(truth, vehicle, _TINY_PINGS if tiny else _PINGS, 0.09, seed, out, True, Options(faults))
                return out

            headings = (180,) if tiny else (30, 90, 180)
            yield Log(f"{name} {kind}", (made(0.0),), speeds, vehicle, {angle: made(float(angle)) for angle in headings})
            if tiny and vehicle == "glider":
                return
    if not seed and (dives := tuple(sorted((_DATA / "seaglider").glob("p1710*.nc")))):
        yield Log("seaglider", dives, speeds, "seaglider", {}, MeasurementConfig(use_inverted=False))
        yield Log("seaglider inverted", dives, speeds, "inverted", {})


def _pings(change: Callable[[dict[str, Any], int], None]) -> Edit:
    """Return a fault of pings: ``change`` alters a copy of a payload, given the ping's number."""

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        number = 0
        for message in messages:
            if "velocity" in message.payload and "n_cells" in message.payload:
                payload = dict(message.payload)
                change(payload, number)
                number += 1
                message = message._replace(payload=payload)
            yield message

    return edit


def _velocity(matrix: Any) -> Edit:
    turn = np.array(matrix, np.float64)

    def change(payload: dict[str, Any], number: int) -> None:
        payload["velocity"] = [
            cell if cell is None or cell[0] is None or cell[1] is None else [*(turn @ np.array(cell[:2])).tolist(), *cell[2:]]
            for cell in payload["velocity"]
        ]
        if isinstance(payload.get("platform_velocity"), Mapping):
            moved = payload["platform_velocity"]
            east, north = (turn @ np.array([moved["east"], moved["north"]])).tolist()
            payload["platform_velocity"] = {**moved, "east": east, "north": north}

    return _pings(change)


def _values(value: Callable[[int, list[Any]], list[Any]]) -> Edit:
    def change(payload: dict[str, Any], number: int) -> None:
        payload["velocity"] = value(number, payload["velocity"])

    return _pings(change)


def _stale() -> Edit:
    kept: list[Any] = []

    def value(number: int, cells: list[Any]) -> list[Any]:
        if number <= 10:
            kept[:] = cells
        return list(kept)

    return _values(value)


def _constant(cells: list[Any], value: float) -> list[Any]:
    return [None if cell is None or cell[0] is None else [value, -value, *cell[2:]] for cell in cells]


def _mean_current(matrix: Any) -> Edit:
    turn = np.array(matrix, np.float64)

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        for message in messages:
            if "dac_eastward" in message.payload:
                east, north = (turn @ np.array([message.payload["dac_eastward"], message.payload["dac_northward"]])).tolist()
                message = message._replace(payload={**message.payload, "dac_eastward": east, "dac_northward": north})
            yield message

    return edit


def _frozen(messages: Iterator[Message]) -> Iterator[Message]:
    place: dict[str, Any] = {}
    for message in messages:
        if "latitude" in message.payload and "longitude" in message.payload:
            place = place or {name: message.payload[name] for name in ("latitude", "longitude")}
            message = message._replace(payload={**message.payload, **place})
        yield message


def _depth_sign(payload: dict[str, Any], number: int) -> None:
    payload["bin0_distance"], payload["cell_distances"] = -payload["bin0_distance"], None
    n, size = payload["n_cells"], payload["cell_size"]
    payload["cell_distances"] = [payload["bin0_distance"] - size * k for k in range(n)]
    payload["pressure"] = -payload["pressure"]


def _up(payload: dict[str, Any], number: int) -> None:
    payload["orientation"] = "up"


def _same(messages: Iterator[Message]) -> Iterator[Message]:
    return messages


_SWAP, _EAST, _NORTH, _BOTH = [[0, 1], [1, 0]], [[-1, 0], [0, 1]], [[1, 0], [0, -1]], [[-1, 0], [0, -1]]
_TWINS, _DIRECTION = ("vessel", "glider"), (findings.CONTRADICTION, findings.COMPASS)
FAULTS = (
    Fault("all zero", _values(lambda number, cells: _constant(cells, 0.0)), (findings.DEAD,), _TWINS, 16),
    Fault("constant", _values(lambda number, cells: _constant(cells, 0.123)), (findings.DEAD,), _TWINS, 16),
    Fault("stale from ping 11", _stale(), (findings.DEAD,), _TWINS, 27),
    Fault("heading off by 30 degrees", _same, _DIRECTION, _TWINS, 18, 30),
    Fault("heading off by 90 degrees", _same, _DIRECTION, _TWINS, 18, 90),
    Fault("heading off by 180 degrees", _same, _DIRECTION, _TWINS, 18, 180),
    Fault("profiles: east and north exchanged", _velocity(_SWAP), _DIRECTION, ("glider",), 68),
    Fault("profiles: sign of east", _velocity(_EAST), _DIRECTION, ("glider",), 68),
    Fault("profiles: sign of north", _velocity(_NORTH), _DIRECTION, ("glider",), 68),
    Fault("profiles: both signs", _velocity(_BOTH), _DIRECTION, ("glider",), 68),
    Fault("mean currents: east and north exchanged", _mean_current(_SWAP), _DIRECTION, ("glider",), 68),
    Fault("mean currents: both signs", _mean_current(_BOTH), _DIRECTION, ("glider",), 68),
    Fault("cm/s", _velocity(100.0 * np.eye(2)), (findings.UNIT,), _TWINS, 30),
    Fault("mm/s", _velocity(1000.0 * np.eye(2)), (findings.UNIT,), _TWINS, 30),
    Fault("knots", _velocity(1.943844 * np.eye(2)), (findings.KNOTS,), ("glider",), 101),
    Fault("sign of depth", _pings(_depth_sign), (findings.DEPTH,), _TWINS, 5),
    Fault("up for down", _pings(_up), (findings.DEPTH,), _TWINS, 5),
    Fault("frozen positions", _frozen, (findings.FROZEN,), ("glider",), 5),
)
