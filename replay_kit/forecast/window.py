"""The part of one file that is used: only the window is read, and both components come to cell centres and fixed depths."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array
from replay_kit.core.claims import exceeds_claim
from replay_kit.core.errors import ForecastError
from replay_kit.core.text import count_text
from replay_kit.forecast.depths import choose_levels
from replay_kit.forecast.grid import Block, region_block
from replay_kit.forecast.layout import Layout, U, V
from replay_kit.forecast.names import LEVEL_COUNTS, SEA_LEVEL, Axes, Current, find_depth
from replay_kit.forecast.s_levels import SCoordinate, at_depths, find_s_coordinate
from replay_kit.forecast.stagger import never_changing, to_centres

_SPEED_UNITS = {
    **dict.fromkeys(
        (
            "",
            "m s-1",
            "m/s",
            "m/sec",
            "m.s-1",
            "m s^-1",
            "m s**-1",
            "meter/s",
            "meter/sec",
            "meter s-1",
            "metre/s",
        ),
        1.0,
    ),
    **dict.fromkeys(
        (
            "meter second-1",
            "metre second-1",
            "meters/second",
            "meter second^-1",
            "meters s-1",
            "meters/sec",
            "meters/s",
        ),
        1.0,
    ),
    **dict.fromkeys(
        (
            "cm s-1",
            "cm/s",
            "cm/sec",
            "cm.s-1",
            "cm s^-1",
            "centimeter/s",
            "centimeter s-1",
            "centimeters/second",
        ),
        0.01,
    ),
}
# Faster than any current: a fill value that the file does not declare.
_NO_SPEED = 1e3

_Faces = tuple[int | None, int | None]
_AT_CENTRES: _Faces = (None, None)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Members of one file in the part used.

    Attributes:
        longitude: shape (J, I) [degrees].
        latitude: shape (J, I) [degrees].
        levels: shape (Z,) [m].
        velocity: shape (E, 2, Z, J, I) [m/s], NaN on land.
        axes: Along which axes the components lie.
        sea_level: Height of the surface of the first member [m], shape (J, I); None where the file has none.
        notes: What was chosen or assumed.
    """

    longitude: Array
    latitude: Array
    levels: Array
    velocity: Array
    axes: Axes
    sea_level: Array | None
    notes: tuple[str, ...]


def read_window(
    ds: xr.Dataset,
    current: Current,
    layout: Layout,
    member: str | None,
    config: ForecastConfig,
    where: str,
) -> Window:
    """Return the members of a dataset at one time, inside the region, on the chosen levels.

    Args:
        ds: With the components ``U`` and ``V``, at one time.
        current: The components' names in the file, for messages.
        layout: Of the dataset.
        member: Its member dimension; None for one member.
        config: Region and levels.
        where: The file, for messages.

    Raises:
        ForecastError: Nothing is inside the region, or units, depths or dimensions are not those expected.
    """
    block = _block(layout, config, where)
    _check_size(ds, layout, block, where)
    longitude, latitude = _coordinates(layout, block)
    if min(longitude.shape) < 2:
        raise ForecastError(
            f"{where}: the region holds a grid of {longitude.shape}; at least 2 x 2 points are needed: widen --region"
        )
    source = _Source(ds, layout, block, member, where)
    dims = tuple(find_depth(ds, ds[name].dims) for name in (U, V))
    s_coordinate = None if dims[0] is None else find_s_coordinate(ds, dims[0], where)
    notes: tuple[str, ...] = ()
    if s_coordinate is None:
        levels, order, notes = choose_levels(
            ds, dims, config, 0.5 * float(latitude.min() + latitude.max()), where
        )
    else:
        levels, order = np.zeros(0), np.arange(s_coordinate.s.size)
    velocity, counts = _at_centres(source, (current.u, current.v), dims, order)
    if velocity.shape[-2:] != longitude.shape:
        got, expected = (
            " x ".join(map(str, shape)) for shape in (velocity.shape[-2:], longitude.shape)
        )
        raise ForecastError(
            f"{where}: the currents have {got} points, the coordinates {expected}; give each forecast alone, with the file of its own grid"
        )
    velocity = np.where(_mask(source, dims[0], order), velocity, np.nan)
    sea_level = _surface(source)
    if s_coordinate is not None:
        velocity, levels, notes = _from_s_levels(source, s_coordinate, velocity, sea_level, config)
    first = None if sea_level is None else np.asarray(sea_level[0])
    return Window(
        longitude, latitude, levels, velocity, layout.axes, first, (*layout.notes, *counts, *notes)
    )


