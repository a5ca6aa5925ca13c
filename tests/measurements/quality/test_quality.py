"""Quality tests of bins against their obvious twins, and what they must never do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.measurements.profiles import qartod as quality
from replay_kit.measurements.profiles.frames import tilt
from tests.reference import quality as slow

NUMBERS = st.one_of(st.floats(-100.0, 100.0), st.just(np.nan))
LIMIT = st.one_of(st.none(), st.floats(-100.0, 100.0))


@given(st.lists(NUMBERS, max_size=6), LIMIT, LIMIT, st.booleans())
def test_limits_as_the_obvious_way_has_them(values, suspect, fail, least):
    flags = quality.graded(np.array(values, np.float64), (suspect, fail), least)
    assert flags.tolist() == [slow.graded(value, suspect, fail, least) for value in values]


@given(
    st.integers(1, 5).flatmap(
        lambda b: st.lists(st.lists(NUMBERS, min_size=b, max_size=b), min_size=1, max_size=4)
    )
)
def test_three_beams_make_a_cell(beams):
    worst = [slow.third_best(cell) for cell in beams]
    np.testing.assert_array_equal(quality.worst_needed(np.array(beams)), worst)


@given(st.floats(-180.0, 180.0), st.floats(-180.0, 180.0))
def test_tilt_is_the_axis_from_the_vertical(pitch, roll):
    found = tilt(np.array([pitch]), np.array([roll]))[0]
    assert found == pytest.approx(slow.tilt(pitch, roll), abs=1e-5)


CELL = st.tuples(st.one_of(st.floats(-3.0, 3.0), st.just(np.nan)), st.floats(-3.0, 3.0))


@settings(max_examples=60)
@given(st.lists(st.tuples(CELL, st.floats(0.05, 0.5)), min_size=1, max_size=14), st.integers(5, 9))
def test_outliers_as_the_obvious_way_has_them(cells, window):
    velocity, floor = [cell for cell, _ in cells], [std for _, std in cells]
    found = quality.outlyingness(np.array(velocity), np.array(floor), window)
    np.testing.assert_allclose(found, slow.outlyingness(velocity, floor, window), rtol=1e-10)
