"""Variables of a file in the part of it that is used, with their dimensions in one order, and which of their values are land."""

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.inputs import unpacking
from replay_kit.forecast.grid import Block
from replay_kit.forecast.layout import DIRECTION, Layout, U, V
from replay_kit.forecast.names import LEVEL_COUNTS, sizes_text

Faces = tuple[int | None, int | None]
AT_CENTRES: Faces = (None, None)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A dataset, and which part of it is read.

    Attributes:
        ds: At one time.
        layout: Of the dataset.
        block: Rows and columns.
        member: Dimension of the members; None for one member.
        where: The file, for messages.
        last_time: The dataset at the last of its times, one member; None where it has but one.
    """

    ds: xr.Dataset
    layout: Layout
    block: Block
    member: str | None
    where: str
    last_time: xr.Dataset | None

    @property
    def places(self) -> tuple[tuple[tuple[str, str], Faces], tuple[tuple[str, str], Faces]]:
        """Of the two components: their horizontal dimensions, and the first faces along these."""
        layout, face = self.layout, self.layout.first_face
        at_u, at_v = ((None, face[1]), (face[0], None)) if face else (AT_CENTRES, AT_CENTRES)
        return (layout.u_dims, at_u), (layout.v_dims, at_v)

    def component(self, name: str, depth: str | None, order: NDArray[np.int64]) -> Values:
        """Return the component ``U`` or ``V`` where it lies, shape (E, Z, J, I), on some levels, in the file's precision."""
        levels = None if depth is None else (depth, order)
        values = self._stored(name, *self.places[name == V], levels)
        if (turn := self.ds[name].attrs.get("replay_kit_turn")) is not None:
            angle = self.read(DIRECTION, *self.places[name == V], levels)
            values = values * np.cos(np.deg2rad(angle + turn))
        return values

    def first_of(self, names: Iterable[str], dims: tuple[str, str]) -> str | None:
        """Return the first of some variables that the dataset holds on two horizontal dimensions; None without any."""
        there = (name for name in names if name in self.ds.variables)
        return next((name for name in there if set(dims) <= set(self._on(name, dims).dims)), None)

    def _on(self, name: str, dims: tuple[str, str]) -> xr.DataArray:
        """Return a variable on two horizontal dimensions: those of other names are the same where position and length are.

        CROCO's history has u on the rows of the centres (eta_rho, xi_u), the file of its grid mask_u on rows of its own (eta_u, xi_u).
        """
        part, sizes = self.ds[name], self.ds.sizes
        if part.ndim < 2:
            return part
        other = zip(map(str, part.dims[-2:]), dims, strict=True)
        return part.rename(
            {
                own: dim
                for own, dim in other
                if dim not in part.dims and part.sizes[own] == sizes[dim]
            }
        )

    def read(
        self,
        name: str,
        dims: tuple[str, str],
        faces: Faces,
        levels: tuple[str, NDArray[np.int64]] | None,
    ) -> Array:
        """Return a variable's part, shape (E, Z, J, I); E or Z is 1 where it has no such dimension.

        Args:
            name: Of the variable.
            dims: Its horizontal dimensions.
            faces: Position of the face before centre 0 along each; None where it lies at the centres.
            levels: Dimension and positions of the levels.
        """
        return self._stored(name, dims, faces, levels).astype(np.float64)

    def _stored(
        self,
        name: str,
        dims: tuple[str, str],
        faces: Faces,
        levels: tuple[str, NDArray[np.int64]] | None,
    ) -> Values:
        part = self._on(name, dims)
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
            sizes = sizes_text(part)
            shown = part.attrs.get("replay_kit_name", name)
            raise ForecastError(
                f"{self.where}: {shown} has dimensions {sizes}; expected {expected} after choosing a time"
            )
        part = part.isel(dict.fromkeys(extra, 0)).transpose(*wanted, *dims)
        if levels is not None and levels[0] in part.dims:
            part = part.isel({levels[0]: _as_slice(levels[1])})
        rows, columns = _with_faces(self.block[0], faces[0]), self._columns(faces[1])
        pieces = [unpacked(part.isel({dims[0]: rows, dims[1]: piece})) for piece in columns]
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


