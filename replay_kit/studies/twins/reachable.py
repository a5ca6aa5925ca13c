"""Targets that a truth can reach: the ends of random glides flown in it that stay in the water."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_geographic, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.plan import Place
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import random_places

SPEED = 0.3  # m/s, through water
TARGET_DEPTH = 500.0  # m
# Shortest and longest time to the target's depth [s]: some 13 to 50 km through water, the distances of a glider's waypoints.
_TIME_TO_DEPTH = (12.0 * 3600.0, 48.0 * 3600.0)
_STEPS = 100
_MAX_DRAWS = 100


@dataclass(frozen=True, slots=True)
class Pair:
    """A start at the surface and a target that a glide in the truth reaches."""

    start: Place
    target: Place


def draw_pairs(field: Field, flow: FlowEstimate, grid: Grid, count: int, seed: int) -> tuple[Pair, ...]:
    """Return starts and targets, each target the end of a random glide flown in the truth that stays in the water.

    Targets are at the paper's depth, or at the deepest level that both grids have.

    Args:
        field: The truth, for places at its wet surface.
        flow: The truth as the planner sees it.
        grid: Of the estimates; a glide has to stay in its water too.
        count: Number of pairs.
        seed: Of starts, headings and times to depth.

    Raises:
        ForecastError: Hardly any glide stays in the water, or there is no level below the surface.
    """
    # a stream of its own: with the pings' the starts would be at pinged places
    rng, depth = np.random.default_rng((seed, 1)), min(TARGET_DEPTH, float(flow.grid.levels[-1]), float(grid.levels[-1]))
    if not depth > 0.0:
        raise ForecastError(f"a glide needs levels below the surface, but the deepest is at {depth:g} m; choose others with --levels")
    pairs: list[Pair] = []
    for _ in range(_MAX_DRAWS):
        start = random_places(field, count, rng)
        heading, duration = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(*_TIME_TO_DEPTH, count)
        down = depth / duration
        along = np.sqrt(SPEED**2 - down**2)
        through = np.column_stack([along * np.sin(heading), along * np.cos(heading), down])
        paths = _flown(flow, np.column_stack([start, np.zeros(count)]), through, duration)
        longitude, latitude = to_geographic(flow.grid.projection, paths[..., 0], paths[..., 1])
        kept = np.all([in_water(one, longitude, latitude, paths[..., 2]) for one in (flow.grid, grid)], axis=0)
        pairs += [
            Pair(Place(float(longitude[0, k]), float(latitude[0, k]), 0.0), Place(float(longitude[-1, k]), float(latitude[-1, k]), depth))
            for k in np.flatnonzero(kept)
        ]
        if len(pairs) >= count:
            return tuple(pairs[:count])
    raise ForecastError(
        f"found {len(pairs)} of {count} glides of {_TIME_TO_DEPTH[0] / 3600:g} to {_TIME_TO_DEPTH[1] / 3600:g} h to {depth:g} m "
        "that stay in the truth's water; use a larger region"
    )


def _flown(flow: FlowEstimate, start: Array, through: Array, duration: Array) -> Array:
    """Return the paths of constant velocities through water, shape (steps + 1, n, 3) [m]: RK4, all glides at once.

    Args:
        flow: The current.
        start: shape (n, 3) [m].
        through: shape (n, 3) [m/s].
        duration: shape (n,) [s].
    """
    step = (duration / _STEPS)[:, None]

    def over_ground(position: Array) -> Array:
        return np.column_stack([through[:, :2] + flow.velocity(*position.T), through[:, 2]])

    path = [start]
    for _ in range(_STEPS):
        path.append(rk4(over_ground, path[-1], step))
    return np.array(path)


def rk4(rate: Callable[[Array], Array], position: Array, step: Array | float) -> Array:
    """Return the positions, shape (n, d), one Runge-Kutta step later.

    Args:
        rate: Of change at positions.
        position: shape (n, d).
        step: shape (n, 1), or one for all.
    """
    first = rate(position)
    second = rate(position + step / 2.0 * first)
    third = rate(position + step / 2.0 * second)
    fourth = rate(position + step * third)
    return position + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


def in_water(grid: Grid, longitude: Array, latitude: Array, depth: Array) -> NDArray[np.bool_]:
    """Return which paths, shape (steps, n), stay inside a grid's outline and over its wet points all along, shape (n,)."""
    east, north = to_local(grid.projection, longitude, latitude)
    nearest = cKDTree(np.column_stack([grid.east.ravel(), grid.north.ravel()])).query(np.stack([east, north], axis=-1))[1]
    level = np.clip(np.searchsorted(grid.levels, depth, side="right") - 1, 0, grid.levels.size - 1)
    wet = grid.wet.reshape(grid.levels.size, -1)[level, nearest]
    return np.asarray(np.all(wet & inside_grid(grid, east, north), axis=0))
