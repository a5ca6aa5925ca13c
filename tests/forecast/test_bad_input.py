"""What comes of files that do not belong together, or hold less than they should: an error or a warning that names them and what to do."""

import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import ConfigError
from replay_kit.forecast.describe import describe_ensemble
from replay_kit.forecast.members.rules import unusual_members
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import read_with, refused, save
from tests.forecast.test_members import dated, fields


def test_copies_are_told_and_refused_where_there_is_nothing_else(tmp_path):
    fields(4, tmp_path)
    read = read_with(tmp_path)
    (note,) = (note for note in read.notes if "duplicate" in note)
    assert (
        note
        == "WARNING: duplicate members are counted once: 1, such as 'mem003.nc' and 'mem000.nc'; remove them"
    )
    refused(
        "all 2 members are identical; give members that differ",
        [tmp_path / "mem000.nc", tmp_path / "mem003.nc"],
    )


def test_speeds_of_no_current_are_told(tmp_path):
    ds = synthetic.dataset()
    for name in ("uo", "vo"):
        ds[name] = (100.0 * ds[name]).assign_attrs(ds[name].attrs)
    (note,) = read_with(save(ds, tmp_path / "e.nc")).notes
    assert note.startswith("WARNING: unusual RMS current of ")
    assert "check the attribute units" in note
    for rms, told in ((0.003, True), (0.005, False), (1.4, False), (1.6, True)):
        assert bool(unusual_members(np.full((1, 2, 1, 2, 2), rms), ("one",), "e.nc")) is told


def test_what_does_not_belong_together_is_refused_in_words(tmp_path):
    fields(3, tmp_path)
    first = tmp_path / "mem000.nc"
    with xr.open_dataset(first) as ds:
        alone = save(ds[["uo"]].load(), tmp_path / "u1.nc")
    refused(
        r"u1\.nc: holds uo and no v; 1 file of u and 0 of v belong together.*: give a file of v for each",
        [first, alone],
        members="files",
    )
    refused(r"mem000\.nc: given twice", [first, first], members="files")
    refused(r"nothing\*\.nc: no file matches this pattern", [tmp_path / "nothing*.nc"])
    refused(
        r"--members files:case\(\\d\) does not fit this file",
        [tmp_path / "mem*.nc"],
        members="files:case(\\d)",
    )
    refused(
        r"no member dimension; .*--members files: 2 files",
        [
            first.rename(tmp_path / "one.nc"),
            (tmp_path / "mem001.nc").rename(tmp_path / "two.nc"),
        ],
    )
    refused(
        r"needs dated forecasts|needs dated fields",
        [tmp_path / "one.nc", tmp_path / "two.nc"],
        members="lags",
    )
    refused(
        r"--members suffix, but no variables differ by a suffix alone",
        [tmp_path / "one.nc"],
        members="suffix",
    )
    # a name is not a regular expression
    refused(
        r"no member dimension ens\(0; expected one of", [tmp_path / "one.nc"], members="dim:ens(0"
    )
    refused(
        r"no member dimension cycle; expected one of", [tmp_path / "one.nc"], members="dim:cycle"
    )
    with pytest.raises(ConfigError, match="is not a regular expression"):
        read_with([tmp_path / "one.nc"], members="files:mem(")
    for wrong in ("times:fortnight", "time:3", "dim:", "suffixes", "xlags"):
        with pytest.raises(
            ConfigError,
            match=rf"forecast\.members.*expected dim\[:NAME\], .*times:15d or models, got '{wrong}'",
        ):
            load_config(None, {"forecast": {"members": wrong}})
    assert (
        load_config(None, {"forecast": {"members": "times:2.5d"}}).forecast.members == "times:2.5d"
    )
    (tmp_path / "empty").mkdir()
    refused("the folder holds no NetCDF file", [tmp_path / "empty"])
    (tmp_path / "empty" / "mem001.nc.analysis").write_bytes(b"")
    refused(r"holds only analysis results, such as mem001\.nc\.analysis", [tmp_path / "empty"])


def test_results_among_the_members_are_left_out_and_said_or_refused_alone(tmp_path):
    fields(2, tmp_path)
    for mark in ("analysis", "increment"):
        fields(1, tmp_path, f"mem{{:03d}}.nc.{mark}")
        refused(
            rf"\*\.{mark}: holds only analysis results, such as mem000\.nc\.{mark}; give the members, or list",
            tmp_path / f"*.{mark}",
        )
    for given in (tmp_path, tmp_path / "mem*"):
        read = read_with(given)
        assert read.members == ("mem000.nc", "mem001.nc")
        (note,) = (note for note in read.notes if "analysis" in note)
        assert note in {
            f"{given}: 2 analysis files excluded ({name} ...); list them by name if they are the members"
            for name in ("mem000.nc.analysis", "mem000.nc.increment")
        }


