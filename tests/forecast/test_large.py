"""Ensembles larger than memory: read in groups, kept on disk, and the same to every user; and stores that declare more than they hold."""

import errno
import os
import tracemalloc

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core import arrays
from replay_kit.core.errors import ForecastError, ReplayKitError
from replay_kit.core.files import inputs
from replay_kit.estimator import build
from replay_kit.forecast import gather, read_series, reader, variables
from replay_kit.forecast.describe import describe_ensemble
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import read_with, unwritten_stores


@pytest.fixture
def nothing_fits(monkeypatch):
    monkeypatch.setattr(arrays, "IN_MEMORY", 1000)
    monkeypatch.setattr(gather, "IN_MEMORY", 1000)
    monkeypatch.setattr(gather, "_GROUP", 6000)


@pytest.mark.parametrize("form", ["zarr", "netcdf", "files"])
def test_an_ensemble_on_disk_equals_one_in_memory(tmp_path, request, monkeypatch, form):
    data, path = synthetic.dataset(n_members=7), tmp_path
    data["uo"][2, :, 1, 1] = np.nan
    data["uo"][:, 2:, 3, 3] = np.nan
    if form == "zarr":
        data.to_zarr(path := tmp_path / "e.zarr", zarr_format=2, consolidated=True)
    elif form == "netcdf":
        data.to_netcdf(path := tmp_path / "e.nc")
    else:
        forms.saved({f"mem{k:03d}.nc": data.isel(member=k, drop=True) for k in range(7)}, path)
    expected = read_with(path)
    request.getfixturevalue("nothing_fits")
    groups = list[int]()

    def noting(*given):
        groups.append(len(found := gather.in_groups(*given)))
        return found

    monkeypatch.setattr(reader, "in_groups", noting)
    ensemble = read_with(path)
    assert (max(groups) > 1) == (form != "files")
    assert_array_equal(ensemble.velocity, expected.velocity)
    assert not ensemble.velocity.flags.owndata
    assert (ensemble.members, ensemble.notes) == (expected.members, expected.notes)
    assert_array_equal(ensemble.rows(1, 3), expected.velocity[:, :, :, 1:3])
    ours, theirs = (build([each], EstimatorConfig()) for each in (ensemble, expected))
    for name in ("mean", "moving", "fixed"):
        one, other = (getattr(each.observer.process, name) for each in (ours, theirs))
        assert_array_equal(one, other)


def test_many_values_in_single_precision_stay_so_and_are_rounded_once(tmp_path, monkeypatch):
    data = synthetic.dataset()
    single = {name: {"dtype": "float32"} for name in ("uo", "vo")}
    data.to_netcdf(tmp_path / "e.nc", engine="scipy", encoding=single)
    few = read_with(tmp_path / "e.nc").velocity
    monkeypatch.setattr(variables, "_MANY", 0)
    many = read_with(tmp_path / "e.nc").velocity
    assert (few.dtype, many.dtype) == (np.float64, np.float32)
    assert_array_equal(many, few.astype(np.float32))


def test_a_full_disk_is_told_before_anything_is_read(nothing_fits, monkeypatch):
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(ReplayKitError, match=r"needs 0\.0 GB.*No space left.*TMPDIR"):
        arrays.large_array((10, 100), np.dtype(np.float32))


def test_a_small_part_of_a_large_curvilinear_grid_is_read(tmp_path):
    y, x = np.mgrid[:1000, :1000]
    noise = np.random.default_rng(1).normal(0.0, 0.05, (2, *x.shape)).astype(np.float32)
    dims = ("member", "y", "x")
    held = {name: (dims, noise, {"units": "m s-1"}) for name in ("uo", "vo")}
    held["nav_lon"] = dims[1:], -20.0 + 0.01 * x + 3e-4 * y
    held["nav_lat"] = dims[1:], 30.0 + 0.01 * y - 2e-4 * x
    encoding = {name: {"zlib": True, "complevel": 1} for name in held}
    xr.Dataset(held).to_netcdf(path := tmp_path / "e.nc", encoding=encoding)
    read = read_with(path, region=(-15.0, 35.0, -14.5, 35.5))
    assert read.velocity.shape[0] == 2
    assert read.grid.east.size < 4000


def refused_early(paths, message, **config):
    """Assert that stores are refused, and that little of what they declare was made."""
    tracemalloc.start()
    try:
        with pytest.raises(ForecastError, match=message):
            describe_ensemble(paths, ForecastConfig(**config))
        assert tracemalloc.get_traced_memory()[1] < 3e7
    finally:
        tracemalloc.stop()


def test_coordinates_that_were_never_written_are_refused_before_currents_are_read(tmp_path):
    # 17 GB of currents; coordinates of 106 MB each in 77 KB, and of 2 MB
    (tmp_path / "large").mkdir()
    claimed = r"U\.zarr: its coordinates cannot be read: it claims 212 MB of values in a file of 0"
    refused_early(unwritten_stores(tmp_path / "large", (80, 3059, 4322)), claimed)
    # a small one is refused too, before it was taken for water at rest
    for shape in ((4400, 400, 601), (8, 40, 60)):
        written = r"U\.zarr: glamt is 0 at every point; were the coordinates written\?"
        refused_early(unwritten_stores(tmp_path, shape), written)
    x, y = np.meshgrid(np.linspace(10.0, 16.0, 60), np.linspace(40.0, 44.0, 40))
    stores = unwritten_stores(tmp_path, (8, 40, 60), x, 0.0 * y + 5.0)
    refused_early(stores, "gphit is 5 at every point")


def test_currents_that_were_never_written_are_refused_before_they_are_made(tmp_path):
    x, y = np.meshgrid(np.linspace(10.0, 16.0, 600), np.linspace(40.0, 44.0, 400))
    paths = unwritten_stores(tmp_path, (4400, 400, 600), x, y)
    words = "vozocrtx cannot be read: it claims {} MB of values in "
    refused_early(paths, words.format(8448) + ".*; choose less with --region and --levels")
    # of a small part all of its chunk is unpacked
    part = {"region": (11.0, 41.0, 11.1, 41.1), "levels": (10.0, 20.0)}
    refused_early(paths, words.format(839), **part)


def test_a_month_of_daily_files_is_measured_by_the_times_of_each(tmp_path, monkeypatch):
    parts = {
        f"day{k:02d}.nc": forms.dated(synthetic.dataset(), [f"2020-01-{k + 1:02d}"])
        for k in range(9)
    }
    forms.saved(parts, tmp_path)
    # arrays may take two times the bytes of their file
    monkeypatch.setattr(inputs, "_FREE", 0)
    monkeypatch.setattr(inputs, "_RATIO", 2)
    assert len(read_series(tmp_path, ForecastConfig())) == 9
