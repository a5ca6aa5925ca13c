"""A ping as its instrument gave it, made absolute: velocities along true east and north, over the ground.

What is done once is recorded in the ping, so that it is not done twice: ``coordinate_system``, ``reference``, ``bin_mapped``,
``declination_applied``, and ``ground_reference``, which says what the platform's motion was taken from.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.config import MeasurementConfig
from replay_kit.errors import MeasurementError
from replay_kit.measurements import frames
from replay_kit.measurements.adcp import (
    COORDINATE_SYSTEMS,
    ORIENTATIONS,
    REFERENCES,
    error_std,
    even_cells,
    known_word,
    number,
    velocity_cells,
)
from replay_kit.types import Array

_CONVENTIONS = ("teledyne", "nortek")
# m/s; of a bottom-track ping that states none: makers state 3 to 30 mm/s for a single one
_BOTTOM_STD = 0.03
# vectors written with three digits are still unit vectors
_UNIT = 0.01


# numbers that no instrument gives become NaN, which is a missing bin
@np.errstate(all="ignore")
def earth_referenced(payload: Mapping[str, Any], config: MeasurementConfig) -> Mapping[str, Any]:
    """Return the ping in earth coordinates with reference earth, or as it is where it does not say how its platform moves.

    In this order: bins are mapped to equal depths, beams solved (three where one is missing), velocities turned by heading, pitch
    and roll, and by the declination where the heading is magnetic; then the ground's velocity relative to the platform is taken
    off: bottom track where the ping has it, else minus the platform's own velocity by GPS. The error grows by that of the reference.

    Args:
        payload: Fields of the ping.
        config: The error of a ping that states none; the declination of one whose heading is magnetic and that states none.

    Raises:
        MeasurementError: A word is none of the known, or a rotation needs what the ping does not say.
    """
    system = known_word(payload, "coordinate_system", COORDINATE_SYSTEMS)
    platform = known_word(payload, "reference", REFERENCES) == "platform"
    declination = _declination(payload, system, config)
    if not platform and system == "earth" and declination == 0.0:
        return payload
    bottom = _bottom(payload, config.max_speed) if platform else None
    if platform and bottom is None:
        return payload
    if declination is None:
        raise MeasurementError("heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination")
    rotation = _rotation(payload, system, declination)
    velocity, std, mapped = _rows(payload), _own_std(payload, system, config), _can_map(payload, system)
    solved = _solved(velocity, payload, rotation, system, mapped)
    earth = _turned(solved, rotation)
    source = None
    if bottom is not None:
        ground, ground_std, ground_system, source = bottom
        turn = rotation if ground_system == system else np.eye(3)
        (east, north, _) = _turned(_solved(ground, payload, turn, ground_system, False), turn)[0]
        earth[:, :2], std = frames.over_ground(earth[:, :2], std, np.array([east, north]), ground_std)
    return {
        **payload,
        "coordinate_system": "earth",
        "reference": "earth",
        "velocity": earth.tolist(),
        "velocity_std": std.tolist(),
        "turned_from": system,
        "error_velocity": _error_velocity(solved, mapped or system == "beam") or payload.get("error_velocity"),
        "bin_mapped": mapped or payload.get("bin_mapped"),
        "magnetic_declination": declination or payload.get("magnetic_declination"),
        "declination_applied": True,
        "ground_reference": source,
    }


def _declination(payload: Mapping[str, Any], system: str, config: MeasurementConfig) -> float | None:
    """Return the angle still to be added to the heading [degrees]; None when it is not known.

    Velocities in earth coordinates are true ones unless the ping says that they are not; a heading is magnetic unless it says so.
    """
    # a number in MAVLink, NaN when unknown
    applied = number(payload.get("declination_applied"))
    if applied == 1.0 or (system == "earth" and applied != 0.0):
        return 0.0
    stated = number(payload.get("magnetic_declination"))
    return stated if np.isfinite(stated) else config.magnetic_declination


def _rotation(payload: Mapping[str, Any], system: str, declination: float) -> Array:
    """Return the matrix from the ping's axes (a beam's: those of its instrument) to true east, north, up."""
    if system == "earth":
        return frames.teledyne_rotation(declination, 0.0, 0.0)
    level = system == "ship" and payload.get("tilt_applied") is not False
    heading, pitch, roll = (number(payload.get(name)) for name in ("heading", "pitch", "roll"))
    if level:
        pitch = roll = 0.0
    if not np.isfinite(heading + pitch + roll):
        raise MeasurementError(f"velocity in {system} coordinates, and heading, pitch or roll is not known")
    convention = "teledyne" if system == "ship" else known_word(payload, "attitude_convention", _CONVENTIONS)
    orientation = known_word(payload, "orientation", ORIENTATIONS)
    if convention == "nortek":
        return frames.nortek_rotation(heading + declination, pitch, roll, orientation == "down")
    return frames.teledyne_rotation(heading + declination, pitch, roll, orientation == "up" and not level)


def _solved(velocity: Array, payload: Mapping[str, Any], rotation: Array, system: str, mapped: bool) -> Array:
    """Return velocities along the axes that the rotation turns, shape (n, at least 3); the error velocity is the fourth."""
    if mapped:
        vectors = _vectors(payload)
        beams = velocity if system == "beam" else frames.beams_of(velocity, vectors)
        beams = frames.map_bins(beams, frames.vertical_stretch(vectors, rotation), *even_cells(payload, len(beams)))
        return frames.solve_beams(beams, vectors)
    return frames.solve_beams(velocity, _vectors(payload)) if system == "beam" else velocity


def _turned(velocity: Array, rotation: Array) -> Array:
    """Return velocities along east, north, up, shape (n, 3); see ``earth_referenced``."""
    if (rotation[2] == (0.0, 0.0, 1.0)).all():
        # a turn about the vertical needs no vertical velocity, which may be missing
        return np.column_stack([velocity[:, :2] @ rotation[:2, :2].T, velocity[:, 2]])
    return np.asarray(velocity[:, :3] @ rotation.T)


def _error_velocity(solved: Array, by_us: bool) -> list[float] | None:
    """Return the error velocity of each cell [m/s]; a solution from three beams has none, which ``solve_beams`` gives as zero."""
    if solved.shape[1] != 4:
        return None
    error = solved[:, 3]
    return [float(value) for value in np.where(by_us & (error == 0.0), np.nan, error)]


def _can_map(payload: Mapping[str, Any], system: str) -> bool:
    """Return whether bins are still to be mapped and can be: from beams, or from axes with the error velocity beside them."""
    if number(payload.get("bin_mapped")) == 1.0 or not payload.get("beam_unit_vectors"):
        return False
    return system == "beam" or (system == "instrument" and _rows(payload).shape[1] == 4)


def _own_std(payload: Mapping[str, Any], system: str, config: MeasurementConfig) -> Array:
    """Return the error of a horizontal component, shape (n,) [m/s]; a beam's grows in the solution."""
    std = error_std(payload, len(velocity_cells(payload)), float("nan"))
    if system == "beam":
        std = std * np.linalg.norm(np.linalg.pinv(_vectors(payload))[0])
    return np.where(np.isfinite(std), std, config.velocity_std)


