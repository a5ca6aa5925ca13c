"""What a member is."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import ensemble_files, field, files, read_ensemble, read_series
from replay_kit.forecast.describe import describe_ensemble
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import (
    LEVELS,
    assert_comes_back,
    noted,
    read_with,
    refused,
    save,
    true_components,
)

DAY, START = np.timedelta64(1, "D"), np.datetime64("2020-01-01", "ns")


def fields(n=3, folder=None, name="mem{:03d}.nc"):
    """Single-field files of the known field, one a member."""
    ds = forms.known()
    return [save(ds.isel(member=k % 3), folder / name.format(k)) for k in range(n)]


@pytest.mark.parametrize("rule", [None, "files", "files:mem0*(\\d+)", "files:mem\\d+"])
@pytest.mark.parametrize("how", ["folder", "pattern", "names"])
def test_a_file_a_member_by_folder_pattern_or_name(tmp_path, rule, how):
    paths = fields(3, tmp_path, "mem{}.nc")
    given = {"folder": [tmp_path], "pattern": [tmp_path / "mem*.nc"], "names": paths}[how]
    read = read_with(given, members=rule)
    assert_comes_back(read, 1e-12)
    assert read.members == ("mem0.nc", "mem1.nc", "mem2.nc")


def test_numbers_in_names_count_and_do_not_sort_as_text(tmp_path):
    names = [tmp_path / f"mem{k}.nc" for k in (1, 2, 10)]
    for path, source in zip(names, fields(3, tmp_path, "x{}.nc"), strict=True):
        source.rename(path)
    assert ensemble_files([tmp_path]) == tuple(names)
    assert_comes_back(read_with(tmp_path), 1e-12)


@pytest.mark.parametrize(
    "name",
    ["r{}i1p1f1_uv.nc", "ens0{}/uv.nc", "run{}/uv.nc", "a_m0{}.nc", "00{}iORCA.nc", "case{}.nc"],
)
def test_usual_names_of_members(tmp_path, name):
    for k in range(3):
        (tmp_path / name.format(k)).parent.mkdir(exist_ok=True)
    fields(3, tmp_path, name)
    assert_comes_back(read_with(tmp_path, members="files"), 1e-12)


def test_files_of_u_and_v_without_member_names_are_paired_in_order(tmp_path):
    ds = forms.known()
    for k in range(3):
        save(ds.isel(member=k)[["uo"]], tmp_path / f"{'abc'[k]}_uo.nc")
        save(ds.isel(member=k)[["vo"]], tmp_path / f"{'abc'[k]}_vo.nc")
    read = read_with(tmp_path, members="files")
    assert_comes_back(read, 1e-12)
    assert read.members == ("a_uo.nc + a_vo.nc", "b_uo.nc + b_vo.nc", "c_uo.nc + c_vo.nc")


def test_members_of_one_file_at_times_of_another(tmp_path):
    ds = synthetic.dataset()
    for k in range(3):
        save(forms.in_turn([ds * (1.0 + k)], [START + 2 * k * DAY]), tmp_path / f"day{k}.nc")
    series = read_series(tmp_path, ForecastConfig())
    assert [part.time_ns - series[0].time_ns for part in series] == [
        0,
        2 * 86_400 * 10**9,
        4 * 86_400 * 10**9,
    ]
    for k, part in enumerate(series):
        assert_allclose(part.velocity, (1.0 + k) * synthetic.ensemble().velocity, atol=1e-14)
    near = int(np.datetime64("2020-01-04T00:00", "ns").astype(np.int64) + 1)
    assert_array_equal(read_with(tmp_path, near_ns=near).velocity, series[2].velocity)


def test_files_of_several_members_each_add_up(tmp_path):
    ds = synthetic.dataset()
    save(ds.isel(member=slice(0, 5)), tmp_path / "first.nc")
    save(ds.isel(member=slice(5, 8)), tmp_path / "second.nc")
    assert_array_equal(read_with(tmp_path).velocity, synthetic.ensemble().velocity)


@pytest.mark.parametrize("member", [{}, {"member": 0}])
def test_daily_files_are_opened_when_they_are_used(tmp_path, monkeypatch, member):
    opened, one = [], forms.known().isel(member, drop=True)

    def noting(path):
        opened.append(path.name)
        return files.opened_file(path)

    monkeypatch.setattr(field, "opened_file", noting)
    for k in range(4):
        ds = (one * (1.0 + k)).assign_coords(time=START + k * DAY).expand_dims("time")
        for part, own in zip(ds.values(), forms._CMEMS, strict=True):
            part.attrs = {"units": "m s-1", **own}
        ds.to_netcdf(tmp_path / f"day{k}.nc", engine="h5netcdf")
    last = ForecastConfig(time="2020-01-03T06:00Z")
    found = describe_ensemble(tmp_path, last).ensemble
    assert opened == ["day0.nc", "day2.nc"]
    assert_allclose(
        found.velocity, 3.0 * describe_ensemble(tmp_path, ForecastConfig()).ensemble.velocity
    )
    # of the same form, which says nothing of standard names
    ds["uo"].attrs["standard_name"], ds["vo"].attrs["standard_name"] = (
        "sea_water_x_velocity",
        "sea_water_y_velocity",
    )
    ds.assign_coords(time=("time", [START + 2 * DAY])).to_netcdf(
        tmp_path / "day2.nc", engine="h5netcdf"
    )
    with pytest.raises(
        ForecastError,
        match=r"day2\.nc: its variables have the names and sizes of those in other files, but",
    ):
        describe_ensemble(tmp_path, last)


def lagged(folder, runs=3, days=6):
    """Forecasts started a day apart; the field of run r valid at day d is (1 + r) (1 + d) times the first member."""
    one = synthetic.dataset().isel(member=0, drop=True)
    for run in range(runs):
        times = START + (run + np.arange(days)) * DAY
        parts = [one * (1.0 + run) * (1.0 + run + day) for day in range(days)]
        save(forms.in_turn(parts, times), folder / f"fc{run}.nc")


def test_lagged_forecasts_valid_at_one_time(tmp_path):
    lagged(tmp_path)
    one = synthetic.ensemble().velocity[0]
    read = read_with(tmp_path, members="lags")
    assert read.made_from == "lags"
    # the last day that all hold is day 5 of the first
    assert_allclose(
        read.velocity, np.array([1.0, 2.0, 3.0])[:, None, None, None, None] * 6.0 * one, atol=1e-13
    )
    assert str(np.datetime64(read.time_ns, "ns"))[:10] == "2020-01-06"
    assert read.members[1] == "fc1.nc started 2020-01-02T00:00"
    near = int(np.datetime64("2020-01-04", "ns").astype(np.int64))
    assert_allclose(
        read_with(tmp_path, members="lags", near_ns=near).velocity[2],
        12.0 * one,
        atol=1e-13,
    )
    lagged(tmp_path, runs=2, days=1)
    (tmp_path / "fc2.nc").unlink()
    refused(
        r"needs a time that all forecasts hold; they hold 2020-01-01T00:00: 2020-01-01T00:00Z to",
        tmp_path,
        members="lags",
    )


def _in_centimetres(ds):
    parts = {
        u: (100.0 * ds[name]).assign_attrs(units="cm/s")
        for u, name in (("UVEL", "uo"), ("VVEL", "vo"))
    }
    return ds.drop_vars(["uo", "vo"]).assign(parts)


def _hours_since_analysis(ds, run, lead):
    return ds.assign(tau=("time", [24.0 * lead], {"units": "hours since analysis"}))


# Of each producer: the names of its files by run and lead, whether all runs hold the same times, and what else is in a file.
FORMS = {
    "CROCO": (
        "run{}/croco_his.nc",
        True,
        lambda ds, run, lead: ds.assign_coords(time=("time", [0.0, 86400.0], {"units": "second"})),
    ),
    "ROMS": ("run{}/roms_avg_0001.nc", True, lambda ds, run, lead: ds.rename(time="ocean_time")),
    "POP": ("{}.pop.h.nc", True, lambda ds, run, lead: _in_centimetres(ds)),
    "HYCOM": ("hycom_glby_930_2020010{}12_t{:03d}_uv3z.nc", False, _hours_since_analysis),
    "CMEMS": (
        "glo12_uovo_R{}.nc",
        False,
        lambda ds, run, lead: ds.assign_attrs(bulletin_date=f"2020-01-0{1 + run}"),
    ),
    "GLONET": ("{}.nc", False, lambda ds, run, lead: ds),
}


@pytest.mark.parametrize("producer", FORMS)
def test_members_of_producers_files_are_found_without_an_option(tmp_path, producer):
    name, same_times, form = FORMS[producer]
    for run in range(3):
        times = START + (np.arange(2) if same_times else run + np.arange(4)) * DAY
        whole = forms.known().isel(member=run, drop=True).expand_dims(time=times)
        leads = range(4) if producer == "HYCOM" else (slice(None),)
        for lead in leads:
            path = tmp_path / name.format(run, lead)
            path.parent.mkdir(exist_ok=True)
            one = whole.isel(time=[lead] if isinstance(lead, int) else lead)
            save(form(one.transpose("time", "depth", ...), run, lead), path)
    read = read_with(tmp_path)
    assert_comes_back(read, 1e-12)
    assert read.made_from == ("" if same_times else "lags")
    assert noted(read, "members: the 3 files" if same_times else "members: forecasts of 3 starts")
    if producer == "CROCO":
        assert read.time_ns is None
        assert noted(read, "time has no dates (unit 'second')")
    if not same_times:
        # the last that all hold, without a log
        assert read.time_ns == (START + 3 * DAY).astype(np.int64)


def test_files_of_one_run_of_other_grids_or_products_are_no_members_by_themselves(tmp_path):
    whole = forms.known().isel(member=0, drop=True)
    for k in range(3):
        (tmp_path / f"part{k}").mkdir()
        # the last time of each is the first of the next
        times = START + (k + np.arange(2)) * DAY
        save(whole.expand_dims(time=times), tmp_path / f"part{k}" / "his.nc")
    refused("no member dimension; .*--members lags", tmp_path)
    other = whole.isel(latitude=slice(1, None)).expand_dims(time=[START, START + DAY])
    save(other, tmp_path / "other.nc")
    product = whole.expand_dims(time=[START, START + DAY]).assign_attrs(source="another model")
    save(product, tmp_path / "product.nc")
    for file in ("other.nc", "product.nc"):
        refused("no member dimension; .*--members models", [tmp_path / "part0", tmp_path / file])


def test_fields_of_the_season_are_anomalies_about_the_forecast(tmp_path):
    one = synthetic.dataset().isel(member=0, drop=True)
    days = ["2018-01-10", "2018-07-01", "2019-01-25", "2019-02-20", "2020-01-02", "2020-01-15"]
    parts = [one * factor for factor in (1.0, 50.0, 2.0, 50.0, 6.0, 10.0)]
    save(forms.in_turn(parts, np.array(days, "M8[ns]")), tmp_path / "archive.nc")
    read = read_with(tmp_path / "archive.nc", members="times:15d")
    assert read.made_from == "times"
    unit = synthetic.ensemble().velocity[0]
    assert_allclose(
        read.velocity, np.array([8.0, 9.0, 13.0])[:, None, None, None, None] * unit, atol=1e-13
    )
    assert "3 fields within 15 days" in read.notes[0]
    assert read.members[0] == "archive.nc 2018-01-10T00:00Z, as an anomaly about 2020-01-15T00:00Z"
    near = int(np.datetime64("2019-01-25", "ns").astype(np.int64))
    assert read_with(tmp_path / "archive.nc", members="times:16d", near_ns=near).n_members == 2
    refused(
        r"0 fields within 3 days of the season of 2018-07-01T00:00Z; at least 2 are needed: widen",
        tmp_path / "archive.nc",
        members="times:3d",
        time="2018-07-01",
    )


def test_models_of_one_time_lose_their_bias_over_the_region(tmp_path):
    one, unit = synthetic.dataset().isel(member=0, drop=True), synthetic.ensemble().velocity[0]
    paths = [
        save(forms.in_turn([one * factor + bias], [START]), tmp_path / f"{bias}.nc")
        for factor, bias in ((0.3, 0.0), (-1.3, 0.4))
    ]
    read = read_with(paths, members="models")
    assert (read.made_from, read_with(paths, members="files").made_from) == ("models", "")
    expected = -1.6 * (unit - unit.mean(axis=(-2, -1), keepdims=True))
    # the bias lies along true axes, which turn by up to 0.16 degrees against the frame's
    assert_allclose(read.velocity[1] - read.velocity[0], expected, atol=1.2e-3)
    assert noted(read, "over the region")


def test_files_of_one_model_are_given_together_and_share_a_mean(tmp_path):
    one = synthetic.dataset().isel(member=0, drop=True)
    factors = np.random.default_rng(2).normal(size=(2, 6))
    groups = []
    for model, bias in enumerate((0.0, 0.4)):
        groups.append([])
        # the first file has four times, the last two one each
        for number, days in enumerate((slice(0, 4), slice(4, 5), slice(5, 6))):
            parts = [one * factor + bias for factor in factors[model, days]]
            times = START + np.arange(6)[days] * DAY
            groups[-1].append(
                save(forms.in_turn(parts, times), tmp_path / f"{'ab'[model]}{number}.nc")
            )
    config = ForecastConfig(members="models", time="2020-01-05")
    read = read_ensemble(groups, config)
    expected = (
        factors[1, 4] - factors[1].mean() - factors[0, 4] + factors[0].mean()
    ) * synthetic.ensemble().velocity[0]
    assert_allclose(read.velocity[1] - read.velocity[0], expected, atol=1e-12)
    assert read.members == ("a1.nc model 0", "b1.nc model 1")
    assert noted(read, "over its times was replaced by that of all 2 models")
    assert read_ensemble([path for group in groups for path in group], config).n_members == 6
    # four times in all are too few for a mean over them
    assert noted(read_ensemble([group[:1] for group in groups], config), "over the region")


def test_members_on_other_grids_and_levels_are_interpolated(tmp_path):
    fields(1, tmp_path, "mem0.nc")
    longitude, latitude = forms.lonlat(9.83, 39.81, (24, 26), 0.04)
    levels = np.arange(0.0, 320.0, 10.0)
    u, v = forms.regular(longitude, latitude, levels)
    u[:, :, :8, :8] = np.nan
    save(
        forms.standard(u, v, longitude, latitude, levels=levels).isel(member=1),
        tmp_path / "mem1.nc",
    )
    read = read_with(tmp_path)
    assert_allclose(read.grid.levels, LEVELS)
    wet = np.ones((7, 8), bool)
    # dry nodes reach to 10.11 E and 40.09 N of the other grid; 40.1 N is a quarter of its cell farther
    wet[:2, :2] = False
    assert_array_equal(read.grid.wet[0], wet)
    assert_comes_back(read, 1.5e-3, n_members=2)
    assert any(
        note == "1 member interpolated to the grid of the first (bilinear; linear in depth)"
        for note in read.notes
    )


def test_a_point_is_water_where_half_of_the_other_grids_cell_is(tmp_path):
    fields(1, tmp_path, "mem0.nc")
    # the points of the first lie at .4 between columns of the other, of which the first two and those from the sixth on are land
    longitude, latitude = forms.lonlat(9.96, 39.9, (9, 10))
    u, v = forms.regular(longitude, latitude)
    u[..., [0, 1, 6, 7, 8, 9]] = np.nan
    save(forms.standard(u, v, longitude, latitude).isel(member=1), tmp_path / "mem1.nc")
    read = read_with(tmp_path)
    # .4 of the second point's weight is water, and .6 of the sixth's
    assert_array_equal(
        read.grid.wet, np.broadcast_to((np.arange(8) > 1) & (np.arange(8) < 6), (4, 7, 8))
    )
    east, _ = forms.truth(longitude[5], latitude[1:8], 5.0, 1)
    assert_allclose(true_components(read)[0][1, 0, :, 5], east, atol=1e-4)


@pytest.mark.parametrize(
    ("levels", "wet", "left"),
    [
        # half of the spacing of 40 m below 290 m, to the surface from 10 m
        ((10.0, 250.0, 290.0), [True, True, True, True], ""),
        (
            (10.0, 250.0, 270.0),
            [True, True, True, False],
            "1 level of the first, 300 m: interpolated members have no level near it",
        ),
        (
            (10.0,),
            [True, False, False, False],
            "3 levels of the first, 60, 150, 300 m: interpolated members have no level near them",
        ),
    ],
)
def test_levels_that_are_near_none_of_another_member_are_left_dry_and_counted(
    tmp_path, levels, wet, left
):
    fields(1, tmp_path, "mem0.nc")
    at = forms.lonlat(9.83, 39.81, (24, 26), 0.04)
    save(forms.known(at, np.array(levels)).isel(member=1), tmp_path / "mem1.nc")
    read = read_with(tmp_path)
    assert_array_equal(
        read.grid.wet, np.broadcast_to(np.array(wet)[:, None, None], read.grid.wet.shape)
    )
    assert [note for note in read.notes if "left dry" in note] == (
        [f"left dry: {left}"] if left else []
    )


@pytest.mark.parametrize("levels", [(4000.0, 4300.0, 4574.0), (4574.0,)])
def test_a_member_of_deep_water_alone_fills_no_water_above(tmp_path, levels):
    fields(1, tmp_path, "mem0.nc")
    save(forms.known(None, np.array(levels)).isel(member=1), tmp_path / "mem1.nc")
    for settings in ({}, {"levels": (150.0,)}):
        refused(r"leave no water at the first level; 'mem1\.nc' misses most", tmp_path, **settings)


def test_what_other_levels_reach_follows_from_all_of_the_file_not_from_those_chosen(tmp_path):
    fields(1, tmp_path, "mem0.nc")
    at, levels = forms.lonlat(9.83, 39.81, (24, 26), 0.04), np.arange(5.0, 225.0, 10.0)
    save(forms.known(at, np.array(levels)).isel(member=1), tmp_path / "mem1.nc")
    read = read_with(tmp_path, levels=(5.0, 300.0))
    # half of 210 m below 215 m would reach it
    assert_array_equal(read.grid.wet.any(axis=(1, 2)), [True, False])
