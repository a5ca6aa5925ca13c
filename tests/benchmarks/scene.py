"""Seas of random eddies of any size, and pings in them.

Members are random eddies on cells of 1/12 degree, some three cells in size, in some vertical modes, with a little noise: the prior's
correlation length is the same in every region.
"""

from dataclasses import replace

import numpy as np

from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation import Observation
from replay_kit.forecast.grids.horizontal import local_grid
from tests import synthetic

_CELL = 1.0 / 12.0
_EDDY = 3.0  # cells
NOISE = 0.09  # m/s


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
    # few on few levels: between these a current is smooth
    n_functions = min(1 + n_levels // 4, 6)
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


def withheld(*size: int) -> tuple[Ensemble, Ensemble]:
    """Return an ensemble, rows, columns, levels and members as of ``ensemble``, and a truth that it does not hold."""
    *shape, members = size
    whole = ensemble(*shape, members + 1)
    return replace(whole, velocity=whole.velocity[:-1]), replace(
        whole, velocity=whole.velocity[-1:]
    )


def track(n: int) -> np.ndarray:
    """Return places along a glider's course from the middle, one every ten minutes, shape (n, 2) [m]."""
    steps = np.random.default_rng(1).normal([130.0, 40.0], 20.0, (n, 2))
    return np.cumsum(steps, axis=0)


def scattered(grid: Grid, n: int) -> np.ndarray:
    """Return random places, shape (n, 2) [m]."""
    half = 0.46 * np.array([np.ptp(grid.east), np.ptp(grid.north)])
    return np.random.default_rng(2).uniform(-half, half, (n, 2))


def pings(truth: Ensemble, places) -> list[Observation]:
    """Return pings of 22 bins of 32 m at places, which measure the nearest node with noise."""
    grid, rng, depth = truth.grid, np.random.default_rng(3), 16.0 + 32.0 * np.arange(22)
    found = []
    for number, (east, north) in enumerate(places):
        j, i = np.unravel_index(
            np.argmin(np.hypot(grid.east - east, grid.north - north)), grid.east.shape
        )
        here = truth.velocity[0, :, :, j, i]
        current = np.column_stack([np.interp(depth, grid.levels, part) for part in here])
        noisy = current + NOISE * rng.standard_normal(current.shape)
        found.append(synthetic.profile(grid, east, north, depth, noisy, NOISE, time_ns=number))
    return found
