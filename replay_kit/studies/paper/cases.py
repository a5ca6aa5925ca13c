"""What the study asks: truths, given or members left out of the ensemble, profiles measured in them, and goals reachable in them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import (
    inside_grid,
    rotate_to_geographic,
    to_geographic,
    to_local,
    wet_above,
)
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation import Observation
from replay_kit.core.plan import Place
from replay_kit.studies.twins.field import EPOCH_NS, Field
from replay_kit.studies.twins.make import BELOW, measure
from replay_kit.studies.twins.mission import random_places

#: Error stated by an instrument without noise: the paper's in ideal conditions [m/s].
IDEAL_ERROR_STD = 0.01
_INTERVAL_NS = 60_000_000_000
# Of the glides to the targets: speed through water [m/s]; depth of the target [m]; shortest and longest time to it [s]: some 13 to 50 km
# through water, the distances of a glider's waypoints.
_SPEED, _TARGET_DEPTH, _TIME_TO_DEPTH = 0.3, 500.0, (12.0 * 3600.0, 48.0 * 3600.0)
_STEPS = 100
_MAX_DRAWS = 100

#: Start at the surface and target that a flight in the truth reaches.
Pair = tuple[Place, Place]


class Case(NamedTuple):
    """Truth, an ensemble of one, and an ensemble independent of it."""

    truth: Ensemble
    ensemble: Ensemble


def members_left_out(ensemble: Ensemble, which: str) -> Sequence[int]:
    """Return the indices of the members that are left out in turn.

    Args:
        ensemble: All members.
        which: ``all``, ``most-distant`` or comma-separated indices from 0.

    Raises:
        ConfigError: An index is invalid or repeated, or too few members remain.
    """
    count = ensemble.n_members
    if count < 3:
        raise ConfigError(f"--leave-out: an ensemble of at least 3 members is needed, got {count}")
    if which == "all":
        return range(count)
    if which == "most-distant":
        return [most_distant(ensemble)]
    names, known = [name.strip() for name in which.split(",")], list(map(str, range(count)))
    if not set(names) <= set(known) or len(set(names)) < len(names):
        raise ConfigError(
            f"--leave-out: expected 0 to {known[-1]} with commas between them, each once, all or most-distant, got '{which}'"
        )
    return list(map(int, names))


def most_distant(ensemble: Ensemble) -> int:
    """Return the index of the member farthest from the mean of the others, in RMS over wet points."""
    anomalies = (ensemble.velocity - ensemble.velocity.mean(axis=0))[:, :, ensemble.grid.wet]
    # the distance from the mean of the others is the distance from the mean of all times E / (E - 1)
    return int(np.argmax(np.sum(anomalies**2, axis=(1, 2))))


def leave_out(ensemble: Ensemble, member: int) -> Case:
    """Return the case with a member, by index from 0, as truth."""
    one, source = ensemble.velocity[member : member + 1], f"{ensemble.source}#{member}"
    others = np.delete(ensemble.velocity, member, axis=0)
    return Case(
        Ensemble(ensemble.grid, one, ensemble.time_ns, source),
        replace(ensemble, velocity=others, members=()),
    )


def random_observations(
    field: Field, pings: int, noise: float, seed: int
) -> tuple[Observation, ...]:
    """Return profiles, 22 bins of 32 m from 16 m, at positions uniformly random over the truth's wet surface.

    Args:
        field: Truth.
        pings: Number of profiles.
        noise: Standard deviation of each component of each bin [m/s], stated as error.
        seed: Seed of positions and noise.

    Raises:
        ForecastError: The truth's surface is almost all dry.
    """
    rng = np.random.default_rng(seed)
    place = np.column_stack([random_places(field, pings, rng), np.zeros(pings)])
    velocity = measure(field, place, noise, rng)
    where = to_geographic(field.grid.projection, *place[:, :2].T)
    return _profiles(where, BELOW, velocity, noise or IDEAL_ERROR_STD)


def grid_observations(truth: Ensemble) -> tuple[Observation, ...]:
    """Return the paper's ideal measurements: each wet grid point once, without noise, one profile per grid column.

    Args:
        truth: Ensemble of one; bins are at its levels.
    """
    grid = truth.grid
    j, i = np.nonzero(grid.wet[0])
    where = grid.longitude[j, i], grid.latitude[j, i]
    velocity = np.stack(
        rotate_to_geographic(grid.projection, *where, *truth.velocity[0][:, :, j, i]), axis=-1
    )
    return _profiles(where, grid.levels, np.moveaxis(velocity, 1, 0), IDEAL_ERROR_STD)


def _profiles(
    places: tuple[Array, Array], depth: Array, velocity: Array, error_std: float
) -> tuple[Observation, ...]:
    """Return profiles, one a minute, at longitudes and latitudes, from velocities of shape (n, depths, 2), NaN where missing."""
    return tuple(
        Observation.profile(
            EPOCH_NS + _INTERVAL_NS * k, lon, lat, depth, each[:, 0], each[:, 1], error_std
        )
        for k, (lon, lat, each) in enumerate(zip(*places, velocity, strict=True))
    )


def draw_pairs(
    field: Field, flow: FlowEstimate, grid: Grid, count: int, seed: int
) -> tuple[Pair, ...]:
    """Return starts and targets; each target is the end of a random glide in the truth's water.

    Targets are at the paper's depth, or at the deepest common level.

    Args:
        field: Truth, for positions on its wet surface.
        flow: Truth in the planner's form.
        grid: Grid of the estimates; glides stay in its water too.
        count: Number of pairs.
        seed: Seed of starts, headings and times to depth.

    Raises:
        ForecastError: Too few glides stay in the water, or there is no level below the surface.
    """
    # a stream of its own: with the pings' the starts would be at pinged places
    rng = np.random.default_rng((seed, 1))
    depth = min(_TARGET_DEPTH, float(flow.grid.levels[-1]), float(grid.levels[-1]))
    if not depth > 0.0:
        raise ForecastError(
            f"a glide needs levels below the surface, but the deepest is at {depth:g} m; choose others with --levels"
        )
    pairs: list[Pair] = []
    for _ in range(_MAX_DRAWS):
        paths = _glides(flow, random_places(field, count, rng), depth, rng)
        where = to_geographic(flow.grid.projection, paths[..., 0], paths[..., 1])
        kept = np.ones(count, dtype=np.bool_)
        for each in (flow.grid, grid):
            local = np.stack([*to_local(each.projection, *where), paths[..., 2]], axis=-1)
            inside = wet_above(each, local) & inside_grid(each, local[..., 0], local[..., 1])
            kept &= inside.all(axis=0)
        starts, targets = (
            [
                Place(lon, lat, at)
                for lon, lat in zip(*(axis[end, kept].tolist() for axis in where), strict=True)
            ]
            for end, at in ((0, 0.0), (-1, depth))
        )
        pairs += zip(starts, targets, strict=True)
        if len(pairs) >= count:
            return tuple(pairs[:count])
    hours = " to ".join(f"{seconds / 3600:g}" for seconds in _TIME_TO_DEPTH)
    raise ForecastError(
        f"found {len(pairs)} of {count} glides of {hours} h to {depth:g} m that stay in the truth's water; use a larger region or shorter "
        "missions"
    )


def _glides(flow: FlowEstimate, start: Array, depth: float, rng: np.random.Generator) -> Array:
    """Return random glides from the surface to a depth [m], shape (steps + 1, n, 3) [m], by RK4 in equal steps.

    Args:
        flow: Current.
        start: shape (n, 2) [m], local east and north.
        depth: Depth at the end [m].
        rng: Generator of headings and times to depth.
    """
    heading = rng.uniform(0.0, 2.0 * np.pi, len(start))
    duration = rng.uniform(*_TIME_TO_DEPTH, len(start))
    down = depth / duration
    along = np.sqrt(_SPEED**2 - down**2)
    through_water = np.column_stack([along * np.sin(heading), along * np.cos(heading), down])

    def over_ground(position: Array) -> Array:
        current = np.zeros(position.shape)
        current[:, :2] = flow.velocity(*position.T)
        return through_water + current

    path, step = [np.column_stack([start, 0.0 * down])], (duration / _STEPS)[:, None]
    for _ in range(_STEPS):
        slopes = [over_ground(path[-1])]
        for part in (0.5, 0.5, 1.0):
            slopes.append(over_ground(path[-1] + part * step * slopes[-1]))
        path.append(path[-1] + step * np.tensordot([1 / 6, 1 / 3, 1 / 3, 1 / 6], slopes, 1))
    return np.array(path)
