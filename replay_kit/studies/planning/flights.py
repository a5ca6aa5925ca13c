"""Missions flown and paths checked by other code than the planner's: to draw goals that can be reached, and to check its paths."""

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.studies.planning.world import Withheld
from replay_kit.studies.twins.reachable import Pair, draw_reachable, fly_dives
from replay_kit.studies.twins.vehicle import random_places

Polygon = tuple[tuple[float, float], ...]
# Distance between the points of a path that are checked [m].
_SPACING = 10.0
# Glide angles that goals are drawn with [degrees]: some of a mission's range is left to the planner.
_DRAWN_ANGLES = (16.0, 25.0)
# Standard deviation of a mission's headings about a common one [rad].
_SCATTER = 0.3


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