def window_size(ds: xr.Dataset, layout: Layout, config: ForecastConfig, where: str) -> int:
    """Return what the velocities inside the region take in memory [bytes]; the arguments are those of ``read_window``."""
    (rows, columns), component = _block(layout, config, where), ds[U]
    points = (rows.stop - rows.start) * sum(part.stop - part.start for part in columns)
    return int(
        16
        * points
        * np.prod([size for dim, size in component.sizes.items() if dim not in layout.u_dims])
    )


def _block(layout: Layout, config: ForecastConfig, where: str) -> Block:
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
        if why := exceeds_claim(Path(where), 8 * points * fields):
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


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A dataset, and which part of it is read."""

    ds: xr.Dataset
    layout: Layout
    block: Block
    member: str | None
    where: str

    def read(
        self,
        name: str,
        dims: tuple[str, str],
        faces: _Faces,
        levels: tuple[str, NDArray[np.int64]] | None,
    ) -> Array:
        """Return a variable's part: shape (E, Z, J, I); E or Z is 1 where it has no such dimension.

        Args:
            name: Of the variable.
            dims: Its horizontal dimensions.
            faces: Position of the face before centre 0 along each; None where it lies at the centres.
            levels: Dimension and positions of the levels.
        """
        part = self.ds[name]
        if levels is not None and levels[0] not in part.dims:
            # masks may have the levels under another name
            alike = [
                dim
                for dim in part.dims
                if dim not in (*dims, self.member)
                and 1 < part.sizes[dim] == self.ds.sizes[levels[0]]
            ]
            part = part.rename(dict.fromkeys(alike[:1], levels[0]))
        wanted = [
            dim
            for dim in (self.member, levels[0] if levels else None)
            if dim is not None and dim in part.dims
        ]
        extra = [dim for dim in part.dims if dim not in (*wanted, *dims)]
        if any(part.sizes[dim] > 1 for dim in extra) or any(dim not in part.dims for dim in dims):
            expected = ", ".join(filter(None, (self.member, levels[0] if levels else None, *dims)))
            sizes = ", ".join(f"{dim} = {size}" for dim, size in part.sizes.items())
            shown = part.attrs.get("replay_kit_name", name)
            raise ForecastError(
                f"{self.where}: {shown} has dimensions {sizes}; expected {expected} after choosing a time"
            )
        part = part.isel(dict.fromkeys(extra, 0)).transpose(*wanted, *dims)
        if levels is not None and levels[0] in part.dims:
            part = part.isel({levels[0]: _as_slice(levels[1])})
        rows, columns = _with_faces(self.block[0], faces[0]), self._columns(faces[1])
        pieces = [
            np.asarray(part.isel({dims[0]: rows, dims[1]: piece}).values, dtype=np.float64)
            for piece in columns
        ]
        values = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=-1)
        if levels is None or levels[0] not in wanted:
            values = np.expand_dims(values, -3)
        return values if self.member in wanted else values[None]

    def _columns(self, first: int | None) -> Sequence[slice]:
        """Return the ranges of columns to read, in their order in space; with faces, those on both sides, also round the globe."""
        parts, period = self.block[1], self.layout.period
        if first is None or period is None:
            return [_with_faces(part, first) for part in parts]
        # counted on past the seam, and cut there
        start, stop = parts[0].start + first, parts[-1].stop + first + 1 + period * (len(parts) - 1)
        turns = range(start // period, (stop - 1) // period + 1)
        return [
            slice(max(start - turn * period, 0), min(stop - turn * period, period))
            for turn in turns
        ]


def _with_faces(part: slice, first: int | None) -> slice:
    """Return the faces on both sides of a range of centres; the range itself where values lie at the centres."""
    return part if first is None else slice(part.start + first, part.stop + first + 1)


def _as_slice(order: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Return positions as a slice where they follow each other, which is read faster."""
    if order.size > 1 and np.all(np.diff(order) == 1):
        return slice(int(order[0]), int(order[-1]) + 1)
    return order


