"""Missions flown and paths checked by other code than the planner's: to draw goals that can be reached, and to check its paths."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import planners
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic, to_local
from replay_kit.core.grid import Grid
from replay_kit.studies.planning.world import Withheld
from replay_kit.studies.twins.reachable import Pair, draw_reachable, fly_dives, in_water
from replay_kit.studies.twins.vehicle import random_places

Polygon = tuple[tuple[float, float], ...]
# Distance between the points of a path that are checked [m].
_SPACING = 10.0
# Glide angles that goals are drawn with [degrees]: some of a mission's range is left to the planner.
_DRAWN_ANGLES = (16.0, 25.0)
# Standard deviation of a mission's headings about a common one [rad].
_SCATTER = 0.3


def fly_plan(flow: FlowEstimate, mission: planners.MissionPlan, depth: float) -> Array:
    """Return the path of a plan's headings and glide angles in a current, shape (n, 3) [m], local east, north, depth."""
    projection = flow.grid.projection
    places = np.vstack([[mission.start.longitude, mission.start.latitude], mission.surfacings])
    local = np.column_stack(to_local(projection, *places.T))
    # a compass holds headings of true north, which turns along a leg
    halfway = to_geographic(projection, *(0.5 * (local[1:] + local[:-1])).T)
    headings = np.deg2rad(mission.headings_deg) + grid_bearing_of_true_north(projection, *halfway)
    return fly_dives(
        flow, local[:1], headings[None], np.deg2rad(mission.glide_angles_deg)[None], depth
    )[:, 0]


def draw_missions(
    withheld: Withheld, flow: FlowEstimate, count: int, depth: float, legs: int, seed: int
) -> tuple[Pair, ...]:
    """Return starts and goals at the surface, each goal the end of a mission of random headings flown in a current.

    The mission keeps to water that is as deep as its dives, in the grids of the current and of the forecast.

    Args:
        withheld: The truth, for places at its wet surface.
        flow: The current that the missions are flown in.
        count: Number of missions.
        depth: Of the dives [m].
        legs: Of each mission.
        seed: Of starts, headings and glide angles.

    Raises:
        ForecastError: Hardly any mission stays in the water.
    """
    # a stream of its own: neither the pings' places nor the glides'
    rng = np.random.default_rng((seed, 2, withheld.member))

    def fly() -> Array:
        start = random_places(withheld.field, count, rng)
        headings = rng.uniform(0.0, 2.0 * np.pi, (count, 1)) + _SCATTER * rng.standard_normal(
            (count, legs)
        )
        return fly_dives(
            flow, start, headings, np.deg2rad(rng.uniform(*_DRAWN_ANGLES, (count, legs))), depth
        )

    grids = flow.grid, withheld.case.ensemble.grid
    return draw_reachable(
        fly, grids, count, f"missions of {legs} dives to {depth:g} m", 0.0, water_depth=depth
    )


def corners_of(grid: Grid, polygon: Polygon) -> Array:
    """Return the corners of a polygon of longitudes and latitudes in a grid's local frame, shape (n, 2) [m]."""
    return np.column_stack(to_local(grid.projection, *np.array(polygon).T))


def polygon_of(grid: Grid, corners: Array) -> Polygon:
    """Return the longitudes and latitudes of corners in a grid's local frame, shape (n, 2) [m]."""
    longitude, latitude = to_geographic(grid.projection, *corners.T)
    return tuple((float(x), float(y)) for x, y in zip(longitude, latitude, strict=True))


def ends_of(grid: Grid, pair: Pair) -> Array:
    """Return start and goal in a grid's local frame, shape (2, 2) [m]."""
    return corners_of(
        grid, tuple((end.longitude, end.latitude) for end in (pair.start, pair.target))
    )


def winds_around(corners: Array, points: Array) -> NDArray[np.bool_]:
    """Return which points, shape (n, 2), a polygon winds around, by the sum of the angles that its edges are seen under.

    Args:
        corners: shape (m, 2), the first not repeated.
        points: shape (n, 2).
    """
    total = np.zeros(len(points))
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        (x0, y0), (x1, y1) = (begin - points).T, (end - points).T
        total += np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    return np.asarray(np.abs(total) > np.pi)


def densely(track: Array, spacing: float = _SPACING) -> Array:
    """Return a path, shape (n, d) [m], with points between so that none are farther apart than a spacing [m]."""
    pieces = np.maximum(
        np.ceil(np.linalg.norm(np.diff(track, axis=0), axis=1) / spacing).astype(int), 1
    )
    number = np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(pieces))])
    return np.column_stack([np.interp(number, np.arange(len(track)), values) for values in track.T])


def crossed(grid: Grid, areas: Sequence[Polygon], track: Array) -> str | None:
    """Return what a path, shape (n, 3) [m], goes through: ``land`` (or out of the grid), ``area``; None when it keeps clear."""
    dense = densely(track)
    longitude, latitude = to_geographic(grid.projection, dense[:, 0], dense[:, 1])
    if not in_water(grid, longitude[:, None], latitude[:, None], dense[:, 2:])[0]:
        return "land"
    inside = [winds_around(corners_of(grid, area), dense[:, :2]).any() for area in areas]
    return "area" if any(inside) else None
