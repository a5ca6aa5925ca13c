"""Velocities from beams to the instrument's axes and to east, north, up: pure maths on arrays of n pings.

A beam's velocity is the component along the beam's unit vector, given in the instrument's axes; a vector that points towards the transducer
makes velocities towards it positive (Teledyne), one that points away makes them negative (Nortek). The vectors hold the whole geometry, for
convex and concave heads and any beam angle. Sums are written out, so that a ping's values do not depend on other pings.

Sources: Teledyne RD Instruments, "ADCP Coordinate Transformation: Formulas and Calculations" (P/N 951-6079-00, 2010), sections 5 and 6;
Nortek, "Signature Principles of Operation" and "Signature Integrators Guide, AD2CP" (N3015-007), coordinate transformations.
"""

import numpy as np

from replay_kit.core.arrays import Array, Mask


def to_earth_axes(velocity: Array, rotation: Array) -> Array:
    """Return velocities along east, north, up, shape (n, m, 3) [m/s].

    Components with zero weight may be missing: a rotation about the vertical needs no vertical velocity.

    Args:
        velocity: shape (n, m, at least 3) [m/s], along the axes of the rotation.
        rotation: shape (n, 3, 3), from these axes to east, north, up.
    """
    by_axis, each = rotation.transpose(1, 2, 0)[..., None], np.moveaxis(velocity, -1, 0)
    return np.stack(
        [
            sum(
                (
                    np.where(factor, factor * one, 0.0)
                    for factor, one in zip(row, each, strict=False)
                    if factor.any()
                ),
                np.zeros(velocity.shape[:2]),
            )
            for row in by_axis
        ],
        axis=-1,
    )


def solve_beams(beams: Array, vectors: Array) -> Array:
    """Return x, y, z and the error velocity of each cell, shape (n, m, 4) [m/s].

    Four beams are solved by least squares, for a Janus head Teledyne's matrix; the error velocity is the residual, scaled to the noise of a
    horizontal component. Three beams are solved exactly, without an error velocity (three-beam solution). With fewer the cell is NaN.

    Args:
        beams: shape (n, m, b) [m/s], along the beams' vectors; NaN where missing.
        vectors: shape (b, 3), the beams' unit vectors in the instrument's axes.

    References:
        Teledyne, sections 5.3 (beam to instrument) and 5.5 (three-beam solutions).
    """
    n, m, b = beams.shape
    result, good = np.full((n, m, 4), np.nan), np.isfinite(beams)
    # the sets of beams that occur are few: one matrix for each, not for each cell
    sets = good @ (1 << np.arange(b))
    for each in np.unique(sets):
        present = (each >> np.arange(b)) & 1 == 1
        if present.sum() < 3 or np.linalg.matrix_rank(vectors[present]) < 3:
            continue
        cells, weights = sets == each, np.zeros((b, 4))
        weights[present, :3] = np.linalg.pinv(vectors[present]).T
        weights[:, 3] = error_weights(vectors) if present.all() and b == 4 else np.nan
        found = beams[cells]
        result[cells] = sum(found[:, k, None] * weights[k] for k in np.flatnonzero(present))
    return result


def error_weights(vectors: Array) -> Array:
    """Return the weights of four beams in the error velocity, shape (4,); positive for the first beam.

    They are orthogonal to the beams of any velocity and have the norm of those of x: Teledyne's d = a / sqrt(2).
    """
    weights = np.linalg.svd(vectors.T)[2][3]
    return np.asarray(weights * noise_gain(vectors) * np.sign(weights[0]))


def noise_gain(vectors: Array) -> float:
    """Return the error of a horizontal component of the solution relative to that of a beam."""
    return float(np.linalg.norm(np.linalg.pinv(vectors)[0]))


def beams_of(velocity: Array, vectors: Array) -> Array:
    """Return beam velocities, shape (n, m, b) [m/s], from x, y, z and, for four beams, the error velocity: inverse of ``solve_beams``.

    Args:
        velocity: shape (n, m, 3) or (n, m, 4) [m/s].
        vectors: shape (b, 3), the beams' unit vectors.
    """
    beams = sum(velocity[..., k, None] * vectors[:, k] for k in range(3))
    if velocity.shape[2] == 4 and len(vectors) == 4:
        weights = error_weights(vectors)
        beams = beams + velocity[..., 3:] * (weights / (weights @ weights))
    return np.asarray(beams)


def teledyne_rotation(
    heading_deg: Array, pitch_deg: Array, roll_deg: Array, up: bool, gimbal: Mask
) -> Array:
    """Return the matrices, shape (n, 3, 3), from Teledyne's instrument axes to east, north, up.

    With zero pitch and roll they also rotate ship axes (x starboard, y forward).

    Args:
        heading_deg: shape (n,), heading of the y axis (beam 3), clockwise from north.
        pitch_deg: shape (n,), positive if beam 3 is higher than beam 4, for both orientations; from the internal tilt sensor, corrected
            here to that of a gimbal (equation 18) unless ``gimbal`` is set.
        roll_deg: shape (n,), positive if the ship's starboard side is down: beam 1 is then higher than beam 2 on a downward-looking
            instrument, lower on an upward-looking one.
        up: Whether the instrument looks up, which rotates its axes by 180 degrees about the ship's y axis.
        gimbal: shape (n,), whether the pitch is an Euler angle, as from a gimbal, gyro or inertial unit.

    References:
        Teledyne, section 5.6, matrix M, and equation 18; the signs of the angles also in the WorkHorse's "Commands and Output Data Format",
        variable leader, pitch (tilt 1) and roll (tilt 2).
    """
    heading, pitch, roll = np.deg2rad([heading_deg, pitch_deg, roll_deg])
    pitch = np.where(gimbal, pitch, np.arctan(np.tan(pitch) * np.cos(roll)))
    return _turn(heading, pitch, roll + np.pi if up else roll)


