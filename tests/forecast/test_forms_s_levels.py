"""One known field on terrain-following levels, as ROMS and CROCO write it."""

import re

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.forecast.describe import describe_ensemble, open_extent
from tests.forecast import forms
from tests.forecast.forms import N_MEMBERS, noted, read_with, refused, save, true_components
from tests.places import DATA


@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("packed", [False, True])
def test_roms_at_44_degrees_on_terrain_following_levels(tmp_path, transform, packed):
    shape = (16, 18)
    at = forms.rotated(shape=shape, cell=0.02)
    made = [forms.roms(at, shape, member, transform, packed) for member in range(N_MEMBERS)]
    paths = [save(ds, tmp_path / f"his_mem{member:03d}.nc") for member, (ds, _) in enumerate(made)]
    levels = (5.0, 60.0, 150.0, 300.0)
    read = read_with(paths, levels=levels)
    assert_array_equal(read.grid.levels, levels)
    assert_array_equal(read.grid.wet[0], made[0][1][1:-1, 1:-1] > 0.0)
    u, v = true_components(read)
    for member in range(N_MEMBERS):
        known = np.stack(
            forms.truth(
                read.grid.longitude, read.grid.latitude, read.grid.levels[:, None, None], member
            )
        )
        # away from land, where one face stands for two
        error = (np.stack([u[member], v[member]]) - known)[:, :, 4:, 5:]
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(known**2))
    assert read.members == ("his_mem000.nc", "his_mem001.nc", "his_mem002.nc")


@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("height", [6.0, -6.0])
def test_levels_move_with_a_tide_as_their_transform_says(tmp_path, transform, height):
    ds, _ = forms.roms(forms.rotated(0.0, shape=(6, 7), cell=0.02), (6, 7), 0, transform)
    ds = ds.drop_vars(["mask_rho", "mask_u", "mask_v"])
    h, hc, s, c = 50.0, 20.0, ds["s_rho"].values, ds["Cs_r"].values
    at_rest = hc * (s - c) + c * h if transform == 1 else h * (hc * s + c * h) / (hc + h)
    # both transforms stretch the column from the sea bed to the surface in proportion
    depth = -(at_rest + height * (h + at_rest) / h)
    ds["h"], ds["zeta"] = 0.0 * ds["h"] + h, 0.0 * ds["zeta"] + height
    ds["u"] = 0.0 * ds["u"] + 1.0 - 0.01 * xr.DataArray(depth, dims="s_rho")
    levels = np.array([8.0, 20.0, 40.0])
    read = read_truth(
        str(save(ds.assign(v=0.0 * ds["v"]), tmp_path / "tide.nc")),
        ForecastConfig(levels=tuple(levels)),
    )
    u, _ = true_components(read)
    assert_allclose(
        u[0], np.broadcast_to((1.0 - 0.01 * levels)[:, None, None], u[0].shape), atol=1e-5
    )


def test_levels_of_terrain_following_files_without_a_choice_are_those_of_the_deepest_column(
    tmp_path,
):
    shape = (8, 9)
    ds, _ = forms.roms(forms.rotated(shape=shape, cell=0.02), shape, 0)
    paths = [
        save(
            forms.roms(forms.rotated(shape=shape, cell=0.02), shape, k)[0], tmp_path / f"mem{k}.nc"
        )
        for k in (1, 2)
    ]
    read = read_with(paths)
    s, c, h = ds["s_rho"].values, ds["Cs_r"].values, 400.0 + 10.0 * 7
    assert_allclose(read.grid.levels, -np.sort(h * (20.0 * s + c * h) / (20.0 + h))[::-1])
    refused(
        r"s_rho numbers terrain-following levels, whose depths need hc, Vtransform too; give the file",
        [save(ds.drop_vars(["hc", "Vtransform"]), tmp_path / f"r{k}_mem{k}.nc") for k in (1, 2)],
    )


@pytest.mark.parametrize("at_sea_bed", [np.nan, 0.0, 1e20])
@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("upwards", [True, False])
def test_the_depth_of_land_turns_nothing_upside_down(tmp_path, at_sea_bed, transform, upwards):
    shape = (8, 9)
    at = forms.rotated(shape=shape, cell=0.02)
    known, spoilt = [], []
    for member in range(2):
        ds, mask = forms.roms(at, shape, member, transform)
        if not upwards:
            ds = ds.isel(s_rho=slice(None, None, -1))
        known.append(save(ds, tmp_path / f"known_mem{member}.nc"))
        ds["h"] = ds["h"].where(mask > 0.0, at_sea_bed)
        ds["zeta"] = ds["zeta"].where(mask > 0.0, 0.0 if at_sea_bed == 0.0 else np.nan)
        spoilt.append(save(ds, tmp_path / f"spoilt_mem{member}.nc"))
    for config in (ForecastConfig(levels=(5.0, 150.0, 300.0)), ForecastConfig()):
        expected, read = read_ensemble(known, config), read_ensemble(spoilt, config)
        assert_array_equal(read.grid.levels, expected.grid.levels)
        assert_array_equal(read.velocity, expected.velocity)
    u, _ = true_components(read_with(spoilt, levels=(60.0,)))
    grid = expected.grid
    assert_allclose(
        u[1, 0, 4:, 5:], forms.truth(grid.longitude, grid.latitude, 60.0, 1)[0][4:, 5:], atol=2e-3
    )


