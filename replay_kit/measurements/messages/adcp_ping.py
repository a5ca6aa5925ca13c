"""The payload of a ``replay_kit.AdcpPing`` to an ``AdcpPing``: every field is read and checked here, once.

The field names and units are in the README beside this file. A field that decides what the velocities are must be right; one that only
some pings need (beam vectors, the attitude's convention) is refused where it is needed.
"""

from collections.abc import Mapping, Sequence
from reprlib import repr as shorten
from typing import Any, cast

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import Reference
from replay_kit.measurements.messages.fields import STD_BELIEVED, dive_number, known_word, number, numbers, rows, whole_number, word
from replay_kit.measurements.ping.adcp_ping import (
    AdcpPing,
    BottomTrack,
    CoordinateSystem,
    InstrumentAttitude,
    Look,
    PlatformVelocity,
    QualityFields,
)

COORDINATE_SYSTEMS: tuple[CoordinateSystem, ...] = ("beam", "instrument", "ship", "earth")
_REFERENCES: tuple[Reference, ...] = ("earth", "platform")
_ORIENTATIONS: tuple[Look, ...] = ("down", "up")
_CELL_FIELDS = ("amplitude", "correlation", "percent_good", "snr", "error_velocity")
_ANGLES = ("heading", "pitch", "roll", "magnetic_declination", "declination_applied")
_CONVENTIONS = ("teledyne", "nortek")
# east, north, up
_FEWEST_COMPONENTS = 3


def parse_ping(payload: Mapping[str, Any], reference: Reference | None = None) -> AdcpPing:
    """Return the ping that a payload holds.

    Args:
        payload: Its fields, with JSON's lists of lists or protobuf's flat ones.
        reference: What the velocities are relative to where the payload does not say.

    Raises:
        MeasurementError: A word is none of the known, or the cells are not as many numbers as they must be.
    """
    stated = {**payload, "reference": reference} if payload.get("reference") is None else payload
    system = cast(CoordinateSystem, _word(stated, "coordinate_system", COORDINATE_SYSTEMS))
    cells = _cells(stated)
    n = len(cells)
    return AdcpPing(
        velocity=_velocity(cells, system == "earth"),
        velocity_std=_velocity_std(stated.get("velocity_std"), n),
        coordinate_system=system,
        measured_system=system,
        reference=cast(Reference, _word(stated, "reference", _REFERENCES)),
        orientation=cast(Look, _word(stated, "orientation", _ORIENTATIONS)),
        distance=_distance(stated, n),
        cell_size=number(stated.get("cell_size")),
        attitude=_attitude(stated),
        beam_vectors=_beam_vectors(stated.get("beam_unit_vectors")),
        # a number in MAVLink, as the declination's
        bin_mapped=number(stated.get("bin_mapped")) == 1.0,
        bottom_track=_bottom_track(stated.get("bottom_track")),
        platform_velocity=_platform_velocity(stated.get("platform_velocity")),
        quality=_quality(stated, n),
        pressure=number(stated.get("pressure")),
        transducer_depth=number(stated.get("transducer_depth")),
        needs_vehicle_depth=stated.get("vehicle_depth_needed") is True,
        correlation_depth=number(stated.get("correlation_depth")),
        dive=dive_number(stated.get("dive")),
        derived=stated.get("derived") is True,
    )


def _word(payload: Mapping[str, Any], name: str, known: Sequence[str]) -> str:
    return known_word(name, word(payload.get(name), known), known)


def _cells(payload: Mapping[str, Any]) -> Sequence[Any]:
    """Return the cells of a ping's velocity as they came, each a list, a message or null; protobuf carries them flat."""
    raw, n_cells = payload.get("velocity"), whole_number(payload.get("n_cells"))
    if not isinstance(raw, list | tuple) or n_cells is None or n_cells < 1:
        raise MeasurementError(
            "ping: expected n_cells >= 1 and a list of velocities, "
            f"got n_cells {shorten(payload.get('n_cells'))} and velocity {type(raw).__name__}"
        )
    if _is_flat(raw, n_cells):
        if len(raw) % n_cells:
            raise MeasurementError(f"ping: {len(raw)} flat velocities do not divide into {n_cells} cells")
        width = len(raw) // n_cells
        raw = [raw[i * width : (i + 1) * width] for i in range(n_cells)]
    if len(raw) != n_cells:
        raise MeasurementError(f"ping: expected {n_cells} cells of east, north[, up], got {len(raw)} cells")
    return raw


def _is_flat(raw: Sequence[Any], n_cells: int) -> bool:
    """Return whether velocities come without cells; nulls alone, as many as there are cells, are missing cells."""
    if any(isinstance(item, list | tuple | Mapping) for item in raw):
        return False
    return bool(raw) and not (len(raw) == n_cells and all(item is None for item in raw))


