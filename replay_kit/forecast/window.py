"""The part of one file that is used: only the window is read, and both components come to cell centres and fixed depths."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.inputs import exceeds_claim
from replay_kit.core.quantities import metres, metres_per_second
from replay_kit.core.text import count_text
from replay_kit.forecast.depths import choose_levels
from replay_kit.forecast.grid import Block, region_block
from replay_kit.forecast.layout import Layout, U, V
from replay_kit.forecast.members import WARNING
from replay_kit.forecast.names import SEA_LEVEL, Axes, Current, find_depth
from replay_kit.forecast.s_levels import LEFT_DRY, find_s_coordinate, from_s_levels
from replay_kit.forecast.selection import Selected
from replay_kit.forecast.variables import (
    AT_CENTRES,
    Source,
    chunk_bytes,
    constant_land,
    mask_at_centres,
    to_centres,
)

# Faster than any current: a fill value that the file does not declare.
_NO_SPEED = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Members of one file in the part used.

    Attributes:
        longitude: shape (J, I) [degrees].
        latitude: shape (J, I) [degrees].
        levels: shape (Z,) [m].
        within: The least and the greatest depth that the levels of the file do for [m].
        velocity: shape (E, 2, Z, J, I) [m/s], NaN on land, in the file's precision.
        axes: Along which axes the components lie.
        sea_level: Height of the surface of the first member [m], shape (J, I); None where the file has none.
        notes: What was chosen or assumed.
    """

    longitude: Array
    latitude: Array
    levels: Array
    within: tuple[float, float]
    velocity: Values
    axes: Axes
    sea_level: Array | None
    notes: tuple[str, ...]


def read_window(field: Selected, layout: Layout, config: ForecastConfig) -> Window:
    """Return the members of a file at one time, inside the region, on the chosen levels.

    Args:
        field: The members.
        layout: Of the file.
        config: Region and levels.

    Raises:
        ForecastError: Nothing is inside the region, or units, depths or dimensions are not those expected.
    """
    ds, where = field.ds, str(field.part.paths[0])
    block = block_of(layout, config, where)
    _check_size(ds, layout, block, where)
    longitude, latitude = _coordinates(layout, block)
    if min(longitude.shape) < 2:
        raise ForecastError(
            f"{where}: the region holds a grid of {longitude.shape}; at least 2 x 2 points are needed: widen --region"
        )
    source = Source(ds, layout, block, field.member, where, field.last_time)
    dims = tuple(find_depth(ds, ds[name].dims) for name in (U, V))
    s_coordinate = None if dims[0] is None else find_s_coordinate(ds, dims[0], where)
    if s_coordinate is None:
        levels = choose_levels(
            ds, dims, config, 0.5 * float(latitude.min() + latitude.max()), where
        )
    order = levels.position if s_coordinate is None else np.arange(s_coordinate.s.size)
    mask, by_level = mask_at_centres(source, dims[0], order)
    # a mask of the surface says nothing of fixed depths, which may lie below the sea bed
    masked = by_level or (mask is not None and s_coordinate is not None)
    velocity, counts = _at_centres(source, field.part.current, dims, order, masked)
    if velocity.shape[-2:] != longitude.shape:
        got, expected = (
            " x ".join(map(str, shape)) for shape in (velocity.shape[-2:], longitude.shape)
        )
        raise ForecastError(
            f"{where}: the currents have {got} points, the coordinates {expected}; give each forecast alone, with the file of its own grid"
        )
    if mask is not None:
        velocity[..., ~np.broadcast_to(mask, velocity.shape[2:])] = np.nan
    sea_level = _surface(source)
    if s_coordinate is not None:
        h = source.read(s_coordinate.h, layout.centre_dims, AT_CENTRES, None)[0, 0]
        velocity, levels = from_s_levels(velocity, s_coordinate, h, sea_level, config.levels, where)
    first = None if sea_level is None else np.asarray(sea_level[0])
    notes = (*layout.notes, *counts, *levels.notes)
    # of terrain-following levels it was said where the water above the first was left dry
    if (least := levels.within[0]) > 0.0 and not any(LEFT_DRY in note for note in levels.notes):
        notes += (
            f"{WARNING}the file has no level near the water above {least:.4g} m: the current of the first level is taken there",
        )
    return Window(
        longitude, latitude, levels.depth, levels.within, velocity, layout.axes, first, notes
    )


def window_size(ds: xr.Dataset, layout: Layout, config: ForecastConfig, where: str) -> int:
    """Return what the velocities inside the region take in memory [bytes]; the arguments are those of ``read_window``."""
    (rows, columns), component = block_of(layout, config, where), ds[U]
    points = (rows.stop - rows.start) * sum(part.stop - part.start for part in columns)
    return int(
        16
        * points
        * np.prod([size for dim, size in component.sizes.items() if dim not in layout.u_dims])
    )


