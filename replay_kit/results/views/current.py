"""Estimate through time: on depth slices as published, from published unknowns, and at a position."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Times
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import depth_weights, hat_weights, with_potential
from replay_kit.core.geodesy import inside_grid, rotate_to_geographic, to_local
from replay_kit.core.grid import Grid, Projection
from replay_kit.results.innovations import thinned
from replay_kit.results.mcap.schemas import decode, numbers
from replay_kit.results.reader import ResultReader
from replay_kit.results.slices import basis_of, depth_slices, grid_cells, slice_axes

#: Of the fields of a slice, those kept: u, v and their standard errors.
KEPT = ("u", "v", "u_standard_error", "v_standard_error")
_FOLDER = "/flow/grid/"
# Share of a depth within which a published one is the same.
_SAME_DEPTH = 0.01
# Steps of a mean over depth, and points at which a flow is evaluated at once.
_STEPS, _CHUNK = 24, 512
#: A place: longitude, latitude [degrees] and depth [m].
At = tuple[float, float, float]


class CurrentSlices(NamedTuple):
    """Current on a regular grid of the local frame at some depths and times.

    Attributes:
        depths: shape (D,) [m], increasing.
        time_ns: shape (T,) [ns, UTC], increasing.
        east: shape (I,) [m], cell centres.
        north: shape (J,) [m], cell centres.
        fields: shape (D, T, 4, J, I) [m/s]: u, v along the local axes and their standard errors; NaN where dry or unknown.
        left_out: Number of omitted published times.
        outside: shape (J, I), True for cells off the forecast's grid; other cells without a current are dry. None if the grid is unknown.
    """

    depths: Array
    time_ns: Times
    east: Array
    north: Array
    fields: Array
    left_out: int = 0
    outside: NDArray[np.bool_] | None = None


def published_slices(
    reader: ResultReader, grid: Grid | None = None, most_values: int = 1_600_000
) -> CurrentSlices | None:
    """Return the slices in a result; None without any.

    Args:
        reader: Reader of the result.
        grid: Grid of the last estimate, to select one of several windows; None for the first.
        most_values: Largest number of values; intermediate times are omitted to keep it.
    """
    names = {float(one[len(_FOLDER) : -1]): one for one in reader.topics if one.startswith(_FOLDER)}
    depths = sorted(names)
    axes = None if grid is None else slice_axes(grid)

    def read() -> Iterator[tuple[int, int, dict[str, Array]]]:
        """Yield level, time [ns] and fields of the slices on the axes."""
        nonlocal axes
        for level, depth in enumerate(depths):
            for time_ns, value in reader.decoded(names[depth]):
                *centres, found = grid_cells(value)
                axes = axes or (centres[0], centres[1])
                # equal to the rounding of a message
                if all(
                    a.size == b.size and np.allclose(a, b, 1e-9, 1e-3)
                    for a, b in zip(centres, axes, strict=True)
                ):
                    yield level, time_ns, found

    times = sorted({time_ns for _, time_ns, _ in read()})
    if not times or axes is None:
        return None
    shape = axes[1].size, axes[0].size
    most = max(1, most_values // (len(KEPT) * shape[0] * shape[1] * len(depths)))
    kept = {times[k]: number for number, k in enumerate(thinned(len(times), most).tolist())}
    fields = np.full((len(depths), len(kept), len(KEPT), *shape), np.nan)
    for level, time_ns, found in read():
        if time_ns in kept:
            for k, name in enumerate(KEPT):
                fields[level, kept[time_ns], k] = found.get(name, np.nan)
    left = len(times) - len(kept)
    return CurrentSlices(np.array(depths), np.array([*kept]), *axes, fields, left)


def slices_of(flow: FlowEstimate, depths: Array) -> CurrentSlices:
    """Return slices of an estimate at its own time at depths [m]."""
    down, east, north, found = depth_slices(flow, depths.tolist())
    fields = np.full((len(down), 1, len(KEPT), *found.shape[2:]), np.nan)
    fields[:, 0, : found.shape[1]] = found
    times = np.array([flow.time_ns or 0])
    return on_grid(CurrentSlices(down, times, east, north, fields), flow.grid)


def on_grid(slices: CurrentSlices, grid: Grid) -> CurrentSlices:
    """Return slices with the mask of cells off the forecast's grid; unchanged if another grid has a current there."""
    outside = ~inside_grid(grid, *np.meshgrid(slices.east, slices.north))
    known = np.isfinite(slices.fields[..., outside]).any()
    return slices if known else slices._replace(outside=outside)


