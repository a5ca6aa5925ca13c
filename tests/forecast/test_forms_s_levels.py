"""One known field on terrain-following levels, as ROMS and CROCO write it."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import read_truth
from replay_kit.forecast.describe import describe_ensemble
from tests.forecast import forms
from tests.forecast.forms import N_MEMBERS, noted, read_with, refused, save, saved, true_components


@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("packed", [False, True])
def test_roms_at_44_degrees_on_terrain_following_levels(tmp_path, transform, packed):
    shape, levels = (16, 18), (5.0, 60.0, 150.0, 300.0)
    at = forms.rotated(shape=shape, cell=0.02)
    made = [forms.roms(at, shape, member, transform, packed) for member in range(N_MEMBERS)]
    read = read_with(
        saved({f"mem{k}.nc": ds for k, (ds, _) in enumerate(made)}, tmp_path), levels=levels
    )
    assert_array_equal(read.grid.levels, levels)
    assert_array_equal(read.grid.wet[0], made[0][1][1:-1, 1:-1] > 0.0)
    assert read.members == ("mem0.nc", "mem1.nc", "mem2.nc")
    places = read.grid.longitude, read.grid.latitude, read.grid.levels[:, None, None]
    for member, found in enumerate(np.stack(true_components(read), 1)):
        known = np.stack(forms.truth(*places, member))
        # away from land, where one face stands for two
        error = (found - known)[:, :, 4:, 5:]
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(known**2))


@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("height", [6.0, -6.0])
def test_levels_move_with_a_tide_as_their_transform_says(tmp_path, transform, height):
    ds, _ = forms.roms(forms.rotated(0.0, shape=(6, 7), cell=0.02), (6, 7), 0, transform)
    h, hc, s, c = 50.0, 20.0, ds["s_rho"], ds["Cs_r"]
    at_rest = hc * (s - c) + c * h if transform == 1 else h * (hc * s + c * h) / (hc + h)
    # both transforms stretch the column from the sea bed to the surface in proportion
    depth = -(at_rest + height * (h + at_rest) / h)
    ds = ds.drop_vars(["mask_rho", "mask_u", "mask_v"])
    ds = ds.assign(h=0.0 * ds["h"] + h, zeta=0.0 * ds["zeta"] + height, v=0.0 * ds["v"])
    path = save(ds.assign(u=0.0 * ds["u"] + 1.0 - 0.01 * depth), tmp_path / "tide.nc")
    levels = (8.0, 20.0, 40.0)
    u, _ = true_components(read_truth(str(path), ForecastConfig(levels=levels)))
    expected = 1.0 - 0.01 * np.array(levels)[:, None, None]
    assert_allclose(u[0], np.broadcast_to(expected, u[0].shape), atol=1e-5)


def members(folder, numbers=(0, 1), change=lambda ds, mask: ds, **options):
    """Write the members of a small sea, a file each; return their files."""
    at = forms.rotated(shape=(8, 9), cell=0.02)
    made = [(k, *forms.roms(at, (8, 9), k, **options)) for k in numbers]
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
        (lambda ds, _: ds.drop_vars(["hc", "Vtransform"]), "s_rho numbers .* need hc, Vtransform"),
        (
            lambda ds, _: ds.assign(h=ds["h"] * np.nan),
            r"no column has both .* sea bed \(h\) above 0",
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
    of_grid = [name for name in GRID if name in ds.variables]
    grid = save(ds[of_grid].drop_vars("s_rho", errors="ignore"), folder / "croco_grd.nc")
    history = ds.drop_vars(of_grid).isel(ocean_time=0, drop=True)
    history = history.rename(Cs_r="Cs_rho").assign(Vtransform=2.0)
    moved = {"u": {"eta_u": "eta_rho"}, "v": {"xi_v": "xi_rho"}, "zeta": {}}
    fields = xr.Dataset({name: history[name].rename(dims) for name, dims in moved.items()})
    seconds = 86400.0 * np.arange(len(factors))
    time = xr.DataArray(seconds, dims="time", attrs={"units": "second"}, name="time")
    whole = xr.concat([fields * factor for factor in factors], time)
    return [save(whole.merge(history.drop_vars([*moved])), folder / "croco_his.nc"), grid]


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


def deep_sea(part):
    """Some of the levels of a file whose sea bed is 4,000 to 4,800 m deep, and 4,100 m to 4,700 m in the columns that are read."""
    ds, _ = forms.roms(forms.rotated(shape=(8, 9), cell=0.02), (8, 9), 0)
    return ds.assign(h=10.0 * ds["h"]).isel(s_rho=part).drop_vars(["mask_rho", "mask_u", "mask_v"])


def test_the_deepest_levels_alone_say_nothing_of_the_water_above_them(tmp_path):
    parts = {"whole": slice(None), "deepest": slice(0, 3), "one": slice(0, 1)}
    for name, part in parts.items():
        save(deep_sea(part), tmp_path / f"{name}.nc")

    def read(name, *levels):
        return read_truth(f"{tmp_path}/{name}.nc", ForecastConfig(levels=levels))

    span = r"those of the file \(3815..4509 m in the deepest column\)"
    words = (
        rf"deepest\.nc: no level is near 500 m, the first asked for; choose --levels from {span}"
    )
    with pytest.raises(ForecastError, match=words):
        read("deepest", 500.0, 1000.0, 1500.0, 2000.0, 3900.0)
    found, known = (read(name, 3500.0, 3900.0, 4150.0) for name in ("deepest", "whole"))
    # at 3,500 m columns are left dry whose first level, at .81 of the depth of the sea bed, is deeper; below all is as it was
    h = np.broadcast_to(4000.0 + 100.0 * np.arange(1, 8), known.grid.east.shape)
    near = (0.8118 * h <= 3500.0) & known.grid.wet[0]
    assert_array_equal(found.grid.wet, [near, *known.grid.wet[1:]])
    assert_array_equal(known.grid.wet[2], known.grid.wet[0] & (h >= 4150.0))
    assert_array_equal(found.velocity[:, :, found.grid.wet], known.velocity[:, :, found.grid.wet])
    dry = int((known.grid.wet[0] & ~near).sum())
    assert noted(found, f"WARNING: left dry: {dry} points in the water at 3500 m: no level is near")
    # one statement about the water above the levels
    assert not noted(found, "the current of the first level is taken there")
    assert not any("left dry" in note or note.startswith("WARNING") for note in known.notes)
    with pytest.raises(ForecastError, match="no level is near 3600 m"):
        read("one", 3600.0)
    # the only level of 4,100 m of water is 3,935 m deep
    wet = read("one", 3930.0).grid.wet[0]
    assert_array_equal(wet, known.grid.wet[0] & (h == 4100.0))