def _bottom(payload: Mapping[str, Any], max_std: float) -> tuple[Array, float, str, str] | None:
    """Return the ground's velocity relative to the platform, shape (1, components) [m/s], its error, coordinates and origin.

    None when the ping does not say, or with an error above ``max_std`` [m/s], which is to say nothing.
    """
    track = payload.get("bottom_track")
    if isinstance(track, Mapping) and isinstance(track.get("velocity"), list | tuple):
        velocity = np.array([[number(value) for value in track["velocity"]]])
        std = number(track.get("velocity_std"))
        system = known_word(payload, "coordinate_system", COORDINATE_SYSTEMS)
        # one beam of four may be missing, but no axis
        needed = velocity if system == "beam" else velocity[:, : 2 if system in ("ship", "earth") else 3]
        if velocity.shape[1] >= 3 and np.isfinite(needed).sum() >= min(3, needed.size):
            return velocity, std if 0.0 < std <= max_std else _BOTTOM_STD, system, "bottom_track"
    own = payload.get("platform_velocity")
    if isinstance(own, Mapping):
        velocity = -np.array([[number(own.get("east")), number(own.get("north")), 0.0]])
        std = number(own.get("velocity_std"))
        if np.isfinite(velocity).all() and 0.0 < std <= max_std:
            return velocity, std, "true", str(own.get("source", "stated"))
    return None


def _rows(payload: Mapping[str, Any]) -> Array:
    """Return all components of the velocity, shape (n, at least 3) [m/s]; NaN where missing."""
    rows = [_row(cell) for cell in velocity_cells(payload)]
    width = max(3, *(len(row) for row in rows))
    return np.array([[*row, *[float("nan")] * (width - len(row))] for row in rows])


def _row(cell: Any) -> list[float]:
    if isinstance(cell, Mapping):
        cell = cell.get("value", [cell.get("east"), cell.get("north"), cell.get("up")])
    return [number(value) for value in cell] if isinstance(cell, list | tuple) else []


def _vectors(payload: Mapping[str, Any]) -> Array:
    """Return the beams' unit vectors, shape (b, 3); protobuf carries them flat."""
    vectors = np.array(payload.get("beam_unit_vectors"), dtype=np.float64)
    if vectors.size == 0 or vectors.size % 3 or not np.isfinite(vectors).all():
        raise MeasurementError("velocity in beam coordinates, and beam_unit_vectors does not hold three numbers a beam")
    vectors = vectors.reshape(-1, 3)
    if not (np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < _UNIT).all():
        raise MeasurementError("beam_unit_vectors: expected vectors of length 1")
    return vectors
