"""Values of variables in the used part of a file, in one order of dimensions; detection of land and missing values."""

import math
import os
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.inputs import claim_text, held, unpacking
from replay_kit.forecast.field import Field
from replay_kit.forecast.grids.layout import AT_CENTRES, DIRECTION, Faces, Layout, U, V
from replay_kit.forecast.members.rules import no_water
from replay_kit.forecast.names import LEVEL_COUNTS, sizes_text

# Dimension and positions of levels.
_Levels = tuple[str, NDArray[np.int64]] | None


def component(field: Field, ds: xr.Dataset, layout: Layout, name: str, levels: _Levels) -> Values:
    """Return the component ``U`` or ``V`` at its own points, shape (E, Z, J, I), on some levels, in the file's precision.

    Args:
        field: Field of the file.
        ds: Dataset of the file at one time.
        layout: Layout of the file.
        name: Name of the component.
        levels: Dimension and positions of the levels.
    """
    dims, faces = (layout.v_dims if name == V else layout.u_dims), layout.faces[name == V]
    values = _stored(field, ds, layout, name, dims, faces, levels)
    if (turn := ds[name].attrs.get("replay_kit_turn")) is not None:
        angle = _stored(field, ds, layout, DIRECTION, dims, faces, levels).astype(np.float64)
        values *= np.cos(np.deg2rad(angle + turn))
    return values


def first_of(field: Field, names: Iterable[str], dims: tuple[str, str]) -> str | None:
    """Return the first of some variables on two horizontal dimensions in a file; None if all are absent."""
    there = (name for name in names if name in field.ds.variables)
    return next((name for name in there if set(dims) <= set(_on(field.ds, name, dims).dims)), None)


def _on(ds: xr.Dataset, name: str, dims: tuple[str, str]) -> xr.DataArray:
    """Return a variable on two horizontal dimensions, identified by position and length if names differ.

    CROCO's history has u on the rows of the centres (eta_rho, xi_u), the file of its grid mask_u on rows of its own (eta_u, xi_u).
    """
    part, sizes = ds[name], ds.sizes
    if part.ndim < 2:
        return part
    other = zip(map(str, part.dims[-2:]), dims, strict=True)
    return part.rename(
        {own: dim for own, dim in other if dim not in part.dims and part.sizes[own] == sizes[dim]}
    )


def read(
    field: Field,
    layout: Layout,
    name: str,
    dims: tuple[str, str],
    faces: Faces = AT_CENTRES,
    levels: _Levels = None,
) -> Array:
    """Return the used part of a variable, shape (E, Z, J, I); E or Z is 1 without such a dimension.

    Args:
        field: Field of the file.
        layout: Layout with the rows and columns used.
        name: Name of the variable.
        dims: Horizontal dimensions of the variable.
        faces: Position of the face before centre 0 along each dimension; None at the centres.
        levels: Dimension and positions of the levels.
    """
    return _stored(field, field.ds, layout, name, dims, faces, levels).astype(np.float64)


def _stored(
    field: Field,
    ds: xr.Dataset,
    layout: Layout,
    name: str,
    dims: tuple[str, str],
    faces: Faces,
    levels: _Levels,
) -> Values:
    part = _on(ds, name, dims)
    if levels is not None and levels[0] not in part.dims:
        # masks may have the levels under another name
        alike = [
            dim
            for dim in part.dims
            if dim not in (*dims, field.member) and 1 < part.sizes[dim] == ds.sizes[levels[0]]
        ]
        part = part.rename(dict.fromkeys(alike[:1], levels[0]))
    of_levels = levels[0] if levels else None
    wanted = [dim for dim in (field.member, of_levels) if dim is not None and dim in part.dims]
    extra = [dim for dim in part.dims if dim not in (*wanted, *dims)]
    if any(part.sizes[dim] > 1 for dim in extra) or any(dim not in part.dims for dim in dims):
        expected = ", ".join(filter(None, (field.member, of_levels, *dims)))
        shown = part.attrs.get("replay_kit_name", name)
        raise ForecastError(
            f"{field.where}: {shown} has dimensions {sizes_text(part)}; expected {expected} after choosing a time"
        )
    part = part.isel(dict.fromkeys(extra, 0)).transpose(*wanted, *dims)
    if levels is not None and levels[0] in part.dims:
        part = part.isel({levels[0]: _as_slice(levels[1])})
    rows, columns = _with_faces(layout.rows, faces[0]), _columns(layout, faces[1])
    pieces = [unpacked(part.isel({dims[0]: rows, dims[1]: piece})) for piece in columns]
    values = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=-1)
    if of_levels not in wanted:
        values = np.expand_dims(values, -3)
    return values if field.member in wanted else values[None]


