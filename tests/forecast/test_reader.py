"""Files of every usual kind and of every bad kind."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.forecast.grids.horizontal import centre_longitude, region_block
from tests import synthetic
from tests.forecast.forms import noted, read_with, refused, save

PLAIN = ForecastConfig()


def assert_is(read, seed=0):
    assert_allclose(read.velocity, synthetic.ensemble(seed).velocity, atol=1e-15)


def test_region_and_levels_cut(tmp_path):
    path = save(synthetic.dataset(), tmp_path / "e.nc")
    read = read_with(path, region=(152.1, -39.9, 152.31, -39.7), levels=(0.0, 140.0, 160.0))
    assert read.grid.longitude.shape == (3, 3)
    assert_array_equal(read.grid.levels, [5.0, 150.0])
    refused(r"no grid point inside the region.*152\.0", path, region=(10.0, 50.0, 12.0, 52.0))


@pytest.mark.parametrize("shift", [0.0, 360.0, -360.0])
def test_regions_in_any_longitude_convention_and_across_the_antimeridian(shift):
    longitude, latitude = np.meshgrid(
        np.array([178.0, 179.0, -180.0, -179.0]), np.array([0.0, 1.0])
    )
    block = region_block(longitude, latitude, (179.0 + shift, -1.0, 181.0 + shift, 2.0))
    assert [part.tolist() for part in block] == [[0, 1], [1, 2, 3]]
    assert centre_longitude(longitude) == pytest.approx(179.5)


def test_land_of_any_member_is_everyone_s_and_is_told(tmp_path):
    ds = synthetic.dataset()
    ds["uo"][:, :, 4, 5] = ds["vo"][:, :, 4, 5] = 0.0
    ds["uo"][3, 1:, 0, 0] = np.nan
    ds["vo"][5, :, 2, 2] = np.nan
    read = read_with(save(ds, tmp_path / "e.nc"))
    assert not read.grid.wet[:, 2, 2].any()
    assert_array_equal(read.grid.wet[:, 0, 0], [True, False, False, False])
    assert np.isnan(read.velocity[:, :, ~read.grid.wet]).all()
    assert np.isfinite(read.velocity[:, :, read.grid.wet]).all()
    assert read.notes == (
        "treated as land: 1 column whose current is exactly zero in every member",
        "treated as land: 7 points without values in 2 of 8 members, most in 'e.nc member 5' (4 of 116 points)",
    )
    ds["uo"][3, 0] = np.nan
    refused(
        r"leave no water at the first level; 'none\.nc member 3' misses most \(33 of 117 points\)",
        save(ds, tmp_path / "none.nc"),
    )


def test_options_that_the_file_has_no_use_for_are_refused(tmp_path):
    path = save(synthetic.dataset(), tmp_path / "e.nc")
    for config in (
        ForecastConfig(lead=3.0),
        ForecastConfig(time="2020-01-01"),
        ForecastConfig(reference_time="2020-01-01"),
    ):
        with pytest.raises(ForecastError, match="remove the option"):
            read_ensemble(path, config)


def test_chooses_a_lead_and_a_time(tmp_path):
    ds = xr.concat([synthetic.dataset(seed=k) for k in range(3)], dim="lead")
    ds = ds.assign_coords(
        lead=("lead", [0.0, 2.0, 4.0], {"standard_name": "forecast_period", "units": "days"})
    )
    path = save(ds, tmp_path / "leads.nc")
    assert_is(read_with(path, lead=2.2), 1)
    times = (
        ds.drop_vars("lead")
        .rename(lead="time")
        .assign_coords(time=np.array(["2020-01-01", "2020-01-03", "2020-01-05"], "datetime64[ns]"))
    )
    path = save(times, tmp_path / "times.nc")
    start = int(np.datetime64("2020-01-01", "ns").astype(np.int64))
    assert_is(read_with(path, near_ns=start + 5 * 86_400 * 10**9), 2)
    chosen = read_with(path, time="2020-01-03", near_ns=start)
    assert_is(chosen, 1)
    late = read_with(path, near_ns=start + 10 * 86_400 * 10**9)
    assert noted(late, "6.0 days before the log begins")


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
    expected = synthetic.ensemble().velocity[3:4]
    assert_allclose(read_truth(f"{path}#3", PLAIN).velocity, expected, atol=1e-15)
    assert_allclose(read_truth(str(single), PLAIN).velocity, expected, atol=1e-15)
    with pytest.raises(ForecastError, match="name the one"):
        read_truth(str(path), PLAIN)
    with pytest.raises(ForecastError, match="no member '99'"):
        read_truth(f"{path}#99", PLAIN)
    with pytest.raises(ForecastError, match="no member dimension"):
        read_truth(f"{single}#1", PLAIN)


def without(name):
    return lambda ds: ds.drop_vars(name)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda ds: ds.isel(member=0, drop=True), "no member dimension.*depth = 4"),
        (lambda ds: ds.drop_vars(["uo", "vo"]), "no current found"),
        (without("lon"), "no longitude found"),
        (lambda ds: ds.assign(uo=ds["uo"].assign_attrs(units="furlongs")), "'furlongs'"),
        (lambda ds: ds.isel(lat=[0]), "at least 2 x 2"),
        (lambda ds: ds.where(False), "is land"),
        (lambda ds: ds.assign_coords(depth=("depth", [5.0, 5.0, 10.0, 20.0])), "distinct"),
        (
            lambda ds: ds.assign_coords(lat=("lat", ds["lat"].values + 300.0, ds["lat"].attrs)),
            "beyond 90",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(tmp_path, spoil, message):
    refused(message, save(spoil(synthetic.dataset()), tmp_path / "e.nc"))


@pytest.mark.parametrize(
    "content", [b"", b"not a dataset at all", b"\x89HDF\r\n\x1a\n broken", b"CDF\x01 broken"]
)
def test_files_that_are_no_dataset(tmp_path, content):
    path = tmp_path / "e.nc"
    path.write_bytes(content)
    refused(r"e\.nc", path)
    refused("no such file", tmp_path / "absent.nc")
