"""What is land: by mask variables, by values that are the same in all members, and at the centres between a C-grid's faces."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.forecast.layout import U, V
from replay_kit.forecast.names import LEVEL_COUNTS
from replay_kit.forecast.variables import AT_CENTRES, Source


def to_centres(
    faces: Array, valid: NDArray[np.bool_], axis: int
) -> tuple[Array, NDArray[np.bool_]]:
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
    weight = wet[0].astype(np.float64) + wet[1]
    return (first + last) / np.maximum(weight, 1.0), weight > 0.0


def _range(faces: Array, axis: int, first: int) -> NDArray[np.intp]:
    return np.arange(first, faces.shape[axis] - 1 + first)


def never_changing(values: Array, constants: Iterable[float]) -> NDArray[np.bool_]:
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
    components: Sequence[Array],
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


def _moves(components: Sequence[Array]) -> bool:
    """Return whether any value is neither missing nor 0."""
    return any(np.nan_to_num(member).any() for values in components for member in values)