def _turn(heading: Array, pitch: Array, roll: Array) -> Array:
    """Return the matrices, shape (n, 3, 3), from axes x starboard, y forward, z up to east, north, up, by angles [rad]."""
    (ch, sh), (cp, sp), (cr, sr) = (
        (np.cos(angle), np.sin(angle)) for angle in (heading, pitch, roll)
    )
    rows = (
        (ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr),
        (-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr),
        (-cp * sr, sp, cp * cr),
    )
    return np.moveaxis(np.array(rows), -1, 0)


def nortek_rotation(heading_deg: Array, pitch_deg: Array, roll_deg: Array, down: bool) -> Array:
    """Return the matrices, shape (n, 3, 3), from Nortek's instrument axes to east, north, up.

    Args:
        heading_deg: shape (n,), heading of the x axis, clockwise from north.
        pitch_deg: shape (n,), positive if the x axis points up.
        roll_deg: shape (n,), about the x axis, right-handed.
        down: Whether the instrument looks down by its status: y and z are then reversed.

    References:
        Nortek, Integrators Guide, coordinate transformations: H P R with heading - 90 degrees.
    """
    # x is forward, y to port
    matrix = _turn(*np.deg2rad([heading_deg, pitch_deg, roll_deg]))[..., [1, 0, 2]]
    return matrix * ((1.0, 1.0, -1.0) if down else (1.0, -1.0, 1.0))


def vertical_stretch(vectors: Array, rotation: Array) -> Array:
    """Return the factor of a tilt on the vertical distance of each beam's cells, shape (n, b); 1 without tilt, 0 for a level beam.

    Args:
        vectors: shape (b, 3), the beams' unit vectors in the instrument's axes.
        rotation: shape (n, 3, 3), from the instrument's axes to east, north, up.
    """
    untilted = np.abs(vectors[:, 2])
    down = np.asarray(sum(rotation[:, 2, k, None] * vectors[:, k] for k in range(3)))
    stretch = np.zeros(down.shape)
    return np.asarray(np.divide(np.abs(down), untilted, out=stretch, where=untilted > 0.0))


def map_bins(beams: Array, stretch: Array, first: Array, cell_size: Array) -> Array:
    """Return each beam's velocities at the vertical distances of untilted cells, shape (n, m, b) [m/s].

    Linear interpolation between the two nearest cells; with one missing the nearer cell, as in Teledyne's mapping. NaN more than half a
    cell beyond a beam's ends.

    Args:
        beams: shape (n, m, b) [m/s], by cell along each beam; NaN where missing.
        stretch: shape (n, b), see ``vertical_stretch``.
        first: shape (n,), vertical distance of the first cell without tilt [m].
        cell_size: shape (n,), vertical size of a cell without tilt [m].

    References:
        Teledyne, section 6 (bin mapping).
    """
    m = beams.shape[1]
    first, size = first[:, None, None], cell_size[:, None, None]
    wanted = first + size * np.arange(m)[:, None]
    factor = np.where(stretch > 0.0, stretch, np.nan)[:, None, :]
    place = (wanted / factor - first) / size
    inside = (place >= -0.5) & (place <= m - 0.5)
    place = np.where(inside, place, 0.0)
    nearest = np.clip(np.round(place).astype(np.intp), 0, m - 1)
    lower = np.clip(np.floor(place).astype(np.intp), 0, max(m - 2, 0))
    below, above, near = (
        np.take_along_axis(beams, at, axis=1)
        for at in (lower, np.minimum(lower + 1, m - 1), nearest)
    )
    between = below + (place - lower) * (above - below)
    return np.where(inside, np.where(np.isfinite(between), between, near), np.nan)


# of a quaternion that is one
_LEAST_NORM, _MOST_NORM = 0.9, 1.1


def attitude_of(quaternion: Array, ned: Mask) -> Array:
    """Return heading of the nose, clockwise from north, pitch, nose up, and roll, starboard down, shape (n, 3) [degrees].

    NaN for quaternions that are unset, not finite or not of unit length.

    Args:
        quaternion: shape (n, 4), x, y, z, w; rotation from the body (x forward, y left, z up) to the frame (x east, y north, z up), as in
            ROS REP-103.
        ned: shape (n,), whether the body is forward, right, down and the frame north, east, down.
    """
    norm = np.sqrt(sum(quaternion.T**2))
    norm = np.where((norm > _LEAST_NORM) & (norm < _MOST_NORM), norm, np.nan)
    x, y, z, w = quaternion.T / norm
    yaw = np.degrees(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    tilt = np.degrees(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))
    roll = np.degrees(np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    heading = np.where(ned, yaw, 90.0 - yaw) % 360.0
    # the remainder of a tiny negative angle rounds to 360 itself; about an axis to the left a positive turn lowers the nose
    return np.column_stack(
        [np.where(heading == 360.0, 0.0, heading), np.where(ned, tilt, -tilt), roll]
    )


def tilt(pitch_deg: Array, roll_deg: Array) -> Array:
    """Return the angles between instrument axes and the vertical [degrees], for both orientations; NaN if unknown."""
    cosine = np.cos(np.deg2rad(pitch_deg)) * np.cos(np.deg2rad(roll_deg))
    return np.asarray(np.degrees(np.arccos(np.abs(cosine))))