def test_a_region_without_a_sea_bed_is_refused_in_words(tmp_path):
    ds, _ = forms.roms(forms.rotated(shape=(8, 9), cell=0.02), (8, 9), 0)
    ds["h"] = ds["h"] * np.nan
    with pytest.raises(
        ForecastError,
        match=r"one\.nc: no column has both a current and a depth of the sea bed \(h\) above 0; check",
    ):
        read_truth(str(save(ds, tmp_path / "one.nc")), ForecastConfig())


GRID = ("mask_rho", "mask_u", "mask_v", "lon_rho", "lat_rho", "lon_u", "lat_u", "h", "angle")


def croco_pair(ds, folder, factors=(1.0,)):
    """A history, in which u has the rows and v the columns of the centres, at some times, and the file of its grid with rows of its own."""
    grid = save(
        ds[[name for name in GRID if name in ds.variables]].drop_vars("s_rho", errors="ignore"),
        folder / "croco_grd.nc",
    )
    history = (
        ds.drop_vars(GRID, errors="ignore")
        .rename(Cs_r="Cs_rho", ocean_time="time")
        .isel(time=0, drop=True)
    )
    history["u"] = history["u"].rename(eta_u="eta_rho")
    history["v"] = history["v"].rename(xi_v="xi_rho")
    history["Vtransform"] = 2.0
    fields = [history[["u", "v", "zeta"]] * factor for factor in factors]
    fields = xr.concat(
        fields,
        xr.DataArray(
            86400.0 * np.arange(len(factors)), dims="time", attrs={"units": "second"}, name="time"
        ),
    )
    return [
        save(history.drop_vars(["u", "v", "zeta"]).merge(fields), folder / "croco_his.nc"),
        grid,
    ]


def test_croco_history_with_the_file_of_its_grid(tmp_path):
    shape = (10, 12)
    ds, mask = forms.roms(forms.rotated(20.0, shape=shape, cell=0.02), shape, 1)
    read = read_with(croco_pair(ds, tmp_path, (1.0, 2.0)), levels=(60.0,), members="dim:time")
    assert_array_equal(read.grid.wet[0], mask[1:-1, 1:-1] > 0.0)
    u, _ = true_components(read)
    east, _ = forms.truth(read.grid.longitude, read.grid.latitude, 60.0, 1)
    assert_allclose(u[0, 0, 4:, 5:], east[4:, 5:], atol=2e-3)
    assert_allclose(u[1], 2.0 * u[0], atol=2e-3)
    assert not noted(read, "not used")


@pytest.mark.parametrize("masks", [True, False])
@pytest.mark.parametrize("times", [2, 1])
def test_a_history_at_rest_at_its_first_time_is_water_at_rest(tmp_path, masks, times):
    shape = (10, 12)
    ds, mask = forms.roms(forms.rotated(20.0, shape=shape, cell=0.02), shape, 1)
    if not masks:
        ds = ds.drop_vars(["mask_rho", "mask_u", "mask_v"])
    pair = [str(path) for path in croco_pair(ds, tmp_path, (0.0, 1.0)[:times])]
    if not masks and times == 1:
        with pytest.raises(
            ForecastError,
            match="every point of the first level is land, or the current is 0 everywhere",
        ):
            describe_ensemble(pair, ForecastConfig())
        return
    read = describe_ensemble(pair, ForecastConfig()).ensemble
    assert_array_equal(read.grid.wet[0], mask[1:-1, 1:-1] > 0.0)
    assert np.nanmax(np.abs(read.velocity)) == 0.0
    (warning,) = (note for note in read.notes if note.startswith("WARNING: "))
    assert warning.startswith("WARNING: the current is 0 everywhere")
    assert "--lead without dates" in warning
    if times == 2:
        assert noted(read, "--lead takes another by its second since the first, 0 to 86400")
        later = describe_ensemble(pair, ForecastConfig(lead=80_000.0)).ensemble
        assert np.nanmax(np.abs(later.velocity)) > 0.1
        assert noted(later, "that of 86400 second since the first of 2 was taken")
        with pytest.raises(ForecastError, match=r"no dates .*--lead takes another"):
            describe_ensemble(pair, ForecastConfig(time="2020-01-01T00:00:00Z"))


