"""Global search before the optimiser: a fan of glides flown at once through a table of the flow.

The table is linear between its points, so a seed's distance is approximate; only the optimiser's starts come from here.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, minimum_filter

from planners.glide.transcription import Glide, GlideTask
from planners.hazards.domain import Region
from planners.track import rk4_step, velocity_through_water
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import depth_weights

# Table points for each kernel length, and at most how many along a side.
_PER_LENGTH, _MOST_POINTS = 3.0, 120


@dataclass(frozen=True, slots=True, eq=False)
class FlowTable:
    """A flow on a regular grid.

    Attributes:
        origin: shape (2,) [m], east and north of the first point.
        spacing: shape (2,) [m].
        depths: shape (D,) [m].
        velocity: shape (2, D, n_north, n_east) [m/s].
        allowed: shape (Z, n_north - 1, n_east - 1), True where a path may be at all four corners of a cell, between a level and the next.
        region: Where a path may be, point by point.
    """

    origin: Array
    spacing: Array
    depths: Array
    velocity: Array
    allowed: NDArray[np.bool_]
    region: Region

    def velocity_at(self, points: Array) -> Array:
        """Return the flow [m/s], shape (n, 3) with nothing downwards, at points, shape (n, 3) [m]; held constant outside the table."""
        column, row = ((points[:, :2] - self.origin) / self.spacing).T
        layer = np.interp(points[:, 2], self.depths, np.arange(self.depths.size, dtype=np.float64))
        u, v = (
            map_coordinates(component, [layer, row, column], order=1, mode="nearest")
            for component in self.velocity
        )
        return np.column_stack([u, v, np.zeros_like(u)])

    def allowed_at(self, points: Array) -> NDArray[np.bool_]:
        """Return whether a path may be at points, shape (n, 3) [m].

        It may within a cell whose four table points are all allowed. Others lie on an edge or a coast, or the start may be between it
        and the nearest table point: there the region itself is asked. A point that is not a number counts as allowed nowhere.
        """
        cells = np.array(self.allowed.shape[:0:-1])
        cell = np.floor((points[:, :2] - self.origin) / self.spacing)
        within = np.all((cell >= 0) & (cell < cells), axis=1)
        column, row = np.where(within[:, None], cell, 0.0).astype(int).T
        found = within & self.allowed[self.region.level_at(points[:, 2]), row, column]
        unsure = np.flatnonzero(~found & np.isfinite(points).all(axis=1))
        found[unsure] = self.region.allowed(points[unsure])
        return np.asarray(found)


def tabulate(flow: FlowEstimate, region: Region) -> FlowTable:
    """Return a flow on a regular grid over its region, three points a kernel length."""
    grid = flow.grid
    low = np.array([grid.east.min(), grid.north.min()])
    extent = np.array([grid.east.max(), grid.north.max()]) - low
    lengths = np.array([flow.horizontal.kernel.length_east, flow.horizontal.kernel.length_north])
    size = np.clip(np.ceil(extent / lengths * _PER_LENGTH).astype(int) + 1, 2, _MOST_POINTS)
    east, north = (np.linspace(low[i], low[i] + extent[i], size[i]) for i in (0, 1))
    points = np.stack(np.meshgrid(east, north), axis=-1)
    # Hats are linear between levels already; a Gaussian bends between them.
    finer = 1 if flow.depth_functions.kind == "hat" else 4
    depths = np.interp(
        np.arange((flow.levels.size - 1) * finer + 1) / finer,
        np.arange(flow.levels.size),
        flow.levels,
    )
    weights = depth_weights(flow.depth_functions, depths, flow.levels)
    rows = [flow.horizontal.velocity(row, flow.latent) for row in points]
    velocity = np.stack([row @ weights.T for row in rows], axis=1)
    allowed = region.inside_outline(points) & region.wet_by_level(points)
    allowed = allowed[:, 1:, 1:] & allowed[:, 1:, :-1] & allowed[:, :-1, 1:] & allowed[:, :-1, :-1]
    return FlowTable(
        low,
        extent / (size - 1),
        depths,
        np.ascontiguousarray(velocity.transpose(0, 3, 1, 2)),
        allowed,
        region,
    )


_N_HEADINGS, _N_TIMES, _N_DRIFTS, _N_STEPS = 90, 32, 8, 48


@dataclass(frozen=True, slots=True)
class Seed:
    """An initial guess for the optimiser.

    Attributes:
        glide: To its closest approach.
        distance: Closest approach [m].
    """

    glide: Glide
    distance: float


def find_seeds(task: GlideTask, count: int) -> list[Seed]:
    """Return the best distinct glides found, nearest to the goal first.

    Two fans over all headings are searched: glides that reach the goal's depth after some time, and glides of any steady depth rate
    for goals that no such glide can reach. Each local minimum of closest approach over a fan is one candidate.

    Args:
        task: The problem.
        count: Most seeds returned.
    """
    table, seeds = tabulate(task.flow, task.region), list[Seed]()
    for depth_rates, durations in _fans(
        table, task.start, task.goal, task.settings.speed, task.settings.max_duration
    ):
        if depth_rates.size:
            seeds += _search_fan(table, task, depth_rates, durations)
    return sorted(
        (seed for seed in seeds if np.isfinite(seed.distance)), key=lambda seed: seed.distance
    )[:count]


def _fans(
    table: FlowTable, start: Array, goal: Array, speed: float, max_duration: float
) -> list[tuple[Array, Array]]:
    """Return (vertical speeds [m/s], durations [s]) of the two fans."""
    to_goal = goal[2] - start[2]
    fastest = speed + float(np.nanmax(np.linalg.norm(table.velocity, axis=0), initial=0.0))
    # No glide arrives sooner than the strongest current could carry it.
    soonest = max(float(np.linalg.norm((goal - start)[:2])) / fastest, abs(to_goal) / speed, 1.0)
    times = (
        np.geomspace(soonest, max_duration, _N_TIMES)
        if soonest < max_duration
        else np.array([max_duration])
    )
    times = times[abs(to_goal) <= speed * times] if to_goal else np.empty(0)
    # Rates that use up the water column within the longest glide, and steeper ones; a horizontal glide among them.
    steeper = np.geomspace(1.0, 0.1, _N_DRIFTS) * max_duration
    rooms = [-start[2], table.region.deepest - start[2]]
    rates = np.concatenate([[0.0], *(room / steeper for room in rooms if room)])
    rates = np.unique(rates[np.abs(rates) < speed])
    room = np.where(rates > 0.0, rooms[1], rooms[0])
    lasting = np.full(rates.size, float(max_duration))
    np.divide(room, rates, out=lasting, where=rates != 0.0)
    lasting = np.minimum(lasting, max_duration)
    return [(to_goal / times, times), (rates, lasting)]


def _search_fan(
    table: FlowTable, task: GlideTask, depth_rates: Array, durations: Array
) -> list[Seed]:
    headings = np.linspace(0.0, 2.0 * np.pi, _N_HEADINGS, endpoint=False)
    angles = np.arcsin(np.clip(depth_rates / task.settings.speed, -1.0, 1.0))
    heading, angle = (a.ravel() for a in np.meshgrid(headings, angles, indexing="ij"))
    velocity = np.column_stack(velocity_through_water(np, heading, angle, task.settings.speed))
    time, distance = _fly_all(
        table, task.start, task.goal, velocity, np.tile(durations, headings.size)
    )
    by_heading = distance.reshape(headings.size, -1)
    # Headings are periodic; the other axis is not.
    lowest = minimum_filter(by_heading, size=3, mode=("wrap", "nearest")).ravel()
    # Glides that only lead away all have the distance of the start: the first of them represents all.
    useful = time > 0.0 if np.any(time > 0.0) else np.arange(time.size) == 0
    found = np.flatnonzero((distance <= lowest) & np.isfinite(distance) & useful)
    return [
        Seed(Glide(float(heading[i]), float(angle[i]), float(time[i])), float(distance[i]))
        for i in found
    ]


def _fly_all(
    table: FlowTable, start: Array, goal: Array, velocity: Array, duration: Array
) -> tuple[Array, Array]:
    """Return (time [s], distance [m]) of each glide's closest approach while it stays in allowed water; NaN flows give infinity."""
    step = (duration / _N_STEPS)[:, None]
    position = np.tile(start, (len(velocity), 1))
    best_distance = np.full(len(velocity), float(np.linalg.norm(start - goal)))
    best_time = np.zeros(len(velocity))
    alive = np.full(len(velocity), True)
    for i in range(_N_STEPS):
        first = velocity + table.velocity_at(position)
        after = rk4_step(lambda at: velocity + table.velocity_at(at), position, step, first)
        alive[alive] = table.allowed_at(after[alive])
        leg = after - position
        along = np.clip(
            np.sum((goal - position) * leg, axis=1) / np.maximum(np.sum(leg**2, axis=1), 1e-12),
            0.0,
            1.0,
        )
        distance = np.linalg.norm(position + along[:, None] * leg - goal, axis=1)
        better = alive & (distance < best_distance)
        best_distance[better], best_time[better] = (
            distance[better],
            ((i + along) * step[:, 0])[better],
        )
        position = after
    return best_time, np.where(np.isfinite(position).all(axis=1), best_distance, np.inf)
