"""Missions and their dives: logs, the sections of a public data set, and the frozen missions of a folder, known by their hashes."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from importlib.resources import files
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import Fix, Measurement, Observation, PathMean, usable
from replay_kit.logs import merge
from replay_kit.measurements.events import Event
from replay_kit.measurements.interpret import events_of
from replay_kit.workflows.replay.inputs.provenance import file_hash
from replay_kit.workflows.replay.inputs.scan import open_readers
from replay_kit.workflows.replay.surfacings.forecasts import (
    ForecastState,
    dive_mean,
    with_profile,
)

_NONE = np.empty((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """One dive as tasks see it; velocities are towards true east and north [m/s].

    Attributes:
        number: As the log counts.
        begin_ns: When it began [ns, UTC].
        end_ns: When it ended.
        place: Where it began: longitude, latitude [degrees].
        way: shape (2,), mean velocity through the water; None where it is not known.
        mean: shape (2,), depth-averaged current; None where the log has none.
        depth: shape (n,) [m], of the usable bins of its absolute profiles, in order of time.
        velocity: shape (n, 2), of these bins.
        given: What an estimator is given of it, in order of time.
        inverted: shape (2,), mean of its absolute profiles along its path; None without.
        at: shape (n, 2), longitude and latitude of the bins [degrees].
        path: Of the mean current; None without.
    """

    number: int
    begin_ns: int
    end_ns: int
    place: tuple[float, float]
    way: Array | None
    mean: Array | None
    depth: Array = field(default_factory=lambda: np.empty(0))
    velocity: Array = field(default_factory=lambda: _NONE)
    given: tuple[Measurement, ...] = ()
    inverted: Array | None = None
    at: Array = field(default_factory=lambda: _NONE)
    path: PathMean | None = None

    @property
    def seconds(self) -> float:
        """Its duration [s]."""
        return (self.end_ns - self.begin_ns) * 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """A mission.

    Attributes:
        name: Of the registry, or the logs' names.
        dives: In order.
        hashes: SHA-256 of its files, by name.
    """

    name: str
    dives: tuple[Dive, ...]
    hashes: dict[str, str]


def registry() -> list[dict[str, Any]]:
    """Return the frozen missions: name, form, origin, and the SHA-256 of each file by its path in the folder."""
    text = files(__package__).joinpath("registry.json").read_text(encoding="utf-8")
    return list(json.loads(text))


def is_frozen(folder: Path) -> bool:
    """Return whether a path is a folder with a file of a frozen mission."""
    return any((folder / name).is_file() for entry in registry() for name in entry["files"])


def frozen_missions(folder: Path, config: RunConfig) -> tuple[list[Mission], list[str]]:
    """Return the frozen missions whose files are in a folder, and the names of the others.

    Raises:
        MeasurementError: A file is not the one that was frozen.
    """
    missions, absent = list[Mission](), list[str]()
    for entry in registry():
        paths = {name: folder / name for name in entry["files"]}
        if not all(path.is_file() for path in paths.values()):
            absent.append(entry["name"])
            continue
        for name, expected in entry["files"].items():
            if (got := file_hash(paths[name])) != expected:
                raise MeasurementError(
                    f"{paths[name]}: expected SHA-256 {expected}, got {got}; take the file from {entry['origin']}"
                )
        read = _sections if entry["form"] == "sections" else read_dives
        # a Slocum's caches of sensor lists are found beside its files
        dives = read([path for path in paths.values() if path.parent.name != "cac"], config)
        missions.append(Mission(entry["name"], dives, dict(entry["files"])))
    return missions, absent


def mission_of(logs: Sequence[Path], config: RunConfig) -> Mission:
    """Return the mission of some logs, see ``read_dives``."""
    hashes = {path.name: file_hash(path) for path in logs if path.is_file()}
    return Mission(" ".join(path.name for path in logs), read_dives(logs, config), hashes)


def read_dives(logs: Sequence[Path], config: RunConfig) -> tuple[Dive, ...]:
    """Return the dives of logs, in order.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: There are fewer than two dives, or nothing in them to predict.
    """
    # decoding takes longer than interpreting
    reordered = config.logs.reorder_window, config.logs.start_ns, config.logs.end_ns
    messages = list(merge(open_readers(logs, config), *reordered))
    given = [
        event
        for event in _events(messages, config)
        if isinstance(event, Measurement) and not _beside_profiles(event)
    ]
    inverted, sources = (_events(messages, _using(config, inverted=use)) for use in (True, False))
    profiles = [
        event
        for event in inverted
        if isinstance(event, Observation) and np.isfinite(event.common_std)
    ]
    paths = {
        event.dive: event
        for event in sources
        if isinstance(event, PathMean) and event.kind == "dac"
    }
    numbers = sorted({event.dive for event in (*given, *profiles, *paths.values())} - {0})
    dives = tuple(
        _dive(
            number,
            tuple(event for event in given if event.dive == number),
            tuple(profile for profile in profiles if profile.dive == number),
            paths.get(number),
        )
        for number in numbers
    )
    if len(dives) < 2:
        names = ", ".join(str(path) for path in logs)
        raise MeasurementError(
            f"{names}: expected at least two dives with profiles or mean currents, got {len(dives)}; give more logs"
        )
    return dives


def _dive(
    number: int,
    given: tuple[Measurement, ...],
    profiles: tuple[Observation, ...],
    path: PathMean | None,
) -> Dive:
    bins = [usable(each.flags) & np.isfinite(each.velocity).all(axis=1) for each in profiles]
    depth = [each.depth[used] for each, used in zip(profiles, bins, strict=True)]
    velocity = [each.velocity[used] for each, used in zip(profiles, bins, strict=True)]
    at = [
        np.tile([each.longitude, each.latitude], (int(used.sum()), 1))
        for each, used in zip(profiles, bins, strict=True)
    ]
    times = [each.time_ns for each in (*profiles, *given)]
    begin, way, inverted = None, None, None
    if path is not None:
        times += path.path_time_ns.tolist()
        begin = Fix(times[-1], float(path.longitude[0]), float(path.latitude[0]))
        if path.fixes is not None:
            begin, end = path.fixes
            times = [begin.time_ns, end.time_ns]
            state = reduce(with_profile, profiles, ForecastState())
            measured = dive_mean(state, path, _NONE)
            way, inverted = measured.way, measured.inverted
    elif profiles:
        begin = Fix(profiles[0].time_ns, profiles[0].longitude, profiles[0].latitude)
    return Dive(
        number,
        min(times),
        max(times),
        (np.nan, np.nan) if begin is None else (begin.longitude, begin.latitude),
        way,
        None if path is None else np.array(path.velocity),
        np.concatenate([np.empty(0), *depth]),
        np.concatenate([_NONE, *velocity]),
        given,
        inverted,
        np.concatenate([_NONE, *at]),
        path,
    )


def _sections(paths: Sequence[Path], config: RunConfig) -> tuple[Dive, ...]:
    """Return the dives of sections that state positions and mean currents, not fixes: each lasts as long as mean currents are apart."""
    import xarray as xr

    tables = []
    for path in paths:
        with xr.open_dataset(path) as data:
            time_s = data["date"].values.astype("datetime64[ns]").astype(np.int64) * 1e-9
            columns = [time_s, *(data[name].values for name in ("lon", "lat", "u", "v"))]
        tables.append(np.column_stack(columns))
    rows = np.concatenate(tables)
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.argsort(rows[:, 0])]
    apart = np.diff(rows[:, 0])
    usual = float(np.median(apart))
    half_ns = (0.5e9 * np.minimum([usual, *apart], 1.5 * usual)).astype(np.int64)
    return tuple(
        Dive(k, int(1e9 * row[0]) - half, int(1e9 * row[0]) + half, tuple(row[1:3]), None, row[3:])
        for k, (row, half) in enumerate(zip(rows, half_ns.tolist(), strict=True), start=1)
    )


def _beside_profiles(event: Measurement) -> bool:
    """Return whether a measurement is a mean current beside profiles that were computed from it."""
    return isinstance(event, PathMean) and event.beside_profiles


def _using(config: RunConfig, *, inverted: bool) -> RunConfig:
    """Return settings with which a log gives its absolute profiles, or its mean currents."""
    measurements = config.measurements.model_copy(update={"use_inverted": inverted})
    return config.model_copy(update={"measurements": measurements})


def _events(messages: Iterable[Message], config: RunConfig) -> Iterator[Event]:
    """Return the events that the measurement step finds in messages."""
    return chain.from_iterable(events_of(messages, config.measurements, config.logs.system))
