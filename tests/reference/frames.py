"""The obvious way to turn velocities: one angle, one beam, one cell at a time."""

import math

import numpy as np

from replay_kit.core.arrays import Array


def about(axis: int, degrees: float) -> Array:
    """Return the right-handed rotation about an axis, as textbooks write it."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[j, j], matrix[j, k], matrix[k, j], matrix[k, k] = c, -s, s, c
    return matrix


def teledyne(heading: float, pitch: float, roll: float, up: bool) -> Array:
    """Return instrument to earth: roll about y, pitch about x, then heading clockwise."""
    gimbal = math.degrees(math.atan(math.tan(math.radians(pitch)) * math.cos(math.radians(roll))))
    return about(2, -heading) @ about(0, gimbal) @ about(1, roll + (180.0 if up else 0.0))


def nortek(heading: float, pitch: float, roll: float, down: bool) -> Array:
    """Return instrument to earth: roll about x (half a turn more when it looks down), pitch about y, then heading of the x axis."""
    return about(2, 90.0 - heading) @ about(1, -pitch) @ about(0, roll + (180.0 if down else 0.0))


def janus(beams: Array, angle: float, convex: bool) -> Array:
    """Return x, y, z, error of four beams by Teledyne's formulas."""
    a = 1.0 / (2.0 * math.sin(math.radians(angle)))
    b = 1.0 / (4.0 * math.cos(math.radians(angle)))
    c, d = (1.0 if convex else -1.0), a / math.sqrt(2.0)
    b1, b2, b3, b4 = beams
    return np.array(
        [c * a * (b1 - b2), c * a * (b4 - b3), b * (b1 + b2 + b3 + b4), d * (b1 + b2 - b3 - b4)]
    )


def mapped(column: Array, factor: float, first: float, size: float) -> Array:
    """Return one beam's velocities at the untilted distances, cell by cell."""
    have = [(first + size * j) * factor for j in range(len(column))]
    out = []
    for k in range(len(column)):
        want = first + size * k
        by_distance = sorted(range(len(column)), key=lambda j: abs(have[j] - want))
        near, other = by_distance[0], by_distance[1]
        # beyond an end the second nearest cell is the one before
        slope = (column[other] - column[near]) / (have[other] - have[near])
        value = column[near] + slope * (want - have[near]) if math.isfinite(slope) else column[near]
        out.append(value if abs(want - have[near]) <= 0.5 * size * factor else math.nan)
    return np.array(out)


def janus_vectors(beam_angle_deg: float, convex: bool = True) -> Array:
    """Return the unit vectors of Teledyne's four beams, shape (4, 3), towards the transducer: x beam 1 to 2, y beam 4 to 3, z.

    Args:
        beam_angle_deg: Angle between each beam and the instrument's axis [degrees].
        convex: Whether the head is convex; the beams of a concave one cross.
    """
    angle = np.deg2rad(beam_angle_deg)
    across, along = (1.0 if convex else -1.0) * np.sin(angle), np.cos(angle)
    return np.array(
        [[across, 0.0, along], [-across, 0.0, along], [0.0, -across, along], [0.0, across, along]]
    )
