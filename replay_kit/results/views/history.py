"""Estimate through time: at the published times, from published unknowns, and at a position."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, repeat

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evaluation import with_potential
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.results.mcap.messages import basis_of
from replay_kit.results.mcap.schemas import decode, numbers
from replay_kit.results.reader import ResultReader
from replay_kit.results.views.slices import KEPT, CurrentSlices

# Share of a depth within which a published one is the same.
_SAME_DEPTH = 0.01
# Steps of a mean over depth, and points at which a flow is evaluated at once.
_STEPS, _CHUNK = 24, 512


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

    def after(self, times_ns: NDArray[np.int64]) -> Iterator[FlowEstimate | None]:
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


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Time series of the current at a position; all arrays have the shape (T,).

    Attributes:
        place: Requested longitude, latitude [degrees] and depth [m].
        depth: Depth of the current [m]: as requested, or of the nearest published slice.
        time_ns: [ns, UTC].
        u: Velocity towards true east [m/s]; NaN on land or outside the region.
        v: Velocity towards true north [m/s].
        u_standard_error: Standard error along the local east axis [m/s]; NaN if unknown.
        v_standard_error: Standard error along the local north axis [m/s].
    """

    place: tuple[float, float, float]
    depth: float
    time_ns: NDArray[np.int64]
    u: Array
    v: Array
    u_standard_error: Array
    v_standard_error: Array


def series_of(
    slices: CurrentSlices,
    projection: Projection,
    history: EstimateHistory,
    place: tuple[float, float, float],
) -> Series:
    """Return the time series of the current at a position.

    It is computed from the published unknowns, at the last time from the last estimate. Its standard error is the published one, at another
    depth that of the last estimate alone. Without unknowns it is the published current at the nearest depth.

    Args:
        slices: Published current.
        projection: Its local frame.
        history: History of the estimate.
        place: Longitude, latitude [degrees] and depth [m].
    """
    published, estimate = series_at(slices, projection, place), history.estimate
    *_, depth = place
    if estimate is None:
        return published
    same = abs(published.depth - depth) <= _SAME_DEPTH * depth
    u, v, u_error, v_error = (np.where(same, getattr(published, name), np.nan) for name in KEPT)
    last = estimate.velocity_at(*place)
    if np.isfinite(last.u):
        at = (*to_local(estimate.grid.projection, *place[:2]), depth)
        for k, flow in enumerate(history.after(slices.time_ns[:-1])):
            if flow is not None:
                u[k], v[k] = flow.velocity(*at, true_axes=True)
        u[-1], v[-1] = last.u, last.v
        if estimate.n_modes:
            u_error[-1], v_error[-1] = estimate.standard_error(*at)
        if u.size > 1 and not np.isfinite(u[:-1]).any():
            return published
    return Series(place, depth, slices.time_ns, u, v, u_error, v_error)


def cell_of(slices: CurrentSlices, east: float, north: float) -> tuple[int, int] | None:
    """Return row and column of the cell that contains a position [m, local frame]; None outside."""
    found = []
    for axis, value in ((slices.north, north), (slices.east, east)):
        nearest = int(np.argmin(np.abs(axis - value)))
        if abs(axis[nearest] - value) > 0.5 * (axis[1] - axis[0]):
            return None
        found.append(nearest)
    return found[0], found[1]


def series_at(
    slices: CurrentSlices, projection: Projection, place: tuple[float, float, float]
) -> Series:
    """Return the time series of the published current at a position and the nearest depth, linear between cells; of its cell beside land.

    Args:
        slices: Published current.
        projection: Its local frame.
        place: Longitude, latitude [degrees] and depth [m].
    """
    longitude, latitude, depth = place
    level = int(np.argmin(np.abs(slices.depths - depth)))
    values, at = (
        np.full((slices.time_ns.size, 4), np.nan),
        to_local(projection, longitude, latitude),
    )
    if (cell := cell_of(slices, *map(float, at))) is not None:
        # loads slowly
        from scipy.interpolate import interpn

        fields = slices.fields[level]
        grid = (slices.north, slices.east), np.moveaxis(fields, (2, 3), (0, 1))
        between = interpn(*grid, at[::-1], bounds_error=False).reshape(values.shape)
        values = np.where(np.isfinite(between), between, fields[..., *cell])
    u, v = rotate_to_geographic(projection, longitude, latitude, values[:, 0], values[:, 1])
    errors = values[:, 2], values[:, 3]
    return Series(place, float(slices.depths[level]), slices.time_ns, u, v, *errors)


def mean_to_depth(slices: CurrentSlices, history: EstimateHistory, depth: float) -> Array:
    """Return the mean current from the surface to a depth at the published times, shape (T, 4, J, I) [m/s] as ``CurrentSlices.fields``.

    The velocity is from all levels of the estimate if known at each time and in deep enough water, else from the published depths. The
    error is the mean of the published ones, an upper bound.

    Args:
        slices: Published current.
        history: History of the estimate.
        depth: Depth [m].
    """
    below = depth * (np.arange(_STEPS) + 0.5) / _STEPS
    rows = np.stack([np.interp(below, slices.depths, row) for row in np.eye(slices.depths.size)])
    share, fields = rows.mean(axis=1)[:, None, None, None, None], slices.fields
    wet = np.isfinite(fields) & (share > 0.0)
    total = np.where(wet, share * np.where(wet, fields, 0.0), 0.0).sum(axis=0)
    weight = (share * wet).sum(axis=0)
    mean = np.divide(total, weight, out=np.full(total.shape, np.nan), where=weight > 0.0)
    deep, last = wet[(share > 0.0).ravel(), -1, 0].all(axis=0), history.estimate
    if last is None or not deep.any():
        return np.asarray(mean)
    weights = depth_weights(last.depth_functions, below, last.levels).mean(axis=0)
    means = []
    for flow in chain(history.after(slices.time_ns[:-1]), [last]):
        if flow is None:
            return np.asarray(mean)
        means.append(flow.latent @ weights)
    latent = np.column_stack(means)
    potential = None if last.potential is None else (last.potential @ weights)[:, None]
    points = np.column_stack([axis[deep] for axis in np.meshgrid(slices.east, slices.north)])
    for first in range(0, len(points), _CHUNK):
        part = tuple(each[first : first + _CHUNK] for each in np.nonzero(deep))
        places = points[first : first + _CHUNK]
        velocity = with_potential(last.horizontal, places, latent, potential)
        mean[:, :2, part[0], part[1]] = np.moveaxis(velocity, 2, 0)
    return np.asarray(mean)


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
    return float(
        slices.depths[max(int(np.searchsorted(slices.depths, middle, side="right")) - 1, 0)]
    )
