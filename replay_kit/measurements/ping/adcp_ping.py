"""One ADCP ping as a value: parsed and checked once, then turned, made absolute and tested without a look at its message.

A ping that states no attitude takes the vehicle's from other messages.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Reference
from replay_kit.core.text import span_text

CoordinateSystem = Literal["beam", "instrument", "ship", "earth"]
Look = Literal["down", "up"]


@dataclass(frozen=True, slots=True)
class InstrumentAttitude:
    """How the instrument lies, and what its angles mean.

    Attributes:
        heading: Clockwise from north [degrees]; NaN when unknown, like the two below.
        pitch: [degrees].
        roll: [degrees].
        convention: ``teledyne`` or ``nortek``; another text is what the ping states, which a rotation that needs it refuses.
        euler_pitch: Whether the pitch is an Euler angle and not the reading of Teledyne's tilt sensor.
        tilt_applied: False when ship coordinates still lean with the ship.
        declination: To be added to a magnetic heading [degrees east]; NaN when not stated.
        declination_applied: Whether the heading (in earth coordinates the velocity) is a true one; None when not stated.
    """

    heading: float
    pitch: float
    roll: float
    convention: str
    euler_pitch: bool
    tilt_applied: bool
    declination: float
    declination_applied: bool | None


@dataclass(frozen=True, slots=True, eq=False)
class BottomTrack:
    """What the ping says of the bottom.

    Attributes:
        velocity: shape (k,) [m/s], of the ground relative to the platform along the axes of the ping; empty when not stated.
        error_std: Of a component [m/s]; NaN when not stated.
        distance: shape (b,) [m], vertical, to the bottom along each beam; NaN where a beam found none.
    """

    velocity: Array
    error_std: float
    distance: Array


@dataclass(frozen=True, slots=True)
class PlatformVelocity:
    """The platform's velocity over the ground.

    Attributes:
        east: True east [m/s].
        north: True north [m/s].
        error_std: Of each component [m/s].
        source: What measured it: bottom_track, dvl, gps or what the ping states.
    """

    east: float
    north: float
    error_std: float
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class QualityFields:
    """What the instrument says of its cells: arrays of shape (n, k), or as text why there is none.

    Attributes:
        amplitude: Echo of each beam [dB].
        correlation: Of each beam [%, or Teledyne's counts as per cent].
        percent_good: Solutions used [%].
        snr: Signal over noise of each beam [dB].
        error_velocity: The part of the beams that no velocity explains [m/s], in the first column.
        noise_floor: shape (1,) or (b,) [dB]; NaN when not stated.
    """

    amplitude: Array | str
    correlation: Array | str
    percent_good: Array | str
    snr: Array | str
    error_velocity: Array | str
    noise_floor: Array


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class AdcpPing:
    """A ping of n cells.

    Attributes:
        velocity: shape (n, k), k >= 3 [m/s], along beams, or x, y, z, or east, north, up; a fourth column is the error velocity or a
            fourth beam; NaN where missing.
        velocity_std: shape (n,) [m/s], the error of each component; NaN where not stated.
        coordinate_system: Of ``velocity`` and ``bottom_track``.
        measured_system: Coordinate system in which the instrument gave the ping, which a rotation leaves as it is.
        reference: What the velocity is relative to.
        orientation: Where the instrument looks.
        distance: shape (n,) [m], vertical, from the transducer to the cells' centres.
        cell_size: Vertical [m]; NaN when not stated.
        attitude: Of the instrument.
        beam_vectors: shape (b, 3), the beams' unit vectors in the instrument's axes, not checked; None when not stated, shape (0, 3)
            when what is stated does not hold three numbers a beam.
        bin_mapped: Whether cells are at equal depths.
        bottom_track: None when not stated.
        platform_velocity: None when not known; that of a ping with reference earth has been added to its velocities.
        quality: What the instrument says of its cells.
        pressure: Sea pressure at the transducer [dbar]; NaN when not stated.
        transducer_depth: Below that pressure, or below the vehicle's depth [m]; NaN when not stated.
        needs_vehicle_depth: Whether the surface must not be taken for the depth of a vehicle that states none.
        correlation_depth: Over which the correlation of the cells' errors falls by e [m]; NaN when not stated.
        dive: Number of its dive; None when not stated.
        derived: Whether it is made of many pings, such as an inversion.
    """

    velocity: Array
    velocity_std: Array
    coordinate_system: CoordinateSystem
    measured_system: CoordinateSystem
    reference: Reference
    orientation: Look
    distance: Array
    cell_size: float
    attitude: InstrumentAttitude
    beam_vectors: Array | None
    bin_mapped: bool
    bottom_track: BottomTrack | None
    platform_velocity: PlatformVelocity | None
    quality: QualityFields
    pressure: float
    transducer_depth: float
    needs_vehicle_depth: bool
    correlation_depth: float
    dive: int | None
    derived: bool

    def __repr__(self) -> str:
        """Return its size and what its velocities are."""
        cells, columns = self.velocity.shape
        return (
            f"AdcpPing of {cells} cells x {columns} components, {span_text(self.distance)} m {self.orientation} from the transducer\n"
            f"  {span_text(self.velocity, 2)} m/s in {self.coordinate_system} coordinates, relative to {self.reference}"
        )


# s; an attitude this old says nothing of a ping
_MOST_AGE_NS = 1_000_000_000
_LEAST_NORM, _MOST_NORM = 0.9, 1.1


@dataclass(frozen=True, slots=True)
class Attitude:
    """How the vehicle lies.

    Attributes:
        heading: Of its nose, clockwise from north [degrees, 0..360); whether that is true or magnetic north the message does not say.
        pitch: Nose up [degrees].
        roll: Starboard down [degrees].
    """

    heading: float
    pitch: float
    roll: float


@dataclass(frozen=True, slots=True)
class Orientation:
    """An attitude as its message holds it: messages come often and pings rarely, so it is worked out when a ping needs it.

    Attributes:
        quaternion: x, y, z, w, NaN where not stated; turns vectors from the body (x forward, y left, z up) to the frame (x east,
            y north, z up), as in ROS REP-103.
        ned: Whether the body is forward, right, down and the frame north, east, down instead.
    """

    quaternion: tuple[float, float, float, float]
    ned: bool = False


def attitude_of(orientation: Orientation) -> Attitude | None:
    """Return the attitude of a quaternion, or None when it is none: unset, not a number, or not of unit length."""
    x, y, z, w = orientation.quaternion
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not _LEAST_NORM < norm < _MOST_NORM:
        return None
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    yaw = math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    tilt = math.degrees(math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))))
    roll = math.degrees(math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    # about an axis to the left a positive turn lowers the nose, about one to the right it raises it
    return (
        Attitude(_compass(yaw), tilt, roll)
        if orientation.ned
        else Attitude(_compass(90.0 - yaw), -tilt, roll)
    )


def _compass(angle: float) -> float:
    """Return an angle in [0, 360); the remainder of a tiny negative one rounds to 360 itself."""
    remainder = angle % 360.0
    return 0.0 if remainder == 360.0 else remainder


def attitude_within(orientation: tuple[int, Orientation] | None, time_ns: int) -> Attitude | None:
    """Return the last attitude before a time, if it is close enough; the orientation comes after its time [ns]."""
    if orientation is None or not 0 <= time_ns - orientation[0] <= _MOST_AGE_NS:
        return None
    return attitude_of(orientation[1])


def with_attitude(
    ping: AdcpPing, orientation: tuple[int, Orientation] | None, time_ns: int
) -> AdcpPing:
    """Return a ping with the attitude that it does not state, if another message stated one close enough in time.

    Its pitch is then an Euler angle, which Teledyne's correction of a tilt sensor must leave alone.

    Args:
        ping: The ping.
        orientation: The last one before it, after its time [ns, UTC].
        time_ns: The ping's.
    """
    if (
        math.isfinite(ping.attitude.heading)
        or (attitude := attitude_within(orientation, time_ns)) is None
    ):
        return ping
    own = replace(
        ping.attitude,
        heading=attitude.heading,
        pitch=attitude.pitch,
        roll=attitude.roll,
        euler_pitch=True,
    )
    return replace(ping, attitude=own)
