from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.studies.twins.field import build_field, grid_indices
from tests.reference import field as slow
from tests.studies.twins.truths import LEVELS, make_truth


def _with_land(truth: Ensemble, wet: np.ndarray) -> Ensemble:
    velocity = np.where(wet, truth.velocity, np.nan)
    return Ensemble(replace(truth.grid, wet=wet), velocity, None, truth.source)


def _inner_places(truth: Ensemble, count: int) -> np.ndarray:
    """Places and depths well inside the grid."""
    rng = np.random.default_rng(3)
    field = build_field(truth)
    rows, columns = truth.grid.east.shape
    index = rng.uniform([0.3, 0.3], [rows - 1.3, columns - 1.3], (count, 2))
    return np.column_stack(
        [field.place_spline(index), rng.uniform(0.0, truth.grid.levels[-1], count)]
    )


def test_grid_points_are_returned_exactly():
    truth = make_truth()
    shape = truth.grid.wet.shape
    east, north = (np.broadcast_to(part, shape) for part in (truth.grid.east, truth.grid.north))
    depth = np.broadcast_to(truth.grid.levels[:, None, None], shape)
    sampled = build_field(truth).velocity(east, north, depth)
    np.testing.assert_allclose(np.moveaxis(sampled, -1, 0), truth.velocity[0], atol=1e-9)


def test_equals_the_slow_twin_and_above_the_first_level_that_level():
    truth = make_truth()
    places = _inner_places(truth, 6)
    expected = [slow.velocity(truth, *place) for place in places]
    field = build_field(truth)
    np.testing.assert_allclose(field.velocity(*places.T), expected, atol=1e-9)
    above, first = (field.velocity(1e3, 2e3, depth) for depth in (0.0, LEVELS[0]))
    np.testing.assert_array_equal(above, first)


def test_indices_of_a_curvilinear_grid_are_found_everywhere_in_it():
    truth = make_truth(bend=0.15)
    field = build_field(truth)
    rng = np.random.default_rng(0)
    rows, columns = truth.grid.east.shape
    index = rng.uniform([0.0, 0.0], [rows - 1.0, columns - 1.0], (2000, 2))
    places = field.place_spline(index)
    j, i, inside = grid_indices(field, places[:, 0], places[:, 1])
    assert inside.all()
    np.testing.assert_allclose(np.column_stack([j, i]), index, atol=1e-8)


def test_outside_of_the_grid_and_below_it_is_nan():
    field = build_field(make_truth())
    assert np.isnan(
        field.velocity([2e5, 0.0, 0.0, np.nan], [0.0, -2e5, 0.0, 0.0], [10.0, 10.0, 751.0, 10.0])
    ).all()


def test_a_cell_with_a_dry_corner_is_nan_and_no_other():
    truth = make_truth()
    wet = truth.grid.wet.copy()
    wet[3:, 6, 10] = False
    field = build_field(_with_land(truth, wet))
    index = np.array([(5.5, 9.5), (6.5, 10.5), (4.5, 9.5), (6.5, 11.5)])
    east, north = field.place_spline(index).T
    dry = np.isnan(field.velocity(east, north, 200.0)).all(axis=-1)
    assert dry.tolist() == [True, True, False, False]
    assert np.isfinite(field.velocity(east, north, 150.0)).all()


@pytest.mark.parametrize(
    "levels", [np.array([10.0]), np.array([10.0, 60.0]), np.array([5.0, 20.0, 90.0])]
)
def test_few_levels_are_enough(levels):
    truth = make_truth(levels=levels)
    sampled = build_field(truth).velocity(truth.grid.east, truth.grid.north, levels[-1])
    np.testing.assert_allclose(np.moveaxis(sampled, -1, 0), truth.velocity[0, :, -1], atol=1e-9)


def test_a_truth_is_one_member_with_water():
    truth = make_truth()
    two = Ensemble(truth.grid, np.repeat(truth.velocity, 2, axis=0), None, "two")
    dry = _with_land(truth, np.zeros_like(truth.grid.wet))
    for wrong, words in ((two, "#MEMBER"), (dry, "no wet point")):
        with pytest.raises(ForecastError, match=words):
            build_field(wrong)
