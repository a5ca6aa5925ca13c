"""Track of the vehicle, ellipses of predicted surfacings, and the seabed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection, Seabed
from replay_kit.core.surfacing import Ellipse
from replay_kit.results.reader import ResultReader
from replay_kit.results.slices import grid_cells


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Positions of the vehicle through time; all arrays have the shape (n,).

    Attributes:
        time_ns: [ns, UTC], increasing.
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down; NaN when unknown.
        east: [m], local frame.
        north: [m], local frame.
        distance: Distance along the track [m].
        dead_reckoned: Whether a position was dead-reckoned.
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
        """Return east, north and distance along the track [m], interpolated at times; NaN without positions."""
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
    distance = along(east, north)
    depth, reckoned = table["depth"].to_numpy(np.float64), table["dead_reckoned"].to_numpy(bool)
    time_ns = table.index.to_numpy().astype("datetime64[ns]").astype(np.int64)
    return Track(time_ns, longitude, latitude, depth, east, north, distance, reckoned)


def along(east: Array, north: Array) -> Array:
    """Return the distance along a track since its first position [m]."""
    steps = np.hypot(np.diff(east), np.diff(north))
    return np.concatenate([np.zeros(min(1, east.size)), np.cumsum(steps)])


def outlines_of(surfacings: Any, projection: Projection) -> list[Array]:
    """Return the outlines of surfacings with an ellipse, see ``Ellipse.outline``.

    Args:
        surfacings: ``Result.surfacings``.
        projection: The local frame.
    """
    names = [f"ellipse_{name}" for name in ("longitude", "latitude", "major", "minor", "bearing")]
    known = surfacings.reindex(columns=names).astype(float).dropna()
    return [Ellipse(*row).outline(projection) for row in known.to_numpy().tolist()]


def published_seabed(reader: ResultReader) -> Seabed | None:
    """Return the seabed around the region in a result; None without one."""
    for _, value in reader.decoded("/plan/seabed"):
        east, north, fields = grid_cells(value)
        return Seabed(east, north, fields["depth"])
    return None
