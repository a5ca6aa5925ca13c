"""Velocities from beams to the instrument's axes and to east, north, up: pure maths.

A beam's velocity is the component along the beam's unit vector, given in the instrument's axes; a vector that points towards the
transducer makes velocities towards it positive (Teledyne), one that points away makes them negative (Nortek). The geometry is
all in these vectors, so that convex and concave heads, and beams at any angle, are one case.

Sources: Teledyne RD Instruments, "ADCP Coordinate Transformation: Formulas and Calculations" (P/N 951-6079-00, 2010), sections 5
and 6; Nortek, "Signature Principles of Operation" and "Signature Integrators Guide, AD2CP" (N3015-007), coordinate transformations.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array

_LEAST_BEAMS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """What turns the velocities of an instrument to true east, north, up.

    Attributes:
        rotation: shape (3, 3), from the velocities' axes (of beams: those of their instrument) to east, north, up.
        along_beams: Whether the velocities are along beams.
        vectors: shape (b, 3), the beams' unit vectors; None where the velocities are turned without them.
        cells: How far the first of evenly spaced cells is from the transducer, and the cells' size [m], where bins are to be mapped to
            equal depths; None where not.
    """

    rotation: Array
    along_beams: bool = False
    vectors: Array | None = None
    cells: tuple[float, float] | None = None


def to_earth(velocity: Array, axes: Axes) -> tuple[Array, Array | None]:
    """Return velocities along true east, north, up, shape (n, 3) [m/s], and the error velocity of each cell, shape (n, 1), if there is one.

    Bins are mapped, beams solved, axes turned. A solution from three beams has no error velocity: NaN.

    Args:
        velocity: shape (n, k) [m/s]; NaN where missing.
        axes: What the components are along; without vectors a fourth component is the error velocity.
    """
    vectors, rotation, error = axes.vectors, axes.rotation, None
    solved = vectors is not None and (axes.along_beams or axes.cells is not None)
    if vectors is not None and solved:
        beams = velocity if axes.along_beams else beams_of(velocity, vectors)
        velocity = solve_beams(
            map_bins(beams, vertical_stretch(vectors, rotation), *axes.cells)
            if axes.cells
            else beams,
            vectors,
        )
    if velocity.shape[1] == 4:
        error = np.where(solved & (velocity[:, 3:] == 0.0), np.nan, velocity[:, 3:])
    if (rotation[2] == (0.0, 0.0, 1.0)).all():
        # a turn about the vertical needs no vertical velocity, which may be missing
        return np.column_stack([velocity[:, :2] @ rotation[:2, :2].T, velocity[:, 2]]), error
    return np.asarray(velocity[:, :3] @ rotation.T), error


def solve_beams(beams: Array, vectors: Array) -> Array:
    """Return x, y, z and the error velocity of each cell, shape (n, 4) [m/s].

    Four beams are solved by least squares, which for a Janus head is Teledyne's matrix; the error velocity is the part that no
    velocity explains, scaled to have the noise of a horizontal component. With one beam missing the other three are solved
    exactly, which sets the error velocity to zero (three-beam solution). With fewer the cell is NaN.

    Args:
        beams: shape (n, b) [m/s], along the beams' vectors; NaN where missing.
        vectors: shape (b, 3), the beams' unit vectors in the instrument's axes.

    References:
        Teledyne, sections 5.3 (beam to instrument) and 5.5 (three-beam solutions).
    """
    result = np.full((len(beams), 4), np.nan)
    good = np.isfinite(beams)
    # the sets of beams that occur are few: one matrix for each, not for each cell
    for present in np.unique(good, axis=0):
        cells = (good == present).all(axis=1)
        if present.sum() < _LEAST_BEAMS or np.linalg.matrix_rank(vectors[present]) < 3:
            continue
        result[cells, :3] = beams[cells][:, present] @ np.linalg.pinv(vectors[present]).T
        result[cells, 3] = (
            beams[cells] @ error_weights(vectors) if present.all() and len(vectors) == 4 else 0.0
        )
    return result


def error_weights(vectors: Array) -> Array:
    """Return the weights of four beams in the error velocity, shape (4,); positive for the first beam.

    They are orthogonal to the beams of every velocity, and as long as those of the x component: Teledyne's d = a / sqrt(2).
    """
    weights = np.linalg.svd(vectors.T)[2][3]
    return np.asarray(weights * noise_gain(vectors) * np.sign(weights[0]))


def noise_gain(vectors: Array) -> float:
    """Return how many times the error of a beam is in a horizontal component of the solution."""
    return float(np.linalg.norm(np.linalg.pinv(vectors)[0]))


def beams_of(velocity: Array, vectors: Array) -> Array:
    """Return beam velocities, shape (n, b) [m/s], of x, y, z and, for four beams, the error velocity: the inverse of ``solve_beams``.

    Args:
        velocity: shape (n, 3) or (n, 4) [m/s].
        vectors: shape (b, 3), the beams' unit vectors.
    """
    beams = velocity[:, :3] @ vectors.T
    if velocity.shape[1] == 4 and len(vectors) == 4:
        weights = error_weights(vectors)
        beams = beams + velocity[:, 3:] * (weights / (weights @ weights))
    return beams


def teledyne_rotation(
    heading_deg: float, pitch_deg: float, roll_deg: float, up: bool = False, gimbal: bool = False
) -> Array:
    """Return the matrix, shape (3, 3), from Teledyne's instrument axes to east, north, up.

    With pitch and roll 0 it turns ship axes (x starboard, y forward) too.

    Args:
        heading_deg: Of the y axis (beam 3), clockwise from north.
        pitch_deg: Positive when beam 3 is higher than beam 4, whether the instrument looks down or up. The pitch of the internal
            tilt sensor, which is corrected here to what a gimbal would measure (equation 18), unless ``gimbal`` is set.
        roll_deg: Positive when the ship's starboard side is down: beam 1 is then higher than beam 2 on an instrument that looks
            down, and beam 2 higher than beam 1 on one that looks up.
        up: Whether the instrument looks up. Roll counts from the ship's axes, from which the axes of an instrument that looks up
            are half a turn away about y.
        gimbal: Whether the pitch is already that of a gimbal: an Euler angle, as of a gyro or an inertial unit.

    References:
        Teledyne, section 5.6, matrix M, and equation 18; the signs of the angles also in the WorkHorse's "Commands and Output Data
        Format", variable leader, pitch (tilt 1) and roll (tilt 2).
    """
    heading, pitch, roll = np.deg2rad(heading_deg), np.deg2rad(pitch_deg), np.deg2rad(roll_deg)
    if not gimbal:
        pitch = np.arctan(np.tan(pitch) * np.cos(roll))
    roll = roll + np.pi if up else roll
    (ch, sh), (cp, sp), (cr, sr) = (
        (np.cos(angle), np.sin(angle)) for angle in (heading, pitch, roll)
    )
    return np.array(
        [
            [ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr],
            [-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr],
            [-cp * sr, sp, cp * cr],
        ]
    )


def nortek_rotation(
    heading_deg: float, pitch_deg: float, roll_deg: float, down: bool = False
) -> Array:
    """Return the matrix, shape (3, 3), from Nortek's instrument axes to east, north, up.

    Args:
        heading_deg: Of the x axis, clockwise from north.
        pitch_deg: Positive when the x axis points up.
        roll_deg: About the x axis, right-handed.
        down: Whether the instrument's status says that it looks down: y and z are then reversed.

    References:
        Nortek, Integrators Guide, coordinate transformations: H P R with heading - 90 degrees.
    """
    heading, pitch, roll = (
        np.deg2rad(90.0 - heading_deg),
        np.deg2rad(pitch_deg),
        np.deg2rad(roll_deg),
    )
    (ch, sh), (cp, sp), (cr, sr) = (
        (np.cos(angle), np.sin(angle)) for angle in (heading, pitch, roll)
    )
    matrix = np.array(
        [
            [ch * cp, -ch * sp * sr - sh * cr, sh * sr - ch * cr * sp],
            [sh * cp, ch * cr - sh * sp * sr, -sh * cr * sp - ch * sr],
            [sp, sr * cp, cp * cr],
        ]
    )
    return matrix * np.array([1.0, -1.0, -1.0]) if down else matrix


def vertical_stretch(vectors: Array, rotation: Array) -> Array:
    """Return by how much a tilt changes the vertical distance of each beam's cells, shape (b,); 1 without tilt, 0 for a level beam.

    Args:
        vectors: shape (b, 3), the beams' unit vectors in the instrument's axes.
        rotation: shape (3, 3), from the instrument's axes to east, north, up.
    """
    untilted = np.abs(vectors[:, 2])
    return np.asarray(
        np.divide(
            np.abs(vectors @ rotation[2]),
            untilted,
            out=np.zeros(len(vectors)),
            where=untilted > 0.0,
        )
    )


def map_bins(beams: Array, stretch: Array, bin0_distance: float, cell_size: float) -> Array:
    """Return each beam's velocities at the vertical distances that the cells have without tilt, shape (n, b) [m/s].

    Linear through the two cells nearest to a distance, so exact for a velocity that is linear in depth. Where one of the two is
    missing the nearer cell is taken as it is, which is Teledyne's own mapping. NaN more than half a cell beyond a beam's ends.

    Args:
        beams: shape (n, b) [m/s], cell after cell along each beam; NaN where missing.
        stretch: shape (b,), see ``vertical_stretch``.
        bin0_distance: Vertical distance of the first cell without tilt [m].
        cell_size: Vertical size of a cell without tilt [m].

    References:
        Teledyne, section 6 (bin mapping).
    """
    n = len(beams)
    wanted = bin0_distance + cell_size * np.arange(n)
    mapped = np.full(beams.shape, np.nan)
    for beam, factor in enumerate(stretch):
        if factor <= 0.0:
            continue
        place = (wanted / factor - bin0_distance) / cell_size
        inside = (place >= -0.5) & (place <= n - 0.5)
        column, nearest = beams[:, beam], np.clip(np.round(place[inside]).astype(int), 0, n - 1)
        lower = np.clip(np.floor(place[inside]).astype(int), 0, max(n - 2, 0))
        upper = np.minimum(lower + 1, n - 1)
        between = column[lower] + (place[inside] - lower) * (column[upper] - column[lower])
        mapped[inside, beam] = np.where(np.isfinite(between), between, column[nearest])
    return mapped
