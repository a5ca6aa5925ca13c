"""Where the vehicle was, and the ellipses of where it was predicted to surface."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.surfacing import Ellipse


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Positions of the vehicle by time; all arrays have the shape (n,).

    Attributes:
        time_ns: [ns, UTC], increasing.
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down; NaN when unknown.
        east: [m], local frame.
        north: [m], local frame.
        distance: Travelled since the first position [m].
        dead_reckoned: Whether a position was computed and not measured.
    """

    time_ns: NDArray[np.int64]
    longitude: Array
    latitude: Array
    depth: Array
    east: Array
    north: Array
    distance: Array
    dead_reckoned: NDArray[np.bool_]

    def at(self, time_ns: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Return east, north and the distance travelled [m] at times, between positions by interpolation; NaN without positions."""
        if self.time_ns.size == 0:
            nothing = np.full(np.shape(time_ns), np.nan)
            return nothing, nothing, nothing
        # of differences, as nanoseconds since 1970 exceed what a float64 holds
        seconds, asked = (self.time_ns - self.time_ns[0]) / 1e9, (time_ns - self.time_ns[0]) / 1e9
        east, north, distance = (
            np.interp(asked, seconds, values) for values in (self.east, self.north, self.distance)
        )
        return east, north, distance


def track_of(fixes: pd.DataFrame, projection: Projection) -> Track:
    """Return the track of the fixes of a result.

    Args:
        fixes: ``Result.fixes``.
        projection: The local frame.
    """
    order = np.argsort(fixes.index.to_numpy(), kind="stable")
    table = fixes.iloc[order]
    longitude, latitude = (
        table["longitude"].to_numpy(np.float64),
        table["latitude"].to_numpy(np.float64),
    )
    east, north = to_local(projection, longitude, latitude)
    steps = np.hypot(np.diff(east), np.diff(north))
    distance = np.concatenate([np.zeros(min(1, east.size)), np.cumsum(steps)])
    depth, reckoned = table["depth"].to_numpy(np.float64), table["dead_reckoned"].to_numpy(bool)
    time_ns = table.index.to_numpy().astype("datetime64[ns]").astype(np.int64)
    return Track(time_ns, longitude, latitude, depth, east, north, distance, reckoned)


def thinned(count: int, most: int) -> NDArray[np.intp]:
    """Return the positions of at most ``most`` of ``count`` values, evenly spread, the first and the last among them."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.intp))


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
