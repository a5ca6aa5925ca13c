"""A ping as its instrument gave it, turned to true east and north, and made absolute where the platform's motion is known.

What is done is recorded in the ping, so that it is not done twice: ``coordinate_system``, ``reference``, ``bin_mapped``,
``declination_applied``, and ``platform_velocity``, which was added to all cells.
"""

import math
from dataclasses import replace
from reprlib import repr as shorten

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.measurements.ping import frames
from replay_kit.measurements.ping.adcp_ping import AdcpPing, PlatformVelocity

_CONVENTIONS = ("teledyne", "nortek")
# m/s; of a bottom-track ping that states none: makers state 3 to 30 mm/s for a single one
_BOTTOM_STD = 0.03
# vectors written with three digits are still unit vectors
_UNIT = 0.01
# of a cell; distances written with few digits are still evenly spaced
_UNEVEN = 0.01


# numbers that no instrument gives become NaN, which is a missing bin
@np.errstate(all="ignore")
def earth_referenced(ping: AdcpPing, config: MeasurementConfig) -> AdcpPing:
    """Return the ping in earth coordinates, and with reference earth where it says how its platform moves.

    In this order: bins are mapped to equal depths, beams solved (three where one is missing), velocities turned by heading, pitch
    and roll, and by the declination where the heading is magnetic; then the platform's velocity over the ground is added: minus the
    bottom track where the ping has it, else what the ping states. That velocity's error is one for all bins, so it stays with
    ``platform_velocity`` and does not enter the bins' own.

    Args:
        ping: The ping.
        config: The declination of a ping whose heading is magnetic and that states none; the fastest motion that is believed.

    Raises:
        MeasurementError: A rotation needs what the ping does not say.
    """
    declination = _declination(ping, config)
    relative = ping.reference == "platform"
    moves = relative and knows_motion(ping, config.max_speed)
    # what is not used needs no turning, which may lack an attitude
    if not moves and ((ping.coordinate_system == "earth" and declination == 0.0) or (relative and not config.use_relative)):
        return ping
    if declination is None:
        raise MeasurementError("heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination")
    rotation = _rotation(ping, declination)
    motion = _motion(ping, rotation, config.max_speed) if moves else None
    turned = _in_earth_coordinates(ping, rotation)
    if motion is None:
        return turned
    velocity = turned.velocity + np.array([motion.east, motion.north, 0.0])
    return replace(turned, velocity=velocity, reference="earth", platform_velocity=motion)


def added_velocity(ping: AdcpPing, config: MeasurementConfig) -> tuple[tuple[float, float] | None, float]:
    """Return what was added to a ping's velocities to make them absolute, true east and north [m/s], and its error [m/s].

    None and no error for a ping whose velocities came absolute and that does not say how; None and an infinite error for one whose
    velocities are still relative to the platform.

    Args:
        ping: A ping that ``earth_referenced`` gave.
        config: The fastest motion that is believed.
    """
    if ping.reference == "platform":
        return None, math.inf
    motion = _stated_motion(ping, config.max_speed)
    return (None, 0.0) if motion is None else ((motion.east, motion.north), motion.error_std)


def knows_motion(ping: AdcpPing, max_speed: float) -> bool:
    """Return whether a ping says how its platform moves, in its bottom track or otherwise.

    Args:
        ping: The ping.
        max_speed: The fastest motion that is believed; with an error above it a ping says nothing [m/s].
    """
    return _found_bottom(ping) or _stated_motion(ping, max_speed) is not None


def _declination(ping: AdcpPing, config: MeasurementConfig) -> float | None:
    """Return the angle still to be added to the heading [degrees]; None when it is not known.

    Velocities in earth coordinates are true ones unless the ping says that they are not; a heading is magnetic unless it says so.
    """
    applied = ping.attitude.declination_applied
    if applied or (applied is None and ping.coordinate_system == "earth"):
        return 0.0
    return ping.attitude.declination if np.isfinite(ping.attitude.declination) else config.magnetic_declination


def _rotation(ping: AdcpPing, declination: float) -> Array:
    """Return the matrix from the ping's axes (a beam's: those of its instrument) to true east, north, up."""
    system, attitude = ping.coordinate_system, ping.attitude
    if system == "earth":
        return frames.teledyne_rotation(declination, 0.0, 0.0)
    level = system == "ship" and attitude.tilt_applied
    pitch, roll = (0.0, 0.0) if level else (attitude.pitch, attitude.roll)
    if not np.isfinite(attitude.heading + pitch + roll):
        raise MeasurementError(f"velocity in {system} coordinates, and heading, pitch or roll is not known")
    heading = attitude.heading + declination
    if system != "ship" and attitude.convention not in _CONVENTIONS:
        raise MeasurementError(
            f"ping: expected attitude_convention to be one of {', '.join(_CONVENTIONS)}, got {attitude.convention}; state it in the message"
        )
    if system != "ship" and attitude.convention == "nortek":
        return frames.nortek_rotation(heading, pitch, roll, ping.orientation == "down")
    return frames.teledyne_rotation(heading, pitch, roll, ping.orientation == "up" and not level, attitude.euler_pitch)


