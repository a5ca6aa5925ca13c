"""Truths of experiments, given or members left out of the ensemble, and goals reachable in them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import distance, inside_grid, to_geographic, to_local, wet_above
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.plan import Place
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import random_places


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """Truth and an ensemble independent of it.

    Attributes:
        member: Index of the member left out; None if the truth is another file.
        truth: Ensemble of one.
        ensemble: Other members.
    """

    member: int | None
    truth: Ensemble
    ensemble: Ensemble


def leave_out(ensemble: Ensemble, member: int) -> Case:
    """Return the case with a member, by index from 0, as truth.

    Raises:
        ConfigError: The member does not exist, or too few remain.
    """
    if not 0 <= member < ensemble.n_members:
        raise ConfigError(
            f"--leave-out: expected 0 to {ensemble.n_members - 1}, got {member}; the ensemble has {ensemble.n_members} members"
        )
    if ensemble.n_members < 3:
        raise ConfigError(
            f"--leave-out: an ensemble of at least 3 members is needed, got {ensemble.n_members}"
        )
    left = np.delete(ensemble.velocity, member, axis=0)
    truth = Ensemble(
        ensemble.grid,
        ensemble.velocity[member : member + 1],
        ensemble.time_ns,
        f"{ensemble.source}#{member}",
    )
    return Case(member, truth, replace(ensemble, velocity=left, members=()))


def members_named(text: str, n_members: int) -> tuple[int, ...]:
    """Return the indices in ``--leave-out``: comma-separated, or ``all``.

    Raises:
        ConfigError: An index is invalid or repeated.
    """
    if text == "all":
        return tuple(range(n_members))
    names = [name.strip() for name in text.split(",")]
    if not all(name.isdecimal() for name in names) or len(set(names)) < len(names):
        raise ConfigError(
            f"--leave-out: expected positions from 0 with commas between them, each once, all or most-distant, got '{text}'"
        )
    return tuple(int(name) for name in names)


def most_distant(ensemble: Ensemble) -> int:
    """Return the index of the member farthest from the mean of the others, in RMS over wet points."""
    anomalies = (ensemble.velocity - ensemble.velocity.mean(axis=0))[:, :, ensemble.grid.wet]
    # the distance from the mean of the others is the distance from the mean of all times E / (E - 1)
    return int(np.argmax(np.sum(anomalies**2, axis=(1, 2))))


def cases(ensemble: Ensemble, truth: Ensemble | None, which: str | None) -> Iterator[Case]:
    """Yield the cases of an experiment.

    Args:
        ensemble: All members.
        truth: Separate truth; None to leave members out.
        which: ``all``, ``most-distant`` or comma-separated member indices from 0; None with a truth.

    Raises:
        ConfigError: Both or none are given, or the member does not exist.
    """
    if (truth is None) == (which is None):
        raise ConfigError("give one of --truth and --leave-out")
    if truth is not None:
        yield Case(None, truth, ensemble)
    elif which == "most-distant":
        yield leave_out(ensemble, most_distant(ensemble))
    elif which is not None:
        yield from (
            leave_out(ensemble, member) for member in members_named(which, ensemble.n_members)
        )


SPEED = 0.3  # m/s, through water
TARGET_DEPTH = 500.0  # m
# Shortest and longest time to the target's depth [s]: some 13 to 50 km through water, the distances of a glider's waypoints.
_TIME_TO_DEPTH = (12.0 * 3600.0, 48.0 * 3600.0)
_STEPS = 100
_MAX_DRAWS = 100


@dataclass(frozen=True, slots=True)
class Pair:
    """Start at the surface and target that a flight in the truth reaches."""

    start: Place
    target: Place

    @property
    def distance(self) -> float:
        """Horizontal distance from start to target [m]."""
        return float(
            distance(
                self.start.longitude,
                self.start.latitude,
                self.target.longitude,
                self.target.latitude,
            )
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
    depth = min(TARGET_DEPTH, float(flow.grid.levels[-1]), float(grid.levels[-1]))
    if not depth > 0.0:
        raise ForecastError(
            f"a glide needs levels below the surface, but the deepest is at {depth:g} m; choose others with --levels"
        )
    pairs: list[Pair] = []
    for _ in range(_MAX_DRAWS):
        paths = _glides(field, flow, count, depth, rng)
        longitude, latitude = to_geographic(flow.grid.projection, paths[..., 0], paths[..., 1])
        wet = [in_water(each, longitude, latitude, paths[..., 2]) for each in (flow.grid, grid)]
        kept = np.flatnonzero(np.all(wet, axis=0))
        starts, targets = (
            [Place(float(longitude[end, k]), float(latitude[end, k]), at) for k in kept]
            for end, at in ((0, 0.0), (-1, depth))
        )
        pairs += map(Pair, starts, targets)
        if len(pairs) >= count:
            return tuple(pairs[:count])
    hours = " to ".join(f"{seconds / 3600:g}" for seconds in _TIME_TO_DEPTH)
    raise ForecastError(
        f"found {len(pairs)} of {count} glides of {hours} h to {depth:g} m that stay in the truth's water; use a larger region or shorter "
        "missions"
    )


def _glides(
    field: Field, flow: FlowEstimate, count: int, depth: float, rng: np.random.Generator
) -> Array:
    """Return random glides from the surface to a depth [m], shape (steps + 1, n, 3) [m], local east, north and depth."""
    start = random_places(field, count, rng)
    heading = rng.uniform(0.0, 2.0 * np.pi, count)
    duration = rng.uniform(*_TIME_TO_DEPTH, count)
    down = depth / duration
    along = np.sqrt(SPEED**2 - down**2)
    through_water = np.column_stack([along * np.sin(heading), along * np.cos(heading), down])
    return fly_steadily(flow, np.column_stack([start, np.zeros(count)]), through_water, duration)


def fly_steadily(flow: FlowEstimate, start: Array, through_water: Array, duration: Array) -> Array:
    """Return the paths of constant velocities through water, shape (steps + 1, n, 3) [m], by vectorised RK4 in equal steps.

    Args:
        flow: Current.
        start: shape (n, 3) [m].
        through_water: shape (n, 3) [m/s].
        duration: shape (n,) [s].
    """

    def over_ground(position: Array) -> Array:
        return np.column_stack(
            [through_water[:, :2] + flow.velocity(*position.T), through_water[:, 2]]
        )

    path, step = [start], (duration / _STEPS)[:, None]
    for _ in range(_STEPS):
        at, slopes = path[-1], [over_ground(path[-1])]
        for part in (0.5, 0.5, 1.0):
            slopes.append(over_ground(at + part * step * slopes[-1]))
        path.append(at + step * np.tensordot([1 / 6, 1 / 3, 1 / 3, 1 / 6], slopes, 1))
    return np.array(path)


def in_water(grid: Grid, longitude: Array, latitude: Array, depth: Array) -> NDArray[np.bool_]:
    """Return the mask of paths, shape (steps, n), that stay inside a grid's outline and over its wet points, shape (n,)."""
    east, north = to_local(grid.projection, longitude, latitude)
    wet = wet_above(grid, np.stack([east, north, depth], axis=-1))
    return np.asarray(np.all(wet & inside_grid(grid, east, north), axis=0))
