"""Members on the grid of the first as one array, on disk if larger than memory."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import IN_MEMORY, Array, Values, large_array, release
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.words.text import count_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.grids.depths import at_depths, depths_text
from replay_kit.forecast.grids.horizontal import (
    bilinear,
    centre_longitude,
    find_cells,
    turn_to_local,
    turned_velocity,
)
from replay_kit.forecast.grids.layout import Layout, lay_out
from replay_kit.forecast.window import Window, read_window, window_size

# Members read at once [bytes].
_GROUP = 1 << 28


def in_groups(field: Field, layout: Layout) -> list[Field]:
    """Return the members of a file in groups that fit into memory, read one after the other.

    Land marked by a constant value is detected in each group separately, as in each of several files.
    """
    if field.member is None or field.extra or (size := window_size(field, layout)) <= IN_MEMORY:
        return [field]
    step = max(1, _GROUP * len(field.labels) // size)
    parts = [slice(start, start + step) for start in range(0, len(field.labels), step)]
    return [
        replace(field, at={**(field.at or {}), field.member: part}, labels=field.labels[part])
        for part in parts
    ]


def members_together(
    fields: Sequence[Field],
    layout: Layout,
    window: Window,
    projection: Projection,
    config: ForecastConfig,
    dtype: np.dtype[np.floating],
) -> tuple[Values, list[str]]:
    """Return the members of fields in the local frame on the grid of the first, and notes on changes.

    Args:
        fields: Fields in order.
        layout: Used part of the first file.
        window: Window of the first file; a single field is turned in place.
        projection: Local frame.
        config: Levels and axes.
        dtype: Precision of the members.
    """
    first, count = window.velocity, sum(1 if field.extra else len(field.labels) for field in fields)
    turn = turn_to_local(projection, window.longitude, window.latitude, window.axes)
    alone = len(first) == count and first.dtype == dtype
    velocity = first if alone else large_array((count, *first.shape[1:]), dtype)
    turned_velocity(first, turn, velocity[: len(first)])
    filled, around, notes = len(first), region_around(window), list[str]()
    moved, far = 0, np.zeros(window.levels.size, dtype=bool)
    for field in fields[1:]:
        last = layout
        if not _same_grid(field, fields[0]):
            last = layout_of(field, config).within(around, field.where)
        other = read_window(field, last, config)
        values, alike = other.velocity, is_alike(other, window)
        if not alike:
            values, moved = on_grid_of(other, window, projection), moved + len(values)
            far |= (window.levels < other.within[0]) | (window.levels > other.within[1])
        if field.extra:
            values = values.mean(axis=0, keepdims=True, dtype=np.float64)
        here = velocity[filled : filled + len(values)]
        filled += len(values)
        if alike:
            turned_velocity(values, turn, here)
        else:
            here[:] = values
        release(velocity)
        notes += [note for note in other.notes if last is not layout or note not in window.notes]
    notes += moved_notes(moved, window.levels[far])
    return velocity, notes


def layout_of(field: Field, config: ForecastConfig) -> Layout:
    """Return the horizontal layout of a file, with the configured axes of its velocities."""
    assert field.current is not None
    layout = lay_out(field.ds, field.current, field.where)
    if config.axes == "auto":
        return layout
    return replace(layout, axes=config.axes, why=f"--axes {config.axes}")


# Parts of the names of coordinates.
_PLACES = ("lon", "lat", "glam", "gphi", "xc", "yc", "xh", "yh", "xu_", "yu_", "geo")


def _same_grid(one: Field, other: Field) -> bool:
    """Return whether two files have the same horizontal grid, by size and first and last coordinates."""
    if one.paths == other.paths:
        return True
    return one.current == other.current and all(
        name in one.ds.variables and _same_ends(one.ds.variables[name], variable)
        for name, variable in other.ds.variables.items()
        if any(mark in str(name).lower() for mark in _PLACES)
    )


def _same_ends(one: xr.Variable, other: xr.Variable) -> bool:
    first, last = dict.fromkeys(one.dims, 0), dict.fromkeys(one.dims, -1)
    return one.sizes == other.sizes and all(
        np.array_equal(one.isel(end).values, other.isel(end).values) for end in (first, last)
    )


def region_around(window: Window) -> tuple[float, float, float, float]:
    """Return the region to read of other grids: the window with a margin of two cells."""
    middle = centre_longitude(window.longitude)
    x, y = unwrap_longitude(window.longitude, middle), window.latitude
    step = 2.0 * max(
        float(np.abs(np.diff(x, axis=1)).max()), float(np.abs(np.diff(y, axis=0)).max())
    )
    return (
        float(x.min()) - step,
        max(float(y.min()) - step, -90.0),
        float(x.max()) + step,
        min(float(y.max()) + step, 90.0),
    )


def is_alike(one: Window, other: Window) -> bool:
    """Return whether two windows share points, levels and axes."""
    if (
        one.axes != other.axes
        or one.longitude.shape != other.longitude.shape
        or one.levels.shape != other.levels.shape
    ):
        return False
    apart = (one.longitude - other.longitude + 180.0) % 360.0 - 180.0
    return bool(
        np.abs(apart).max() < 1e-5
        and np.abs(one.latitude - other.latitude).max() < 1e-5
        and np.allclose(one.levels, other.levels, rtol=1e-3)
    )


def on_grid_of(other: Window, window: Window, projection: Projection) -> Values:
    """Return another window's velocities in the local frame, interpolated to the grid and levels of the first."""
    turn = turn_to_local(projection, other.longitude, other.latitude, other.axes)
    values = turned_velocity(other.velocity, turn)
    (east, north), (at_east, at_north) = (
        to_local(projection, unwrap_longitude(part.longitude, projection.longitude), part.latitude)
        for part in (other, window)
    )
    j, i, inside = find_cells(east, north, at_east, at_north)
    depths = other.levels[:, None, None]
    return bilinear(at_depths(values, depths, other.within, window.levels), j, i, inside)


def moved_notes(moved: int, far: Array) -> list[str]:
    """Return notes on interpolated members, and on levels of the first [m] far from all of theirs."""
    if not moved:
        return []
    notes = [
        f"{count_text(moved, 'member')} interpolated to the grid of the first (bilinear; linear in depth)"
    ]
    if far.size:
        dry = f"left dry: {count_text(far.size, 'level')} of the first, {depths_text(far)}"
        notes.append(
            f"{dry}: interpolated members have no level near {'it' if far.size == 1 else 'them'}"
        )
    return notes
