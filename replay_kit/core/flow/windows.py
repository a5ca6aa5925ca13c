"""Estimates of several windows as one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.flow.field import FlowField
from replay_kit.core.flow.points import Velocities, velocity_at


def best_velocity_at(
    flows: Sequence[FlowField], longitude: ArrayLike, latitude: ArrayLike, depth: ArrayLike
) -> Velocities:
    """Return velocities at points, each from the estimate with the least standard error there; NaN where none holds it.

    Windows overlap: near the side of one that the vehicle had left, another knows the current better.

    Args:
        flows: At least one, each with its uncertainty; of equal ones the later counts.
        longitude: [degrees east], any shape; the three broadcast together.
        latitude: [degrees north].
        depth: [m], positive down.
    """
    found = [velocity_at(flow, longitude, latitude, depth) for flow in reversed(flows)]
    errors = np.array([np.hypot(one.u_standard_error, one.v_standard_error) for one in found])
    best = np.argmin(np.where(np.isnan(errors), np.inf, errors), axis=0)
    names = ("time", "estimate_time", "u", "v", "u_standard_error", "v_standard_error")
    chosen = (
        np.take_along_axis(np.array([getattr(one, name) for one in found]), best[None], axis=0)[0]
        for name in names
    )
    return Velocities(found[0].longitude, found[0].latitude, found[0].depth, *chosen)
