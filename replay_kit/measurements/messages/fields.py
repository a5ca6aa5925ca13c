"""Numbers, words and cells of a payload, whatever encoding wrote them: JSON lists of lists, protobuf flat lists, MAVLink numbers."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import chain
from reprlib import repr as shorten
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError

# m/s; an error outside is no statement of one, and its square would not survive the filter's arithmetic
STD_BELIEVED = (1e-6, 1e3)
_LARGEST_DIVE = 2**32 - 1
# east, north, up
_FEWEST_COMPONENTS = 3


def number(value: Any) -> float:
    """Return a payload's number; None, strings such as "NaN" and anything infinite become NaN."""
    if value is None:
        return math.nan
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")
    return result if math.isfinite(result) else math.nan


def numbers(value: Any) -> Array:
    """Return a list of numbers, shape (n,), NaN where an item is none; anything but a list has no items."""
    return rows([value]).reshape(-1) if isinstance(value, list | tuple) else np.empty(0)


def rows(values: Sequence[Any]) -> Array:
    """Return rows of any lengths, shape (n, longest); NaN where a row is shorter or holds no number."""
    try:
        plain = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        plain = np.empty(0)
    if plain.ndim == 2:
        finite = np.isfinite(plain)
        return plain if finite.all() else np.where(finite, plain, np.nan)
    found = [
        [number(item) for item in (row if isinstance(row, list | tuple) else [row])]
        for row in values
    ]
    width = max(map(len, found), default=0)
    return np.array([row + [np.nan] * (width - len(row)) for row in found], np.float64).reshape(
        len(found), width
    )


def whole_number(value: Any) -> int | None:
    """Return an integer, which some encodings write as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return int(value) if isinstance(value, int) or value.is_integer() else None


def dive_number(value: Any) -> int | None:
    """Return the dive that a message states; None for what can be none."""
    return (
        value
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _LARGEST_DIVE
        else None
    )


def word(value: Any, known: Sequence[str]) -> str:
    """Return a word given by itself or by its number among the known; of anything else a short text that is none of them."""
    if isinstance(value, str) and value in known:
        return value
    code = whole_number(value)
    if code is not None and 0 <= code < len(known):
        return known[code]
    # most payloads leave most of them out
    return "None" if value is None else shorten(value)


def known_word(payload: Mapping[str, Any], name: str, known: Sequence[str]) -> str:
    """Return the word in a field, given by itself or by its number.

    Raises:
        MeasurementError: It is none of the known ones.
    """
    value = word(payload.get(name), known)
    if value not in known:
        raise MeasurementError(
            f"ping: expected {name} to be one of {', '.join(known)}, got {value}; state it in the message"
        )
    return value


def velocity_cells(
    payloads: Sequence[Mapping[str, Any]], systems: Sequence[str]
) -> list[Array | MeasurementError]:
    """Return the components of each cell of pings' velocities, shape (n, at least 3) [m/s]; protobuf carries them flat.

    Of cells that are not as many as ``n_cells``, or of which one has not the components that it must have, what is wrong is returned. In
    earth coordinates a cell has east and north, or is missing as a whole.

    Args:
        payloads: ``velocity``, ``n_cells`` and ``coordinate_system`` of them are read.
        systems: The coordinate systems that are known.
    """
    listed: list[Any] = [payload.get("velocity") for payload in payloads]
    counts = {whole_number(payload.get("n_cells")) for payload in payloads}
    try:
        # most pings list as many components for each of as many cells; of nested lists NumPy would ask for every length twice
        cells = [*chain(*listed)]
        plain = np.array([*chain(*cells)], np.float64)
        alike = plain.ndim == 1 and {*map(type, cells)} <= {list, tuple}
        shape = len(listed), *{*map(len, listed)}, *{*map(len, cells)}
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
    """Return velocities, shape (..., n, k), with at least three components, NaN where one is not finite or missing."""
    known = np.where(np.isfinite(velocity), velocity, np.nan)
    *shape, width = velocity.shape
    missing = np.full((*shape, max(_FEWEST_COMPONENTS - width, 0)), np.nan)
    return np.concatenate([known, missing], axis=-1) if missing.size else known


def _cells_of(payload: Mapping[str, Any], systems: Sequence[str]) -> Array:
    """Return the velocities of a ping whose cells are flat, missing, or of different lengths, shape (n, k).

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
    if _is_flat(raw, n_cells):
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


