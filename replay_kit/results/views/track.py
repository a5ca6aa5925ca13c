"""Track of the vehicle, ellipses of predicted surfacings, and the last plan.

The plan has its track over the seabed, cost, odds and areas.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection, Seabed
from replay_kit.core.plan import Area, plan_legs
from replay_kit.core.surfacing import Ellipse, planned_ellipses
from replay_kit.results.reader import ResultReader
from replay_kit.results.result import ResultFile
from replay_kit.results.slices import grid_cells
from replay_kit.results.views.record import plan_statistics


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
    distance = _along(east, north)
    depth, reckoned = table["depth"].to_numpy(np.float64), table["dead_reckoned"].to_numpy(bool)
    time_ns = table.index.to_numpy().astype("datetime64[ns]").astype(np.int64)
    return Track(time_ns, longitude, latitude, depth, east, north, distance, reckoned)


def _along(east: Array, north: Array) -> Array:
    """Return the distance along a track since its first position [m]."""
    steps = np.hypot(np.diff(east), np.diff(north))
    return np.concatenate([np.zeros(min(1, east.size)), np.cumsum(steps)])


def thinned(count: int, most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of ``count`` indices, evenly spread, including the first and the last."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.intp))


def outlines_of(surfacings: Any, projection: Projection) -> list[Array]:
    """Return the outlines of surfacings with an ellipse, see ``Ellipse.outline``.

    Args:
        surfacings: ``Result.surfacings``.
        projection: The local frame.
    """
    names = [f"ellipse_{name}" for name in ("longitude", "latitude", "major", "minor", "bearing")]
    known = surfacings.reindex(columns=names).astype(float).dropna()
    return [Ellipse(*row).outline(projection) for row in known.to_numpy().tolist()]


_ODDS = ("reached", "safe", "radius", "deadline", "arrival_median", "arrival_90_percent")


@dataclass(frozen=True, slots=True, eq=False)
class LastPlan:
    """Last plan of a result.

    Attributes:
        row: Single values, the last row of ``Result.plans``.
        track: Rows of ``Result.plan_tracks``; empty if it failed.
        east: shape (n,) [m], track in the local frame.
        north: shape (n,) [m], track in the local frame.
        start: shape (2,) [m], local frame.
        goal: shape (2,) [m], local frame.
        statistics: Solver statistics by name.
        legs: Legs of a mission; empty for a glide.
        ellipses: Outlines of the surfacing ellipses, each shape (k, 2) [m], the last point equal to the first.
        areas: Areas that it avoids.
    """

    row: Any
    track: pd.DataFrame
    east: Array
    north: Array
    start: Array
    goal: Array
    statistics: Mapping[str, str]
    legs: Sequence[Mapping[str, Any]]
    ellipses: Sequence[Array]
    areas: Sequence[Area]

    @property
    def along(self) -> Array:
        """Distance along the track [m], shape (n,)."""
        return _along(self.east, self.north)

    @property
    def bottom(self) -> Array | None:
        """Seabed depth under the track [m], shape (n,); None without a bathymetry."""
        depth = self.track["bottom"].to_numpy(np.float64)
        return depth if np.isfinite(depth).any() else None

    @property
    def energy(self) -> float | None:
        """Energy used [J]; None if not in the result."""
        return _positive(self.row["energy"])

    @property
    def battery(self) -> float | None:
        """Energy of the battery [J]; None if not stated."""
        return _positive(self.row["battery"])

    @property
    def odds(self) -> Mapping[str, float] | None:
        """Figures of its simulated flights: ``n_samples``, fractions and misses [m]; None without samples."""
        count = _positive(self.row["odds_n_samples"])
        return (
            None
            if count is None
            else {
                "n_samples": int(count),
                **{name: float(self.row[f"odds_{name}"]) for name in _ODDS},
            }
        )


def last_plan(result: ResultFile, projection: Projection) -> LastPlan | None:
    """Return the last plan of a result; None without plans.

    Args:
        result: The result.
        projection: Its local frame.
    """
    if not len(result.plans):
        return None
    row, tracks = result.plans.iloc[-1], result.plan_tracks
    track = tracks[tracks["plan"] == len(result.plans) - 1]
    east, north = to_local(projection, track["longitude"], track["latitude"])
    start, goal = (
        np.array(to_local(projection, row[f"{end}_longitude"], row[f"{end}_latitude"]))
        for end in ("start", "goal")
    )
    # an unfinished result has none, one of an earlier version that of each plan
    drawn = next(result.reader.decoded("/plan/geojson", newest=True), None)
    statistics = plan_statistics(result)
    legs = plan_legs(statistics)
    ellipses = [ellipse.outline(projection) for ellipse in planned_ellipses(legs)]
    return LastPlan(
        row,
        track,
        east,
        north,
        start,
        goal,
        statistics,
        legs,
        ellipses,
        _areas(json.loads(drawn[1].geojson)) if drawn else [],
    )


def published_seabed(reader: ResultReader) -> Seabed | None:
    """Return the seabed around the region in a result; None without one."""
    for _, value in reader.decoded("/plan/seabed"):
        east, north, fields = grid_cells(value)
        return Seabed(east, north, fields["depth"])
    return None


def _areas(geojson: Mapping[str, Any]) -> list[Area]:
    held = ((one["properties"], one["geometry"]["coordinates"][0]) for one in geojson["features"])
    return [
        Area(about["name"], about["surface_only"], tuple((x, y) for x, y in ring[:-1]))
        for about, ring in held
        if about.get("kind") == "no_go"
    ]


def _positive(value: float) -> float | None:
    """Return a number above 0; None if unknown, 0 in results of earlier versions."""
    return float(value) if np.isfinite(value) and value > 0.0 else None