def _columns(layout: Layout, first: int | None) -> Sequence[slice]:
    """Return the ranges of columns to read, in their order in space; with faces on both sides, also round the globe."""
    parts, period = layout.columns, layout.period
    if first is None or period is None:
        return [_with_faces(part, first) for part in parts]
    # counted on past the seam, and cut there
    start, stop = parts[0].start + first, parts[-1].stop + first + 1 + period * (len(parts) - 1)
    turns = range(start // period, (stop - 1) // period + 1)
    return [
        slice(max(start - turn * period, 0), min(stop - turn * period, period)) for turn in turns
    ]


def chunk_bytes(part: xr.DataArray) -> int:
    """Return the memory of one chunk of a variable [bytes], which is unpacked for any part of it."""
    return 8 * math.prod(part.encoding.get("chunksizes") or part.encoding.get("chunks") or ())


# Values of a single-precision file that are kept so from this size on, in double precision [bytes].
_MANY = 1 << 24


def precision(variable: xr.DataArray, count: int) -> np.dtype[np.floating]:
    """Return the precision for ``count`` values of a variable: double, but single for many values of single precision."""
    single = variable.dtype.kind == "f" and variable.dtype.itemsize <= 4 and 8 * count > _MANY
    return np.dtype(np.float32 if single else np.float64)


def unpacked(part: xr.DataArray) -> Values:
    """Return the unpacked values of a part of a variable as a writable array; for its type see ``precision``.

    The decoder's memory is limited to the needs of these values and its chunks.
    """
    # several threads decode a Zarr store
    threads = 0 if "chunksizes" in part.encoding else min(32, (os.cpu_count() or 1) + 4)
    with unpacking(8 * part.size + 4 * chunk_bytes(part), threads):
        return np.require(part.values, precision(part, part.size), "W")


def _with_faces(part: slice, first: int | None) -> slice:
    """Return the faces on both sides of a range of centres; the range itself for values at the centres."""
    return part if first is None else slice(part.start + first, part.stop + first + 1)


def _as_slice(order: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Return positions as a slice, which is read faster, if they are consecutive."""
    if order.size > 1 and np.all(np.diff(order) == 1):
        return slice(int(order[0]), int(order[-1]) + 1)
    return order


def to_centres(
    faces: Values, valid: NDArray[np.bool_], axis: int
) -> tuple[Values, NDArray[np.bool_]]:
    """Return the mean of a component over the wet faces of each cell, and whether any is wet.

    Args:
        faces: Component at the faces, shape (..., n + 1, ...) [m/s]; dry faces are ignored.
        valid: Wet faces, same shape.
        axis: Axis of the faces.
    """
    first, last = (
        np.take(np.where(valid, faces, 0.0), _range(faces, axis, k), axis) for k in (0, 1)
    )
    wet = [np.take(valid, _range(faces, axis, k), axis) for k in (0, 1)]
    weight = wet[0].astype(faces.dtype) + wet[1]
    return (first + last) / np.maximum(weight, 1.0), weight > 0.0


def _range(faces: Values, axis: int, first: int) -> NDArray[np.intp]:
    return np.arange(first, faces.shape[axis] - 1 + first)


def never_changing(values: Values, constants: Iterable[float]) -> NDArray[np.bool_]:
    """Return the mask of points at which all members equal one of some constants, shape (Z, J, I).

    Zeros count from the sea bed up, in columns that are dry there: a level at rest everywhere is not land.

    Args:
        values: Values, shape (E, Z, J, I), processed member by member.
        constants: 0, and the unpacked value of a fill value that packing cannot hold.
    """
    found = np.zeros(values.shape[1:], dtype=bool)
    for constant in constants:
        same = np.ones(values.shape[1:], dtype=bool)
        for member in values:
            # unpacked in single or double precision; one step of the packing is far more
            same &= np.abs(member - constant) <= 1e-6 * abs(constant)
            if not same.any():
                break
        if constant == 0.0:
            below = np.logical_and.accumulate(same[::-1], axis=0)[::-1]
            at_rest = same.all(axis=(1, 2), keepdims=True)
            same = np.where(at_rest, same.all(axis=0), below)
        found |= same
    return found


def mask_at_centres(
    field: Field, layout: Layout, levels: _Levels
) -> tuple[NDArray[np.bool_] | None, bool]:
    """Return the water of mask variables at cell centres, shape (1 or Z, J, I), and whether per level; None without masks."""
    centre = layout.centre_dims
    if (name := first_of(field, layout.kind.mask, centre)) is not None:
        wet = read(field, layout, name, centre, levels=levels)[0] > 0.0
        sizes = field.ds[name].sizes.values()
        return np.asarray(wet), sum(size > 1 for size in sizes) > len(centre)
    if (name := first_of(field, LEVEL_COUNTS, centre)) is not None:
        order = np.zeros(1, np.int64) if levels is None else levels[1]
        return np.asarray(read(field, layout, name, centre)[0] > order[:, None, None]), True
    return None, False


def constant_land(
    field: Field,
    layout: Layout,
    components: Sequence[Values],
    levels: Sequence[_Levels],
    masked: bool,
) -> list[NDArray[np.bool_]]:
    """Return the mask of each component's points with a constant for land in all members, shape (Z, J, I).

    Zeros are ambiguous if the current is 0 everywhere, as at the start of a run: then the file's last time is used. If that is at rest too,
    or absent, only a mask defines land.

    Args:
        field: Field of the file.
        layout: Layout of the file.
        components: Values of the components, shape (E, Z, J, I).
        levels: Levels of each component.
        masked: Whether a mask defines land on each level.
    """
    if not _moves(components):
        if (last := field.last_time) is not None:
            components = [
                component(field, last, layout, name, of)
                for name, of in zip((U, V), levels, strict=True)
            ]
        if masked and not _moves(components):
            return [np.zeros(values.shape[1:], dtype=bool) for values in components]
    offsets = (float(field.ds[name].attrs.get("replay_kit_offset", 0.0)) for name in (U, V))
    return [
        never_changing(values, {0.0, offset})
        for values, offset in zip(components, offsets, strict=True)
    ]


def _moves(components: Sequence[Values]) -> bool:
    """Return whether any value is neither missing nor 0."""
    return any(np.nan_to_num(member).any() for values in components for member in values)


# What is read without having been looked at [bytes], and per byte of the files: land alone takes less room than that.
_UNSEEN, _USUAL = 1 << 22, 12
# Values in water per byte of the files; and bytes that are looked at together, unless a chunk has more, up to the most of one.
_IN_WATER, _PART, _CHUNK = 32, 1 << 23, 1 << 26


def check_content(fields: Sequence[Field], layout: Layout, size: float, times: int) -> None:
    """Raise ForecastError if members are implausibly large for their files, as repeated bytes compress a thousandfold.

    Args:
        fields: Members at one time.
        layout: Used part of the first file.
        size: Memory of their currents [bytes].
        times: Number of times to be read.
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
    """Return the reason why stored bytes are too few for the members; empty if most points are land, which needs no room."""
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
    """Yield the parts of a variable along its first dimensions, each of at most ``most`` bytes in memory."""
    dim = next((dim for dim in values.dims if values.sizes[dim] > 1), None)
    if 8 * values.size <= most or dim is None:
        yield values
        return
    step = max(1, most * values.sizes[dim] // (8 * values.size))
    for start in range(0, values.sizes[dim], step):
        yield from _parts(values.isel({dim: slice(start, start + step)}), most)
