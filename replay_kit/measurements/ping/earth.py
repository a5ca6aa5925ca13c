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
from replay_kit.measurements.ping.adcp_ping import AdcpPing, BottomTrack, PlatformVelocity
from replay_kit.measurements.ping.frames import (
    Axes,
    noise_gain,
    nortek_rotation,
    teledyne_rotation,
    to_earth,
)

_CONVENTIONS = ("teledyne", "nortek")
# m/s; of a bottom-track ping that states none: makers state 3 to 30 mm/s for a single one
_BOTTOM_STD = 0.03
# of a DVL's velocity; a vehicle may turn and stop in more
_BOTTOM_AGE_NS = 3_000_000_000
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
    stated, bottom = _stated_motion(ping, config.max_speed), _found_bottom(ping)
    declination = _declination(ping, config)
    relative = ping.reference == "platform"
    moves = relative and (bottom is not None or stated is not None)
    # what is not used needs no turning, which may lack an attitude
    if not moves and (
        (ping.coordinate_system == "earth" and declination == 0.0)
        or (relative and not config.use_relative)
    ):
        return ping
    if declination is None:
        raise MeasurementError(
            "heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination"
        )
    axes = _axes(ping, declination)
    velocity, error_velocity = to_earth(ping.velocity, axes)
    if moves and bottom is not None:
        ((east, north, _),), std = (
            -to_earth(bottom.velocity[None], replace(axes, cells=None))[0],
            bottom.error_std,
        )
        stated = PlatformVelocity(
            float(east),
            float(north),
            std if 0.0 < std <= config.max_speed else _BOTTOM_STD,
            "bottom_track",
        )
    if moves and stated is not None:
        velocity = velocity + np.array([stated.east, stated.north, 0.0])
    gain = noise_gain(axes.vectors) if axes.along_beams and axes.vectors is not None else 1.0
    return replace(
        ping,
        coordinate_system="earth",
        velocity=velocity,
        velocity_std=ping.velocity_std * gain,
        reference="earth" if moves else ping.reference,
        platform_velocity=stated if moves else ping.platform_velocity,
        bin_mapped=axes.cells is not None or ping.bin_mapped,
        attitude=replace(ping.attitude, declination_applied=True),
        quality=ping.quality
        if error_velocity is None
        else replace(ping.quality, error_velocity=error_velocity),
    )


def with_bottom_track(
    ping: AdcpPing, bottom: tuple[int, PlatformVelocity] | None, time_ns: int, max_speed: float
) -> AdcpPing:
    """Return a ping with the velocity that a DVL measured within three seconds of it, where it does not state one itself.

    Args:
        ping: The ping.
        bottom: The DVL's last velocity over the ground, after its time [ns, UTC].
        time_ns: The ping's.
        max_speed: The fastest motion that is believed [m/s].
    """
    if bottom is None or abs(time_ns - bottom[0]) > _BOTTOM_AGE_NS or ping.reference == "earth":
        return ping
    known = _found_bottom(ping) is not None or _stated_motion(ping, max_speed) is not None
    return ping if known else replace(ping, platform_velocity=bottom[1])


def added_velocity(
    ping: AdcpPing, config: MeasurementConfig
) -> tuple[tuple[float, float] | None, float]:
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


def _declination(ping: AdcpPing, config: MeasurementConfig) -> float | None:
    """Return the angle still to be added to the heading [degrees]; None when it is not known.

    Velocities in earth coordinates are true ones unless the ping says that they are not; a heading is magnetic unless it says so.
    """
    applied = ping.attitude.declination_applied
    if applied or (applied is None and ping.coordinate_system == "earth"):
        return 0.0
    return (
        ping.attitude.declination
        if np.isfinite(ping.attitude.declination)
        else config.magnetic_declination
    )


