"""How set-up, a ping and a standard error grow with the region: processor time, and memory in a process of its own.

Members are random eddies on cells of 1/12 degree, some three cells in size, in six vertical modes with a little noise, so that the prior's
correlation length is the same in every region.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.flow.dataset import to_dataset
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator import ReducedBasisEstimator, build
from replay_kit.forecast import read_ensemble
from replay_kit.forecast.grid import local_grid
from tests import synthetic
from tests.benchmarks.estimator import online
from tests.benchmarks.measure import Row, alone, cpu, peak_mb, row

_CELL = 1.0 / 12.0
_EDDY = 3.0  # cells
# Rows, columns, levels, members, and what is asked [s], [MB]; None where nothing is.
SIZES = (
    (17, 31, 8, 50, 3.0, None),
    (60, 60, 8, 50, 6.0, 600.0),
    (120, 120, 30, 50, 30.0, 1500.0),
)
GROWTH = (30, 60, 120, 240)
LARGEST = (240, 240, 50, 95, 360.0, 4000.0)
#: As the default was set up before, dense: nodes a level, seconds, peak memory [MB]; 8 levels, 50 members.
DENSE = (
    (100, 2.0, 35.0),
    (256, 2.3, 57.0),
    (527, 3.5, 81.0),
    (900, 7.8, 172.0),
    (1600, 25.3, 470.0),
    (3600, 133.0, 2400.0),
)


def region(rows: int, columns: int, levels: int) -> Grid:
    """Return a grid without land."""
    longitude, latitude = np.meshgrid(
        -30.0 + _CELL * np.arange(columns), 40.0 + _CELL * np.arange(rows)
    )
    return local_grid(
        longitude,
        latitude,
        np.geomspace(5.0, 1000.0, levels),
        np.ones((levels, rows, columns), dtype=bool),
        None,
    )


def member(grid: Grid, number: int) -> np.ndarray:
    """Return the velocities of a member, shape (2, Z, J, I), along the local axes; all share those of member -1."""
    n_levels, rows, columns = grid.wet.shape
    n_functions = min(n_levels, 6)
    wave = 2.0 * np.pi * np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns))
    functions = (
        np.cos(np.pi * np.outer(np.arange(n_functions), np.linspace(0.0, 1.0, n_levels)))
        * 0.6 ** np.arange(n_functions)[:, None]
    )
    out = np.zeros((2, *grid.wet.shape))
    for seed in dict.fromkeys((0, number + 1)):
        rng = np.random.default_rng(seed)
        stream = np.fft.ifft2(
            np.fft.fft2(rng.standard_normal((n_functions, rows, columns)))
            * np.exp(-0.5 * (_EDDY * wave) ** 2)
        ).real
        stream *= 0.3 * _EDDY / np.sqrt(np.mean(stream**2))
        flow = np.stack([-np.gradient(stream, axis=1), np.gradient(stream, axis=2)])
        out += np.einsum(
            "kz,ckji->czji", functions, flow, optimize=True
        ) + 0.01 * rng.standard_normal(out.shape)
    return out


def ensemble(rows: int, columns: int, levels: int, members: int) -> Ensemble:
    """Return an ensemble in memory."""
    grid = region(rows, columns, levels)
    velocity = np.empty((members, 2, *grid.wet.shape))
    for number in range(members):
        velocity[number] = member(grid, number)
    return Ensemble(grid, velocity, None, "benchmark of sizes")


def write_zarr(path: Path, rows: int, columns: int, levels: int, members: int) -> None:
    """Write an ensemble member by member, a chunk a member, in single precision as forecasts are."""
    grid = region(rows, columns, levels)
    for number in range(members):
        values = member(grid, number).astype(np.float32)[:, None]
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
    took, grown, estimator = setup(lambda: ensemble(rows, columns, levels, members), modes)
    name = f"set-up, {rows} x {columns} nodes, {levels} levels, {members} members, {estimator.basis.n_modes} modes"
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
    world = ensemble(rows, columns, levels, members + 1)
    truth = world.velocity[-1]
    estimator = build(
        [replace(world, velocity=world.velocity[:-1])], EstimatorConfig(modes=modes), GatingConfig()
    )
    rng, depth = np.random.default_rng(1), 16.0 + 32.0 * np.arange(22)
    place, observations = np.zeros(2), []
    for number in range(pings):
        place = place + np.array([130.0, 40.0]) + 20.0 * rng.standard_normal(2)
        j, i = np.unravel_index(
            np.argmin(np.hypot(world.grid.east - place[0], world.grid.north - place[1])),
            world.grid.east.shape,
        )
        current = np.column_stack(
            [np.interp(depth, world.grid.levels, component) for component in truth[:, :, j, i]]
        )
        noisy = current + 0.09 * rng.standard_normal(current.shape)
        observations.append(
            synthetic.profile(world.grid, *place, depth, noisy, 0.09, time_ns=number)
        )

    took, (state, *_) = cpu(lambda: online(estimator, observations))
    before = peak_mb(anew=True)
    error_s, _ = cpu(lambda: to_dataset(estimator.flow(state)))
    more = {
        "ms_a_ping": 1e3 * took / pings,
        "asked_ms": 60.0,
        "standard_error_s": error_s,
        "asked_standard_error_s": 5.0,
    }
    form = type(state.posterior).__name__
    name = f"{pings} pings at {rows} x {columns} x {levels}, mean after each; standard error of every node and level"
    grown = peak_mb() - before
    return row(name, took, asked=0.06 * pings, peak_mb=grown, form=form, **more)


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


def draw(found: list[Row], path: Path) -> None:
    """Write the growth of time and memory with the nodes of a level, before and now, as PNG."""
    growth = next(each for each in found if "times_s" in each)
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    panels = figure.subplots(1, 2)
    for panel, now, column, name in zip(
        panels, (growth["times_s"], growth["memory_mb"]), (1, 2), ("time", "memory"), strict=True
    ):
        panel.loglog(
            [each[0] for each in DENSE],
            [each[column] for each in DENSE],
            "s--",
            color="0.5",
            label="before, dense",
        )
        panel.loglog(
            [side**2 for side in GROWTH],
            now,
            "o-",
            label=f"now, exponent {growth[f'exponent_of_{name}']:.2f}",
        )
        panel.set(
            xlabel="nodes of a level",
            ylabel={"time": "processor time [s]", "memory": "peak memory [MB]"}[name],
        )
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
    figure.savefig(path.with_suffix(".png"), dpi=110)
