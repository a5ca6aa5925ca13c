"""Estimates with islands and forbidden areas drawn at random, and a start and goal on either side of one."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Grid
from replay_kit.estimator.basis.embedding import embed
from replay_kit.studies.planning.flights import Polygon, corners_of, crossed, polygon_of
from replay_kit.studies.twins.reachable import Pair, place_at

_ISLANDS, _AREAS = (1, 5), (1, 4)  # at least, and fewer than
_ISLAND_RADII = (0.6, 1.8)  # cells, of the two axes
_AREA_RADII = (4e3, 12e3)  # m, of the corners
_CORNERS = (5, 10)
_AWAY = (8e3, 22e3)  # m, start and goal from what lies between
# Start and goal keep this distance from land and areas [m]; the planner's own margin is less.
_CLEAR = 500.0
_MAX_DRAWS = 400


@dataclass(frozen=True, slots=True, eq=False)
class Masked:
    """One case.

    Attributes:
        flow: The estimate among islands.
        areas: Longitudes and latitudes of their corners [degrees].
        pair: Start and goal at the surface, both in water and out of the areas.
        blocked: Whether the straight line between them is.
    """

    flow: FlowEstimate
    areas: tuple[Polygon, ...]
    pair: Pair
    blocked: bool


def with_land(flow: FlowEstimate, dry: NDArray[np.bool_], nugget: float) -> FlowEstimate:
    """Return a flow without uncertainty with more land; at the other grid points the current is unchanged.

    Args:
        flow: The flow.
        dry: shape (J, I), points that become land at all levels.
        nugget: Of the fit to what is left, as in ``EstimatorConfig``.
    """
    grid = replace(flow.grid, wet=flow.grid.wet & ~dry)
    # latents of neighbours cancel each other, so they cannot be dropped: the current is fitted again to the remaining points
    left = flow.horizontal.velocity(grid.nodes, flow.latent).reshape(2 * len(grid.nodes), -1)
    functions = flow.horizontal.at_nodes(grid.nodes)
    latent = embed(functions, grid.nodes, left, nugget)
    return replace(
        flow.mean_flow(),
        grid=grid,
        horizontal=functions,
        latent=latent,
        modes=np.empty((len(latent), 0)),
    )


def draw_masked(
    flow: FlowEstimate, depth: float, nugget: float, rng: np.random.Generator
) -> Masked:
    """Return an estimate with islands and areas, and start and goal of a mission on two sides of one of them.

    Args:
        flow: The estimate.
        depth: Of the dives [m].
        nugget: As for ``with_land``.
        rng: Source of everything.

    Raises:
        ForecastError: Hardly any place is left.
    """
    masked = with_land(flow, _islands(flow.grid, rng), nugget)
    areas = tuple(_area(masked.grid, rng) for _ in range(rng.integers(*_AREAS)))
    start, goal = _ends(masked.grid, areas, depth, rng)
    blocked = crossed(masked.grid, areas, np.vstack([start, goal])) is not None
    return Masked(
        masked, areas, Pair(place_at(masked.grid, start), place_at(masked.grid, goal)), blocked
    )


def _islands(grid: Grid, rng: np.random.Generator) -> NDArray[np.bool_]:
    row, column = np.indices(grid.east.shape)
    dry = np.zeros(grid.east.shape, dtype=bool)
    for _ in range(rng.integers(*_ISLANDS)):
        at, turn, radii = (
            rng.uniform(0.0, grid.east.shape),
            rng.uniform(0.0, np.pi),
            rng.uniform(*_ISLAND_RADII, 2),
        )
        y, x = row - at[0], column - at[1]
        along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        dry |= (along / radii[0]) ** 2 + (across / radii[1]) ** 2 <= 1.0
    return dry


def _inside(grid: Grid, rng: np.random.Generator) -> Array:
    low, high = (np.array([f(grid.east), f(grid.north)]) for f in (np.min, np.max))
    return np.asarray(rng.uniform(0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high))


def _area(grid: Grid, rng: np.random.Generator) -> Polygon:
    """Return a star-shaped polygon."""
    bearings = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(*_CORNERS)))
    radii, centre = rng.uniform(*_AREA_RADII, bearings.size), _inside(grid, rng)
    return polygon_of(
        grid, centre + radii[:, None] * np.column_stack([np.sin(bearings), np.cos(bearings)])
    )


def _ends(
    grid: Grid, areas: tuple[Polygon, ...], depth: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return two places, shape (3,) [m] each, at the dives' depth, that are clear all around, on two sides of an island or an area."""
    around = _CLEAR * np.array([(np.sin(b), np.cos(b)) for b in np.linspace(0.0, 2.0 * np.pi, 9)])
    land = ~grid.wet[0]
    hazards = np.vstack(
        [
            np.column_stack([grid.east[land], grid.north[land]]),
            *(corners_of(grid, area).mean(axis=0) for area in areas),
        ]
    )
    for _ in range(_MAX_DRAWS):
        bearing, away = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_AWAY, 2)
        centre, way = (
            hazards[rng.integers(len(hazards))],
            np.array([np.sin(bearing), np.cos(bearing)]),
        )
        ends = centre - away[0] * way, centre + away[1] * way
        circles = [np.column_stack([end + around, np.full(len(around), depth)]) for end in ends]
        if all(crossed(grid, areas, circle) is None for circle in circles):
            return np.append(ends[0], depth), np.append(ends[1], depth)
    raise ForecastError(
        "islands and areas leave hardly any place to go between; use a larger region"
    )
