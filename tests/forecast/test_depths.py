"""Depth axes in every unit that has a meaning, and those that hold no depth."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.dataset import write_grid
from replay_kit.estimator import build
from replay_kit.forecast import read_ensemble, read_series, read_truth
from tests import synthetic
from tests.forecast.forms import read_with, refused, save
from tests.forecast.test_reader import PLAIN


def with_depths(values, **attrs) -> xr.Dataset:
    """The synthetic ensemble with another depth axis."""
    return synthetic.dataset().assign_coords(depth=("depth", values, attrs))


def test_a_level_asked_for_that_is_near_none_of_the_file_is_said(tmp_path):
    path = save(with_depths(np.array([5.0, 60.0, 150.0, 250.0]), units="m"), tmp_path / "e.nc")
    read = read_with(path, levels=(0.0, 140.0, 310.0, 1000.0))
    assert_array_equal(read.grid.levels, [5.0, 150.0, 250.0])
    assert read.notes == (
        "no level of the file (5..250 m) is near 310, 1000 m: nearest level used",
    )
    assert read_with(path, levels=(0.0, 140.0, 300.0)).notes == ()
    assert read_with(path).notes == ()


@pytest.mark.parametrize(
    ("levels", "least"), [((40.0, 60.0, 150.0, 250.0), 40.0), ((15.0, 20.0, 25.0, 30.0), None)]
)
def test_a_file_without_a_level_near_the_surface_is_warned_of(tmp_path, levels, least):
    read = read_with(save(with_depths(np.array(levels), units="m"), tmp_path / "e.nc"))
    warning = f"WARNING: the file has no level near the water above {least} m: the current of the first level is taken there"
    assert read.notes == (() if least is None else (warning.replace(".0 m", " m"),))


@pytest.mark.parametrize("unit", ["fathoms", "M", "Pa", "degrees_north"])
def test_a_unit_that_is_not_known_is_refused_with_its_file_and_coordinate(tmp_path, unit):
    path = save(with_depths(synthetic.LEVELS, units=unit), tmp_path / "e.nc")
    for read in (read_ensemble, read_series, lambda path, config: read_truth(f"{path}#0", config)):
        with pytest.raises(
            ForecastError,
            match=rf"e\.nc.*: coordinate depth is in '{unit}'; expected m, .*convert the axis to metres",
        ):
            read(path, PLAIN)


@pytest.mark.parametrize(
    "attrs",
    [
        {"units": "1"},
        {"units": "sigma_level"},
        {"units": "Layer"},
        {"units": "1", "standard_name": "ocean_sigma_coordinate"},
        {"standard_name": "model_level_number"},
        {"standard_name": "ocean_s_coordinate_g2"},
        {"formula_terms": "sigma: depth eta: zeta depth: h"},
    ],
)
def test_model_levels_are_refused_as_such(tmp_path, attrs):
    path = save(with_depths(np.array([1.0, 2.0, 3.0, 4.0]), **attrs), tmp_path / "e.nc")
    refused(
        r"e\.nc: coordinate depth has .*holds model levels and no depths.*fixed depths in metres",
        path,
    )


def test_the_grid_that_a_replay_writes_can_be_a_truth(tmp_path):
    ensemble = synthetic.ensemble()
    estimator = build([ensemble], EstimatorConfig(modes=4, sample_share=0.6))
    write_grid(estimator.flow(estimator.initial()), tmp_path / "flow.nc")
    truth = read_truth(str(tmp_path / "flow.nc"), PLAIN)
    assert_array_equal(truth.grid.levels, synthetic.LEVELS)
    assert truth.notes == ()
