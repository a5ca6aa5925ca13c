"""Missions flown by another code than the planner's: to draw goals that can be reached, and to check its paths."""

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic, to_local
from replay_kit.core.plan import Place
from replay_kit.studies.planning.calls import Mission
from replay_kit.studies.planning.world import Withheld
from replay_kit.studies.twins.reachable import SPEED, Pair, in_water, rk4
from replay_kit.studies.twins.vehicle import random_places

# Glide angles that a mission may have, and those that goals are drawn with [degrees]: some of the range is left to the planner.
ANGLES = (15.0, 35.0)
_DRAWN_ANGLES = (16.0, 25.0)
# A mission's headings scatter by so much about one [rad].
_SCATTER = 0.3
_MAX_DRAWS = 50


def fly_dives(flow: FlowEstimate, start: Array, headings: Array, angles: Array, depth: float, steps: int = 20) -> Array:
    """Return where missions of one dive a leg lead in a current, shape (2 L steps + 1, n, 3) [m]: all at once, RK4, constant speed.

    Args:
        flow: The current.
        start: shape (n, 2) [m], local east and north, at the surface.
        headings: shape (n, L), clockwise from local north [rad].
        angles: shape (n, L), below the horizontal in dives, above it in climbs [rad].
        depth: Of the dives [m].
        steps: For each dive and each climb.
    """
    path = [np.column_stack([start, np.zeros(len(start))])]
    for heading, angle in zip(headings.T, angles.T, strict=True):
        along, down = SPEED * np.cos(angle), SPEED * np.sin(angle)
        for sign in (1.0, -1.0):
            through = np.column_stack([along * np.sin(heading), along * np.cos(heading), sign * down])

            def over_ground(position: Array, through: Array = through) -> Array:
                return np.column_stack([through[:, :2] + flow.velocity(*position.T), through[:, 2]])

            for _ in range(steps):
                path.append(rk4(over_ground, path[-1], (depth / down / steps)[:, None]))
    return np.array(path)


def fly_plan(flow: FlowEstimate, mission: Mission, depth: float) -> Array:
    """Return where a plan's headings and glide angles lead in a current, shape (n, 3) [m], local east, north, depth."""
    projection = flow.grid.projection
    begins = np.vstack([[mission.start.longitude, mission.start.latitude], mission.surfacings[:-1]])
    headings = np.deg2rad(mission.headings_deg) + grid_bearing_of_true_north(projection, *begins.T)
    start = np.column_stack(to_local(projection, *begins[:1].T))
    return fly_dives(flow, start, headings[None], np.deg2rad(mission.glide_angles_deg)[None], depth)[:, 0]


def draw_missions(withheld: Withheld, flow: FlowEstimate, count: int, depth: float, legs: int, seed: int) -> tuple[Pair, ...]:
    """Return starts and goals at the surface, each goal the end of a mission of random headings flown in a current.

    The mission keeps to water that is as deep as its dives, in the grids of the current and of the forecast.

    Args:
        withheld: The truth, for places at its wet surface.
        flow: What they are flown in.
        count: Number of missions.
        depth: Of the dives [m].
        legs: Of each mission.
        seed: Of starts, headings and glide angles.

    Raises:
        ForecastError: Hardly any mission stays in the water.
    """
    # a stream of its own: neither the pings' places nor the glides'
    rng, pairs = np.random.default_rng((seed, 2, withheld.member)), []
    for _ in range(_MAX_DRAWS):
        start = random_places(withheld.field, count, rng)
        headings = rng.uniform(0.0, 2.0 * np.pi, (count, 1)) + _SCATTER * rng.standard_normal((count, legs))
        angles = np.deg2rad(rng.uniform(*_DRAWN_ANGLES, (count, legs)))
        path = fly_dives(flow, start, headings, angles, depth)
        longitude, latitude = to_geographic(flow.grid.projection, path[..., 0], path[..., 1])
        deepest = np.full(longitude.shape, depth)
        kept = np.all([in_water(grid, longitude, latitude, deepest) for grid in (flow.grid, withheld.case.ensemble.grid)], axis=0)
        pairs += [
            Pair(Place(float(longitude[0, k]), float(latitude[0, k]), 0.0), Place(float(longitude[-1, k]), float(latitude[-1, k]), 0.0))
            for k in np.flatnonzero(kept)
        ]
        if len(pairs) >= count:
            return tuple(pairs[:count])
    raise ForecastError(
        f"found {len(pairs)} of {count} missions of {legs} dives to {depth:g} m that stay in water as deep; use a larger region, or fewer "
        "--legs"
    )