def _at_centres(
    source: _Source,
    names: tuple[str | None, str | None],
    depths: tuple[str | None, ...],
    order: NDArray[np.int64],
) -> tuple[Array, tuple[str, ...]]:
    """Return both components at cell centres [m/s], shape (E, 2, Z, J, I), NaN on land, and what was taken for land."""
    layout, face = source.layout, source.layout.first_face
    at_u, at_v = ((None, face[1]), (face[0], None)) if face else (_AT_CENTRES, _AT_CENTRES)
    places: tuple[tuple[tuple[str, str], _Faces], ...] = (
        (layout.u_dims, at_u),
        (layout.v_dims, at_v),
    )
    raw, constant, odd = [], [], 0
    for component, name, depth, (dims, faces) in zip((U, V), names, depths, places, strict=True):
        values, undeclared = _speeds(
            source.read(component, dims, faces, None if depth is None else (depth, order)),
            source,
            component,
            name,
        )
        odd += undeclared
        constants = {0.0, float(source.ds[component].attrs.get("replay_kit_offset", 0.0))}
        raw.append(values)
        constant.append(never_changing(values, constants))
    notes = (
        [f"taken for missing: {count_text(odd, 'value')} beyond {_NO_SPEED:g} m/s"] if odd else []
    )
    if face is None:
        dry = constant[0] & constant[1]
        velocity = np.stack(raw, axis=1)
        velocity[:, :, dry] = np.nan
        columns = int(dry.all(axis=0).sum())
        exactly = "exactly zero" if np.all(raw[0][:, dry] == 0.0) else "one constant value"
        notes += (
            [
                f"taken for land: {count_text(columns, 'column')} whose current is {exactly} in every member"
            ]
            if columns
            else []
        )
        return velocity, tuple(notes)
    means = []
    for axis, values, dry, names_of in (
        (-1, raw[0], constant[0], layout.kind.mask_u),
        (-2, raw[1], constant[1], layout.kind.mask_v),
    ):
        mask, place = (
            next((name for name in names_of if name in source.ds.variables), None),
            places[0 if axis == -1 else 1],
        )
        valid = np.isfinite(values) & ~dry
        if mask is not None:
            valid &= source.read(mask, place[0], place[1], (str(depths[0]), order))[0] > 0.0
        means.append(to_centres(values, valid, axis))
    (u, u_wet), (v, v_wet) = means
    wet = u_wet | v_wet
    return np.stack([np.where(wet, u, np.nan), np.where(wet, v, np.nan)], axis=1), tuple(notes)


def _speeds(values: Array, source: _Source, component: str, name: str | None) -> tuple[Array, int]:
    """Return velocities in m/s, NaN where they cannot be any, and how many of these the file does not declare."""
    unit = str(source.ds[component].attrs.get("units", "")).strip()
    if unit not in _SPEED_UNITS:
        raise ForecastError(
            f"{source.where}: {name} is in '{unit}'; expected m s-1 or cm s-1: convert it, and set its attribute units"
        )
    values = values * _SPEED_UNITS[unit]
    with np.errstate(invalid="ignore"):
        odd = np.abs(values) > _NO_SPEED
    if odd.any():
        values[odd] = np.nan
    return values, int(odd.sum())


def _mask(source: _Source, depth: str | None, order: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return where mask variables at cell centres have water, shape (1 or Z, J, I); all of it without any."""
    ds, centre = source.ds, source.layout.centre_dims
    wet = np.ones((1, 1, 1), dtype=bool)
    for name in source.layout.kind.mask:
        if name in ds.variables and set(centre) <= set(ds[name].dims):
            return np.asarray(
                source.read(name, centre, _AT_CENTRES, None if depth is None else (depth, order))[0]
                > 0.0
            )
    for name in LEVEL_COUNTS:
        if name in ds.variables and set(centre) <= set(ds[name].dims):
            return np.asarray(
                source.read(name, centre, _AT_CENTRES, None)[0] > order[:, None, None]
            )
    return wet


def _surface(source: _Source) -> Array | None:
    """Return the height of the surface [m], shape (E or 1, J, I); None where the file has none at cell centres."""
    ds, centre = source.ds, source.layout.centre_dims
    for name in SEA_LEVEL:
        if name in ds.variables and set(centre) <= set(ds[name].dims):
            scale = (
                0.01 if str(ds[name].attrs.get("units", "m")).startswith(("cm", "centi")) else 1.0
            )
            return source.read(name, centre, _AT_CENTRES, None)[:, 0] * scale
    return None


def _from_s_levels(
    source: _Source,
    coordinate: SCoordinate,
    velocity: Array,
    sea_level: Array | None,
    config: ForecastConfig,
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return velocities at fixed depths, those depths [m], and notes."""
    h = source.read(coordinate.h, source.layout.centre_dims, _AT_CENTRES, None)[0, 0]
    at_rest = np.sort(
        coordinate.depths(h, np.zeros_like(h)).reshape(coordinate.s.size, -1)[:, np.nanargmax(h)]
    )
    levels = np.unique(config.levels) if config.levels is not None else at_rest
    surface = np.zeros((1, *h.shape)) if sea_level is None else np.nan_to_num(sea_level)
    found = [
        at_depths(field, coordinate.depths(h, surface[min(k, surface.shape[0] - 1)]), h, levels)
        for k, field in enumerate(velocity)
    ]
    chosen = (
        "the levels asked for"
        if config.levels is not None
        else "those of the deepest column at rest"
    )
    own = (
        "its own surface"
        if sea_level is not None
        else "a surface at rest, as the file holds no zeta"
    )
    note = f"terrain-following levels (transform {coordinate.transform}) interpolated to fixed depths, {chosen}; each member with {own}"
    return np.stack(found), np.asarray(levels, dtype=np.float64), (note,)