def test_a_member_without_one_component_is_named(tmp_path):
    ds = forms.known()
    for k in range(2):
        save(ds.isel(member=k), tmp_path / f"mem{k}.nc")
    save(ds.isel(member=2)[["vo"]], tmp_path / "mem2.nc")
    refused(
        r"mem2\.nc: holds vo and no u; 0 files of u and 1 of v belong together as member 2: give a file of u",
        tmp_path,
    )
    members = {
        f"{name}_m{k}": ds[name].isel(member=k, drop=True)
        for k in range(3)
        for name in ("uo", "vo")
    }
    members["uo_mean"] = members["uo_m0"]
    suffix = xr.Dataset(members).drop_vars(["uo_m1"])
    for rule in (None, "suffix"):
        read = read_with(save(suffix, tmp_path / f"{rule}.nc4"), members=rule)
        assert read.members == (f"{rule}.nc4 m0", f"{rule}.nc4 m2")
        assert read.notes == (
            f"WARNING: members with only one component were excluded: {rule}.nc4: vo_m1 without uo_m1; add the other",
        )
        (tmp_path / f"{rule}.nc4").unlink()
    # a variable with a like name in a file of one field is no member
    plain = read_with(save(ds.assign(uo_stokes=ds["uo"]), tmp_path / "plain.nc"))
    assert plain.notes == ()


def test_other_numbers_of_members_of_u_and_v_are_refused(tmp_path):
    ds = synthetic.dataset()
    paths = [
        save(ds[["uo"]], tmp_path / "u.nc"),
        save(ds[["vo"]].isel(member=slice(0, 6)), tmp_path / "v.nc"),
    ]
    refused(
        r"v\.nc: its members are not those of .*u\.nc: 8 of uo and 6 of vo along member; give files with",
        paths,
    )
    within = ds[["uo"]].assign(vo=(("other", "depth", "lat", "lon"), ds["vo"].values[:6]))
    refused(
        r"in\.nc: vo has no dimension member, which uo has; mend the file",
        save(within, tmp_path / "in.nc"),
    )


def test_one_member_is_no_ensemble(tmp_path):
    path = save(synthetic.dataset().isel(member=[3]), tmp_path / "e.nc")
    refused(
        r"e\.nc: an ensemble needs at least 2 members, got 1; give several files, of other times, starts or",
        path,
    )


def test_members_of_other_times_or_calendars_are_warned_of(tmp_path):
    ds = forms.known()
    for k, day in enumerate(("2020-01-01", "2020-01-03", "2020-01-02")):
        save(dated(ds.isel(member=k), [day]), tmp_path / f"mem{k}.nc")
    read = read_with(tmp_path)
    warning = "WARNING: members are of different times, 2020-01-01T00:00Z to 2020-01-03T00:00Z: choose one that all have with forecast.time"
    assert read.notes == (warning,)
    # 30 February is no date of ours, and year 0 no time of ours
    for k, unit in ((0, "days since 2020-02-29"), (1, "days since 0000-01-01")):
        other = ds.isel(member=k).expand_dims(time=1)
        other["time"] = ("time", [1.0], {"units": unit, "calendar": "360_day"})
        save(other, tmp_path / f"mem{k}.nc")
    read = read_with(tmp_path)
    said = [note for note in read.notes if note.startswith("WARNING: ")]
    alike = "such as mem0.nc: check the attributes units and calendar of its times"
    assert said == [
        f"WARNING: 2 members of 3 without a date that can be aligned with the others, {alike}"
    ]
    (tmp_path / "mem1.nc").unlink()
    said = [note for note in read_with(tmp_path).notes if note.startswith("WARNING: ")]
    assert said == [
        f"WARNING: 1 member of 2 without a date that can be aligned with the others, {alike}"
    ]


def test_other_times_of_u_and_v_are_refused(tmp_path):
    ds = forms.known().isel(member=0)
    save(dated(ds[["uo"]], ["2020-01-01"]), tmp_path / "u.nc")
    save(dated(ds[["vo"]], ["2020-01-02"]), tmp_path / "v.nc")
    refused(
        r"v\.nc: its times \(1 from 2020-01-02T.*\) are not those of .*u\.nc",
        tmp_path,
        members="files",
    )
    save(dated(ds[["vo"]], ["2020-01-01", "2020-01-02"]), tmp_path / "v.nc")
    refused(
        r"v\.nc: its times \(2 from 2020-01-01T.*\) are not those of .*u\.nc \(1 from",
        tmp_path,
        members="files",
    )


