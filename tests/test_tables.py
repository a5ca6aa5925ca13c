"""Tables of pings: whatever holds the same numbers, in memory or in a file, is the same observations; errors name what was given."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import replay_kit as rk
from replay_kit.core.errors import ConfigError, ForecastError
from tests.command import run_command
from tests.test_in_memory import DEPTHS, SETTINGS, _dataset, _profiles

OPTIONS = "--modes 6 --time-scale static --config fast.toml"
PROFILES = [*_profiles()]
SPEEDS = np.array([profile.velocity.T for profile in PROFILES])


def _pings() -> xr.Dataset:
    """The profiles of ``PROFILES`` on time and depth, in cm/s, under standard names alone."""
    east, north = (f"{word}ward_sea_water_velocity" for word in ("east", "north"))
    columns = {
        "a": (("time", "depth"), 100.0 * SPEEDS[:, 0], {"units": "cm s-1", "standard_name": east}),
        "b": (("depth", "time"), SPEEDS[:, 1].T, {"units": "m/s", "standard_name": north}),
        "lon": ("time", [profile.longitude for profile in PROFILES]),
        "lat": ("time", [profile.latitude for profile in PROFILES]),
        "error": 0.05,
    }
    times = np.array([profile.time_ns for profile in PROFILES]).astype("datetime64[ns]")
    return xr.Dataset(columns, {"time": times, "depth": DEPTHS})


def _rows() -> pd.DataFrame:
    """The same with a row a bin, in m/s, and the time as the index."""
    pings = _pings().rename(a="u", b="v")
    return pings.assign(u=pings["u"] / 100.0).to_dataframe().reset_index("depth")


def _columns() -> dict[str, np.ndarray]:
    return {name: column.to_numpy() for name, column in _rows().reset_index().items()}


def _latent(result) -> np.ndarray:
    return result.estimate.latent


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    return _latent(rk.replay(PROFILES, _dataset(), settings=SETTINGS))


@pytest.mark.parametrize(
    "table",
    [
        _pings(),
        _rows(),
        _rows().rename_axis(None),
        _rows().set_index("depth", append=True),
        _columns(),
        {name: ("row", column) for name, column in _columns().items()},
        {**{name: [*column] for name, column in _columns().items()}, "error": 0.05},
        _rows().assign(u=100.0 * _rows()["u"]).rename(columns={"u": "u [cm/s]"}),
    ],
    ids=["xarray", "index", "unnamed", "indices", "arrays", "dimensions", "lists", "brackets"],
)
def test_whatever_a_dataset_can_be_made_of_is_a_table(table, expected):
    found = rk.replay(table, _dataset(), settings=SETTINGS)
    np.testing.assert_allclose(_latent(found), expected, atol=1e-10)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"error": None}, "it lacks error; state the standard error of each component, it is not"),
        (
            {"u": np.ones(3)},
            r"^measurements\['u'\]: expected 48 values, as others have, got \(3,\)",
        ),
        ({"error": 0.0}, r"^measurements\['error'\]: .* above 0, got 0; it is not guessed"),
        (
            {"time": np.datetime64("1950-01-01")},
            r"^measurements\['time'\]: .* outside 1970\.\.2262",
        ),
        ({"time": 1_542_330_000}, r"^measurements\['time'\]: .* got what would be seconds"),
        ({"u": ["bad"] * 48}, "^u: expected numbers, got texts"),
        ({"lon": -207.6}, "^measurements: expected rows with a time and a place"),
        ({"time": np.arange(48)}, r"^measurements\['time'\]: .* got 0; give text"),
    ],
)
def test_errors_of_a_table_name_its_column(change, words):
    table = {name: one for name, one in (_columns() | change).items() if one is not None}
    with pytest.raises(rk.ReplayKitError, match=words):
        rk.replay(table, _dataset(), settings=SETTINGS)


def test_a_mapping_names_columns_and_constants(expected):
    table = {f"my {name}": column for name, column in _columns().items() if name != "error"}
    named = {"longitude": "my lon", "latitude": "my lat", "error": 0.05}
    named |= {name: f"my {name}" for name in ("time", "depth", "u", "v")}
    settings = SETTINGS | {"logs": {"columns": named}}
    np.testing.assert_allclose(
        _latent(rk.replay(table, _dataset(), settings=settings)), expected, atol=1e-10
    )
    with pytest.raises(ConfigError, match=r"logs\.columns\.u: expected a column of measurements"):
        rk.replay(_columns(), _dataset(), settings={"logs": {"columns": {"u": "none"}}})
    grid, named = _dataset().assign(error=0.1), {"logs": {"columns": {"u": "uo", "v": "vo"}}}
    with pytest.raises(ConfigError, match="got columns over lon, lat, depth, member"):
        rk.replay(grid, _dataset(), settings=named)


def test_columns_without_rows_in_common_are_refused_before_they_take_memory():
    dims = {"depth": "a", "u": "a", "lon": "a", "v": "b", "lat": "b"}
    columns = {name: (dim, np.ones(1_000_000)) for name, dim in dims.items()}
    with pytest.raises(ConfigError, match="got columns over a, b"):
        rk.replay(columns | {"time": np.datetime64("2020"), "error": 0.1}, _dataset())


def test_datasets_in_a_list_are_members_and_errors_name_the_one(expected):
    members = [_dataset().isel(member=k) for k in range(10)]
    found = rk.replay(PROFILES, members, settings=SETTINGS)
    np.testing.assert_allclose(_latent(found), expected, atol=1e-12)
    variables = {name: (v.dims, v.values, v.attrs) for name, v in _dataset().variables.items()}
    found = rk.replay(PROFILES, variables, settings=SETTINGS)
    np.testing.assert_array_equal(_latent(found), expected)
    opened = [rk.open_ensemble(form) for form in (members, _dataset())]
    np.testing.assert_array_equal(*(each.velocity for each in opened))
    assert repr(opened[1]).startswith("Ensemble of 10 members from ensemble, ")
    with pytest.raises(ForecastError, match=r"^ensemble: no longitude found"):
        rk.open_ensemble(_dataset().drop_vars("lon"))
    with pytest.raises(ForecastError, match=r"^ensemble: no longitude found"):
        rk.replay(PROFILES, _dataset().drop_vars("lon"), settings=SETTINGS)
    with pytest.raises(ForecastError, match=r"^ensemble\[0\]: no longitude found"):
        rk.replay(PROFILES, [one.drop_vars("lon") for one in members], settings=SETTINGS)


@pytest.mark.filterwarnings("ignore:.*does not fit this water")
def test_tables_of_several_vehicles_share_an_estimate():
    found = rk.replay({"a": _rows()[:24], "b": _columns()}, _dataset(), settings=SETTINGS)
    assert {name: len(one.observations) for name, one in found.vehicles.items()} == {
        "a": 6,
        "b": 12,
    }
    with pytest.raises(ConfigError, match=r"^logs\['b'\]\['u'\]: expected 48 values"):
        rk.replay({"a": _rows(), "b": _columns() | {"u": np.ones(3)}}, _dataset())
    with pytest.raises(ConfigError, match="goal: the table has no vehicle position"):
        rk.replay({"a": _rows(), "b": _columns()}, _dataset(), goal=(152.3, -39.8, 50.0))


def test_vehicles_of_mean_currents_alone_share_an_estimate():
    start, end = ((one.time_ns, one.longitude, one.latitude) for one in PROFILES[:2])
    speeds = {"a": 0.1, "b": 0.11}
    dives = {k: rk.Observation.mean(start, end, 300.0, u, 0.0, 0.03) for k, u in speeds.items()}
    assert rk.replay(dives, _dataset(), settings=SETTINGS).outcome.observations["used"] == 2


def _erddap(path):
    units = {"time": "seconds since 1970-01-01T00:00:00Z", "u": "cm s-1", "v": "m s-1"}
    rows = _rows().reset_index()
    rows = rows.assign(time=rows["time"].astype("int64") / 1e9, u=100.0 * rows["u"])
    heading = pd.DataFrame([[units.get(name, "") for name in rows]], columns=rows.columns)
    pd.concat([heading, rows.astype(object)]).to_csv(path, index=False)


FILES = {
    "times.csv": ("", lambda path: _rows().to_csv(path)),
    "brackets.csv": (
        "",
        lambda path: (
            _rows()
            .assign(u=100 * _rows()["u"], time=_rows().index.astype("int64") / 1e9)
            .rename(columns={"u": "U [cm/s]"})
            .to_csv(path, sep=";", index=False)
        ),
    ),
    "units.csv": ("", _erddap),
    "mapped.csv": (
        "--columns u=East --columns error=0.05",
        lambda path: _rows().drop(columns="error").rename(columns={"u": "East"}).to_csv(path),
    ),
    "new.nc": ("", lambda path: _pings().to_netcdf(path, engine="h5netcdf")),
    "classic.nc": ("", lambda path: _pings().to_netcdf(path, engine="scipy")),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_pings_is_an_input_of_the_command(tmp_path, name, expected):
    options, write = FILES[name]
    write(tmp_path / name)
    _dataset().to_netcdf(tmp_path / "e.nc", engine="h5netcdf")
    (tmp_path / "fast.toml").write_text("[estimator]\nsample_share = 0.5\nshift_distance = 0.0")
    done = run_command(tmp_path, f"replay {name} --ensemble e.nc -o out.mcap {OPTIONS} {options}")
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(_latent(rk.open_result(tmp_path / "out.mcap")), expected, atol=1e-10)
    if options:
        assert run_command(tmp_path, "verify out.mcap").returncode == 0
    said = run_command(tmp_path, f"info {name} {options}").stdout
    assert "12 profiles with 48 usable bins" in said


def test_a_table_that_lacks_a_column_and_rows_without_a_time_are_named(tmp_path):
    _rows().drop(columns="error").to_csv(tmp_path / "a.csv")
    done = run_command(tmp_path, "info a.csv")
    assert done.returncode == 3
    assert "it lacks error; state the standard error of each component" in done.stderr
    assert "--columns error=COLUMN" in done.stderr
    rows = _rows().reset_index().astype({"time": str})
    rows.loc[:2, "time"] = ""
    rows.to_csv(tmp_path / "b.csv", index=False)
    log = rk.open_log(tmp_path / "b.csv")
    assert len([*rk.observations(log)]) == 12
    assert log.report().undecodable == {"/observations": (3, "row without a time or a place")}
    rows.loc[:30, "time"] = ""
    rows.to_csv(tmp_path / "b.csv", index=False)
    verdict = rk.replay(tmp_path / "b.csv", _dataset(), settings=SETTINGS).outcome.verdict
    assert verdict.word == "with care"
    assert "31 rows on /observations were not used" in str(verdict)