def _in_earth_coordinates(ping: AdcpPing, rotation: Array) -> AdcpPing:
    """Return a ping with its velocities along true east, north, up: bins mapped, beams solved, axes turned."""
    system = ping.coordinate_system
    to_map = _can_map(ping)
    if to_map:
        vectors = _vectors(ping)
        beams = ping.velocity if system == "beam" else frames.beams_of(ping.velocity, vectors)
        beams = frames.map_bins(beams, frames.vertical_stretch(vectors, rotation), *_even_cells(ping))
        solved = frames.solve_beams(beams, vectors)
    else:
        solved = _solved(ping.velocity, ping)
    error_velocity = _error_velocity(solved, to_map or system == "beam")
    return replace(
        ping,
        coordinate_system="earth",
        velocity=_turned(solved, rotation),
        velocity_std=ping.velocity_std * (_noise_gain(_vectors(ping)) if system == "beam" else 1.0),
        bin_mapped=to_map or ping.bin_mapped,
        attitude=replace(ping.attitude, declination_applied=True),
        quality=ping.quality if error_velocity is None else replace(ping.quality, error_velocity=error_velocity),
    )


def _solved(velocity: Array, ping: AdcpPing) -> Array:
    """Return velocities along the axes that the rotation turns, shape (n, at least 3); the error velocity is the fourth."""
    return frames.solve_beams(velocity, _vectors(ping)) if ping.coordinate_system == "beam" else velocity


def _noise_gain(vectors: Array) -> float:
    """Return how many times the error of a beam is in a horizontal component of the solution."""
    return float(np.linalg.norm(np.linalg.pinv(vectors)[0]))


def _turned(velocity: Array, rotation: Array) -> Array:
    """Return velocities along east, north, up, shape (n, 3); see ``earth_referenced``."""
    if (rotation[2] == (0.0, 0.0, 1.0)).all():
        # a turn about the vertical needs no vertical velocity, which may be missing
        return np.column_stack([velocity[:, :2] @ rotation[:2, :2].T, velocity[:, 2]])
    return np.asarray(velocity[:, :3] @ rotation.T)


def _error_velocity(solved: Array, by_us: bool) -> Array | None:
    """Return the error velocity of each cell [m/s]; a solution from three beams has none, which ``solve_beams`` gives as zero."""
    if solved.shape[1] != 4:
        return None
    error = solved[:, 3:]
    return np.where(by_us & (error == 0.0), np.nan, error)


def _can_map(ping: AdcpPing) -> bool:
    """Return whether bins are still to be mapped and can be: from beams, or from axes with the error velocity beside them."""
    if ping.bin_mapped or ping.beam_vectors is None:
        return False
    return ping.coordinate_system == "beam" or (ping.coordinate_system == "instrument" and ping.velocity.shape[1] == 4)


def _even_cells(ping: AdcpPing) -> tuple[float, float]:
    """Return how far the first of evenly spaced cells is from the transducer, at its centre, and the cells' size [m]."""
    centres, steps = ping.distance, np.arange(ping.distance.size)
    if ping.cell_size > 0.0 and (centres == centres[0] + ping.cell_size * steps).all():
        return float(centres[0]), ping.cell_size
    size = float(centres[-1] - centres[0]) / (centres.size - 1) if centres.size > 1 else ping.cell_size
    if not (size > 0.0 and (np.abs(centres - centres[0] - size * steps) <= _UNEVEN * size).all()):
        raise MeasurementError(
            "ping: bins can be mapped to equal depths only where cell_distances are finite, growing and evenly spaced [m], "
            f"got {shorten(centres.tolist())}; map them before, and state bin_mapped"
        )
    return float(centres[0]), size


def _motion(ping: AdcpPing, rotation: Array, max_speed: float) -> PlatformVelocity | None:
    """Return the platform's velocity over the ground: by bottom track, or as the ping states it.

    Args:
        ping: The ping.
        rotation: shape (3, 3), from its axes to true east, north, up.
        max_speed: A stated error above it is none [m/s].
    """
    if ping.bottom_track is None or not _found_bottom(ping):
        return _stated_motion(ping, max_speed)
    std = ping.bottom_track.error_std
    east, north, _ = -_turned(_solved(ping.bottom_track.velocity[None], ping), rotation)[0]
    return PlatformVelocity(float(east), float(north), std if 0.0 < std <= max_speed else _BOTTOM_STD, "bottom_track")


def _found_bottom(ping: AdcpPing) -> bool:
    """Return whether the bottom track gives a velocity: one beam of four may be missing, but no axis."""
    if ping.bottom_track is None or ping.bottom_track.velocity.size < 3:
        return False
    velocity, system = ping.bottom_track.velocity, ping.coordinate_system
    needed = velocity if system == "beam" else velocity[: 2 if system in ("ship", "earth") else 3]
    return bool(np.isfinite(needed).sum() >= min(3, needed.size))


def _stated_motion(ping: AdcpPing, max_speed: float) -> PlatformVelocity | None:
    """Return the platform's velocity that a ping states; None when it states none, or with an error above the fastest motion."""
    motion = ping.platform_velocity
    if motion is None or not math.isfinite(motion.east + motion.north) or not 0.0 < motion.error_std <= max_speed:
        return None
    return motion


def _vectors(ping: AdcpPing) -> Array:
    """Return the beams' unit vectors, shape (b, 3), checked."""
    vectors = ping.beam_vectors
    if vectors is None or vectors.size == 0 or not np.isfinite(vectors).all():
        raise MeasurementError("velocity in beam coordinates, and beam_unit_vectors does not hold three numbers a beam")
    if not (np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < _UNIT).all():
        raise MeasurementError("beam_unit_vectors: expected vectors of length 1")
    return vectors
