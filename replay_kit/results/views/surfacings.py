"""Ellipses of predicted surfacings, as outlines for a map."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Projection
from replay_kit.core.surfacing import Ellipse


def outlines_of(surfacings: Any, projection: Projection) -> list[Array]:
    """Return the outlines of the ellipses of surfacings that have one, each as ``Ellipse.outline``.

    Args:
        surfacings: ``Result.surfacings``.
        projection: The local frame.
    """
    rows = (
        surfacings[np.isfinite(surfacings["ellipse_major"].astype(float))]
        if len(surfacings)
        else surfacings
    )
    return [
        Ellipse(
            row.ellipse_longitude,
            row.ellipse_latitude,
            row.ellipse_major,
            row.ellipse_minor,
            row.ellipse_bearing,
        ).outline(projection)
        for row in rows.itertuples()
    ]