@pytest.mark.parametrize("factor", [1.0, 0.0])
def test_a_pair_made_of_a_real_file(tmp_path, factor):
    source = DATA / "models" / "roms_ocean_his_0001.nc"
    if not source.exists():
        pytest.skip("the shared data are not on this machine")
    with xr.open_dataset(source, decode_times=False) as ds:
        pair = croco_pair(ds.load(), tmp_path, (factor, 1.0))
    read, whole = (
        describe_ensemble(pair, ForecastConfig()).ensemble,
        read_truth(str(source), ForecastConfig()),
    )
    assert_array_equal(read.grid.wet, whole.grid.wet)
    assert_allclose(read.velocity, factor * whole.velocity, atol=1e-12)


def deep_sea(part, member=0):
    """Some of the levels of a file whose sea bed is 4,000 to 4,800 m deep, and 4,100 m to 4,700 m in the columns that are read."""
    ds, _ = forms.roms(forms.rotated(shape=(8, 9), cell=0.02), (8, 9), member)
    return ds.assign(h=10.0 * ds["h"]).isel(s_rho=part).drop_vars(["mask_rho", "mask_u", "mask_v"])


def test_the_deepest_levels_alone_say_nothing_of_the_water_above_them(tmp_path):
    whole = save(deep_sea(slice(None)), tmp_path / "whole.nc")
    deepest = str(save(deep_sea(slice(0, 3)), tmp_path / "deepest.nc"))
    span = "those of the file (3815..4509 m in the deepest column)"
    with pytest.raises(
        ForecastError,
        match=rf"deepest\.nc: no level is near 500 m, the first asked for; choose --levels from {re.escape(span)}",
    ):
        read_truth(deepest, ForecastConfig(levels=(500.0, 1000.0, 1500.0, 2000.0, 3900.0)))
    levels = (3500.0, 3900.0, 4150.0)
    read, known = (
        read_truth(str(path), ForecastConfig(levels=levels)) for path in (deepest, whole)
    )
    # at 3,500 m columns are left dry whose first level, at .81 of the depth of the sea bed, is deeper; below all is as it was
    h = np.broadcast_to(4000.0 + 100.0 * np.arange(1, 8), known.grid.east.shape)
    near = (0.8118 * h <= 3500.0) & known.grid.wet[0]
    assert_array_equal(read.grid.wet, [near, *known.grid.wet[1:]])
    assert_array_equal(known.grid.wet[2], known.grid.wet[0] & (h >= 4150.0))
    assert_array_equal(read.velocity[:, :, read.grid.wet], known.velocity[:, :, read.grid.wet])
    dry = int((known.grid.wet[0] & ~near).sum())
    assert (
        f"WARNING: left dry: {dry} points in the water at 3500 m: no level is near, of {span}"
        in read.notes
    )
    # one statement about the water above the levels
    assert not any("the current of the first level is taken there" in note for note in read.notes)
    assert not any("left dry" in note or note.startswith("WARNING") for note in known.notes)
    one = str(save(deep_sea(slice(0, 1)), tmp_path / "one.nc"))
    with pytest.raises(ForecastError, match="no level is near 3600 m"):
        read_truth(one, ForecastConfig(levels=(3600.0,)))
    # the only level of 4,100 m of water is 3,935 m deep
    read = read_truth(one, ForecastConfig(levels=(3930.0,)))
    assert_array_equal(read.grid.wet[0], known.grid.wet[0] & (h == 4100.0))


def test_a_patch_of_deep_water_alone_is_of_the_first_level_asked_for(tmp_path):
    for k in range(2):
        save(deep_sea(slice(0, 3), k), tmp_path / f"mem{k}.nc")
    with open_extent(tmp_path, ForecastConfig(levels=(3900.0, 4000.0)), None) as found:
        assert_array_equal(found.patch(found.box).grid.levels, [3900.0])
        south, north, cell = found.latitude.min(), found.latitude.max(), max(found.step)
        assert found.box[1::2] == pytest.approx((south - cell, north + cell), abs=0.01 * cell)
    with (
        open_extent(tmp_path, ForecastConfig(), None) as found,
        pytest.raises(ForecastError, match="no level is near 0 m"),
    ):
        found.patch(found.box)


def test_levels_that_end_far_above_the_sea_bed_do_for_half_a_spacing_below_the_last(tmp_path):
    whole, cut = (
        save(deep_sea(part), tmp_path / f"{part.start}.nc")
        for part in (slice(0, None), slice(20, None))
    )
    ends = deep_sea(slice(20, None))
    # of the column with 4,700 m of water
    depths = -(20.0 * ends["s_rho"] + ends["Cs_r"] * 4700.0) / 4720.0 * 4700.0
    last, spacing = float(depths[0]), float(depths[0] - depths[1])
    levels = (5.0, 100.0, last + 0.4 * spacing, last + 0.7 * spacing, 3000.0)
    read, known = (read_truth(str(path), ForecastConfig(levels=levels)) for path in (cut, whole))
    assert_array_equal(read.grid.wet.any(axis=(1, 2)), [True, True, True, False, False])
    assert_array_equal(read.grid.wet[:2], known.grid.wet[:2])
    assert_array_equal(read.velocity[:, :, :2], known.velocity[:, :, :2])
