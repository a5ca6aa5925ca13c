"""A mission's slow twin: its legs integrated by an adaptive method in the flow itself."""

from itertools import pairwise

import numpy as np
from pyproj import Geod
from scipy.integrate import solve_ivp

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic, to_local

ELLIPSOID = Geod(ellps="WGS84")


def fly_leg_slowly(
    flow: FlowEstimate,
    start: Array,
    heading: float,
    angle: float,
    speed: float,
    yo_depths: tuple[float, ...],
) -> Array:
    """Return where a leg ends, shape (2,) [m].

    Args:
        flow: The current.
        start: shape (2,) [m].
        heading: Held by a compass, from true north [rad].
        angle: Glide angle [rad].
        speed: Through water [m/s].
        turns: Depths at which it begins, turns and ends [m].
    """
    through = speed * np.cos(angle) * np.array([np.sin(heading), np.cos(heading)])
    place, frame = start, flow.grid.projection
    for depth, next_depth in pairwise(yo_depths):
        down = np.sign(next_depth - depth) * speed * np.sin(angle)

        def rate(time: float, at: Array, depth: float = depth, down: float = down) -> Array:
            longitude, latitude = to_geographic(frame, *at)
            water = rotate_to_geographic(
                frame, longitude, latitude, *flow.velocity(at[0], at[1], depth + down * time)
            )
            east, north = through + np.array(water)
            # a second on the ellipsoid
            there = ELLIPSOID.fwd(
                longitude, latitude, np.rad2deg(np.arctan2(east, north)), np.hypot(east, north)
            )[:2]
            return np.array(to_local(frame, *there)) - at

        lasts = (next_depth - depth) / down
        place = solve_ivp(rate, (0.0, lasts), place, rtol=1e-9, atol=1e-4, max_step=lasts / 60).y[
            :, -1
        ]
    return place
