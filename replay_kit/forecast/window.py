"""Window of one file: both components at cell centres and fixed depths; nothing else is read."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.inputs import exceeds_claim
from replay_kit.core.words.quantities import metres, metres_per_second
from replay_kit.core.words.text import count_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.grids.depths import choose_levels
from replay_kit.forecast.grids.layout import CENTRE, Layout, U, V
from replay_kit.forecast.grids.s_levels import (
    LEFT_DRY,
    follows_terrain,
    from_s_levels,
    read_terrain,
)
from replay_kit.forecast.members.rules import WARNING
from replay_kit.forecast.names import SEA_LEVEL, Axes, find_depth
from replay_kit.forecast.variables import (
    chunk_bytes,
    constant_land,
    first_of,
    mask_at_centres,
    read_component,
    read_variable,
    to_centres,
)

# Faster than any current: a fill value that the file does not declare.
_NO_SPEED = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Members of one file in the window read.

    Attributes:
        longitude: Longitude, shape (J, I) [degrees east].
        latitude: Latitude, shape (J, I) [degrees north].
        levels: Depths of the levels, shape (Z,) [m].
        within: Range of depths that the levels of the file represent [m].
        velocity: Velocities in the file's precision, NaN on land, shape (E, 2, Z, J, I) [m/s].
        axes: Axes of the components.
        sea_level: Sea surface height of the first member [m], shape (J, I); None if absent.
        notes: Choices and assumptions.
    """

    longitude: Array
    latitude: Array
    levels: Array
    within: tuple[float, float]
    velocity: Values
    axes: Axes
    sea_level: Array | None
    notes: tuple[str, ...]


def read_window(field: Field, layout: Layout, config: ForecastConfig) -> Window:
    """Return the members of a file at one time, in its used part, on the chosen levels.

    Args:
        field: Members of the file.
        layout: Used part of the file.
        config: Requested levels.

    Raises:
        ForecastError: Units, depths or dimensions are not as expected.
    """
    ds, where = field.ds, field.where
    longitude, latitude = layout.points
    if min(longitude.shape) < 2:
        raise ForecastError(
            f"{where}: the region holds a grid of {longitude.shape}; at least 2 x 2 points are needed: widen --region"
        )
    dims = {name: find_depth(ds, ds[name].dims) for name in (U, V)}
    terrain = follows_terrain(ds, dims[U])
    if terrain:
        order = np.arange(ds.sizes[dims[U]])
    else:
        middle = 0.5 * float(latitude.min() + latitude.max())
        levels = choose_levels(ds, tuple(dims.values()), config, middle, where)
        order = levels.position
    depth_dims = {**dims, CENTRE: dims[U]}
    layout = replace(layout, levels={name: (dim, order) for name, dim in depth_dims.items() if dim})
    mask, by_level = mask_at_centres(field, layout)
    # a mask of the surface says nothing of fixed depths, which may lie below the sea bed
    velocity, counts = _at_centres(field, layout, by_level or (mask is not None and terrain))
    if velocity.shape[-2:] != longitude.shape:
        got, expected = (
            " x ".join(map(str, shape)) for shape in (velocity.shape[-2:], longitude.shape)
        )
        raise ForecastError(
            f"{where}: the currents have {got} points, the coordinates {expected}; give each forecast alone, with the file of its own grid"
        )
    if mask is not None:
        velocity[..., ~np.broadcast_to(mask, velocity.shape[2:])] = np.nan
    sea_level = _surface(field, layout)
    if terrain:
        depths = read_terrain(field, layout, sea_level)
        velocity, levels = from_s_levels(velocity, depths, config.levels, where)
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


def window_size(field: Field, layout: Layout) -> int:
    """Return the memory of the velocities in the used part of a file [bytes], in double precision."""
    sizes = field.ds[U].sizes.items()
    others = math.prod(n for dim, n in sizes if dim not in layout.dims[U])
    return 16 * layout.rows.size * layout.columns.size * others


def check_claims(fields: Sequence[Field], layout: Layout) -> None:
    """Raise ForecastError for velocities that are not numeric, or implausibly many for their file.

    Args:
        fields: Fields to be read, each at one time.
        layout: Used part of the first file.
    """
    claims = Counter[Path]()
    for field in fields:
        claims[field.paths[0]] += window_size(field, layout) // 2
    for field in {field.paths[0]: field for field in fields}.values():
        for name in (U, V):
            part = field.ds[name]
            shown = part.attrs.get("replay_kit_name", name)
            if part.dtype.kind not in "fiu":
                raise ForecastError(
                    f"{field.where}: expected numbers, {shown} holds values of the type {part.dtype}; give a forecast of currents"
                )
            size = max(claims[field.paths[0]], chunk_bytes(part))
            if why := exceeds_claim(field.paths[0], size):
                raise ForecastError(
                    f"{field.where}: {shown} cannot be read: {why}; choose less with --region and --levels, or mend the file"
                )


def _at_centres(field: Field, layout: Layout, masked: bool) -> tuple[Values, tuple[str, ...]]:
    """Return both components at cell centres [m/s], shape (E, 2, Z, J, I), NaN on land, and notes on assumed land."""
    raw, odd = zip(*(_speeds(field, layout, name) for name in (U, V)), strict=True)
    constant, notes = constant_land(field, layout, raw, masked), list[str]()
    if any(odd):
        notes.append(
            f"treated as missing: {count_text(sum(odd), 'value')} beyond {_NO_SPEED:g} m/s"
        )
    if layout.first_face is None:
        dry = constant[0] & constant[1]
        exactly = "exactly zero" if np.all(raw[0][:, dry] == 0.0) else "one constant value"
        velocity = np.stack(raw, axis=1)
        if dry.any():
            velocity[:, :, dry] = np.nan
        if columns := int(dry.all(axis=0).sum()):
            notes.append(
                f"treated as land: {count_text(columns, 'column')} whose current is {exactly} in every member"
            )
        return velocity, tuple(notes)
    means = []
    masks = (U, -1, layout.kind.mask_u), (V, -2, layout.kind.mask_v)
    for (points, axis, names), values, dry in zip(masks, raw, constant, strict=True):
        mask = next((name for name in names if name in field.ds.variables), None)
        valid = np.isfinite(values) & ~dry
        if mask is not None:
            valid &= read_variable(field, layout, mask, points)[0] > 0.0
        means.append(to_centres(values, valid, axis))
    (u, u_wet), (v, v_wet) = means
    wet = u_wet | v_wet
    return np.stack([np.where(wet, u, np.nan), np.where(wet, v, np.nan)], axis=1), tuple(notes)


def _speeds(field: Field, layout: Layout, name: str) -> tuple[Values, int]:
    """Return a component in m/s, implausible values as NaN, and the number of these not declared missing."""
    values, about = read_component(field, layout, name), field.ds[name].attrs
    unit = str(about.get("units", "")).strip()
    scale = metres_per_second(unit) if unit else 1.0
    if scale is None:
        raise ForecastError(
            f"{field.where}: {about['replay_kit_name']} is in '{unit}'; expected m s-1 or cm s-1: convert it, and set its attribute units"
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


def _surface(field: Field, layout: Layout) -> Array | None:
    """Return the sea surface height [m], shape (E or 1, J, I); None if absent at cell centres."""
    name = first_of(field, layout, SEA_LEVEL)
    if name is None:
        return None
    scale = metres(str(field.ds[name].attrs.get("units", "m")).strip())
    return read_variable(field, layout, name)[:, 0].astype(np.float64) * (scale or 1.0)
