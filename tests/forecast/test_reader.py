"""Files of every usual kind and of every bad kind."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.dataset import write_grid
from replay_kit.estimator import build
from replay_kit.forecast import read_ensemble, read_truth
from tests import synthetic
from tests.forecast.forms import noted, read_with, save

PLAIN, DAY_NS = ForecastConfig(), 86_400 * 10**9


def assert_is(read, seed=0):
    assert_allclose(read.velocity, synthetic.ensemble(seed).velocity, atol=1e-15)


def test_region_and_levels_cut(tmp_path):
    path = save(synthetic.dataset(), tmp_path / "e.nc")
    read = read_with(path, region=(152.1, -39.9, 152.31, -39.7), levels=(0.0, 140.0, 160.0))
    assert read.grid.longitude.shape == (3, 3)
    assert_array_equal(read.grid.levels, [5.0, 150.0])


def test_chooses_a_lead_and_a_time(tmp_path):
    ds = xr.concat([synthetic.dataset(seed=k) for k in range(3)], dim="lead")
    about = {"standard_name": "forecast_period", "units": "days"}
    path = save(ds.assign_coords(lead=("lead", [0.0, 2.0, 4.0], about)), tmp_path / "leads.nc")
    assert_is(read_with(path, lead=2.2), 1)
    days = np.array(["2020-01-01", "2020-01-03", "2020-01-05"], "datetime64[ns]")
    path = save(ds.rename(lead="time").assign_coords(time=days), tmp_path / "times.nc")
    start = int(days[0].astype(np.int64))
    assert_is(read_with(path, near_ns=start + 5 * DAY_NS), 2)
    assert_is(read_with(path, time="2020-01-03", near_ns=start), 1)
    assert noted(read_with(path, near_ns=start + 10 * DAY_NS), "6.0 days before the log begins")


def test_a_topology_says_which_coordinates_are_those_of_the_centres(tmp_path):
    held = {}
    for j, i, count in ("q", "p", 6), ("j", "i", 5):
        for name, values in zip(
            "xy", np.meshgrid(*[np.arange(count) - 0.1 * count] * 2), strict=True
        ):
            about = {"standard_name": "longitude" if name == "x" else "latitude"}
            held[name + j] = (j, i), values, about
    u = np.random.default_rng(0).normal(size=(3, 5, 6))
    held |= {"u": (("member", "j", "p"), u), "v": (("member", "q", "i"), u.swapaxes(1, 2))}
    held["grid"] = (), 0, {"face_dimensions": "i: p j: q", "face_coordinates": "xj yj"}
    read = read_with(save(xr.Dataset(held), tmp_path / "e.nc"))
    assert_array_equal(read.grid.longitude, held["xj"][1])


def test_placing_moves_the_grid_and_says_so(tmp_path):
    path = save(synthetic.dataset(), tmp_path / "e.nc")
    here, there = read_with(path), read_ensemble(path, PLAIN, place_at=(86.0, 12.0))
    assert_allclose(there.grid.east, here.grid.east, atol=1e-6)
    assert_array_equal(there.velocity, here.velocity)
    assert abs(there.grid.longitude.mean() - 86.0) < 0.05
    assert "not a forecast" in there.notes[0]


def test_truth_of_one_field_or_of_a_named_member(tmp_path):
    ds = synthetic.dataset()
    path = save(ds, tmp_path / "e.nc")
    single = save(ds.isel(member=3, drop=True), tmp_path / "t.nc")
    for given in (f"{path}#3", str(single)):
        expected = synthetic.ensemble().velocity[3:4]
        assert_allclose(read_truth(given, PLAIN).velocity, expected, atol=1e-15)
    for given, words in (
        (path, "name the one"),
        (f"{path}#99", "no member '99'"),
        (f"{single}#1", "no member dimension"),
    ):
        with pytest.raises(ForecastError, match=words):
            read_truth(str(given), PLAIN)


def test_the_grid_that_a_replay_writes_can_be_a_truth(tmp_path):
    estimator = build([synthetic.ensemble()], EstimatorConfig(modes=4, sample_share=0.6))
    write_grid(estimator.flow(estimator.initial()), tmp_path / "flow.nc")
    truth = read_truth(str(tmp_path / "flow.nc"), PLAIN)
    assert_array_equal(truth.grid.levels, synthetic.LEVELS)
    assert truth.notes == ()
