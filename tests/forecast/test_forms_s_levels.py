"""One known field on terrain-following levels, as ROMS and CROCO write it."""

import re

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import read_truth
from replay_kit.forecast.describe import describe_ensemble
from tests.forecast import forms
from tests.forecast.forms import N_MEMBERS, noted, read_with, refused, save, true_components


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


def members(folder, numbers=(0, 1), shape=(8, 9), change=lambda ds, mask: ds, **options):
    """Write the members of a small sea, a file each; return their files."""
    at = forms.rotated(shape=shape, cell=0.02)
    made = [(k, *forms.roms(at, shape, k, **options)) for k in numbers]
    return [save(change(ds, mask), folder / f"mem{k}.nc") for k, ds, mask in made]


def test_levels_without_a_choice_are_those_of_the_deepest_column(tmp_path):
    paths = members(tmp_path, (1, 2))
    with xr.open_dataset(paths[0]) as ds:
        s, c, h = ds["s_rho"].values, ds["Cs_r"].values, 400.0 + 10.0 * 7
    levels = read_with(paths).grid.levels
    assert_allclose(levels, -np.sort(h * (20.0 * s + c * h) / (20.0 + h))[::-1])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda ds, mask: ds.drop_vars(["hc", "Vtransform"]),
            r"s_rho numbers terrain-following levels, whose depths need hc, Vtransform too; give",
        ),
        (
            lambda ds, mask: ds.assign(h=ds["h"] * np.nan),
            r"no column has both a current and a depth of the sea bed \(h\) above 0; check",
        ),
    ],
)
def test_levels_without_depths_are_refused(tmp_path, change, words):
    refused(words, members(tmp_path, change=change))


@pytest.mark.parametrize(
    ("at_sea_bed", "transform", "upwards"), [(np.nan, 1, True), (0.0, 2, False), (1e20, 1, False)]
)
def test_the_depth_of_land_turns_nothing_upside_down(tmp_path, at_sea_bed, transform, upwards):
    def turned(ds, mask):
        return ds if upwards else ds.isel(s_rho=slice(None, None, -1))

    def spoilt(ds, mask):
        height = ds["zeta"].where(mask > 0.0, 0.0 if at_sea_bed == 0.0 else np.nan)
        return turned(ds.assign(h=ds["h"].where(mask > 0.0, at_sea_bed), zeta=height), mask)

    (tmp_path / "known").mkdir()
    known = members(tmp_path / "known", change=turned, transform=transform)
    paths = members(tmp_path, change=spoilt, transform=transform)
    for levels in ((5.0, 150.0, 300.0), None):
        expected, read = (read_with(each, levels=levels) for each in (known, paths))
        assert_array_equal(read.grid.levels, expected.grid.levels)
        assert_array_equal(read.velocity, expected.velocity)
    u, _ = true_components(read_with(paths, levels=(60.0,)))
    grid = expected.grid
    assert_allclose(
        u[1, 0, 4:, 5:], forms.truth(grid.longitude, grid.latitude, 60.0, 1)[0][4:, 5:], atol=2e-3
    )


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


@pytest.mark.parametrize(("masks", "times"), [(True, 2), (True, 1), (False, 2), (False, 1)])
def test_a_history_at_rest_at_its_first_time_is_water_at_rest(tmp_path, masks, times):
    shape = (10, 12)
    ds, mask = forms.roms(forms.rotated(20.0, shape=shape, cell=0.02), shape, 1)
    if not masks:
        ds = ds.drop_vars(["mask_rho", "mask_u", "mask_v"])
    pair = croco_pair(ds, tmp_path, (0.0, 1.0)[:times])
    if not masks and times == 1:
        with pytest.raises(ForecastError, match="is land, or the current is 0 everywhere"):
            describe_ensemble(pair, ForecastConfig())
        return
    read = describe_ensemble(pair, ForecastConfig()).ensemble
    assert_array_equal(read.grid.wet[0], mask[1:-1, 1:-1] > 0.0)
    assert np.nanmax(np.abs(read.velocity)) == 0.0
    assert noted(read, "WARNING: the current is 0 everywhere")
    if times == 2:
        assert noted(read, "--lead takes another by its second since the first, 0 to 86400")
        later = describe_ensemble(pair, ForecastConfig(lead=80_000.0, levels=(60.0,))).ensemble
        east, _ = forms.truth(later.grid.longitude, later.grid.latitude, 60.0, 1)
        assert_allclose(true_components(later)[0][0, 0, 4:, 5:], east[4:, 5:], atol=2e-3)
        assert noted(later, "that of 86400 second since the first of 2 was taken")
        with pytest.raises(ForecastError, match=r"no dates .*--lead takes another"):
            describe_ensemble(pair, ForecastConfig(time="2020-01-01T00:00:00Z"))


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
