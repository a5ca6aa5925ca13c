"""How set-up, a ping and a standard error grow with the region: processor time, and memory in a process of its own."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.flow.dataset import to_dataset
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import ReducedBasisEstimator, build
from replay_kit.forecast import read_ensemble
from tests import synthetic
from tests.benchmarks import scene
from tests.benchmarks.estimator import online
from tests.benchmarks.measure import Row, alone, cpu, peak_mb, row

# Rows, columns, levels, members, and what is asked [s], [MB]; None where nothing is.
SIZES = (
    (17, 31, 8, 50, 3.0, None),
    (60, 60, 8, 50, 6.0, 600.0),
    (120, 120, 30, 50, 30.0, 1500.0),
)
GROWTH = (30, 60, 120, 240)
LARGEST = (240, 240, 50, 95, 360.0, 4000.0)


def write_zarr(path: Path, rows: int, columns: int, levels: int, members: int) -> None:
    """Write an ensemble member by member, a chunk a member, in single precision as forecasts are."""
    grid = scene.region(rows, columns, levels)
    for number in range(members):
        values = scene.member(grid, number).astype(np.float32)[:, None]
        dataset = synthetic.as_forecast(
            values, grid.levels, grid.latitude[:, 0], grid.longitude[0], number
        )
        more: dict[str, Any] = {"append_dim": "member"} if number else {"mode": "w"}
        dataset.to_zarr(path, zarr_format=2, **more)


def setup(make: Callable[[], Ensemble], modes: int) -> tuple[float, float, ReducedBasisEstimator]:
    """Return the processor time [s] and what memory grew to at most, the ensemble included [MB]."""
    before = peak_mb(anew=True)
    world = make()
    took, estimator = cpu(lambda: build([world], EstimatorConfig(modes=modes), GatingConfig()))
    return took, peak_mb() - before, estimator


def size_row(
    rows: int,
    columns: int,
    levels: int,
    members: int,
    asked: float | None,
    asked_mb: float | None,
    modes: int,
) -> Row:
    took, grown, estimator = setup(lambda: scene.ensemble(rows, columns, levels, members), modes)
    name = f"set-up, {rows} x {columns} nodes, {levels} levels, {members} members, {estimator.unknowns} unknowns"
    return row(name, took, asked=asked or 0.0, peak_mb=grown, asked_mb=asked_mb)


def from_zarr_row(
    rows: int, columns: int, levels: int, members: int, asked: float, asked_mb: float, modes: int
) -> Row:
    """The set-up from a Zarr store, reading included."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ensemble.zarr"
        write_zarr(path, rows, columns, levels, members)
        before = peak_mb(anew=True)
        start = time.process_time()
        world = read_ensemble(path, ForecastConfig())
        read_s = time.process_time() - start
        build([world], EstimatorConfig(modes=modes), GatingConfig())
        took, grown = time.process_time() - start, peak_mb() - before
    name = f"set-up from Zarr, {rows} x {columns} nodes, {levels} levels, {members} members"
    return row(name, took, asked=asked, peak_mb=grown, asked_mb=asked_mb, read_s=read_s)


def use_row(rows: int, columns: int, levels: int, members: int, pings: int, modes: int) -> Row:
    """Pings along a glider's track through the last member, the mean after each; then the standard error at every node and level."""
    world, truth = scene.withheld(rows, columns, levels, members)
    estimator = build([world], EstimatorConfig(modes=modes), GatingConfig())
    observations = scene.pings(truth, scene.track(pings))
    took, (state, _) = cpu(lambda: online(estimator, observations))
    before = peak_mb(anew=True)
    error_s, _ = cpu(lambda: to_dataset(estimator.flow(state)))
    more = {
        "ms_a_ping": 1e3 * took / pings,
        "asked_ms": 60.0,
        "standard_error_s": error_s,
        "asked_standard_error_s": 5.0,
    }
    name = f"{pings} pings at {rows} x {columns} x {levels}, mean after each; standard error of every node and level"
    grown = peak_mb() - before
    return row(name, took, asked=0.06 * pings, peak_mb=grown, **more)


def growth_row(
    sides: tuple[int, ...],
    levels: int,
    members: int,
    modes: int,
    run: Callable[[Callable[[], Row]], Row],
) -> Row:
    """Exponents of processor time and memory in the number of nodes, over square regions."""
    found = [
        run(lambda side=side: size_row(side, side, levels, members, None, None, modes))
        for side in sides
    ]
    nodes = np.log([side**2 for side in sides])
    times, memory = [each["ours_s"] for each in found], [each["peak_mb"] for each in found]
    exponents = {
        "exponent_of_time": float(np.polyfit(nodes, np.log(times), 1)[0]),
        "asked_exponent_of_time": 1.35,
    }
    if all(memory) and min(memory) > 0.0:
        exponents |= {
            "exponent_of_memory": float(np.polyfit(nodes, np.log(memory), 1)[0]),
            "asked_exponent_of_memory": 1.3,
        }
    name = f"growth of the set-up from {sides[0]} x {sides[0]} to {sides[-1]} x {sides[-1]} nodes, {levels} levels, {members} members"
    return row(
        name,
        times[-1],
        asked=0.0,
        peak_mb=memory[-1],
        times_s=times,
        memory_mb=memory,
        **exponents,
    )


def rows(tiny: bool) -> list[Row]:
    """All rows, each in a process of its own; tiny ones in this one."""
    if tiny:
        done = [
            size_row(5, 6, 3, 6, 1.0, None, 10),
            from_zarr_row(4, 5, 3, 4, 1.0, 1.0, 8),
            use_row(5, 6, 12, 6, 3, 10),
        ]
        return [*done, growth_row((4, 6), 3, 5, 8, lambda job: job())]
    done = [alone(lambda size=size: size_row(*size, 300)) for size in SIZES]
    done.append(alone(lambda: use_row(120, 120, 30, 50, 200, 300)))
    done.append(growth_row(GROWTH, 8, 50, 300, alone))
    done.append(alone(lambda: from_zarr_row(*LARGEST, 300)))
    return done
