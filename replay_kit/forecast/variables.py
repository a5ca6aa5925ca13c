"""Values of variables in the used part of a file, in one order of dimensions; detection of land."""

import math
import os
from collections.abc import Iterable, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.core.arrays import Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.inputs import unpacking
from replay_kit.forecast.field import Field
from replay_kit.forecast.grids.horizontal import index_runs
from replay_kit.forecast.grids.layout import CENTRE, DIRECTION, Layout, U, V
from replay_kit.forecast.names import LEVEL_COUNTS, sizes_text


def read_variable(field: Field, layout: Layout, name: str, component: str = CENTRE) -> Values:
    """Return the used part of a variable, shape (E, Z, J, I), in the file's precision; E or Z is 1 without such a dimension.

    Args:
        field: Field of the file.
        layout: Rows, columns and levels used.
        name: Name of the variable.
        component: Its points: those of ``U`` or ``V``, or ``CENTRE``.
    """
    ds, dims = field.ds, layout.dims[component]
    depth, order = layout.levels.get(component, (None, np.zeros(0, np.int64)))
    part = _on(ds, name, dims)
    if depth is not None and depth not in part.dims:
        # masks may have the levels under another name
        others = [dim for dim in part.dims if dim not in (*dims, field.member)]
        alike = [dim for dim in others if 1 < part.sizes[dim] == ds.sizes[depth]]
        part = part.rename(dict.fromkeys(alike[:1], depth))
    wanted = [dim for dim in (field.member, depth) if dim in part.dims]
    extra = [dim for dim in part.dims if dim not in (*wanted, *dims)]
    if any(part.sizes[dim] > 1 for dim in extra) or not set(dims) <= set(part.dims):
        expected = ", ".join(filter(None, (field.member, depth, *dims)))
        shown = part.attrs.get("replay_kit_name", name)
        raise ForecastError(
            f"{field.where}: {shown} has dimensions {sizes_text(part)}; expected {expected} after choosing a time"
        )
    part = part.isel(dict.fromkeys(extra, 0)).transpose(*wanted, *dims)
    if depth in part.dims:
        part = part.isel({depth: index_runs(order)[0] if np.all(np.diff(order) == 1) else order})
    rows, columns = (index_runs(index) for index in layout.taken(component))
    pieces = [unpacked_values(part.isel({dims[0]: rows[0], dims[1]: piece})) for piece in columns]
    values = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=-1)
    if depth not in wanted:
        values = np.expand_dims(values, -3)
    return values if field.member in wanted else values[None]


def read_component(field: Field, layout: Layout, name: str) -> Values:
    """Return the component ``U`` or ``V`` at its own points as ``read_variable`` does; see there for the arguments."""
    values = read_variable(field, layout, name, name)
    if (turn := field.ds[name].attrs.get("replay_kit_turn")) is not None:
        angle = read_variable(field, layout, DIRECTION, name).astype(np.float64)
        values *= np.cos(np.deg2rad(angle + turn))
    return values


def first_of(field: Field, layout: Layout, names: Iterable[str]) -> str | None:
    """Return the first of some variables at the cell centres of a file; None if all are absent."""
    dims = layout.dims[CENTRE]
    there = (name for name in names if name in field.ds.variables)
    return next((name for name in there if set(dims) <= set(_on(field.ds, name, dims).dims)), None)


def _on(ds: xr.Dataset, name: str, dims: tuple[str, str]) -> xr.DataArray:
    """Return a variable on two horizontal dimensions, identified by position and length if names differ.

    CROCO's history has u on the rows of the centres (eta_rho, xi_u), the file of its grid mask_u on rows of its own (eta_u, xi_u).
    """
    part, sizes = ds[name], ds.sizes
    other = zip(map(str, part.dims[-2:]), dims, strict=False) if part.ndim > 1 else ()
    return part.rename(
        {
            found: dim
            for found, dim in other
            if dim not in part.dims and part.sizes[found] == sizes[dim]
        }
    )


def chunk_bytes(part: xr.DataArray) -> int:
    """Return the memory of one chunk of a variable [bytes], which is unpacked for any part of it."""
    return 8 * math.prod(part.encoding.get("chunksizes") or part.encoding.get("chunks") or ())


# Values of a single-precision file that are kept so from this size on, in double precision [bytes].
_MANY = 1 << 24


def precision(variable: xr.DataArray, count: int) -> np.dtype[np.floating]:
    """Return the precision for ``count`` values of a variable: double, but single for many values of single precision."""
    single = variable.dtype.kind == "f" and variable.dtype.itemsize <= 4 and 8 * count > _MANY
    return np.dtype(np.float32 if single else np.float64)


def unpacked_values(part: xr.DataArray) -> Values:
    """Return the unpacked values of a part of a variable as a writable array; for its type see ``precision``.

    The decoder's memory is limited to the needs of these values and its chunks.
    """
    # several threads decode a Zarr store
    threads = 0 if "chunksizes" in part.encoding else min(32, (os.cpu_count() or 1) + 4)
    with unpacking(8 * part.size + 4 * chunk_bytes(part), threads):
        return np.require(part.values, precision(part, part.size), "W")


def to_centres(
    faces: Values, valid: NDArray[np.bool_], axis: int
) -> tuple[Values, NDArray[np.bool_]]:
    """Return the mean of a component over the wet faces of each cell, and whether any is wet.

    Args:
        faces: Component at the faces, shape (..., n + 1, ...) [m/s]; dry faces are ignored.
        valid: Wet faces, same shape.
        axis: Axis of the faces: -1 or -2.
    """
    before, after = (
        (*(slice(None),) * (faces.ndim + axis), part) for part in (slice(-1), slice(1, None))
    )
    wet = np.where(valid, faces, 0.0)
    weight = valid[before].astype(faces.dtype) + valid[after]
    return (wet[before] + wet[after]) / np.maximum(weight, 1.0), weight > 0.0


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
        else:
            if constant == 0.0:
                below = np.logical_and.accumulate(same[::-1], axis=0)[::-1]
                at_rest = same.all(axis=(1, 2), keepdims=True)
                same = np.where(at_rest, same.all(axis=0), below)
            found |= same
    return found


def mask_at_centres(field: Field, layout: Layout) -> tuple[NDArray[np.bool_] | None, bool]:
    """Return the water of mask variables at cell centres, shape (1 or Z, J, I), and whether per level; None without masks."""
    if (name := first_of(field, layout, layout.kind.mask)) is not None:
        wet = read_variable(field, layout, name)[0] > 0.0
        return wet, sum(size > 1 for size in field.ds[name].shape) > 2
    if (name := first_of(field, layout, LEVEL_COUNTS)) is not None:
        _, order = layout.levels.get(CENTRE, ("", np.zeros(1, np.int64)))
        return np.asarray(read_variable(field, layout, name)[0] > order[:, None, None]), True
    return None, False


def constant_land(
    field: Field, layout: Layout, components: Sequence[Values], masked: bool
) -> list[NDArray[np.bool_]]:
    """Return the mask of each component's points with a constant for land in all members, shape (Z, J, I).

    Zeros are ambiguous if the current is 0 everywhere, as at the start of a run: then the file's last time is used. If that is at rest too,
    or absent, only a mask defines land.

    Args:
        field: Field of the file.
        layout: Layout of the file.
        components: Values of ``U`` and ``V``, shape (E, Z, J, I).
        masked: Whether a mask defines land on each level.
    """
    if not _moves(components):
        if (last := field.at_last_time) is not None:
            components = [read_component(last, layout, name) for name in (U, V)]
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
