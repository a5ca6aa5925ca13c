"""Velocities of a flow, or of the estimates of several windows, at places in degrees and along tracks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.cf import described, encoded
from replay_kit.core.flow.dataset import ATTRIBUTES, wet_at
from replay_kit.core.flow.estimate import FlowEstimate, checked_depth
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.quantities import to_time_ns
from replay_kit.core.text import place_text, span_text, time_text
from replay_kit.core.version import __version__

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


#: A vehicle's pressure sensor may read so far above the surface when it lies there [m].
WASHED = 1.0
_NO_TIME = "no time"
# Columns of a table of velocities; the first five are coordinates.
_COLUMNS = (
    "time",
    "longitude",
    "latitude",
    "depth",
    "estimate_time",
    "u",
    "v",
    "u_standard_error",
    "v_standard_error",
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Velocities:
    """Velocities at points, towards true east and true north; all arrays have the shape of the points.

    Velocity and standard error are NaN where nothing is known: outside the region, on land and below the last level.

    Attributes:
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
        time: datetime64[ns], UTC, that was asked for, or along a track; NaT when unknown.
        estimate_time: datetime64[ns], UTC, for which the velocity holds; later than ``time`` where an estimate that changes with time was
            asked for the past of its last observation, along a track, and the estimate's own where it is constant.
        u: Eastward velocity [m/s].
        v: Northward velocity [m/s].
        u_standard_error: [m/s]; NaN when the flow has no uncertainty.
        v_standard_error: [m/s].
        about: Global attributes of its dataset, as the flow's.
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
        """Return where and when, and the velocities with their standard errors."""
        known = np.isfinite(self.u)
        rest = (
            ""
            if known.all()
            else f"\n  {np.sum(~known)} of {known.size} outside the region, on land or below the last level: NaN"
        )
        depths = f"{span_text(self.depth)} m deep"
        if known.shape == ():
            where = f"{place_text(float(self.longitude), float(self.latitude))}, {depths}, {self._times()}"
            values = f"u {self.u:.3f} +- {self.u_standard_error:.3f}, v {self.v:.3f} +- {self.v_standard_error:.3f} m/s"
            return f"Velocity at {where}\n  {values} (true east, true north){rest}"
        errors = span_text([self.u_standard_error, self.v_standard_error], 2)
        values = f"u {span_text(self.u, 2)}, v {span_text(self.v, 2)}, standard error {errors} m/s"
        return f"Velocities at {known.size} points {known.shape}, {depths}, {self._times()}\n  {values} (true east, true north){rest}"

    def _times(self) -> str:
        asked, held = _ends(self.time), _ends(self.estimate_time)
        return asked if held in (asked, _NO_TIME) else f"{asked} (estimate for {held})"

    def _columns(self) -> dict[str, Array]:
        return {name: np.ravel(getattr(self, name)) for name in _COLUMNS}

    def to_xarray(self) -> "xr.Dataset":
        """Return a CF dataset on the dimension ``point``."""
        import xarray as xr

        values = {
            name: ("point", column, ATTRIBUTES[name]) for name, column in self._columns().items()
        }
        dataset = described(
            xr.Dataset(values).set_coords(_COLUMNS[:5]),
            "Ocean current estimate at points",
            f"replay-kit {__version__}: Velocities.to_xarray",
            {"featureType": "point", **self.about},
        )
        return encoded(dataset)

    def to_og1(self, platform: str, **stated: str) -> "xr.Dataset":
        """Return a trajectory after OG1.0 (OceanGliders), on the dimension ``N_MEASUREMENTS``; what is not stated is left out.

        Args:
            platform: Serial number of the glider with its prefix, such as ``sg033``.
            **stated: What a person knows: ``PLATFORM_MODEL`` and ``WMO_IDENTIFIER``, and global attributes such as ``contributor_name``.

        Raises:
            EstimatorError: There is no point, or the time of one is not known.
        """
        from replay_kit.core.flow.dataset import trajectory

        return trajectory(self._columns(), platform, stated, self.about)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a table with a row a point."""
        return self.to_xarray().reset_coords().to_dataframe()


def _ends(dates: NDArray[np.datetime64]) -> str:
    """Return the first and the last date as text, once where they are the same."""
    times = dates[~np.isnat(dates)].astype(np.int64)
    if not times.size:
        return _NO_TIME
    return " to ".join(dict.fromkeys(time_text(int(end)) for end in (times.min(), times.max())))


def velocity_at(
    flow: FlowEstimate,
    longitude: ArrayLike,
    latitude: ArrayLike,
    depth: ArrayLike,
    time: Any = None,
) -> Velocities:
    """Return the velocities at points; see ``FlowEstimate.velocity_at``."""
    points = longitude, latitude, checked_depth(depth)
    if time is None:
        return _velocities(flow, points, None)
    time_ns, first = to_time_ns(time), flow.last_observation_ns
    flow.require_model_of_time()
    if first is not None and time_ns.size and time_ns.min() < first:
        raise EstimatorError(
            f"time: {time_text(int(time_ns.min()))} is before the last observation of the estimate, {time_text(first)}; expected that time "
            "or a later one: leave time out for the estimate's own, or look back with the command smooth"
        )
    return _velocities(flow, points, time_ns)


def velocity_along(flow: FlowEstimate, track: Any) -> Velocities:
    """Return the velocities along a track; see ``FlowEstimate.along``."""
    if not isinstance(track, Mapping) and not hasattr(track, "keys"):
        kind = type(track).__name__
        raise EstimatorError(
            f"track: expected a table, dataset or mapping with longitude, latitude, depth and perhaps time, got {kind}"
        )
    columns = {
        name: track[name] for name in ("longitude", "latitude", "depth", "time") if name in track
    }
    index = getattr(track, "index", None)
    if "time" not in columns and getattr(index, "name", None) == "time":
        columns["time"] = index
    if missing := [name for name in ("longitude", "latitude", "depth") if name not in columns]:
        raise EstimatorError(
            f"track: expected longitude, latitude, depth and perhaps time, but {', '.join(missing)} is missing"
        )
    time = columns.pop("time", None)
    columns["depth"] = checked_depth(columns["depth"], WASHED)
    return _velocities(flow, tuple(columns.values()), None if time is None else to_time_ns(time))


def _velocities(
    flow: FlowEstimate, points: tuple[Any, ...], time_ns: NDArray[np.int64] | None
) -> Velocities:
    """Return the velocities at points.

    Those before the last observation of an estimate are at the time of that, and those of one that does not change at its own.
    """
    own = np.iinfo(np.int64).min if flow.time_ns is None else flow.time_ns  # the former is NaT
    axes = (np.asarray(axis, dtype=np.float64) for axis in points)
    longitude, latitude, depth, asked = np.broadcast_arrays(
        *axes, np.int64(own) if time_ns is None else time_ns
    )
    if np.any(np.abs(latitude) > 90.0):
        raise EstimatorError(
            f"latitude: expected -90 to 90 degrees, got {span_text(latitude)}; the order is longitude, latitude, depth"
        )
    at = np.column_stack([axis.ravel() for axis in (longitude, latitude, np.maximum(depth, 0.0))])
    first = flow.last_observation_ns
    held = (
        np.full(len(at), own)
        if flow.process is None
        else asked.ravel()
        if first is None
        else np.maximum(asked.ravel(), first)
    )
    if time_ns is None or flow.process is None:
        values = _evaluate(flow, *at.T)
    else:
        values = np.empty((len(at), 4))
        for time in np.unique(held).tolist():
            here = held == time
            values[here] = _evaluate(flow.at(time), *at[here].T)
    kept = (column.reshape(depth.shape)[()] for column in values.T)
    dates = (value.reshape(depth.shape).astype("datetime64[ns]")[()] for value in (asked, held))
    return Velocities(longitude[()], latitude[()], depth[()], *dates, *kept, about=flow.about)


def _evaluate(flow: FlowEstimate, longitude: Array, latitude: Array, depth: Array) -> Array:
    """Return velocity and standard error, shape (n, 4), at points, each shape (n,); NaN where nothing is known."""
    out = np.full((depth.size, 4), np.nan)
    known = np.isfinite(longitude + latitude)
    east, north = to_local(flow.grid.projection, longitude[known], latitude[known])
    known[known] = wet_at(flow.grid, east, north, depth[known]) & inside_grid(
        flow.grid, east, north
    )
    east, north = to_local(flow.grid.projection, longitude[known], latitude[known])
    out[known, :2] = flow.velocity(east, north, depth[known], true_axes=True)
    if flow.n_modes:
        out[known, 2:] = flow.standard_error(east, north, depth[known], true_axes=True)
    return out


def best_velocity_at(
    flows: Sequence[FlowEstimate],
    longitude: ArrayLike,
    latitude: ArrayLike,
    depth: ArrayLike,
    time: Any = None,
) -> Velocities:
    """Return velocities at points, each from the estimate with the least standard error there; NaN where none holds it.

    Windows overlap: near the side of one that the vehicle had left, another knows the current better.

    Args:
        flows: At least one, each with its uncertainty; of equal ones the later counts.
        longitude: [degrees east], any shape; the four broadcast together.
        latitude: [degrees north].
        depth: [m], positive down.
        time: As of ``FlowEstimate.velocity_at``.
    """
    found = [velocity_at(flow, longitude, latitude, depth, time) for flow in reversed(flows)]
    errors = np.array([np.hypot(one.u_standard_error, one.v_standard_error) for one in found])
    best = np.argmin(np.where(np.isnan(errors), np.inf, errors), axis=0)
    names = ("time", "estimate_time", "u", "v", "u_standard_error", "v_standard_error")
    chosen = (
        np.take_along_axis(np.array([getattr(one, name) for one in found]), best[None], axis=0)[0]
        for name in names
    )
    return Velocities(found[0].longitude, found[0].latitude, found[0].depth, *chosen)
