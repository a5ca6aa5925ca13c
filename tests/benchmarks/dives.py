"""``python -m tests.benchmarks dives``: a dive's mean current predicted from the dives before it, over the last dive's, on frozen missions.

``next`` knows the dive's way through the water, ``planned`` takes the last one's. A mission is scored from its third predicted dive on, its
files are known by their hashes (``dives.json``). ``over_last`` is the ratio of the RMS errors, ``gain`` the mean difference of the
logarithms of the stated densities [nats], ``in_90`` the share of dives in their ellipses of 90 %.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import chain
from pathlib import Path

import numpy as np
import xarray as xr

from replay_kit.config.run import load_config
from replay_kit.core.observation import Observation, PathMean, Profiles
from replay_kit.estimator.next_dive.mixture import Persistence
from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess
from replay_kit.logs import merge
from replay_kit.workflows.replay.inputs.scan import open_readers
from replay_kit.workflows.replay.surfacings import Gathered, dive_mean
from tests.benchmarks.measure import Row, row, seconds
from tests.measurements.samples import events_of
from tests.places import DATA, SAMPLES

_FIRST = 3


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """When a dive was [ns], its mean current, and where known the way through the water and the mean of its profiles, each (2,) [m/s]."""

    begin_ns: int
    end_ns: int
    mean: np.ndarray
    way: np.ndarray | None = None
    inverted: np.ndarray | None = None


def missions() -> Iterator[tuple[str, list[Dive]]]:
    """Yield the frozen missions of the data, each by its name.

    Raises:
        ValueError: A file is not the one that was frozen.
    """
    for entry in json.loads(Path(__file__).with_suffix(".json").read_text()):
        paths = [DATA / name for name in entry["files"]]
        if not all(path.is_file() for path in paths):
            continue
        for path, expected in zip(paths, entry["files"].values(), strict=True):
            if sha256(path.read_bytes()).hexdigest() != expected:
                raise ValueError(f"{path}: take the file from {entry['origin']}")
        # a Slocum's caches of sensor lists are found beside its files
        logs = [path for path in paths if path.parent.name != "cac"]
        yield entry["name"], (sections if entry["form"] == "sections" else dives)(logs)


def dives(logs: Sequence[Path]) -> list[Dive]:
    """Return the dives of logs that have a mean current."""
    events = {}
    for use in (True, False):
        config = load_config(None, {"measurements": {"use_inverted": use}})
        messages = merge(open_readers(logs, config), config.logs.reorder_window)
        events[use] = list(chain.from_iterable(events_of(messages, config.measurements)))
    profiles = [e for e in events[True] if isinstance(e, Observation) and np.isfinite(e.common_std)]
    # where one is stated again, the last holds
    paths = {e.dive: e for e in events[False] if isinstance(e, PathMean) and e.kind == "dac"}
    return [
        _dive(paths[number], [one for one in profiles if one.dive == number])
        for number in sorted(paths.keys() - {0})
    ]


def _dive(path: PathMean, profiles: Sequence[Observation]) -> Dive:
    if path.fixes is None:
        times = path.path_time_ns
        return Dive(int(times.min()), int(times.max()), np.array(path.velocity))
    begin, end = path.fixes
    state = Gathered()
    for profile in profiles:
        state = state.after(Profiles.of([profile]))
    found = dive_mean(path, np.empty((0, 2)), state.along(path))
    return Dive(begin.time_ns, end.time_ns, np.array(path.velocity), found.way, found.inverted)


def sections(paths: Sequence[Path]) -> list[Dive]:
    """Return the dives of sections of mean currents without fixes: each lasts as long as mean currents are apart."""
    tables = []
    for path in paths:
        with xr.open_dataset(path) as data:
            time_s = data["date"].values.astype("datetime64[ns]").astype(np.int64) * 1e-9
            tables.append(np.column_stack([time_s, *(data[n].values for n in ("lon", "u", "v"))]))
    rows = np.concatenate(tables)
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.argsort(rows[:, 0])]
    apart = np.diff(rows[:, 0])
    usual = float(np.median(apart))
    half_ns = (0.5e9 * np.minimum([usual, *apart], 1.5 * usual)).astype(np.int64)
    times = (1e9 * rows[:, 0]).astype(np.int64)
    return [
        Dive(at - half, at + half, mean)
        for at, half, mean in zip(times.tolist(), half_ns.tolist(), rows[:, 2:], strict=True)
    ]


def figures(mission: Sequence[Dive], planned: bool) -> dict[str, float]:
    """Return the figures of a mission whose next dive, or planned one, is predicted; none where too few dives can be."""
    model = MeanCurrentProcess()
    state, last, ways = model.initial(), Persistence(), Persistence()
    off, held, gains, predicted = [], [], [], 0
    for dive in mission:
        if last.velocity is not None and (not planned or dive.way is not None):
            said = model.forecast(state, _asked(dive, None if planned else dive.way, ways))
            predicted += 1
            if predicted >= _FIRST:
                off.append((said.mean - dive.mean, last.velocity - dive.mean))
                wide = np.linalg.solve(said.cov, off[-1][0]) @ off[-1][0]
                held.append(wide <= said.radii((0.9,)) ** 2)
                gains.append(said.log_density(dive.mean) - last.log_density(dive.mean))
        state = model.step(state, _asked(dive, dive.way, ways))
        last = last.after(dive.mean)
        ways = ways if dive.way is None else ways.after(dive.way)
    if not off:
        return {}
    ours, persistent = np.square(off).sum(axis=(0, 2))
    ratio = float(np.sqrt(ours / persistent))
    return {"over_last": ratio, "gain": float(np.mean(gains)), "in_90": float(np.mean(held))}


def _asked(dive: Dive, way: np.ndarray | None, ways: Persistence) -> DiveMean:
    std = 0.0
    if way is None:
        # the last way, with the changes so far as its error
        way, std = ways.velocity, float(np.sqrt(0.5 * ways.squares / max(ways.changes, 1)))
    way = np.zeros(2) if way is None else way
    lasts, middle = (dive.end_ns - dive.begin_ns) * 1e-9, (dive.begin_ns + dive.end_ns) // 2
    return DiveMean(middle, lasts, way, dive.mean, dive.inverted, way_std=std)


def rows(tiny: bool) -> list[Row]:
    """Return a row of each task, with the figures of each mission."""
    known = (
        dict(missions())
        if not tiny and DATA.exists()
        else {"sample": dives([SAMPLES / "glider.mcap"])}
    )
    return [_row(task, known) for task in ("next", "planned")]


def _row(task: str, known: dict[str, list[Dive]]) -> Row:
    took, each = seconds(lambda: {n: figures(one, task == "planned") for n, one in known.items()})
    told = {f"{n}_{what}": value for n, one in each.items() for what, value in one.items()}
    ratios = [one["over_last"] for one in each.values() if one]
    mean = float(np.exp(np.mean(np.log(ratios)))) if ratios else None
    return row(f"{task} dive's mean current", took, "the last dive's", over_last=mean, **told)