def _velocity(cells: Sequence[Any], earth: bool) -> Array:
    """Return the components of each cell, shape (n, at least 3); in earth coordinates a cell has east and north, or is missing."""
    found = rows([_components(cell, earth) for cell in cells])
    velocity = np.full((len(cells), max(found.shape[1], _FEWEST_COMPONENTS)), np.nan)
    velocity[:, : found.shape[1]] = found
    return velocity


def _components(cell: Any, earth: bool) -> Sequence[Any]:
    """Return the components of a cell: a list, a message with ``value`` or with ``east`` and ``north``, or null."""
    listed = cell
    if isinstance(cell, Mapping):
        listed = cell.get("value", [cell["east"], cell["north"], cell.get("up")] if "east" in cell and "north" in cell else [])
    if isinstance(listed, list | tuple) and (len(listed) >= 2 or not earth):
        return listed
    # null, NaN or "NaN" in the place of a cell
    if not earth or (not isinstance(cell, list | tuple | Mapping) and np.isnan(number(cell))):
        return ()
    raise MeasurementError(f"ping: expected cells of east, north[, up], got {shorten(cell)}")


def _velocity_std(raw: Any, n: int) -> Array:
    """Return the stated error of each of n cells, one number or n; NaN where it is none that can be believed."""
    values = numbers(raw) if isinstance(raw, list | tuple) and raw else np.array([number(raw)])
    if values.size not in (1, n):
        raise MeasurementError(f"ping: expected velocity_std to be a number or {n} numbers, got {values.size}")
    believed = np.where((values >= STD_BELIEVED[0]) & (values <= STD_BELIEVED[1]), values, np.nan)
    return np.full(n, believed[0]) if values.size == 1 else believed


def _distance(payload: Mapping[str, Any], n: int) -> Array:
    """Return how far the centres of n cells are from the transducer [m]: listed, or evenly spaced."""
    listed = payload.get("cell_distances")
    if listed is not None:
        if not isinstance(listed, list | tuple) or len(listed) != n:
            raise MeasurementError(f"ping: expected cell_distances to be {n} numbers [m], got {shorten(listed)}")
        return numbers(listed)
    cell_size, first = number(payload.get("cell_size")), number(payload.get("bin0_distance"))
    if not (cell_size > 0.0 and np.isfinite(first)):
        raise MeasurementError(
            "ping: expected cell_size > 0 and a finite bin0_distance [m], "
            f"got {shorten(payload.get('cell_size'))} and {shorten(payload.get('bin0_distance'))}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(first + cell_size * np.arange(n), np.float64)


def _attitude(payload: Mapping[str, Any]) -> InstrumentAttitude:
    heading, pitch, roll, declination, applied = (number(payload.get(name)) for name in _ANGLES)
    return InstrumentAttitude(
        heading,
        pitch,
        roll,
        convention=word(payload.get("attitude_convention"), _CONVENTIONS),
        euler_pitch=payload.get("gimbal_pitch") is True,
        tilt_applied=payload.get("tilt_applied") is not False,
        declination=declination,
        declination_applied={1.0: True, 0.0: False}.get(applied),
    )


def _beam_vectors(raw: Any) -> Array | None:
    """Return vectors listed one by one or flat, as protobuf carries them; an empty list is one that is not known."""
    if not raw:
        return None
    try:
        return np.array(raw, np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError):
        return np.empty((0, 3))


def _bottom_track(raw: Any) -> BottomTrack | None:
    if not isinstance(raw, Mapping):
        return None
    return BottomTrack(numbers(raw.get("velocity")), number(raw.get("velocity_std")), numbers(raw.get("distance")))


def _platform_velocity(raw: Any) -> PlatformVelocity | None:
    if not isinstance(raw, Mapping):
        return None
    east, north, error_std = (number(raw.get(name)) for name in ("east", "north", "velocity_std"))
    return PlatformVelocity(east, north, error_std, str(raw.get("source", "stated")))


def _quality(payload: Mapping[str, Any], n: int) -> QualityFields:
    amplitude, correlation, percent_good, snr, error_velocity = (_by_cell(payload.get(name), name, n) for name in _CELL_FIELDS)
    floor = payload.get("noise_floor")
    floors = numbers(floor) if isinstance(floor, list | tuple) and floor else np.array([number(floor)])
    return QualityFields(amplitude, correlation, percent_good, snr, error_velocity, floors)


def _by_cell(raw: Any, name: str, n: int) -> Array | str:
    """Return a field with one or more numbers for each of n cells, shape (n, k), or why there is none; protobuf carries them flat."""
    if not isinstance(raw, list | tuple) or not raw:
        return f"the ping has no {name}"
    try:
        values = np.array(raw, np.float64)
    except (TypeError, ValueError, OverflowError):
        # cells of different lengths, or something among them that is no number
        values = rows(raw)
    if values.ndim > 2 or values.size == 0 or values.size % n or (values.ndim == 2 and len(values) != n):
        return f"{name} is not as long as the velocity"
    values = np.where(np.isfinite(values), values, np.nan).reshape(n, -1)
    return values if np.isfinite(values).any() else f"the ping has no {name}"