def _is_flat(raw: Sequence[Any], n_cells: int) -> bool:
    """Return whether velocities come without cells; nulls alone, as many as there are cells, are missing cells."""
    if any(isinstance(item, list | tuple | Mapping) for item in raw):
        return False
    return bool(raw) and not (len(raw) == n_cells and all(item is None for item in raw))


def _components(cell: Any, earth: bool) -> Sequence[Any]:
    """Return the components of a cell: a list, a message with ``value`` or with ``east`` and ``north``, or null."""
    listed = cell
    if isinstance(cell, Mapping):
        listed = cell.get(
            "value",
            [cell["east"], cell["north"], cell.get("up")]
            if "east" in cell and "north" in cell
            else [],
        )
    if isinstance(listed, list | tuple) and (len(listed) >= 2 or not earth):
        return listed
    # null, NaN or "NaN" in the place of a cell
    if not earth or (not isinstance(cell, list | tuple | Mapping) and np.isnan(number(cell))):
        return ()
    raise MeasurementError(f"ping: expected cells of east, north[, up], got {shorten(cell)}")


def number_or_numbers(value: Any) -> Array:
    """Return what may be one number or a list of them, shape (1,) or (n,); an empty list is one number that is not known."""
    return (
        numbers(value) if isinstance(value, list | tuple) and value else np.array([number(value)])
    )


def believed_std(value: Any, n: int) -> Array:
    """Return the stated error of each of n cells, one number or n; NaN where it is none that can be believed.

    Raises:
        MeasurementError: The numbers are neither one nor n.
    """
    if not isinstance(value, list | tuple):
        return _one_std(number(value), n)
    values = number_or_numbers(value)
    if values.size not in (1, n):
        raise MeasurementError(
            f"ping: expected velocity_std to be a number or {n} numbers, got {values.size}"
        )
    believed = np.where((values >= STD_BELIEVED[0]) & (values <= STD_BELIEVED[1]), values, np.nan)
    return np.full(n, believed[0]) if values.size == 1 else believed


@lru_cache(maxsize=64)
def _one_std(value: float, n: int) -> Array:
    """Return the error that n cells share, for all pings the same array."""
    shared = np.full(n, value if STD_BELIEVED[0] <= value <= STD_BELIEVED[1] else np.nan)
    shared.setflags(write=False)
    return shared


def unit_vectors(value: Any) -> Array | None:
    """Return vectors listed one by one or flat, as protobuf carries them; an empty list is one that is not known."""
    if not value:
        return None
    try:
        return np.array(value, np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError):
        return np.empty((0, 3))


def by_cell(payload: Mapping[str, Any], name: str, n: int) -> Array | str:
    """Return a field with one or more numbers for each of n cells, shape (n, k), or why there is none; protobuf carries them flat."""
    raw = payload.get(name)
    if not isinstance(raw, list | tuple) or not raw:
        return f"the ping has no {name}"
    try:
        values = np.array(raw, np.float64)
    except (TypeError, ValueError, OverflowError):
        # cells of different lengths, or something among them that is no number
        values = rows(raw)
    if (
        values.ndim > 2
        or values.size == 0
        or values.size % n
        or (values.ndim == 2 and len(values) != n)
    ):
        return f"{name} is not as long as the velocity"
    values = np.where(np.isfinite(values), values, np.nan).reshape(n, -1)
    return values if np.isfinite(values).any() else f"the ping has no {name}"


def part(value: Any) -> Mapping[str, Any] | None:
    """Return the fields of a part of a message; None where it is no part."""
    return value if isinstance(value, Mapping) else None
