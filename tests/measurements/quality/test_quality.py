"""Quality tests of bins against their obvious twins, and what they must never do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.block import BinTest
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements import qartod as quality
from replay_kit.measurements.frames import tilt
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
    flags = quality.graded(quality.worst_needed(np.array(beams)), (50.0, 0.0), least=True)
    assert flags.tolist() == [slow.graded(value, 50.0, 0.0, True) for value in worst]


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


def test_a_clean_profile_has_no_outliers_and_a_noisy_one_hardly_any():
    z = np.arange(60.0)
    floor = np.full(60, 0.1)
    shear, step, jet = (
        0.5 * z,
        np.where(z < 20, 1.0, -1.0),
        2.0 * np.exp(-0.5 * ((z - 30.0) / 1.5) ** 2),
    )
    for clean in (shear, step, jet):
        assert quality.outlyingness(np.column_stack([clean, -clean]), floor, 7).max() < 2.0
    rng = np.random.default_rng(5)
    # noise five times as large as the instrument says
    ratios = np.concatenate(
        [quality.outlyingness(rng.normal(0.0, 0.5, (60, 2)), floor, 7) for _ in range(100)]
    )
    assert np.mean(ratios > 6.0) < 1e-3


def test_planted_outliers_are_found_among_noise():
    rng = np.random.default_rng(6)
    found = []
    for k in range(100):
        velocity = rng.normal(0.2, 0.09, (30, 2))
        velocity[k % 30, k % 2] += 1.0
        found.append(quality.outlyingness(velocity, np.full(30, 0.1), 7)[k % 30])
    assert np.mean(np.array(found) > 4.0) > 0.95


def test_flags_are_the_worst_and_reasons_are_all():
    whole = np.full(1, "", object)
    tests = [
        BinTest("tilt", Reason.TILT, np.array([[1, 3, 3, 2, 3]], np.int8), whole),
        BinTest("outlier", Reason.OUTLIER, np.array([[2, 2, 4, 2, 4]], np.int8), whole),
    ]
    velocity = np.zeros((1, 5, 2))
    velocity[0, 4] = np.nan
    profiles = {"velocity": velocity, "depth": np.zeros((1, 5))}
    flags, reasons = quality._rolled_up(tests, profiles, True)
    assert flags[0].tolist() == [Flag.GOOD, Flag.SUSPECT, Flag.FAIL, Flag.GOOD, Flag.MISSING]
    both = Reason.TILT | Reason.OUTLIER
    assert reasons[0].tolist() == [0, Reason.TILT, both, 0, both | Reason.MISSING]
    strict, same = quality._rolled_up(tests, profiles, False)
    assert strict[0].tolist() == [Flag.GOOD, Flag.FAIL, Flag.FAIL, Flag.GOOD, Flag.MISSING]
    assert np.array_equal(reasons, same)