def block_of(layout: Layout, config: ForecastConfig, where: str) -> Block:
    """Return the rows and columns of a file's cells that lie in the region; the arguments are those of ``read_window``."""
    x, y = layout.places
    if config.region is None:
        return layout.rows, (layout.columns,)
    block = region_block(x, y, config.region)
    if block is None:
        raise ForecastError(
            f"{where}: no grid point inside the region {config.region} (west, south, east, north); the file covers "
            f"{x.min():.3f}..{x.max():.3f} E, {y.min():.3f}..{y.max():.3f} N"
        )
    rows, columns = block
    return _moved(rows, layout.rows.start), tuple(
        _moved(part, layout.columns.start) for part in columns
    )


def _check_size(ds: xr.Dataset, layout: Layout, block: Block, where: str) -> None:
    """Refuse velocities that are no numbers, or more than the file can be meant to hold."""
    rows, columns = block
    points = (rows.stop - rows.start) * sum(part.stop - part.start for part in columns)
    for name, dims in ((U, layout.u_dims), (V, layout.v_dims)):
        part = ds[name]
        fields = math.prod(size for dim, size in part.sizes.items() if dim not in dims)
        shown = part.attrs.get("replay_kit_name", name)
        if part.dtype.kind not in "fiu":
            raise ForecastError(
                f"{where}: expected numbers, {shown} holds values of the type {part.dtype}; give a forecast of currents"
            )
        if why := exceeds_claim(Path(where), max(8 * points * fields, chunk_bytes(part))):
            raise ForecastError(
                f"{where}: {shown} cannot be read: {why}; choose less with --region and --levels, or mend the file"
            )


def _moved(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)


def _coordinates(layout: Layout, block: Block) -> tuple[Array, Array]:
    rows, columns = block
    if layout.longitude.ndim == 1:
        x, y = np.meshgrid(
            np.concatenate([layout.longitude[part] for part in columns]), layout.latitude[rows]
        )
        return x, y
    x, y = (
        np.concatenate([axis[rows, part] for part in columns], axis=1)
        for axis in (layout.longitude, layout.latitude)
    )
    return x, y


def _at_centres(
    source: Source,
    current: Current,
    depths: tuple[str | None, ...],
    order: NDArray[np.int64],
    masked: bool,
) -> tuple[Values, tuple[str, ...]]:
    """Return both components at cell centres [m/s], shape (E, 2, Z, J, I), NaN on land, and what was taken for land."""
    layout, face = source.layout, source.layout.first_face
    raw, odd = [], 0
    for component, name, depth in zip((U, V), (current.u, current.v), depths, strict=True):
        values, undeclared = _speeds(
            source.component(component, depth, order), source, component, name
        )
        odd += undeclared
        raw.append(values)
    constant = constant_land(source, raw, depths, order, masked)
    notes = (
        [f"treated as missing: {count_text(odd, 'value')} beyond {_NO_SPEED:g} m/s"] if odd else []
    )
    if face is None:
        dry = constant[0] & constant[1]
        exactly = "exactly zero" if np.all(raw[0][:, dry] == 0.0) else "one constant value"
        velocity = np.stack(raw, axis=1)
        if dry.any():
            velocity[:, :, dry] = np.nan
        columns = int(dry.all(axis=0).sum())
        notes += (
            [
                f"treated as land: {count_text(columns, 'column')} whose current is {exactly} in every member"
            ]
            if columns
            else []
        )
        return velocity, tuple(notes)
    means = []
    masks = layout.kind.mask_u, layout.kind.mask_v
    for axis, values, dry, names_of, place in zip(
        (-1, -2), raw, constant, masks, source.places, strict=True
    ):
        mask = next((name for name in names_of if name in source.ds.variables), None)
        valid = np.isfinite(values) & ~dry
        if mask is not None:
            valid &= source.read(mask, *place, (str(depths[0]), order))[0] > 0.0
        means.append(to_centres(values, valid, axis))
    (u, u_wet), (v, v_wet) = means
    wet = u_wet | v_wet
    return np.stack([np.where(wet, u, np.nan), np.where(wet, v, np.nan)], axis=1), tuple(notes)


def _speeds(values: Values, source: Source, component: str, name: str | None) -> tuple[Values, int]:
    """Return velocities in m/s, NaN where they cannot be any, and how many of these the file does not declare."""
    unit = str(source.ds[component].attrs.get("units", "")).strip()
    scale = metres_per_second(unit) if unit else 1.0
    if scale is None:
        raise ForecastError(
            f"{source.where}: {name} is in '{unit}'; expected m s-1 or cm s-1: convert it, and set its attribute units"
        )
    if scale != 1.0:
        values *= scale
    odd = 0
    for member in values:
        with np.errstate(invalid="ignore"):
            beyond = np.abs(member) > _NO_SPEED
        if count := np.count_nonzero(beyond):
            member[beyond] = np.nan
            odd += int(count)
    return values, odd


def _surface(source: Source) -> Array | None:
    """Return the height of the surface [m], shape (E or 1, J, I); None where the file has none at cell centres."""
    centre = source.layout.centre_dims
    name = source.first_of(SEA_LEVEL, centre)
    if name is None:
        return None
    scale = metres(str(source.ds[name].attrs.get("units", "m")).strip())
    return source.read(name, centre, AT_CENTRES, None)[:, 0] * (scale or 1.0)
