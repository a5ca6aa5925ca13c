"""One ADCP ping as a value: parsed and checked once, then turned, made absolute and tested without a look at its message."""

from dataclasses import dataclass
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
