"""Velocities of a flow, or of several windows' estimates, at geographic points and along tracks."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.arrays import Array, Mask, Times
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import checked_depth
from replay_kit.core.geodesy import inside_grid, nearest_node, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.words.quantities import to_time_ns
from replay_kit.core.words.text import place_text, span_text, time_text

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


#: A vehicle's pressure sensor may read so far above the surface when it lies there [m].
WASHED = 1.0
KnownAt = Callable[[Grid, Array, Array, Array], Mask]
_NO_TIME, _NAT = "no time", np.iinfo(np.int64).min
# Columns of a table of velocities; the first five are coordinates.
_COORDINATES = ["time", "longitude", "latitude", "depth", "estimate_time"]
_VALUES = ["u", "v", "u_standard_error", "v_standard_error"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Velocities:
    """Velocities at points, towards true east and true north; all arrays have the shape of the points.

    Velocity and standard error are NaN outside the region, on land and below the last level.

    Attributes:
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
        time: Requested or track time, datetime64[ns], UTC; NaT when unknown.
        estimate_time: Valid time of the velocity, datetime64[ns], UTC; along a track before the last observation the time of that, for a
            constant estimate its own.
        u: Eastward velocity [m/s].
        v: Northward velocity [m/s].
        u_standard_error: [m/s]; NaN when the flow has no uncertainty.
        v_standard_error: [m/s].
        about: Global attributes of its dataset.
    """

    longitude: Array
    latitude: Array
    depth: Array
    time: NDArray[np.datetime64]
    estimate_time: NDArray[np.datetime64]
    u: Array
    v: Array
    u_standard_error: Array
    v_standard_error: Array
    about: Mapping[str, str] = field(default_factory=dict, kw_only=True)

    def __repr__(self) -> str:
        """Return extent, velocities and standard errors as text."""
        known, depths = np.isfinite(self.u), f"{span_text(self.depth)} m deep"
        asked, held = _ends(self.time), _ends(self.estimate_time)
        times = asked if held in (asked, _NO_TIME) else f"{asked} (estimate for {held})"
        if known.shape == ():
            place = place_text(float(self.longitude), float(self.latitude))
            where = f"Velocity at {place}, {depths}, {times}"
            u, v = (
                f"{value:.3f} +- {error:.3f}" if np.isfinite(error) else f"{value:.3f}"
                for value, error in (
                    (self.u, self.u_standard_error),
                    (self.v, self.v_standard_error),
                )
            )
            values = f"u {u}, v {v} m/s"
        else:
            where = f"Velocities at {known.size} points {known.shape}, {depths}, {times}"
            errors = span_text([self.u_standard_error, self.v_standard_error], 2)
            values = (
                f"u {span_text(self.u, 2)}, v {span_text(self.v, 2)}, standard error {errors} m/s"
            )
        text = f"{where}\n  {values} (true east, true north)"
        if known.all():
            return text
        return f"{text}\n  {np.sum(~known)} of {known.size} outside the region, on land or below the last level: NaN"

    def _columns(self) -> dict[str, Array]:
        return {name: np.ravel(getattr(self, name)) for name in _COORDINATES + _VALUES}

    def to_xarray(self) -> "xr.Dataset":
        """Return a CF dataset on the dimension ``point``."""
        from replay_kit.core.flow.dataset import dataset_of_points

        return dataset_of_points(self._columns(), _COORDINATES, self.about)

    def to_og1(self, platform: str, **stated: str) -> "xr.Dataset":
        """Return a trajectory after OG1.0 (OceanGliders), on the dimension ``N_MEASUREMENTS``, without attributes that are not stated.

        Args:
            platform: Serial number of the glider with its prefix, such as ``sg033``.
            **stated: Metadata: ``PLATFORM_MODEL`` and ``WMO_IDENTIFIER``, and global attributes such as ``contributor_name``.

        Raises:
            EstimatorError: There is no point, or the time of one is unknown.
        """
        from replay_kit.core.flow.dataset import trajectory

        return trajectory(self._columns(), platform, stated, self.about)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a table with a row per point."""
        from pandas import DataFrame

        return DataFrame(self._columns())