def test_long_lists_of_variables_are_shortened(tmp_path):
    grid = xr.Dataset({f"e{k}": (("y", "x"), np.ones((2, 3))) for k in range(9)})
    path = save(grid, tmp_path / "mesh.nc")
    use = describe_ensemble(path, ForecastConfig()).use
    assert use.startswith(
        "no current: a file of the grid or of other variables (e0, e1, e2, e3, e4, e5 and 3 more); give it with"
    )
    refused(r"no current found; .*; got e0, e1, e2, e3, e4, e5 and 3 more$", path)


def test_coordinates_that_are_named_and_not_in_the_file_are_told(tmp_path):
    data = synthetic.dataset(n_members=3)
    for name in ("uo", "vo"):
        data[name].attrs["coordinates"] = "geolon geolat depth"
    data.to_netcdf(tmp_path / "e.nc")
    notes = read_with(tmp_path / "e.nc").notes
    assert any(
        note.startswith("coordinates geolon, geolat are named but missing in the file")
        for note in notes
    )


def _with_twice(ds, dim, at=3):
    """Return a forecast in which a coordinate of a dimension is there twice, as where tiles were joined."""
    order = np.insert(np.arange(ds.sizes[dim]), at, at)
    return ds.isel({dim: order})


def _curved(ds):
    """Return a forecast with longitudes and latitudes of two dimensions."""
    lon, lat = np.meshgrid(ds.lon, ds.lat)
    ds = ds.rename_dims(lon="x", lat="y").drop_vars(["lon", "lat"])
    return ds.assign_coords(nav_lon=(("y", "x"), lon), nav_lat=(("y", "x"), lat))


@pytest.mark.parametrize("dims", [("lon",), ("lat",), ("lon", "lat"), ("x",), ("x", "y")])
def test_a_repeated_coordinate_is_read_once_and_noted(tmp_path, dims):
    ds = synthetic.dataset() if "x" not in dims else _curved(synthetic.dataset())
    whole = read_with(save(ds, tmp_path / "whole.nc"))
    for dim in dims:
        ds = _with_twice(ds, dim)
    ds["uo"][:, :, 0, 0] = np.nan
    ds["vo"][:, :, 0, 0] = np.nan
    read = read_with(save(ds, tmp_path / "e.nc"))
    for dim in dims:
        what = "the places of 1 position" if dim in "xy" else "1 value"
        assert any(note.startswith(f"{dim} repeats {what}") for note in read.notes)
    np.testing.assert_allclose(read.grid.longitude, whole.grid.longitude)
    wet = read.grid.wet
    assert not wet[:, 0, 0].any()
    np.testing.assert_allclose(read.velocity[:, :, wet], whole.velocity[:, :, wet], atol=1e-6)


def test_a_repeated_coordinate_of_other_values_and_one_that_turns_are_refused(tmp_path):
    ds = _with_twice(synthetic.dataset(), "lon")
    other = ds.copy(deep=True)
    other["vo"][2, 1, 2, 4] += 0.1
    refused("lon repeats .* with other values of vo", save(other, tmp_path / "e.nc"))
    refused("x repeats the places .* of vo", save(_curved(other), tmp_path / "c.nc"))
    overlapping = synthetic.dataset().isel(lon=[0, 1, 2, 1, 2, 3, 4, 5])
    refused("lon is not monotonic: it turns at its value 4", save(overlapping, tmp_path / "o.nc"))


def test_a_missing_value_that_is_stated_unpacked_is_missing(tmp_path):
    ds = synthetic.dataset()
    whole = read_with(save(ds, tmp_path / "whole.nc"))
    for name in ("uo", "vo"):
        packed = np.round(ds[name].values / 0.001)
        packed[:, :, 1, 2] = -32000
        ds[name] = (
            ds[name].dims,
            packed.astype(np.int16),
            {**ds[name].attrs, "scale_factor": 0.001, "add_offset": 0.0, "missing_value": -32.0},
        )
    read = read_with(save(ds, tmp_path / "e.nc"))
    assert not read.grid.wet[:, 1, 2].any()
    assert read.grid.wet.sum() == whole.grid.wet.sum() - whole.grid.levels.size
    assert np.nanmax(np.abs(read.velocity)) < 2.0