def chunk_bytes(part: xr.DataArray) -> int:
    """Return what one chunk of a variable takes in memory [bytes], which is unpacked for any part of it."""
    return 8 * math.prod(part.encoding.get("chunksizes") or part.encoding.get("chunks") or ())


def unpacked(part: xr.DataArray) -> Values:
    """Return the values of a part of a variable, single where its digits are no more, which may be written to.

    The decoder may take no more memory than these and its chunks need.
    """
    # several threads decode a Zarr store
    threads = 0 if "chunksizes" in part.encoding else min(32, (os.cpu_count() or 1) + 4)
    with unpacking(8 * part.size + 4 * chunk_bytes(part), threads):
        single = part.dtype.kind == "f" and part.dtype.itemsize <= 4
        return np.require(part.values, np.float32 if single else np.float64, "W")


def _with_faces(part: slice, first: int | None) -> slice:
    """Return the faces on both sides of a range of centres; the range itself where values lie at the centres."""
    return part if first is None else slice(part.start + first, part.stop + first + 1)


def _as_slice(order: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Return positions as a slice where they follow each other, which is read faster."""
    if order.size > 1 and np.all(np.diff(order) == 1):
        return slice(int(order[0]), int(order[-1]) + 1)
    return order


def to_centres(
    faces: Values, valid: NDArray[np.bool_], axis: int
) -> tuple[Values, NDArray[np.bool_]]:
    """Return the mean of a component at the two faces of each cell, weighted by which of them are water, and whether any is.

    Args:
        faces: shape (..., n + 1, ...) [m/s]; values on dry faces count for nothing.
        valid: Water, of the same shape.
        axis: Of the faces.
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
    """Return where all members have the same one of some constants, shape (Z, J, I).

    Zeros count from the sea bed up, in columns that are dry there: a level that is at rest everywhere is no land.

    Args:
        values: shape (E, Z, J, I), of which one member after the other is looked at.
        constants: 0, and what a fill value becomes that packing cannot hold.
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
    source: Source, depth: str | None, order: NDArray[np.int64]
) -> tuple[NDArray[np.bool_] | None, bool]:
    """Return where mask variables at cell centres have water, shape (1 or Z, J, I), and whether level by level; None without any.

    Args:
        source: The part of the file.
        depth: Its dimension of levels; None without one.
        order: Positions of the levels used.
    """
    centre = source.layout.centre_dims
    if (name := source.first_of(source.layout.kind.mask, centre)) is not None:
        wet = (
            source.read(name, centre, AT_CENTRES, None if depth is None else (depth, order))[0]
            > 0.0
        )
        return np.asarray(wet), sum(size > 1 for size in source.ds[name].sizes.values()) > len(
            centre
        )
    if (name := source.first_of(LEVEL_COUNTS, centre)) is not None:
        return np.asarray(
            source.read(name, centre, AT_CENTRES, None)[0] > order[:, None, None]
        ), True
    return None, False


def constant_land(
    source: Source,
    components: Sequence[Values],
    depths: Sequence[str | None],
    order: NDArray[np.int64],
    masked: bool,
) -> list[NDArray[np.bool_]]:
    """Return where each component has a constant that stands for land in all members, shape (Z, J, I).

    Where the current is at rest everywhere, as at the beginning of a run, zeros say nothing: then those of the file's last time count; if
    that is at rest too, or there is none, a mask alone says what is land.

    Args:
        source: The part of the file.
        components: Their values, shape (E, Z, J, I).
        depths: Dimensions of their levels.
        order: Positions of the levels used.
        masked: Whether a mask says what is land on each level.
    """
    if not _moves(components):
        if source.last_time is not None:
            last = replace(source, ds=source.last_time)
            components = [
                last.component(name, depth, order)
                for name, depth in zip((U, V), depths, strict=True)
            ]
        if masked and not _moves(components):
            return [np.zeros(values.shape[1:], dtype=bool) for values in components]
    offsets = (float(source.ds[name].attrs.get("replay_kit_offset", 0.0)) for name in (U, V))
    return [
        never_changing(values, {0.0, offset})
        for values, offset in zip(components, offsets, strict=True)
    ]


def _moves(components: Sequence[Values]) -> bool:
    """Return whether any value is neither missing nor 0."""
    return any(np.nan_to_num(member).any() for values in components for member in values)