def _ends(dates: NDArray[np.datetime64]) -> str:
    """Return the first and the last date as text, once if they are equal."""
    times = dates[~np.isnat(dates)].astype(np.int64)
    if not times.size:
        return _NO_TIME
    return " to ".join(dict.fromkeys(time_text(int(end)) for end in (times.min(), times.max())))


def known_at(grid: Grid, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Mask:
    """Return whether a flow on a grid is known at points: ``wet_at``, and inside the grid's outline."""
    return wet_at(grid, east, north, depth) & inside_grid(grid, east, north)


def wet_at(grid: Grid, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Mask:
    """Return True where the nearest grid point at the nearest level is wet and the point lies inside the grid and its levels.

    Points farther than half a cell's diagonal from every grid point are not wet. Depths above the first level count as the first level;
    below the last level nothing is wet.

    Args:
        grid: The grid.
        east: [m], local frame; the three broadcast together. Values that are not finite are off the grid.
        north: [m], local frame.
        depth: [m], positive down.
    """
    places = np.stack(np.broadcast_arrays(east, north), axis=-1)
    number = nearest_node(grid, places)
    points = np.column_stack([grid.east.ravel(), grid.north.ravel()])
    distance = np.hypot(*(places - points[number]).T).T
    depth = np.asarray(depth, dtype=np.float64)
    level = np.argmin(np.abs(depth[..., None] - grid.levels), axis=-1)
    # A hair more than the half diagonal, so that the corners shared by four cells belong to one; a single row has no cells.
    cell = [float(np.max(grid.steps(axis), initial=0.0)) for axis in (0, 1)]
    on_grid = distance <= 0.5 * np.hypot(cell[0], cell[1]) * (1.0 + 1e-6)
    wet = grid.wet.reshape(grid.levels.size, -1)[level, number]
    return np.asarray(wet & on_grid & (depth <= grid.levels[-1]))


def best_velocity_at(
    flows: Sequence[FlowEstimate],
    longitude: ArrayLike,
    latitude: ArrayLike,
    depth: ArrayLike,
    time: Any = None,
) -> Velocities:
    """Return velocities at points, each from the estimate with the least standard error; NaN outside all.

    Windows overlap: near the edge of one, another may be more accurate.

    Args:
        flows: At least one; several need uncertainties, and the later of equal ones counts.
        longitude: [degrees east], any shape; the four broadcast together.
        latitude: [degrees north].
        depth: [m], positive down.
        time: See ``FlowEstimate.velocity_at``, also for errors and warnings.
    """
    asked, latest = own_or(time), max(flow.last_observation_ns or 0 for flow in flows)
    if time is not None:
        for flow in flows:
            flow.require_model_of_time()
        if asked.size and asked.min() < latest:
            raise EstimatorError(
                f"time: {time_text(int(asked.min()))} is before the last observation of the estimate, {time_text(latest)}; expected that "
                "time or a later one: leave time out for the estimate's own, or look back with smooth and export --at"
            )
    found = velocities(flows, longitude, latitude, checked_depth(depth), asked)
    warn_outside(flows, found.time, 4)
    return found


def velocity_along(flow: FlowEstimate, track: Any) -> Velocities:
    """Return the velocities along a track; see ``FlowEstimate.along``."""
    if not hasattr(track, "keys"):
        kind = type(track).__name__
        raise EstimatorError(
            f"track: expected a table, dataset or mapping with longitude, latitude, depth and perhaps time, got {kind}"
        )
    place = ("longitude", "latitude", "depth")
    if missing := [name for name in place if name not in track]:
        raise EstimatorError(
            f"track: expected longitude, latitude, depth and perhaps time, but {', '.join(missing)} is missing"
        )
    index = getattr(track, "index", None)
    time = track.get("time", index if getattr(index, "name", None) == "time" else None)
    longitude, latitude, depth = (track[name] for name in place)
    return velocities([flow], longitude, latitude, checked_depth(depth, WASHED), own_or(time))


def own_or(time: Any) -> Times:
    """Return times [ns, UTC] as ``to_time_ns``; NaT, a flow's own time, for None."""
    return np.array(_NAT) if time is None else to_time_ns(time)


def velocities(
    flows: Sequence[FlowEstimate],
    longitude: ArrayLike,
    latitude: ArrayLike,
    depth: Array,
    time_ns: Times,
    known_at: KnownAt = known_at,
) -> Velocities:
    """Return velocities at points, each from the flow with the least standard error.

    Times before an estimate's last observation count as that observation's; a constant estimate holds for its own time.

    Args:
        flows: At least one.
        longitude: [degrees east]; the four broadcast together.
        latitude: [degrees north].
        depth: [m], positive down.
        time_ns: Times as returned by ``own_or``.
        known_at: Returns whether a flow is known at local points; elsewhere velocities are NaN.
    """
    # on a grid many points lie over one place
    places = np.broadcast_arrays(*(np.asarray(axis, np.float64) for axis in (longitude, latitude)))
    if np.any(np.abs(places[1]) > 90.0):
        raise EstimatorError(
            f"latitude: expected -90 to 90 degrees, got {span_text(latitude)}; the order is longitude, latitude, depth"
        )

    def values_of(flow: FlowEstimate) -> tuple[NDArray[Any], ...]:
        """Return requested and valid times [ns, UTC], velocities and standard errors."""
        at = [*to_local(flow.grid.projection, *places), np.maximum(depth, 0.0)]
        valid = _NAT if flow.time_ns is None else flow.time_ns
        asked = np.where(time_ns == _NAT, valid, time_ns)
        *at, known, asked = np.broadcast_arrays(*at, known_at(flow.grid, *at), asked)
        held = np.full_like(asked, valid)
        if flow.process is not None:
            held = np.maximum(asked, flow.last_observation_ns or asked)
        values = np.full((*held.shape, 4), np.nan)
        for time in np.unique(held).tolist():
            here, now = known & (held == time), flow if time == valid else flow.at(time)
            east, north, down = (axis[here] for axis in at)
            values[here, :2] = now.velocity(east, north, down, True)
            if now.n_modes:
                values[here, 2:] = now.variance(east, north, down, True) ** 0.5
        return asked, held, *np.moveaxis(values, -1, 0)

    found = [values_of(flow) for flow in reversed(flows)]
    errors = np.array([np.hypot(u_error, v_error) for *_, u_error, v_error in found])
    best = np.argmin(np.where(np.isnan(errors), np.inf, errors), axis=0)[None]
    asked, held, *values = (
        np.take_along_axis(np.array(each), best, axis=0)[0] for each in zip(*found, strict=True)
    )
    dates = (each.astype("datetime64[ns]") for each in (asked, held))
    at = (axis[()] for axis in np.broadcast_arrays(*places, depth, asked)[:3])
    return Velocities(*at, *dates, *values, about=flows[-1].about)


def warn_outside(flows: Sequence[FlowEstimate], times: NDArray[Any], stacklevel: int) -> None:
    """Warn of times outside the data of constant estimates, the windows of one run.

    Args:
        flows: Estimates; changing ones and those of unknown span do not warn.
        times: Any shape [ns, UTC]; NaT is ignored.
        stacklevel: Stack level of the user's call, as in ``warnings.warn``.
    """
    constant = [one for one in flows if one.unknowns is not None and one.process is None]
    ends = [end for one in constant if one.span_ns is not None for end in one.span_ns]
    if not ends:
        return
    asked, span = np.ravel(times).astype(np.int64), (min(ends), max(ends))
    # NaT is none
    outside = asked[((asked < span[0]) | (asked > span[1])) & (asked >= 0)]
    if outside.size:
        data = " to ".join(map(time_text, span))
        warnings.warn(
            f"time: {time_text(int(outside[0]))} is outside the estimate's data, {data}; its model is constant in time: the "
            "current is that of estimate_time, and its standard error does not grow",
            stacklevel=stacklevel,
        )
