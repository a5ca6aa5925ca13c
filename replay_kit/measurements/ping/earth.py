"""A ping as its instrument gave it, turned to true east and north, and made absolute where the platform's motion is known.

What is done once is recorded in the ping, so that it is not done twice: ``coordinate_system``, ``reference``, ``bin_mapped``,
``declination_applied``, ``gimbal_pitch`` (pitch is an Euler angle, not the reading of a tilt sensor), and ``ground_reference``, which
says what ``platform_velocity``, added to all bins, was taken from.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.measurements.ping import frames
from replay_kit.measurements.ping.payload import (
    COORDINATE_SYSTEMS,
    ORIENTATIONS,
    REFERENCES,
    error_std,
    even_cells,
    known_word,
    number,
    velocity_cells,
)

_CONVENTIONS = ("teledyne", "nortek")
# m/s; of a bottom-track ping that states none: makers state 3 to 30 mm/s for a single one
_BOTTOM_STD = 0.03
# vectors written with three digits are still unit vectors
_UNIT = 0.01


# numbers that no instrument gives become NaN, which is a missing bin
@np.errstate(all="ignore")
def earth_referenced(payload: Mapping[str, Any], config: MeasurementConfig) -> Mapping[str, Any]:
    """Return the ping in earth coordinates, and with reference earth where it says how its platform moves.

    In this order: bins are mapped to equal depths, beams solved (three where one is missing), velocities turned by heading, pitch
    and roll, and by the declination where the heading is magnetic; then the platform's velocity over the ground is added: minus the
    bottom track where the ping has it, else what the ping states. That velocity's error is one for all bins, so it stays with
    ``platform_velocity`` and does not enter the bins' own.

    Args:
        payload: Fields of the ping.
        config: The error of a ping that states none; the declination of one whose heading is magnetic and that states none.

    Raises:
        MeasurementError: A word is none of the known, or a rotation needs what the ping does not say.
    """
    system = known_word(payload, "coordinate_system", COORDINATE_SYSTEMS)
    platform = known_word(payload, "reference", REFERENCES) == "platform"
    declination = _declination(payload, system, config)
    bottom = _bottom(payload, config.max_speed) if platform else None
    # what is not used needs no turning, which may lack an attitude
    if bottom is None and ((system == "earth" and declination == 0.0) or (platform and not config.use_relative)):
        return payload
    if declination is None:
        raise MeasurementError("heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination")
    rotation = _rotation(payload, system, declination)
    velocity, std, mapped = _rows(payload), _own_std(payload, system, config), _can_map(payload, system)
    solved = _solved(velocity, payload, rotation, system, mapped)
    earth = _turned(solved, rotation)
    motion = None
    if bottom is not None:
        ground, ground_std, ground_system, source = bottom
        turn = rotation if ground_system == system else np.eye(3)
        (east, north, _) = -_turned(_solved(ground, payload, turn, ground_system, False), turn)[0]
        earth[:, :2] += (east, north)
        motion = {"east": float(east), "north": float(north), "velocity_std": ground_std, "source": source}
    return {
        **payload,
        "coordinate_system": "earth",
        "reference": "platform" if platform and motion is None else "earth",
        "velocity": earth.tolist(),
        "velocity_std": std.tolist(),
        "turned_from": system,
        "error_velocity": _error_velocity(solved, mapped or system == "beam") or payload.get("error_velocity"),
        "bin_mapped": mapped or payload.get("bin_mapped"),
        "magnetic_declination": declination or payload.get("magnetic_declination"),
        "declination_applied": True,
        "platform_velocity": motion or payload.get("platform_velocity"),
        "ground_reference": None if motion is None else motion["source"],
    }


def added_velocity(payload: Mapping[str, Any], config: MeasurementConfig) -> tuple[tuple[float, float] | None, float]:
    """Return what was added to a ping's velocities to make them absolute, true east and north [m/s], and its error [m/s].

    None and no error for a ping whose velocities came absolute and that does not say how; None and an infinite error for one whose
    velocities are still relative to the platform.

    Args:
        payload: Fields of a ping that ``earth_referenced`` gave.
        config: The fastest motion that is believed.
    """
    if known_word(payload, "reference", REFERENCES) == "platform":
        return None, math.inf
    motion = _stated_motion(payload, config.max_speed)
    return (None, 0.0) if motion is None else ((motion[0], motion[1]), motion[2])


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
    gimbal = payload.get("gimbal_pitch") is True
    return frames.teledyne_rotation(heading + declination, pitch, roll, orientation == "up" and not level, gimbal)


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
    motion = _stated_motion(payload, max_std)
    if motion is None:
        return None
    return -np.array([[motion[0], motion[1], 0.0]]), motion[2], "true", str(payload["platform_velocity"].get("source", "stated"))


def _stated_motion(payload: Mapping[str, Any], max_std: float) -> tuple[float, float, float] | None:
    """Return the platform's velocity that a ping states, true east and north, and its error [m/s]; None as in ``_bottom``."""
    own = payload.get("platform_velocity")
    if not isinstance(own, Mapping):
        return None
    east, north, std = (number(own.get(name)) for name in ("east", "north", "velocity_std"))
    return (east, north, std) if math.isfinite(east + north) and 0.0 < std <= max_std else None


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
