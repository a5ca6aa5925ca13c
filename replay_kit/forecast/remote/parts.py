"""Required part of a forecast: rows, columns, levels and times, from its coordinates alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Address
from replay_kit.core.quantities import parse_time
from replay_kit.core.region import Region
from replay_kit.core.text import time_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.files import with_dates
from replay_kit.forecast.grids.depths import choose_levels
from replay_kit.forecast.grids.layout import Layout, U, V, lay_out
from replay_kit.forecast.grids.s_levels import follows_terrain
from replay_kit.forecast.members.rules import MADE
from replay_kit.forecast.members.times import dated_leads, valid_times
from replay_kit.forecast.names import find_depth, find_lead, find_time
from replay_kit.forecast.remote.servers import open_address

# Cells beyond the box on each side of staggered grids, and of members that are interpolated to the grid of the first.
_MARGIN = 2
_DAY_NS = 86_400 * 10**9

#: Parts of each dimension that are taken, in order.
Parts = Mapping[str, tuple[slice, ...]]


@dataclass(frozen=True, slots=True)
class Wanted:
    """Required region, depths and times of a forecast.

    Attributes:
        region: West, south, east, north [degrees]; None for all points.
        deepest: Greatest required depth [m]; None for all depths.
        first_ns: First required time [ns, UTC]; None for all times.
        last_ns: Last required time [ns, UTC]; None for all times.
    """

    region: Region | None = None
    deepest: float | None = None
    first_ns: int | None = None
    last_ns: int | None = None


def parts_of(
    field: Field, wanted: Wanted, config: ForecastConfig, kind: str, alone: bool
) -> dict[str, tuple[slice, ...]]:
    """Return the required indices of each dimension of a file, or of a pair of files.

    Args:
        field: Field of the file; only its coordinates are received.
        wanted: Required part.
        config: Levels, lead and time, if chosen.
        kind: Kind of the definition of a member.
        alone: Whether no other file has members, to be interpolated to this one's grid.

    Raises:
        ForecastError: The forecast covers another region or time.
    """
    (first, *_), where, ds = field.paths, field.where, field.ds
    assert field.current is not None
    # as the server has it, where a field is one of its runs
    whole = with_dates(open_address(first)) if isinstance(first, Address) else ds
    current = field.current.u if whole is not ds else U
    taken = _of_times(whole, whole[current].dims, wanted, config, kind, where)
    layout = lay_out(ds, field.current, where)
    for dims in (layout.centre_dims, layout.u_dims, layout.v_dims):
        taken |= {dim: (slice(0, ds.sizes[dim]),) for dim in dims}
    if wanted.region is not None:
        taken |= _of_region(layout, ds, wanted.region, alone, where)
    depths = tuple(find_depth(ds, ds[name].dims) for name in (U, V))
    if depths[0] is not None and not follows_terrain(ds, depths[0]):
        everything = config.model_copy(update={"levels": None})
        levels = choose_levels(ds, depths, everything, float(np.mean(layout.latitude)), where)
        order = levels.position[_of_depths(levels.depth, wanted.deepest, config.levels)]
        for dim in dict.fromkeys(filter(None, depths)):
            taken[dim] = (slice(int(order.min()), int(order.max()) + 1),)
    # files of u and v apart may have dimensions of one name and other sizes
    return {dim.removesuffix("_of_v"): parts for dim, parts in taken.items()}


def _of_depths(depth: np.ndarray, deepest: float | None, levels: tuple[float, ...] | None) -> slice:
    """Return the range of required levels by depth, with one more on each side of those requested."""
    if levels is not None:
        nearest = [int(np.argmin(np.abs(depth - level))) for level in levels]
        return slice(max(0, min(nearest) - 1), max(nearest) + 2)
    if deepest is None:
        return slice(None)
    return slice(0, max(int(np.searchsorted(depth, deepest)) + 1, 2))


def _of_region(
    layout: Layout, ds: Any, region: Region, alone: bool, where: str
) -> dict[str, tuple[slice, ...]]:
    """Return the rows and columns around a region with a margin, for each staggered dimension."""
    cut = layout.within(region, where)
    margin = 0 if alone and layout.first_face is None else _MARGIN
    taken: dict[str, tuple[slice, ...]] = {}
    ends = (cut.rows.start, cut.rows.stop), (cut.columns[0].start, cut.columns[-1].stop)
    for axis, (first, last) in enumerate(ends):
        centre = layout.centre_dims[axis]
        dims, size = {centre, layout.u_dims[axis], layout.v_dims[axis]}, ds.sizes[centre]
        period, seam = layout.period if axis else None, last <= first
        low, high = first - margin, last + margin
        if period is not None and all(ds.sizes[dim] == size for dim in dims):
            parts = _round(low, high + period * seam, period)
            taken |= dict.fromkeys(dims, parts)
        elif not seam:
            for dim in dims:
                stop = min(size, high) + ds.sizes[dim] - size
                taken[dim] = (slice(max(0, low), max(1, stop)),)
    return taken


def _round(low: int, high: int, period: int) -> tuple[slice, ...]:
    """Return the columns of a global grid in their order in space."""
    if high - low >= period:
        return (slice(0, period),)
    low, high = low % period, high % period or period
    if low < high:
        return (slice(low, high),)
    return slice(low, period), slice(0, high)


def _of_times(
    ds: Any, dims: tuple[Any, ...], wanted: Wanted, config: ForecastConfig, kind: str, where: str
) -> dict[str, tuple[slice, ...]]:
    """Return the times or leads from the last before the first required time to the first after the last.

    Raises:
        ForecastError: The forecast covers other times.
    """
    lead, time = find_lead(ds, dims), find_time(ds, dims)
    if time is not None and (time not in ds.coords or ds[time].dtype.kind != "M"):
        return {}
    # members made of the fields of other times need them all
    if kind in MADE and kind != "lags":
        return {}
    runs = valid_times(ds, dims)
    # of runs that are no members it is the start
    dated = kind == "lags" if runs is not None else time is not None
    chosen = (parse_time(config.time),) * 2 if config.time and dated else None
    if lead is not None and config.lead is not None:
        nearest = int(np.argmin(np.abs(ds[lead].values.astype(float) - config.lead)))
        if kind != "lags" or runs is None:
            return {lead: (slice(nearest, nearest + 1),)}
        # that of the newest run
        chosen = (int(runs[0][:, nearest].max()),) * 2
    span = chosen or (wanted.first_ns, wanted.last_ns)
    if runs is not None:
        return _of_runs(*runs, span)
    dim = time or lead
    if dim is None:
        return {}
    if time is not None:
        times = ds[time].values.astype("M8[ns]").astype(np.int64)
    else:
        times = np.array([valid for _, valid in dated_leads(ds, str(lead), config)], np.int64)
    first, last = span
    if not times.size or first is None or last is None:
        return {}
    if not chosen and (last < times.min() - _DAY_NS or first > times.max() + _DAY_NS):
        raise ForecastError(
            f"{where}: the forecast is of {time_text(int(times.min()))} to {time_text(int(times.max()))}, the log of {time_text(first)} to "
            f"{time_text(last)}; nothing of its currents was received: give one of that time, or choose one of these with forecast.time"
        )
    before, after = np.flatnonzero(times <= first), np.flatnonzero(times >= last)
    low = int(before[np.argmax(times[before])]) if before.size else int(np.argmin(times))
    high = int(after[np.argmin(times[after])]) if after.size else int(np.argmax(times))
    low, high = min(low, high), max(low, high)
    # what changes in time is read as such only where there are two
    if low == high and times.size > 1 and not chosen:
        low, high = (low, high + 1) if high + 1 < times.size else (low - 1, high)
    return {str(dim): (slice(low, high + 1),)}


def _of_runs(
    valid: np.ndarray, dims: tuple[str, str], span: tuple[int | None, int | None]
) -> dict[str, tuple[slice, ...]]:
    """Return the starts and leads with a valid time in the required span, or nearest to it."""
    first, last = span
    if first is None or last is None:
        return {}
    step = np.diff(valid, axis=1).max(initial=0)
    needed = (valid > first - step) & (valid < last + step)
    kept = [np.flatnonzero(needed.any(axis=axis)) for axis in (1, 0)]
    if not kept[0].size:
        return {}
    return {
        dim: (slice(int(found[0]), int(found[-1]) + 1),)
        for dim, found in zip(dims, kept, strict=True)
    }
