"""Numbers of a ping's cells: velocities, errors, distances, and what the instrument says of them."""

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from reprlib import repr as shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.logs.tables.columns import (
    Payload,
    each,
    field,
    number,
    numbers,
    rows,
    whole_number,
    word,
)

# m/s; an error outside is no statement of one, and its square would not survive the filter's arithmetic
STD_BELIEVED = (1e-6, 1e3)


def velocity_cells(
    payloads: Sequence[Payload], systems: Sequence[str]
) -> list[Array | MeasurementError]:
    """Return the components of each cell of pings' velocities, shape (m, at least 3) [m/s]; protobuf carries them flat.

    Of cells that are not as many as ``n_cells``, or of which one has not the components that it must have, what is wrong is returned. In
    earth coordinates a cell has east and north, or is missing as a whole.

    Args:
        payloads: ``velocity``, ``n_cells`` and ``coordinate_system`` of them are read.
        systems: The coordinate systems that are known.
    """
    values, counts = field(payloads, "velocity"), {*each(whole_number, field(payloads, "n_cells"))}
    try:
        # of nested lists NumPy would ask for every length twice
        cells = [*chain(*values)]
        plain = np.array([*chain(*cells)], np.float64)
        alike = plain.ndim == 1 and {*map(type, cells)} <= {list, tuple}
        shape = len(values), *{*map(len, values)}, *{*map(len, cells)}
        plain = plain.reshape(shape) if alike else np.empty(0)
    except (TypeError, ValueError, OverflowError):
        plain = np.empty(0)
    if plain.ndim == 3 and plain.shape[2] >= 2 and counts == {plain.shape[1]}:
        return list(_padded(plain))
    if len(payloads) > 1:
        return [cells for payload in payloads for cells in velocity_cells([payload], systems)]
    try:
        return [_padded(_cells_of(payload, systems)) for payload in payloads]
    except MeasurementError as error:
        return [error]


def _padded(velocity: Array) -> Array:
    """Return velocities, shape (..., m, k), with at least three components, NaN where one is not finite or missing."""
    known = np.where(np.isfinite(velocity), velocity, np.nan)
    *shape, width = velocity.shape
    missing = np.full((*shape, max(3 - width, 0)), np.nan)
    return np.concatenate([known, missing], axis=-1) if missing.size else known


def _cells_of(payload: Payload, systems: Sequence[str]) -> Array:
    """Return the velocities of a ping whose cells are flat, missing, or of different lengths, shape (m, k).

    Raises:
        MeasurementError: As ``velocity_cells`` returns it.
    """
    earth = word(payload.get("coordinate_system"), systems) == "earth"
    raw, n_cells = payload.get("velocity"), whole_number(payload.get("n_cells"))
    if not isinstance(raw, list | tuple) or n_cells is None or n_cells < 1:
        raise MeasurementError(
            "ping: expected n_cells >= 1 and a list of velocities, "
            f"got n_cells {shorten(payload.get('n_cells'))} and velocity {type(raw).__name__}"
        )
    flat = bool(raw) and not any(isinstance(item, list | tuple | Mapping) for item in raw)
    # nulls alone, as many as there are cells, are missing cells
    if flat and not (len(raw) == n_cells and all(item is None for item in raw)):
        if len(raw) % n_cells:
            raise MeasurementError(
                f"ping: {len(raw)} flat velocities do not divide into {n_cells} cells"
            )
        width = len(raw) // n_cells
        raw = [raw[i * width : (i + 1) * width] for i in range(n_cells)]
    if len(raw) != n_cells:
        raise MeasurementError(
            f"ping: expected {n_cells} cells of east, north[, up], got {len(raw)} cells"
        )
    return rows([_components(cell, earth) for cell in raw])


