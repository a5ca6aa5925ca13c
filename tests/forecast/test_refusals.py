"""What comes of files that do not belong together, or hold less than they should: an error or a note that names them and what to do."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import ConfigError
from replay_kit.forecast.describe import describe_ensemble
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import dated, noted, read_with, refused, save, saved

SEA, KNOWN = synthetic.dataset(), forms.known()
ONE, U, V = KNOWN.isel(member=0), KNOWN.isel(member=0)[["uo"]], KNOWN.isel(member=0)[["vo"]]
TWICE = np.insert(np.arange(6), 3, 3)


def changed(**variables):
    """Return the synthetic ensemble with other variables, each as its dimensions, values and attributes."""
    return SEA.assign(variables)


def curved(ds):
    """Return a forecast with longitudes and latitudes of two dimensions."""
    lon, lat = np.meshgrid(ds.lon, ds.lat)
    ds = ds.rename_dims(lon="x", lat="y").drop_vars(["lon", "lat"])
    return ds.assign_coords(nav_lon=(("y", "x"), lon), nav_lat=(("y", "x"), lat))


def other_twice():
    """Return a forecast with a longitude twice, with other values of v."""
    ds = SEA.isel(lon=TWICE).copy(deep=True)
    ds["vo"][2, 1, 2, 4] += 0.1
    return ds


def beside_another_grid():
    """Return a forecast without coordinates, and a grid of another size."""
    u, v = forms.regular(*forms.lonlat())
    dims = ("member", "depth", "y", "x")
    x, y = np.meshgrid(*forms.lonlat(shape=(9, 14)))
    grid = {"lon_rho": x, "lat_rho": y, "mask_rho": np.ones(x.shape)}
    return {
        "e.nc": xr.Dataset({"uo": (dims, u), "vo": (dims, v)}, {"depth": ("depth", forms.LEVELS)}),
        "grid.nc": xr.Dataset({name: (("eta_rho", "xi_rho"), of) for name, of in grid.items()}),
    }


#: Files by name, settings, and words of the refusal.
REFUSED = [
    ({"e.nc": ONE}, {}, "no member dimension.*depth = 4"),
    ({"e.nc": ONE}, {"members": "lags"}, "needs dated forecasts"),
    ({"e.nc": ONE}, {"members": "suffix"}, "but no variables differ by a suffix alone"),
    # a name is not a regular expression
    ({"e.nc": ONE}, {"members": "dim:ens(0"}, r"no member dimension ens\(0; expected one of"),
    ({"e.nc": SEA.drop_vars(["uo", "vo"])}, {}, "no current found"),
    ({"e.nc": SEA.drop_vars("lon")}, {}, "no longitude found"),
    ({"e.nc": SEA.assign(uo=SEA.uo.assign_attrs(units="furlongs"))}, {}, "'furlongs'"),
    ({"e.nc": SEA.isel(lat=[0])}, {}, "at least 2 x 2"),
    ({"e.nc": SEA.where(False)}, {}, "is land"),
    ({"e.nc": changed(depth=("depth", [5.0, 5.0, 10.0, 20.0]))}, {}, "distinct"),
    ({"e.nc": SEA.assign_coords(lat=SEA.lat + 300.0)}, {}, "beyond 90"),
    ({"e.nc": SEA}, {"region": (10.0, 50.0, 12.0, 52.0)}, r"no grid point inside .*152\.0"),
    ({"e.nc": SEA}, {"lead": 3.0}, "remove the option"),
    ({"e.nc": SEA}, {"time": "2020-01-01"}, "remove the option"),
    ({"e.nc": SEA.isel(member=[3])}, {}, "needs at least 2 members, got 1; give several files"),
    (
        {"e.nc": SEA[["uo"]].assign(vo=(("other", "depth", "lat", "lon"), SEA.vo.values[:6]))},
        {},
        "e.nc: uo has member = 8, .*, vo has other = 6, .*; give the same members",
    ),
    ({"e.nc": other_twice()}, {}, "lon repeats .* with other values of vo"),
    ({"e.nc": curved(other_twice())}, {}, "x repeats the place .* of vo"),
    ({"e.nc": SEA.isel(lon=[0, 1, 2, 1, 2, 3, 4, 5])}, {}, "it turns at its value 4"),
    *(
        (
            {"e.nc": changed(depth=("depth", forms.LEVELS, {"units": unit}))},
            {},
            rf"e\.nc: coordinate depth is in '{unit}'; expected m, .*convert the axis to metres",
        )
        for unit in ("fathoms", "M", "Pa")
    ),
    *(
        (
            {"e.nc": changed(depth=("depth", [1.0, 2.0, 3.0, 4.0], about))},
            {},
            r"e\.nc: coordinate depth has .*holds model levels and no depths.*fixed depths in metres",
        )
        for about in (
            {"units": "sigma_level"},
            {"units": "1", "standard_name": "ocean_sigma_coordinate"},
            {"standard_name": "ocean_s_coordinate_g2"},
            {"formula_terms": "sigma: depth eta: zeta depth: h"},
        )
    ),
    ({"m0.nc": ONE, "m1.nc": ONE}, {"members": "files"}, "all 2 members are identical"),
    ({"one.nc": ONE, "two.nc": ONE}, {}, "no member dimension; .*--members files: 2 files"),
    ({"one.nc": ONE}, {"members": r"files:case(\d)"}, r"case\(\\d\) does not fit this file"),
    (
        {"mem1.nc": ONE, "mem2.nc": V},
        {},
        r"mem2\.nc: holds vo and no u; 0 files of u and 1 of v belong together as member 2: give",
    ),
    (
        {"u.nc": SEA[["uo"]], "v.nc": SEA[["vo"]].isel(member=slice(6))},
        {},
        r"v\.nc: its members are not those of .*u\.nc: uo has member = 8, .*, vo has .* = 6,",
    ),
    (
        {"u.nc": dated(U, ["2020-01-01"]), "v.nc": dated(V, ["2020-01-02"])},
        {"members": "files"},
        r"v\.nc: its times \(1 from 2020-01-02T.*\) are not those of .*u\.nc",
    ),
    (
        {"u.nc": dated(U, ["2020-01-01"]), "v.nc": dated(V, ["2020-01-01", "2020-01-02"])},
        {"members": "files"},
        r"v\.nc: its times \(2 from 2020-01-01T.*\) are not those of .*u\.nc \(1 from",
    ),
    (beside_another_grid(), {}, "the currents have 7 x 8 points, the coordinates 9 x 14; give"),
    (
        {"e.nc": SEA, "ocean_hgrid.nc": xr.Dataset({"x": (("nyp", "nxp"), np.ones((3, 3)))})},
        {},
        "a supergrid of MOM, .*; give ocean_static.nc",
    ),
    ({}, {}, "the folder holds no NetCDF file"),
    ({"a.nc.analysis": ONE}, {}, r"holds only analysis results, such as a\.nc\.analysis; give"),
]


@pytest.mark.parametrize(("files", "settings", "words"), REFUSED)
def test_what_cannot_be_used_is_refused_in_words(tmp_path, files, settings, words):
    refused(words, saved(files, tmp_path), **settings)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "neither NetCDF nor Zarr"),
        (b"not a dataset at all", "neither NetCDF nor Zarr"),
        (b"\x89HDF\r\n\x1a\n broken", "cannot be read as h5netcdf"),
        (b"CDF\x01 broken", "cannot be read as scipy"),
        (None, "no such file"),
    ],
)
def test_files_that_are_no_dataset(tmp_path, content, words):
    if content is not None:
        (tmp_path / "e.nc").write_bytes(content)
    refused(rf"e\.nc: {words}", tmp_path / "e.nc")
    refused(r"e\.nc: given twice", [tmp_path / "e.nc"] * 2)
    refused(r"x\*\.nc: no file matches this pattern", tmp_path / "x*.nc")


def test_rules_that_are_none_are_refused():
    with pytest.raises(ConfigError, match="is not a regular expression"):
        read_with("e.nc", members="files:mem(")
    for wrong in ("times:fortnight", "time:3", "dim:", "suffixes", "xlags"):
        with pytest.raises(ConfigError, match=rf"expected dim\[:NAME\], .* got '{wrong}'"):
            load_config(None, {"forecast": {"members": wrong}})


ALIKE = "such as m0.nc: check the attributes units and calendar of its times"


def in_calendar(member, unit):
    """Return a member at a time that no date of ours is."""
    ds = KNOWN.isel(member=member).expand_dims(time=1)
    return ds.assign_coords(time=("time", [1.0], {"units": unit, "calendar": "360_day"}))


def at_depths(*levels):
    return {"e.nc": changed(depth=("depth", list(levels), {"units": "m"}))}


def members(**more):
    return {f"m{k}.nc": KNOWN.isel(member=k % 3) for k in range(4)} | more


def faster(factor):
    return {"e.nc": SEA.assign({name: factor * part for name, part in SEA.data_vars.items()})}


SUFFIXES = xr.Dataset(
    {f"{n}_m{k}": KNOWN[n].isel(member=k, drop=True) for k in range(3) for n in ("uo", "vo")}
)
#: Files by name, settings, and all notes.
NOTED = [
    (
        members(),
        {"members": "files"},
        "WARNING: duplicate members are counted once: 1, such as 'm3.nc' and 'm0.nc'; remove them",
    ),
    ({"e.nc": KNOWN.assign(uo_stokes=KNOWN["uo"])}, {}, ""),
    (
        {"e.nc": SUFFIXES.assign(uo_mean=SUFFIXES.uo_m0).drop_vars("uo_m1")},
        {},
        "WARNING: members with only one component were excluded: e.nc: vo_m1 without uo_m1",
    ),
    (
        {f"m{k}.nc": dated(KNOWN.isel(member=k), [f"2020-01-0{1 + 2 * k % 3}"]) for k in range(3)},
        {"members": "files"},
        "WARNING: members are of different times, 2020-01-01T00:00Z to 2020-01-03T00:00Z: choose one that all have with forecast.time",
    ),
    (
        {
            "m0.nc": in_calendar(0, "days since 2020-02-29"),
            "m1.nc": in_calendar(1, "days since 0000-01-01"),
            "m2.nc": dated(KNOWN.isel(member=2), ["2020-01-01"]),
        },
        {"members": "files"},
        f"WARNING: 2 members of 3 without a date that can be aligned with the others, {ALIKE}",
    ),
    (
        at_depths(5.0, 60.0, 150.0, 250.0),
        {"levels": (0.0, 140.0, 310.0, 1000.0)},
        "no level of the file (5..250 m) is near 310, 1000 m: nearest level used",
    ),
    (at_depths(5.0, 60.0, 150.0, 250.0), {"levels": (0.0, 140.0, 300.0)}, ""),
    (at_depths(15.0, 20.0, 25.0, 30.0), {}, ""),
    (
        at_depths(40.0, 60.0, 150.0, 250.0),
        {},
        "WARNING: the file has no level near the water above 40 m: the current of the first level is taken there",
    ),
    (faster(100.0), {}, "WARNING: unusual RMS current of "),
    (faster(0.01), {}, "WARNING: unusual RMS current of "),
    (
        {"e.nc": SEA.assign(uo=SEA.uo.assign_attrs(coordinates="geolon geolat depth"))},
        {},
        "coordinates geolon, geolat are named but missing in the file",
    ),
]


@pytest.mark.parametrize(("files", "settings", "note"), NOTED)
def test_what_is_odd_is_noted(tmp_path, files, settings, note):
    read = read_with(saved(files, tmp_path), **settings)
    said = [each for each in read.notes if "has no dates" not in each]
    assert [each.startswith(note) for each in said] == ([True] if note else [])


def test_land_of_any_member_is_everyone_s_and_is_told(tmp_path):
    ds = synthetic.dataset()
    ds["uo"][:, :, 4, 5] = ds["vo"][:, :, 4, 5] = 0.0
    ds["uo"][3, 1:, 0, 0] = np.nan
    ds["vo"][5, :, 2, 2] = np.nan
    read = read_with(save(ds, tmp_path / "e.nc"))
    assert not read.grid.wet[:, 2, 2].any()
    assert_array_equal(read.grid.wet[:, 0, 0], [True, False, False, False])
    assert_array_equal(
        np.isfinite(read.velocity), np.broadcast_to(read.grid.wet, read.velocity.shape)
    )
    assert read.notes == (
        "treated as land: 1 column whose current is exactly zero in every member",
        "treated as land: 7 points without values in 2 of 8 members, most in 'e.nc member 5' (4 of 116 points)",
    )
    ds["uo"][3, 0] = np.nan
    refused(
        r"leave no water at the first level; 'none\.nc member 3' misses most \(33 of 117 points\)",
        save(ds, tmp_path / "none.nc"),
    )


def test_results_among_the_members_are_left_out_and_said(tmp_path):
    kept = {"mem0.nc": KNOWN.isel(member=0), "mem1.nc": KNOWN.isel(member=1)}
    saved(kept | {f"mem0.nc.{mark}": ONE for mark in ("analysis", "increment")}, tmp_path)
    for given in (tmp_path, tmp_path / "mem*"):
        read = read_with(given)
        assert read.members == ("mem0.nc", "mem1.nc")
        assert noted(read, f"{given}: 2 analysis files excluded (mem0.nc.")


def test_long_lists_of_variables_are_shortened(tmp_path):
    grid = xr.Dataset({f"e{k}": (("y", "x"), np.ones((2, 3))) for k in range(9)})
    use = describe_ensemble(save(grid, tmp_path / "mesh.nc"), ForecastConfig()).use
    assert "no current: a file of the grid or of other variables (e0, " in use
    assert "e5 and 3 more); give it with" in use


@pytest.mark.parametrize("dims", [("lon", "lat"), ("x",), ("x", "y")])
def test_a_repeated_coordinate_is_read_once_and_noted(tmp_path, dims):
    ds = SEA if "x" not in dims else curved(SEA)
    whole = read_with(save(ds, tmp_path / "whole.nc"))
    for dim in dims:
        ds = ds.isel({dim: TWICE[: ds.sizes[dim] + 1]})
    ds = ds.copy(deep=True)
    ds["uo"][:, :, 0, 0] = ds["vo"][:, :, 0, 0] = np.nan
    read = read_with(save(ds, tmp_path / "e.nc"))
    for dim in dims:
        assert noted(read, f"{dim} repeats the places of 1 position")
    assert_allclose(read.grid.longitude, whole.grid.longitude)
    wet = read.grid.wet
    assert not wet[:, 0, 0].any()
    assert_allclose(read.velocity[:, :, wet], whole.velocity[:, :, wet], atol=1e-6)


def test_a_missing_value_that_is_stated_unpacked_is_missing(tmp_path):
    whole, ds = read_with(save(SEA, tmp_path / "whole.nc")), synthetic.dataset()
    for name in ("uo", "vo"):
        packed = np.round(ds[name].values / 0.001)
        packed[:, :, 1, 2] = -32000
        about = {"scale_factor": 0.001, "add_offset": 0.0, "missing_value": -32.0}
        ds[name] = (ds[name].dims, packed.astype(np.int16), {**ds[name].attrs, **about})
    read = read_with(save(ds, tmp_path / "e.nc"))
    assert not read.grid.wet[:, 1, 2].any()
    assert read.grid.wet.sum() == whole.grid.wet.sum() - whole.grid.levels.size
    assert np.nanmax(np.abs(read.velocity)) < 2.0
