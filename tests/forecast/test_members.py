"""What a member is: files, rules, and the factors of one field that their members are."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast import read_ensemble, read_series
from replay_kit.forecast.describe import describe_ensemble
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import (
    LEVELS,
    assert_comes_back,
    noted,
    read_with,
    refused,
    row,
    save,
    saved,
    true_components,
)

DAY, START = np.timedelta64(1, "D"), np.datetime64("2020-01-01", "ns")
SEA = synthetic.dataset()
ONE, UNIT = SEA.isel(member=0, drop=True), synthetic.ensemble().velocity[0]


def days(*numbers):
    """Return times some days after the first."""
    return START + np.array(numbers) * DAY


def of(factor, *at):
    """Return the field times a factor; or times several, at as many days."""
    if at:
        return forms.in_turn([ONE * each for each in factor], days(*at))
    return ONE.assign(
        {name: (factor * part).assign_attrs(part.attrs) for name, part in ONE.items()}
    )


def made(files, factors, second="", **settings):
    return files, factors, second, settings


def lagged(runs=3, length=6):
    """Forecasts started a day apart; the field of run r valid at day d is (1 + r) (1 + d) times the first member."""
    valid = [range(run, run + length) for run in range(runs)]
    return {
        f"fc{run}.nc": of([(1.0 + run) * (1.0 + day) for day in own], *own)
        for run, own in enumerate(valid)
    }


def producer(name, same_times, change=lambda ds, run, lead: ds):
    """Return files of three runs in the form of a producer; by name, run and lead."""
    made = {}
    for run in range(3):
        at = range(2) if same_times else range(run, run + 4)
        whole = of([1.0 + run] * len(at), *at)
        for lead in range(4) if "t{:03d}" in name else (slice(None),):
            part = whole.isel(time=[lead] if isinstance(lead, int) else lead)
            made[name.format(run, lead)] = change(part, run, lead)
    return made


def in_centimetres(ds, run, lead):
    ds = ds.rename(uo="UVEL", vo="VVEL")
    return ds.assign(
        {name: (100.0 * ds[name]).assign_attrs(units="cm/s") for name in ("UVEL", "VVEL")}
    )


def undated(ds, run, lead):
    return ds.assign_coords(time=("time", [0.0, 86400.0], {"units": "second"}))


PRODUCERS = [
    ("run{}/croco_his.nc", True, undated),
    ("run{}/roms_avg_0001.nc", True, lambda ds, run, lead: ds.rename(time="ocean_time")),
    ("{}.pop.h.nc", True, in_centimetres),
    (
        "hycom_glby_930_2020010{}12_t{:03d}_uv3z.nc",
        False,
        lambda ds, run, lead: ds.assign(
            tau=("time", [24.0 * lead], {"units": "hours since analysis"})
        ),
    ),
    (
        "glo12_uovo_R{}.nc",
        False,
        lambda ds, run, lead: ds.assign_attrs(bulletin_date=f"2020-01-0{1 + run}"),
    ),
    ("{}.nc", False),
]
ARCHIVE = of([1.0, 50.0, 2.0, 50.0, 6.0, 10.0], *range(6)).assign_coords(
    time=np.array(
        ["2018-01-10", "2018-07-01", "2019-01-25", "2019-02-20", "2020-01-02", "2020-01-15"],
        "M8[ns]",
    )
)
NAMES = ("r{}i1p1f1.nc", "ens0{}/uv.nc", "run{}/uv.nc", "a_m0{}.nc", "00{}iORCA.nc", "c{}.nc")
THREE = {f"mem{k}.nc": of(1.0 + k) for k in range(3)}

SHIFTED = of([1.0, 2.0], 0, 1)

#: Files by name, factors of the members, the label of the second, and settings.
ROWS = [
    *(made(THREE, [1, 2, 3], "mem1.nc", members=rule) for rule in (None, "files")),
    *(made(THREE, [1, 2, 3], "mem1.nc", members=f"files:mem{n}") for n in (r"0*(\d+)", r"\d+")),
    # numbers in names count, and do not sort as text
    made({f"mem{k}.nc": of(k) for k in (10, 2, 1)}, [1, 2, 10], "mem2.nc"),
    *(
        made({name.format(k): of(1.0 + k) for k in range(3)}, [1, 2, 3], members="files")
        for name in NAMES
    ),
    made(
        {f"{'ab'[k]}_{n}.nc": of(1.0 + k)[[n]] for k in range(2) for n in ("uo", "vo")},
        [1, 2],
        "b_uo.nc + b_vo.nc",
        members="files",
    ),
    # the last day that all hold is day 5 of the first
    made(lagged(), [6, 12, 18], "fc1.nc started 2020-01-02T00:00", members="lags"),
    made(lagged(), [4, 8, 12], members="lags", time="2020-01-04"),
    *(made(producer(*each), [1, 2, 3]) for each in PRODUCERS),
    made(
        {"a.nc": ARCHIVE},
        [8, 9, 13],
        "a.nc 2019-01-25T00:00Z, as an anomaly about 2020-01-15T00:00Z",
        members="times:15d",
    ),
    made({"a.nc": ARCHIVE}, [-2.5, 6.5], members="times:16d", time="2019-01-25"),
]


@pytest.mark.parametrize(("files", "factors", "second", "settings"), ROWS)
def test_members_of_files_by_rule_or_by_their_form(tmp_path, files, factors, second, settings):
    read = read_with(saved(files, tmp_path), **settings)
    expected = np.array(factors, float)[:, None, None, None, None] * UNIT
    assert_allclose(read.velocity, expected, atol=1e-12)
    assert second in read.members[1]
    rule = str(settings.get("members")).partition(":")[0]
    lags = len({str(part.get("time", "")) for part in files.values()}) > 1
    assert read.made_from == (rule if rule in ("lags", "times") else "lags" * lags)
    for words in {"lags": ["underdispersive"], "times": [" fields within 1"]}.get(rule, []):
        assert noted(read, words)


#: Files by name, words of the refusal, and settings.
NONE = [
    row(lagged(2, 1), "they hold 2020-01-01T00:00: 2020-01-01T00:00Z to", members="lags"),
    # the last time of each is the first of the next
    row(
        {f"part{k}/his.nc": of([1.0, 2.0], k, k + 1) for k in range(3)},
        "no member dimension; .*--members lags",
    ),
    *(
        row({"a.nc": SHIFTED, "b.nc": other}, "no member dimension; .*models")
        for other in (
            SHIFTED.isel(lat=slice(1, None)),
            SHIFTED.assign_attrs(source="another model"),
        )
    ),
    row(
        {"a.nc": ARCHIVE},
        "0 fields within 3 days of the season of 2018-07-01T00:00Z; at least 2 are needed: widen",
        members="times:3d",
        time="2018-07-01",
    ),
]


@pytest.mark.parametrize(("files", "words", "settings"), NONE)
def test_files_that_are_no_members_are_refused(tmp_path, files, words, settings):
    refused(words, saved(files, tmp_path), **settings)


def test_members_of_one_file_at_times_of_another(tmp_path):
    parts = {f"day{k}.nc": forms.in_turn([SEA * (1.0 + k)], days(2 * k)) for k in range(3)}
    series = read_series(saved(parts, tmp_path), ForecastConfig())
    assert_array_equal([part.time_ns for part in series], days(0, 2, 4).astype(np.int64))
    for k, part in enumerate(series):
        assert_allclose(part.velocity, (1.0 + k) * synthetic.ensemble().velocity, atol=1e-14)
    near = int(days(3).astype(np.int64)[0] + 1)
    assert_array_equal(read_with(tmp_path, near_ns=near).velocity, series[2].velocity)


@pytest.mark.parametrize("member", [{}, {"member": 0}])
def test_daily_files_are_those_of_their_days(tmp_path, member):
    one = forms.known().isel(member, drop=True)
    for k in range(4):
        # as of most producers, without a calendar
        ds = forms.in_turn([one * (1.0 + k)], [k], units="days since 2020-01-01")
        ds.to_netcdf(tmp_path / f"day{k}.nc", engine="h5netcdf")
    first, third = (
        describe_ensemble(tmp_path, ForecastConfig(time=time)).ensemble
        for time in (None, "2020-01-03T06:00Z")
    )
    assert_allclose(third.velocity, 3.0 * first.velocity)
    # of another form by their standard names alone
    for name, axis in (("uo", "x"), ("vo", "y")):
        ds[name].attrs["standard_name"] = f"sea_water_{axis}_velocity"
    ds.assign_coords(time=days(2)).to_netcdf(tmp_path / "day2.nc", engine="h5netcdf")
    last = ForecastConfig(time="2020-01-03T06:00Z")
    assert describe_ensemble(tmp_path, last).check.axes == "grid"


def test_models_of_one_time_lose_their_bias_over_the_region(tmp_path):
    for factor, bias in ((0.3, 0.0), (-1.3, 0.4)):
        save(forms.in_turn([ONE * factor + bias], [START]), tmp_path / f"{bias}.nc")
    read = read_with(tmp_path, members="models")
    assert (read.made_from, read_with(tmp_path, members="files").made_from) == ("models", "")
    expected = -1.6 * (UNIT - UNIT.mean(axis=(-2, -1), keepdims=True))
    # the bias lies along true axes, which turn by up to 0.16 degrees against the frame's
    assert_allclose(read.velocity[1] - read.velocity[0], expected, atol=1.2e-3)
    assert noted(read, "over the region")


def test_files_of_one_model_are_given_together_and_share_a_mean(tmp_path):
    factors = np.random.default_rng(2).normal(size=(2, 6))
    groups = [
        # the first file has four times, the last two one each
        [
            save(
                forms.in_turn([ONE * factor + 0.4 * model for factor in own[part]], days(*part)),
                tmp_path / f"{'ab'[model]}{part[0]}.nc",
            )
            for part in ([0, 1, 2, 3], [4], [5])
        ]
        for model, own in enumerate(factors)
    ]
    config = ForecastConfig(members="models", time="2020-01-05")
    read = read_ensemble(groups, config)
    change = factors[:, 4] - factors.mean(axis=1)
    expected = (change[1] - change[0]) * UNIT
    assert_allclose(read.velocity[1] - read.velocity[0], expected, atol=1e-12)
    assert read.members == ("a4.nc model 0", "b4.nc model 1")
    assert noted(read, "over its times was replaced by that of all 2 models")
    assert read_ensemble([path for group in groups for path in group], config).n_members == 6
    # four times in all are too few for a mean over them
    assert noted(read_ensemble([group[:1] for group in groups], config), "over the region")


def beside(other, folder):
    """Write the first member, and beside it the second on another grid or other levels."""
    parts = {"mem0.nc": forms.known().isel(member=0), "mem1.nc": other.isel(member=1)}
    return saved(parts, folder)


FINE = forms.lonlat(9.83, 39.81, (24, 26), 0.04)


def test_members_on_other_grids_and_levels_are_interpolated(tmp_path):
    other = forms.known(FINE, np.arange(0.0, 320.0, 10.0))
    other["uo"][..., :8, :8] = np.nan
    read = read_with(beside(other, tmp_path))
    assert_allclose(read.grid.levels, LEVELS)
    wet = np.ones((7, 8), bool)
    # dry nodes reach to 10.11 E and 40.09 N of the other grid; 40.1 N is a quarter of its cell farther
    wet[:2, :2] = False
    assert_array_equal(read.grid.wet[0], wet)
    assert_comes_back(read, 1.5e-3, n_members=2)
    note = "1 member interpolated to the grid of the first (bilinear; linear in depth)"
    assert note in read.notes


def test_a_point_is_water_where_half_of_the_other_grids_cell_is(tmp_path):
    # the points of the first lie at .4 between columns of the other, of which the first two and those from the sixth on are land
    longitude, latitude = forms.lonlat(9.96, 39.9, (9, 10))
    other = forms.known((longitude, latitude))
    other["uo"][..., [0, 1, 6, 7, 8, 9]] = np.nan
    read = read_with(beside(other, tmp_path))
    # .4 of the second point's weight is water, and .6 of the sixth's
    assert_array_equal(
        read.grid.wet, np.broadcast_to((np.arange(8) > 1) & (np.arange(8) < 6), (4, 7, 8))
    )
    east, _ = forms.truth(longitude[5], latitude[1:8], 5.0, 1)
    assert_allclose(true_components(read)[0][1, 0, :, 5], east, atol=1e-4)


@pytest.mark.parametrize(
    ("levels", "asked", "wet", "left"),
    [
        # half of the spacing of 40 m below 290 m, to the surface from 10 m
        ((10.0, 250.0, 290.0), None, 4, ""),
        ((10.0, 250.0, 270.0), None, 3, "1 level of the first, 300 m: interpolated members have"),
        ((10.0,), None, 1, "3 levels of the first, 60, 150, 300 m: interpolated members have no"),
        # half of 210 m below 215 m would reach it, were it not for the levels between
        (np.arange(5.0, 225.0, 10.0), (5.0, 300.0), 1, "1 level of the first, 300 m: inter"),
    ],
)
def test_levels_that_are_near_none_of_another_member_are_left_dry_and_counted(
    tmp_path, levels, asked, wet, left
):
    read = read_with(beside(forms.known(FINE, np.array(levels)), tmp_path), levels=asked)
    assert_array_equal(read.grid.wet.all(axis=(1, 2)), np.arange(read.grid.levels.size) < wet)
    assert [note for note in read.notes if note.startswith(f"left dry: {left}")] == [
        note for note in read.notes if "left dry" in note
    ]
    assert noted(read, "left dry") == bool(left)


@pytest.mark.parametrize("levels", [(4000.0, 4300.0, 4574.0), (4574.0,)])
def test_a_member_of_deep_water_alone_fills_no_water_above(tmp_path, levels):
    beside(forms.known(None, np.array(levels)), tmp_path)
    for settings in ({}, {"levels": (150.0,)}):
        refused(r"leave no water at the first level; 'mem1\.nc' misses most", tmp_path, **settings)
