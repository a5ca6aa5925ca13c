"""Ellipses of predicted surfacings, as outlines for a map."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_local
from replay_kit.core.grid import Projection

_POINTS = 49


def ellipse_outline(projection: Projection, centre: tuple[float, float], semi_axes: Sequence[float], bearing_deg: float) -> Array:
    """Return the outline of an ellipse in the local frame, shape (n, 2) [m], its last point the first.

    Args:
        projection: The local frame.
        centre: Longitude and latitude [degrees].
        semi_axes: Major and minor [m].
        bearing_deg: Of the major axis, clockwise from true north.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    bearing = np.deg2rad(bearing_deg) + float(grid_bearing_of_true_north(projection, *centre))
    along, across = semi_axes[0] * np.cos(turn), semi_axes[1] * np.sin(turn)
    east, north = to_local(projection, *centre)
    return np.column_stack(
        [east + along * np.sin(bearing) + across * np.cos(bearing), north + along * np.cos(bearing) - across * np.sin(bearing)]
    )


def outlines_of(surfacings: Any, projection: Projection) -> list[Array]:
    """Return the outlines of the ellipses of surfacings that have one.

    Args:
        surfacings: ``Result.surfacings``.
        projection: The local frame.
    """
    rows = surfacings[np.isfinite(surfacings["ellipse_major"].astype(float))] if len(surfacings) else surfacings
    return [
        ellipse_outline(
            projection, (row.ellipse_longitude, row.ellipse_latitude), (row.ellipse_major, row.ellipse_minor), row.ellipse_bearing
        )
        for row in rows.itertuples()
    ]