class EstimateHistory:
    """Mean of the estimate at the published times, from the unknowns published with the slices."""

    def __init__(self, reader: ResultReader, estimate: FlowEstimate | None) -> None:
        """Create the history from the last estimate of a result; without one every mean is None."""
        self._reader, self.estimate = reader, estimate

    @cached_property
    def _published(self) -> list[tuple[int, Array]]:
        """Times [ns, UTC] and unknowns of this window's estimate as published, in order."""
        assert self.estimate is not None
        basis, messages = basis_of(self.estimate), self._reader.messages("/flow/estimate")
        each = ((time_ns, decode("Estimate", data)) for time_ns, data in messages)
        return [(at, numbers("Estimate", one, "x")) for at, one in each if one.basis == basis]

    def after(self, times_ns: Times) -> Iterator[FlowEstimate | None]:
        """Yield the latest published mean of the estimate at each of some times; None if unknown.

        Args:
            times_ns: [ns, UTC].
        """
        estimate = self.estimate
        if estimate is None or estimate.unknowns is None:
            yield from repeat(None, times_ns.size)
            return
        published, mean = self._published, estimate.mean_flow()
        times = np.array([time_ns for time_ns, _ in published], np.int64)
        for k in (np.searchsorted(times, times_ns, "right") - 1).tolist():
            if k < 0:
                yield None
                continue
            time_ns, x = published[k]
            unknowns = replace(estimate.unknowns, x=x.astype(np.float64))
            yield replace(mean, latent=unknowns.latent(estimate.modes, time_ns), time_ns=time_ns)


def series_of(
    slices: CurrentSlices, projection: Projection, history: EstimateHistory, place: At
) -> pd.DataFrame:
    """Return the time series of the current at a position: time, place, depth, current and standard errors of ``KEPT`` [m/s].

    It is of the published unknowns, at the last time of the last estimate; its standard error is the published one, at another depth that
    of the last estimate alone. Without unknowns it is of the nearest depth. Velocities are on true
    axes, standard errors on local ones.

    Args:
        slices: Published current.
        projection: Its local frame.
        history: History of the estimate.
        place: Longitude, latitude [degrees] and depth [m].
    """
    (depth, published), estimate = published_at(slices, projection, place), history.estimate
    *at, asked = place
    values = np.where(abs(depth - asked) <= _SAME_DEPTH * asked, published, np.nan)
    if estimate is not None and np.isfinite((last := estimate.velocity_at(*place)).u):
        local = (*to_local(estimate.grid.projection, *at), asked)
        for k, flow in enumerate(history.after(slices.time_ns[:-1])):
            if flow is not None:
                values[k, :2] = flow.velocity(*local, true_axes=True)
        values[-1, :2] = last.u, last.v
        if estimate.n_modes:
            values[-1, 2:] = estimate.standard_error(*local)
        known = len(values) == 1 or bool(np.isfinite(values[:-1, 0]).any())
    else:
        known = estimate is not None
    if not known:
        values, asked = published, depth
    about = {"time": slices.time_ns.astype("datetime64[ns]"), "longitude": at[0]}
    about |= {"latitude": at[1], "depth": asked}
    return pd.DataFrame(about | dict(zip(KEPT, values.T, strict=True)))