def _components(cell: Any, earth: bool) -> Sequence[Any]:
    """Return the components of a cell: a list, a message with ``value`` or with ``east`` and ``north``, or null."""
    found = cell
    if isinstance(cell, Mapping):
        both = "east" in cell and "north" in cell
        found = cell.get("value", [cell["east"], cell["north"], cell.get("up")] if both else [])
    if isinstance(found, list | tuple) and (len(found) >= 2 or not earth):
        return found
    # null, NaN or "NaN" in the place of a cell
    if not earth or (not isinstance(cell, list | tuple | Mapping) and np.isnan(number(cell))):
        return ()
    raise MeasurementError(f"ping: expected cells of east, north[, up], got {shorten(cell)}")


def believed_std(values: Sequence[Any], m: int) -> Array:
    """Return the stated errors of m cells, one number or m of each ping, shape (n, m) [m/s]; NaN where none can be believed.

    Raises:
        MeasurementError: Numbers are neither one nor m.
    """
    kinds = {*map(type, values)}
    if not kinds & {list, tuple}:
        found = numbers(values)[:, None]
    else:
        lists = [isinstance(value, list | tuple) for value in values]
        sizes = {
            len(value) or 1 if is_list else 1 for value, is_list in zip(values, lists, strict=True)
        }
        if len(values) > 1 and (len(sizes) > 1 or not all(lists)):
            raise ValueError("pings state errors in unlike ways")
        if sizes not in ({1}, {m}):
            raise MeasurementError(
                f"ping: expected velocity_std to be a number or {m} numbers, got {min(sizes)}"
            )
        found = rows([value or [math.nan] for value in values])
    least, most = STD_BELIEVED
    return np.broadcast_to(
        np.where((found >= least) & (found <= most), found, np.nan), (len(values), m)
    )


def cell_distances(payloads: Sequence[Payload], n: int, m: int) -> Array:
    """Return how far the centres of m cells are from the transducer, shape (n, m) [m]: as listed, or evenly spaced.

    Raises:
        MeasurementError: The list has another length, or first distance and size are none.
    """
    stated = field(payloads, "cell_distances")
    if any(each is not None for each in stated):
        for each in stated:
            if not isinstance(each, list | tuple) or len(each) != m:
                raise MeasurementError(
                    f"ping: expected cell_distances to be {m} numbers [m], got {shorten(each)}"
                )
        return rows(stated)
    first, size = (number(payloads[0].get(name)) for name in ("bin0_distance", "cell_size"))
    if not (size > 0.0 and math.isfinite(first)):
        raise MeasurementError(
            "ping: expected cell_size > 0 and a finite bin0_distance [m], "
            f"got {shorten(payloads[0].get('cell_size'))} and {shorten(payloads[0].get('bin0_distance'))}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        return np.broadcast_to(first + size * np.arange(m), (n, m))


def by_cell(
    stated: Sequence[Any], name: str, n: int, m: int
) -> tuple[Array | None, NDArray[np.object_]]:
    """Return a field with one or more numbers for each of m cells, shape (n, m, b), and why pings have none, shape (n,).

    Raises:
        ValueError: Pings have unlike numbers of beams.
    """
    none, why = f"the ping has no {name}", np.full(n, "", object)
    if not {*map(type, stated)} & {list, tuple}:
        why[:] = none
        return None, why
    given = [bool(each) and isinstance(each, list | tuple) for each in stated]
    if not any(given):
        why[:] = none
        return None, why
    if not all(given):
        raise ValueError(none)
    try:
        values = np.array(stated, np.float64)
    except (TypeError, ValueError, OverflowError):
        # cells of different lengths, or something among them that is no number
        if n > 1:
            raise
        values = rows(stated[0])[None]
    wrong = values.ndim == 3 and values.shape[1] != m
    if wrong or values.ndim > 3 or values.size == 0 or values[0].size % m:
        why[:] = f"{name} is not as long as the velocity"
        return None, why
    values = np.where(np.isfinite(values), values, np.nan).reshape(n, m, -1)
    why[~np.isfinite(values).any(axis=(1, 2))] = none
    return values, why
