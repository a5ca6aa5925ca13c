"""Members brought together on the first one's grid, as one array, which lies on disk where it is larger than memory."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from replay_kit.core.arrays import IN_MEMORY, Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.inputs import claim_text, held
from replay_kit.core.text import count_text
from replay_kit.forecast.depths import depths_text, to_levels
from replay_kit.forecast.field import Field
from replay_kit.forecast.grid import (
    bilinear,
    centre_longitude,
    find_cells,
    turn_to_local,
    turned,
)
from replay_kit.forecast.layout import Layout, U, V
from replay_kit.forecast.members import no_water
from replay_kit.forecast.variables import chunk_bytes, unpacked
from replay_kit.forecast.window import Window, window_size

# Members read at once [bytes].
_GROUP = 1 << 28
# What is read without having been looked at [bytes], and per byte of the files: land alone takes less room than that.
_UNSEEN, _USUAL = 1 << 22, 12
# Values in water per byte of the files; and bytes that are looked at together, unless a chunk has more, up to the most of one.
_IN_WATER, _PART, _CHUNK = 32, 1 << 23, 1 << 26


def check_content(fields: Sequence[Field], layout: Layout, size: float, times: int) -> None:
    """Raise ForecastError where members are more than their files can tell: bytes that repeat take a thousandth of their room.

    Args:
        fields: The members at one time.
        layout: The part of the first file.
        size: What their currents take in memory [bytes].
        times: How many such are read, in all.
    """
    parts = {field.paths: field.load()[0][U].size for field in fields}
    paths = {path for part in parts for path in part}
    # what is on a server has limits of its own
    if not all(path.exists() for path in paths):
        return
    claimed = size * times
    stored = sum(held(path, claimed) for path in paths)
    why = claim_text(int(claimed), stored)
    # of the files' bytes those of these fields
    own = int(stored * min(1.0, size / (16 * sum(parts.values()))))
    if not why and size > _UNSEEN + _USUAL * own:
        why = _why_repeated(fields, layout, own)
    if why:
        raise ForecastError(
            f"{fields[0].where}: its currents cannot be read: {why}; choose less with --region and --levels, or mend the file"
        )


def _why_repeated(fields: Sequence[Field], layout: Layout, stored: int) -> str:
    """Return why members cannot be told by so many bytes; empty where most of them is land, which takes no room."""
    water = 0
    for field in fields:
        for name, dims in ((U, layout.u_dims), (V, layout.v_dims)):
            whole = field.ds[name]
            if (chunk := chunk_bytes(whole)) > _CHUNK:
                return f"{chunk / 1e6:.0f} MB of them are packed as one, which take {stored / 1e6:.3f} MB in all"
            for columns in layout.columns:
                cut = whole.isel({dims[0]: layout.rows, dims[1]: columns})
                for part in _parts(cut, max(_PART, chunk)):
                    values = unpacked(part)
                    new = np.isfinite(values[..., 1:]) & (values[..., 1:] != values[..., :-1])
                    water += 8 * int(np.count_nonzero(new))
            if water > _UNSEEN + _IN_WATER * stored:
                return f"more than {water / 1e6:.0f} MB of values in water in {stored / 1e6:.3f} MB of a file: they repeat"
    if not water:
        raise no_water(fields[0].where)
    return ""


def _parts(values: xr.DataArray, most: int) -> Iterator[xr.DataArray]:
    """Yield a variable in parts of no more than so many bytes in memory, along its first dimensions."""
    dim = next((dim for dim in values.dims if values.sizes[dim] > 1), None)
    if 8 * values.size <= most or dim is None:
        yield values
        return
    step = max(1, most * values.sizes[dim] // (8 * values.size))
    for start in range(0, values.sizes[dim], step):
        yield from _parts(values.isel({dim: slice(start, start + step)}), most)


def in_groups(field: Field, layout: Layout) -> list[Field]:
    """Return members of one file in groups that are read one after the other; in one where they fit into memory.

    What is land by its constant value is found in each group by itself, as in each of several files.
    """
    if field.member is None or field.extra or (size := window_size(field, layout)) <= IN_MEMORY:
        return [field]
    step = max(1, _GROUP * len(field.labels) // size)
    parts = [slice(start, start + step) for start in range(0, len(field.labels), step)]
    return [
        replace(field, at={**(field.at or {}), field.member: part}, labels=field.labels[part])
        for part in parts
    ]


def region_around(window: Window) -> tuple[float, float, float, float]:
    """Return the region that other grids are read in: the window and two of its cells around it."""
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
    """Return whether two windows have the same points, levels and axes."""
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
    """Return another window's velocities, in the local frame, on the grid and levels of the first."""
    turn = turn_to_local(projection, other.longitude, other.latitude, other.axes)
    values = turned(other.velocity, turn)
    (east, north), (at_east, at_north) = (
        to_local(projection, unwrap_longitude(part.longitude, projection.longitude), part.latitude)
        for part in (other, window)
    )
    j, i, inside = find_cells(east, north, at_east, at_north)
    return bilinear(to_levels(values, other.levels, other.within, window.levels), j, i, inside)


def moved_notes(moved: int, far: Array) -> list[str]:
    """Return notes on members of other grids, and on the first one's levels [m] that are not near any of theirs."""
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
