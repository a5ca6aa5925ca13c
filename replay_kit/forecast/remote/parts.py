"""Required part of a forecast: rows, columns, levels and times, from its coordinates alone."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.paths import Address
from replay_kit.core.region import Region
from replay_kit.core.words.quantities import parse_time
from replay_kit.core.words.text import time_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.files import with_dates
from replay_kit.forecast.grids.depths import choose_levels
from replay_kit.forecast.grids.horizontal import Index
from replay_kit.forecast.grids.layout import CENTRE, Layout, U, V, lay_out
from replay_kit.forecast.grids.s_levels import follows_terrain
from replay_kit.forecast.members.rules import MADE
from replay_kit.forecast.members.times import nearest_position, steps_of, valid_times
from replay_kit.forecast.names import find_depth, find_lead, find_time
from replay_kit.forecast.remote.servers import open_address

# Cells beyond the box on each side of staggered grids, and of members that are interpolated to the grid of the first.
_MARGIN = 2
_DAY_NS = 86_400 * 10**9

#: Positions that are taken along each dimension, in order.
Parts = Mapping[str, Index]


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
) -> dict[str, Index]:
    """Return the required positions along each dimension of a file, or of a pair of files.

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
    taken = _time_range(field, whole, whole[current].dims, wanted, config, kind)
    layout = lay_out(ds, field.current, where)
    for dims in layout.dims.values():
        taken |= {dim: np.arange(ds.sizes[dim]) for dim in dims}
    if wanted.region is not None:
        taken |= _region_ranges(layout.within(wanted.region, where), ds, alone)
    depths = tuple(find_depth(ds, ds[name].dims) for name in (U, V))
    if depths[0] is not None and not follows_terrain(ds, depths[0]):
        everything = config.model_copy(update={"levels": None})
        levels = choose_levels(ds, depths, everything, float(np.mean(layout.latitude)), where)
        order = levels.position[_depth_range(levels.depth, wanted.deepest, config.levels)]
        for dim in filter(None, depths):
            taken[dim] = np.arange(order.min(), order.max() + 1)
    # files of u and v apart may have dimensions of one name and other sizes
    return {dim.removesuffix("_of_v"): parts for dim, parts in taken.items()}


def _depth_range(
    depth: np.ndarray, deepest: float | None, levels: tuple[float, ...] | None
) -> slice:
    """Return the range of required levels by depth, with one more on each side of those requested."""
    if levels is not None:
        at = [nearest_position(depth, level) for level in levels]
        return slice(max(0, min(at) - 1), max(at) + 2)
    if deepest is None:
        return slice(None)
    return slice(0, max(int(np.searchsorted(depth, deepest)) + 1, 2))


def _region_ranges(cut: Layout, ds: xr.Dataset, alone: bool) -> dict[str, Index]:
    """Return the rows and columns of a region with a margin, for each staggered dimension."""
    taken, margin = dict[str, Index](), 0 if alone and cut.first_face is None else _MARGIN
    for axis, index in enumerate((cut.rows, cut.columns)):
        dims = {dims_of[axis] for dims_of in cut.dims.values()}
        size = ds.sizes[cut.dims[CENTRE][axis]]
        period = cut.period if axis else None
        wider = np.arange(-margin, index.size + margin) + index[0]
        if period is not None and all(ds.sizes[dim] == size for dim in dims):
            taken |= dict.fromkeys(
                dims, np.arange(period) if wider.size >= period else wider % period
            )
        elif wider[-1] - margin == index[-1]:
            for dim in dims:
                more = ds.sizes[dim] - size
                taken[dim] = np.arange(max(0, wider[0]), max(1, min(size, wider[-1] + 1) + more))
    return taken


def _time_range(
    field: Field,
    ds: xr.Dataset,
    dims: tuple[Hashable, ...],
    wanted: Wanted,
    config: ForecastConfig,
    kind: str,
) -> dict[str, Index]:
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
        at = nearest_position(ds[lead].values.astype(float), config.lead)
        if kind != "lags" or runs is None:
            return {lead: np.array([at])}
        # that of the newest run
        chosen = (int(runs[0][:, at].max()),) * 2
    first, last = chosen or (wanted.first_ns, wanted.last_ns)
    if first is None or last is None:
        return {}
    if runs is not None:
        return _needed(*runs, first, last)
    steps = steps_of(field, config)
    times, dim = steps.valid, str(steps.dim)
    if not times.size:
        return {}
    if not chosen and (last < times.min() - _DAY_NS or first > times.max() + _DAY_NS):
        raise ForecastError(
            f"{field.where}: the forecast is of {time_text(int(times.min()))} to {time_text(int(times.max()))}, the log of "
            f"{time_text(first)} to {time_text(last)}; give one of that time, or choose one of "
            "these with forecast.time"
        )
    found = _needed(times[None], ("", dim), first, last).get(
        dim, np.array([nearest_position(times, first)])
    )
    # what changes in time is read as such only where there are two
    if found.size == 1 < times.size and not chosen:
        found = np.arange(2) + min(found[0], times.size - 2)
    return {dim: found}


def _needed(valid: np.ndarray, dims: tuple[str, str], first: int, last: int) -> dict[str, Index]:
    """Return the starts and leads with a valid time in the required span, or nearest to it."""
    step = np.abs(np.diff(valid, axis=1)).max(initial=0)
    needed = (valid > first - step) & (valid < last + step)
    kept = [np.flatnonzero(needed.any(axis=axis)) for axis in (1, 0)]
    if not kept[0].size:
        return {}
    return {dim: np.arange(found[0], found[-1] + 1) for dim, found in zip(dims, kept, strict=True)}