def published_at(slices: CurrentSlices, projection: Projection, place: At) -> tuple[float, Array]:
    """Return the published depth [m] nearest to a position, and the current there, linear between cells; of its cell beside land.

    Args:
        slices: Published current.
        projection: Its local frame.
        place: Longitude, latitude [degrees] and depth [m].

    Returns:
        Depth, and current and standard errors, shape (T, 4) [m/s], velocities towards true east and north; NaN outside the cells.
    """
    level = int(np.argmin(np.abs(slices.depths - place[2])))
    fields, at = slices.fields[level], to_local(projection, *place[:2])[::-1]
    axes = slices.north, slices.east
    off = [np.abs(axis - each) for axis, each in zip(axes, at, strict=True)]
    values = np.full(fields.shape[:2], np.nan)
    if all(each.min() <= 0.5 * (axis[1] - axis[0]) for each, axis in zip(off, axes, strict=True)):
        y, x = (
            hat_weights(np.atleast_1d(each), axis)[0] for each, axis in zip(at, axes, strict=True)
        )
        near = np.ix_(y > 0.0, x > 0.0)
        between = np.einsum("tkji,j,i->tk", fields[:, :, *near], y[y > 0.0], x[x > 0.0])
        nearest = fields[..., *map(np.argmin, off)]
        values = np.where(np.isfinite(between), between, nearest)
    u, v, *errors = values.T
    true = rotate_to_geographic(projection, *place[:2], u, v)
    return float(slices.depths[level]), np.column_stack([*true, *errors])


def mean_to_depth(slices: CurrentSlices, history: EstimateHistory, depth: float) -> Array:
    """Return the mean current from the surface to a depth at the published times, shape (T, 4, J, I) [m/s] as ``CurrentSlices.fields``.

    The velocity is from all levels of the estimate if known at each time and in deep enough water, else from the published depths. The
    error is the mean of the published ones, an upper bound.

    Args:
        slices: Published current.
        history: History of the estimate.
        depth: Depth [m].
    """
    below, last = depth * (np.arange(_STEPS) + 0.5) / _STEPS, history.estimate
    share = hat_weights(below, slices.depths).mean(axis=0)
    known: Any = np.ma.average(np.ma.masked_invalid(slices.fields), axis=0, weights=share)
    mean: Array = known.filled(np.nan)
    deep = np.isfinite(slices.fields[share > 0.0, -1, 0]).all(axis=0)
    flows = [*history.after(slices.time_ns[:-1]), last]
    if last is None or None in flows or not deep.any():
        return mean
    weights = depth_weights(last.depth_functions, below, last.levels).mean(axis=0)
    latent = np.column_stack([flow.latent @ weights for flow in flows if flow is not None])
    potential = None if last.potential is None else (last.potential @ weights)[:, None]
    points = np.column_stack([axis[deep] for axis in np.meshgrid(slices.east, slices.north)])
    parts = np.array_split(points, -(-len(points) // _CHUNK))
    each = [with_potential(last.horizontal, part, latent, potential) for part in parts]
    mean[:, :2, deep] = np.moveaxis(np.concatenate(each, axis=1), 2, 0)
    return mean


def typical_depth(slices: CurrentSlices | None, depths: Array) -> float:
    """Return the deepest published depth above the median depth of measurements [m], else the shallowest.

    Args:
        slices: Published current; None gives the median itself, or 0.
        depths: shape (n,) [m]; NaN are ignored.
    """
    known = depths[np.isfinite(depths)]
    middle = float(np.median(known)) if known.size else 0.0
    if slices is None:
        return middle
    return float(slices.depths[max(int(np.searchsorted(slices.depths, middle, "right")) - 1, 0)])


def error_through_time(slices: CurrentSlices) -> Array:
    """Return the RMS standard error of a component over each published slice [m/s], shape (D, T); NaN if unknown."""
    squares = np.ma.masked_invalid(slices.fields[:, :, 2:]) ** 2
    return np.asarray(np.sqrt(squares.mean(axis=(2, 3, 4))).filled(np.nan))