def _axes(ping: AdcpPing, declination: float) -> Axes:
    """Return what turns a ping's velocities to true east, north, up; beams' vectors only where beams are solved or bins mapped."""
    system, attitude = ping.coordinate_system, ping.attitude
    if system == "earth":
        return Axes(teledyne_rotation(declination, 0.0, 0.0))
    level = system == "ship" and attitude.tilt_applied
    pitch, roll = (0.0, 0.0) if level else (attitude.pitch, attitude.roll)
    if not np.isfinite(attitude.heading + pitch + roll):
        raise MeasurementError(
            f"velocity in {system} coordinates, and heading, pitch or roll is not known"
        )
    heading = attitude.heading + declination
    if system != "ship" and attitude.convention not in _CONVENTIONS:
        raise MeasurementError(
            f"ping: expected attitude_convention to be one of {', '.join(_CONVENTIONS)}, got {attitude.convention}; state it in the message"
        )
    along_beams, to_map = system == "beam", _can_map(ping)
    vectors = _vectors(ping) if along_beams or to_map else None
    cells = _even_cells(ping) if to_map else None
    if system != "ship" and attitude.convention == "nortek":
        rotation = nortek_rotation(heading, pitch, roll, ping.orientation == "down")
    else:
        rotation = teledyne_rotation(
            heading, pitch, roll, ping.orientation == "up" and not level, attitude.euler_pitch
        )
    return Axes(rotation, along_beams, vectors, cells)


def _can_map(ping: AdcpPing) -> bool:
    """Return whether bins are still to be mapped and can be: from beams, or from axes with the error velocity beside them."""
    if ping.bin_mapped or ping.beam_vectors is None:
        return False
    return ping.coordinate_system == "beam" or (
        ping.coordinate_system == "instrument" and ping.velocity.shape[1] == 4
    )


def _even_cells(ping: AdcpPing) -> tuple[float, float]:
    """Return how far the first of evenly spaced cells is from the transducer, at its centre, and the cells' size [m]."""
    centres, steps = ping.distance, np.arange(ping.distance.size)
    if ping.cell_size > 0.0 and (centres == centres[0] + ping.cell_size * steps).all():
        return float(centres[0]), ping.cell_size
    size = (
        float(centres[-1] - centres[0]) / (centres.size - 1) if centres.size > 1 else ping.cell_size
    )
    if not (size > 0.0 and (np.abs(centres - centres[0] - size * steps) <= _UNEVEN * size).all()):
        raise MeasurementError(
            "ping: bins can be mapped to equal depths only where cell_distances are finite, growing and evenly spaced [m], "
            f"got {shorten(centres.tolist())}; map them before, and state bin_mapped"
        )
    return float(centres[0]), size


def _found_bottom(ping: AdcpPing) -> BottomTrack | None:
    """Return the bottom track if it gives a velocity: one beam of four may be missing, but no axis."""
    bottom, system = ping.bottom_track, ping.coordinate_system
    if bottom is None or bottom.velocity.size < 3:
        return None
    needed = (
        bottom.velocity
        if system == "beam"
        else bottom.velocity[: 2 if system in ("ship", "earth") else 3]
    )
    return bottom if np.isfinite(needed).sum() >= min(3, needed.size) else None


def _stated_motion(ping: AdcpPing, max_speed: float) -> PlatformVelocity | None:
    """Return the platform's velocity that a ping states; None when it states none, or with an error above the fastest motion."""
    motion = ping.platform_velocity
    if (
        motion is None
        or not math.isfinite(motion.east + motion.north)
        or not 0.0 < motion.error_std <= max_speed
    ):
        return None
    return motion


def _vectors(ping: AdcpPing) -> Array:
    """Return the beams' unit vectors, shape (b, 3), checked."""
    vectors = ping.beam_vectors
    if vectors is None or vectors.size == 0 or not np.isfinite(vectors).all():
        raise MeasurementError(
            "velocity in beam coordinates, and beam_unit_vectors does not hold three numbers a beam"
        )
    if not (np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < _UNIT).all():
        raise MeasurementError("beam_unit_vectors: expected vectors of length 1")
    return vectors
