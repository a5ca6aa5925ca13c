"""Rotations, beam solutions and bin mapping, against their obvious twins and against what must hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from replay_kit.measurements.profiles import frames
from tests.reference import frames as slow

ANGLE = st.floats(-180.0, 360.0)
TILT = st.floats(-40.0, 40.0)
BEAM_ANGLE = st.floats(10.0, 45.0)
SPEED = st.floats(-5.0, 5.0)
BEAMS = st.lists(SPEED, min_size=4, max_size=4).map(np.array)
quick = settings(max_examples=30, deadline=None, derandomize=True)


def teledyne(heading, pitch, roll, up=False):
    """Return one matrix."""
    angles = (np.array([angle]) for angle in (heading, pitch, roll))
    return frames.teledyne_rotation(*angles, up, np.zeros(1, bool))[0]


def nortek(heading, pitch, roll, down=False):
    """Return one matrix."""
    return frames.nortek_rotation(*(np.array([angle]) for angle in (heading, pitch, roll)), down)[0]


def solved(beams, vectors):
    """Return the solution of one ping's cells."""
    return frames.solve_beams(beams[None], vectors)[0]


def map_bins(beams, stretch, first, size):
    """Return one ping's mapped cells."""
    return frames.map_bins(beams[None], stretch[None], np.array([first]), np.array([size]))[0]


@quick
@given(ANGLE, TILT, TILT, st.booleans())
def test_rotations_are_orthonormal_and_those_of_the_twin(heading, pitch, roll, flipped):
    for ours, twin in (
        (teledyne, slow.teledyne),
        (nortek, slow.nortek),
    ):
        matrix = ours(heading, pitch, roll, flipped)
        assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(matrix) == pytest.approx(1.0)
        assert_allclose(matrix, twin(heading, pitch, roll, flipped), atol=1e-14)


@quick
@given(BEAMS, BEAM_ANGLE, st.booleans())
def test_four_beams_are_solved_as_teledyne_does(beams, angle, convex):
    vectors = slow.janus_vectors(angle, convex)
    assert_allclose(np.linalg.norm(vectors, axis=1), 1.0)
    found = solved(beams[None], vectors)
    assert_allclose(found[0], slow.janus(beams, angle, convex), rtol=1e-10, atol=1e-10)
    assert_allclose(frames.beams_of(found[None], vectors)[0, 0], beams, rtol=1e-10, atol=1e-10)


@quick
@given(st.lists(SPEED, min_size=3, max_size=3).map(np.array), BEAM_ANGLE, st.integers(0, 3))
def test_three_beams_equal_four_when_the_error_velocity_is_zero(velocity, angle, bad):
    vectors = slow.janus_vectors(angle)
    beams = frames.beams_of(velocity[None, None], vectors)[0]
    four = solved(beams, vectors)
    beams[0, bad] = np.nan
    three = solved(beams, vectors)
    assert_allclose(four[0], [*velocity, 0.0], atol=1e-10)
    # three beams leave nothing that no velocity explains
    assert_allclose(three[0], [*velocity, np.nan], atol=1e-10)


@quick
@given(ANGLE, TILT, TILT, st.booleans())
def test_mapped_bins_are_exact_for_a_velocity_linear_in_depth(heading, pitch, roll, up):
    first, size, n = 2.0, 1.0, 24
    vectors, rotation = slow.janus_vectors(20.0), teledyne(heading, pitch, roll, up)
    stretch = frames.vertical_stretch(vectors, rotation[None])[0]
    slope, offset = np.array([0.02, -0.013, 0.001]), np.array([0.4, 0.1, -0.02])
    distance = (first + size * np.arange(n))[:, None] * stretch
    beams = np.einsum("nbi,bi->nb", offset + distance[..., None] * slope, vectors @ rotation.T)
    holed = np.where(np.arange(n)[:, None] == 12, np.nan, beams)
    for each in (holed, beams):
        mapped = map_bins(each, stretch, first, size)
        twin = [slow.mapped(*one, first, size) for one in zip(each.T, stretch, strict=True)]
        assert_allclose(mapped.T, twin, atol=1e-12)
    earth = solved(mapped, vectors)[:, :3] @ rotation.T
    inside = np.isfinite(mapped).all(axis=1)
    assert inside[2:10].all()
    expected = offset + (first + size * np.arange(n))[:, None] * slope
    assert_allclose(earth[inside], expected[inside], atol=1e-10)
