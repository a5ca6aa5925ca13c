"""What comes of files that do not belong together, or hold less than they should: an error or a note that names them and what to do."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import dated, noted, read_with, refused, row, save, saved

SEA, KNOWN = synthetic.dataset(), forms.known()
ONE, U, V = KNOWN.isel(member=0), KNOWN.isel(member=0)[["uo"]], KNOWN.isel(member=0)[["vo"]]
TWICE = np.insert(np.arange(6), 3, 3)


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


def with_depth(values, **about):
    return SEA.assign(depth=("depth", values, about))


#: Files, words of the refusal, and settings.
REFUSED = [
    row(ONE, "no member dimension.*depth = 4"),
    row(ONE, "needs dated forecasts", members="lags"),
    row(ONE, "but no variables differ by a suffix alone", members="suffix"),
    # a name is not a regular expression
    row(ONE, r"no member dimension ens\(0; expected one of", members="dim:ens(0"),
    row(SEA.drop_vars(["uo", "vo"]), "no current found"),
    row(SEA.drop_vars("lon"), "no longitude found"),
    row(SEA.assign(uo=SEA.uo.assign_attrs(units="furlongs")), "'furlongs'"),
    row(SEA.isel(lat=[0]), "at least 2 x 2"),
    row(SEA.where(False), "is land"),
    row(with_depth([5.0, 5.0, 10.0, 20.0]), "distinct"),
    row(SEA.assign_coords(lat=SEA.lat + 300.0), "beyond 90"),
    row(SEA, r"no grid point inside .*152\.0", region=(10.0, 50.0, 12.0, 52.0)),
    row(SEA, "remove the option", lead=3.0),
    row(SEA, "remove the option", time="2020-01-01"),
    row(SEA.isel(member=[3]), "needs at least 2 members, got 1; give several files"),
    row(
        SEA[["uo"]].assign(vo=(("other", "depth", "lat", "lon"), SEA.vo.values[:6])),
        "e.nc: uo has member = 8, .*, vo has other = 6, .*; give the same members",
    ),
    row(other_twice(), "lon repeats .* with other values of vo"),
    row(curved(other_twice()), "x repeats the place .* of vo"),
    row(SEA.isel(lon=[0, 1, 2, 1, 2, 3, 4, 5]), "it turns at its value 4"),
    *(
        row(
            with_depth(forms.LEVELS, units=unit),
            rf"e\.nc: coordinate depth is in '{unit}'; expected m, .*convert the axis to metres",
        )
        for unit in ("fathoms", "M", "Pa")
    ),
    *(
        row(
            with_depth([1.0, 2.0, 3.0, 4.0], **about),
            r"e\.nc: coordinate depth has .*holds model levels and no depths.*fixed depths in metres",
        )
        for about in (
            {"units": "sigma_level"},
            {"units": "1", "standard_name": "ocean_sigma_coordinate"},
            {"standard_name": "ocean_s_coordinate_g2"},
            {"formula_terms": "sigma: depth eta: zeta depth: h"},
        )
    ),
    row({"m0.nc": ONE, "m1.nc": ONE}, "all 2 members are identical", members="files"),
    row({"one.nc": ONE, "two.nc": ONE}, "no member dimension; .*--members files: 2 files"),
    row(ONE, r"case\(\\d\) does not fit this file", members=r"files:case(\d)"),
    row(
        {"mem1.nc": ONE, "mem2.nc": V},
        r"mem2\.nc: holds vo and no u; 0 files of u and 1 of v belong together as member 2: give",
    ),
    row(
        {"u.nc": SEA[["uo"]], "v.nc": SEA[["vo"]].isel(member=slice(6))},
        r"v\.nc: its members are not those of .*u\.nc: uo has member = 8, .*, vo has .* = 6,",
    ),
    *(
        row(
            {"u.nc": dated(U, ["2020-01-01"]), "v.nc": dated(V, times)},
            rf"v\.nc: its times \({len(times)} from {times[0]}T.*\) are not those of .*u\.nc \(1 from",
            members="files",
        )
        for times in (["2020-01-02"], ["2020-01-01", "2020-01-02"])
    ),
    row(beside_another_grid(), "the currents have 7 x 8 points, the coordinates 9 x 14; give"),
    row(
        {"e.nc": SEA, "ocean_hgrid.nc": xr.Dataset({"x": (("nyp", "nxp"), np.ones((3, 3)))})},
        "a supergrid of MOM, .*; give ocean_static.nc",
    ),
    row({}, "the folder holds no NetCDF file"),
    row({"a.nc.analysis": ONE}, r"holds only analysis results, such as a\.nc\.analysis; give"),
]


@pytest.mark.parametrize(("files", "words", "settings"), REFUSED)
def test_what_cannot_be_used_is_refused_in_words(tmp_path, files, words, settings):
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


def in_calendar(member, unit):
    """Return a member at a time that no date of ours is."""
    ds = KNOWN.isel(member=member).expand_dims(time=1)
    return ds.assign_coords(time=("time", [1.0], {"units": unit, "calendar": "360_day"}))


def at_depths(*levels):
    return with_depth(list(levels), units="m")


def faster(factor):
    return SEA.assign({name: factor * part for name, part in SEA.data_vars.items()})


SUFFIXES = xr.Dataset(
    {f"{n}_m{k}": KNOWN[n].isel(member=k, drop=True) for k in range(3) for n in ("uo", "vo")}
)
#: Files, all notes, and settings.
NOTED = [
    row(
        {f"m{k}.nc": KNOWN.isel(member=k % 3) for k in range(4)},
        "WARNING: duplicate members are counted once: 1, such as 'm3.nc' and 'm0.nc'",
        members="files",
    ),
    row(KNOWN.assign(uo_stokes=KNOWN["uo"]), ""),
    row(
        SUFFIXES.assign(uo_mean=SUFFIXES.uo_m0).drop_vars("uo_m1"),
        "WARNING: members with only one component were excluded: e.nc: vo_m1 without uo_m1",
    ),
    row(
        {f"m{k}.nc": dated(KNOWN.isel(member=k), [f"2020-01-0{1 + 2 * k % 3}"]) for k in range(3)},
        "WARNING: members are of different times, 2020-01-01T00:00Z to 2020-01-03T00:00Z",
        members="files",
    ),
    row(
        {
            "m0.nc": in_calendar(0, "days since 2020-02-29"),
            "m1.nc": in_calendar(1, "days since 0000-01-01"),
            "m2.nc": dated(KNOWN.isel(member=2), ["2020-01-01"]),
        },
        "WARNING: 2 members of 3 without a date that can be aligned with the others, such as m0.nc",
        members="files",
    ),
    row(
        at_depths(5.0, 60.0, 150.0, 250.0),
        "no level of the file (5..250 m) is near 310, 1000 m: nearest level used",
        levels=(0.0, 140.0, 310.0, 1000.0),
    ),
    row(at_depths(5.0, 60.0, 150.0, 250.0), "", levels=(0.0, 140.0, 300.0)),
    row(at_depths(15.0, 20.0, 25.0, 30.0), ""),
    row(
        at_depths(40.0, 60.0, 150.0, 250.0),
        "WARNING: the file has no level near the water above 40 m: the current of the first level",
    ),
    row(faster(100.0), "WARNING: unusual RMS current of "),
    row(faster(0.01), "WARNING: unusual RMS current of "),
    row(
        SEA.assign(uo=SEA.uo.assign_attrs(coordinates="geolon geolat depth")),
        "coordinates geolon, geolat are named but missing in the file",
    ),
]


@pytest.mark.parametrize(("files", "note", "settings"), NOTED)
def test_what_is_odd_is_noted(tmp_path, files, note, settings):
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
    files = {f"mem{k}.nc": KNOWN.isel(member=k) for k in (0, 1)}
    saved(files | {f"mem0.nc.{mark}": ONE for mark in ("analysis", "increment")}, tmp_path)
    for given in (tmp_path, tmp_path / "mem*"):
        read = read_with(given)
        assert read.members == ("mem0.nc", "mem1.nc")
        assert noted(read, f"{given}: 2 analysis files excluded (mem0.nc.")


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
