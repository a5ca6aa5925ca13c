"""What a script holds in memory: measurements, tables, datasets, and an estimator and a planner of its own."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import replay_kit as rk
from replay_kit.core.errors import ConfigError, ForecastError, LogError, MeasurementError
from replay_kit.core.observation import PathMean
from replay_kit.estimator.baselines import nearest_member
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.logs.netcdf import glider_samples as made
from tests.logs.slocum import slocum_samples
from tests.places import SAMPLES

SETTINGS = {
    "estimator": {"modes": 6, "sample_share": 0.5, "shift_distance": 0.0},
    "time": {"scale": "static"},
    "output": {"interval": 1e6},
}
TIME = "2018-11-16T06:00:00Z"
DEPTHS = np.array([10.0, 60.0, 150.0, 250.0])


def _profiles(n=12, seed=1):
    rng = np.random.default_rng(seed)
    start = np.datetime64("2018-11-16T01:00:00", "ns")
    for k in range(n):
        lon, lat = 152.1 + 0.03 * k, -39.9 + 0.02 * k
        u, v = rng.normal(0.1, 0.05, (2, DEPTHS.size))
        yield rk.Observation.profile(
            start + np.timedelta64(20 * k, "m"), lon, lat, DEPTHS, u, v, 0.05
        )


def _dataset() -> xr.Dataset:
    return synthetic.dataset(n_members=10).assign_coords(time=np.datetime64(TIME[:-1], "ns"))


def _replayed(forecast, **parts):
    return rk.replay([*_profiles(4)], forecast, settings=SETTINGS, **parts)


def test_an_estimate_whose_ensemble_hardly_covers_the_current_is_used_with_care():
    sea = _dataset()
    narrow = (sea.mean("member") + 0.05 * (sea - sea.mean("member"))).transpose(*sea.uo.dims)
    for name in sea.data_vars:
        narrow[name].attrs = sea[name].attrs
    outcome = rk.replay([*_profiles(20)], narrow, settings={"estimator": {"modes": 6}}).outcome
    assert outcome.verdict.word == "with care"
    assert "multiplied by 280, as" in outcome.verdict.reasons[1]
    assert "hardly covers this current" in outcome.outside[0]


def test_measurements_and_a_dataset_give_what_their_files_give(tmp_path):
    profiles = [*_profiles()]
    out = tmp_path / "a.mcap"
    stated = {**SETTINGS, "output": {"interval": 1e6, "metadata": {"license": "CC-BY-4.0"}}}
    result = rk.replay(profiles, _dataset(), out=out, settings=stated)
    # what a person states goes with what is made of it
    about = rk.open_result(out).estimate.velocity_at(152.3, -39.8, 60.0).to_xarray().attrs
    assert about["license"] == "CC-BY-4.0"
    assert result.outcome.observations["used"] == 12
    files = tmp_path / "a.observations.mcap", tmp_path / "a.ensemble.nc"
    assert all(path.exists() for path in files)
    again = rk.replay(*files, settings=SETTINGS)
    np.testing.assert_array_equal(again.estimate.latent, result.estimate.latent)
    # and what the estimator itself makes of them
    ensemble = rk.open_ensemble(files[1])
    other = rk.replay(profiles, ensemble, settings=SETTINGS)
    got, expected = (each.estimate.velocity_at(152.3, -39.8, 60.0) for each in (other, result))
    assert (got.u, got.v) == pytest.approx((expected.u, expected.v), abs=1e-9)


def test_a_mean_current_is_a_straight_dive_between_its_fixes():
    mean = rk.Observation.mean(
        (TIME, 152.2, -39.9), ("2018-11-16T09:00:00Z", 152.3, -39.8), 300.0, 0.1, 0.05, 0.02
    )
    assert isinstance(mean, PathMean)
    assert mean.weight.sum() == pytest.approx(1.0)
    assert mean.weight @ mean.depth == pytest.approx(150.0)
    # as long before the middle of three hours as after it
    assert mean.weight @ (mean.time_ns - mean.path_time_ns) == pytest.approx(1.5 * 3600e9)
    assert np.all(np.diff(mean.path_time_ns, append=mean.time_ns) > 0)
    assert mean.weight @ mean.longitude == pytest.approx(152.25)
    assert mean.weight @ mean.latitude == pytest.approx(-39.85)
    result = rk.replay([mean, *_profiles(3)], _dataset(), settings=SETTINGS)
    assert result.outcome.observations["used"] == 4
    with pytest.raises(ConfigError, match="an end after the start"):
        rk.Observation.mean((TIME, 152.2, -39.9), (TIME, 152.3, -39.8), 300.0, 0.1, 0.05, 0.02)


def test_a_single_component_informs_along_its_direction_alone():
    one = rk.Observation.component((TIME, 152.3, -39.8), 5.0, 90.0, 0.1, 0.02)
    settings = SETTINGS | {"measurements": {"surface_tide_std": 0.0}}
    ensemble = _dataset()
    found, unknown = (
        rk.replay([each], ensemble, settings=settings)
        for each in (one, replace(one, error_std=np.array([9.0])))
    )
    # by a sensor of its own, no radar
    (row,) = found.outcome.observations["sources"]
    assert (row["kind"], row["used"]) == ("sensors", 1)
    at, before = (each.estimate.velocity_at(152.3, -39.8, 5.0) for each in (found, unknown))
    assert abs(at.u - 0.1) < 0.3 * abs(before.u - 0.1)
    assert at.u_standard_error < 0.5 * before.u_standard_error
    assert at.v_standard_error > 0.8 * before.v_standard_error
    north = rk.Observation.component((TIME, 152.3, -39.8), 5.0, 0.0, 0.4, 0.02)
    np.testing.assert_allclose(north.components, [[0.0, 1.0]], atol=1e-15)
    place = TIME, 152.3, -39.8
    with pytest.raises(ConfigError, match="a depth from 0 on, a direction and a speed, got -1"):
        rk.Observation.component(place, -1.0, 0.0, 0.4, 0.02)
    with pytest.raises(ConfigError, match="it is not guessed"):
        rk.Observation.component(place, 1.0, 0.0, 0.4, None)
    two = rk.Observation.profile(*place, [5.0, 9.0], [0.1] * 2, [0.1] * 2, 0.1).linear
    with pytest.raises(ConfigError, match=r"make each with Observation\.component"):
        rk.replay([two], ensemble)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lat": 95.0}, "expected longitude and latitude"),
        ({"u": [0.1]}, "expected depth, u, v and error of one length"),
        ({"error": [0.1, -1.0]}, "above 0"),
        ({"error": None}, "it is not guessed"),
        ({"time": "yesterday"}, "is no time"),
        ({"time": 1_542_326_400}, "got what would be seconds"),
    ],
)
def test_a_profile_that_cannot_be_is_refused(change, words):
    good = {"time": TIME, "lon": 152.2, "lat": -39.9, "depth": [5.0, 9.0], "error": 0.05}
    good |= {"u": [0.1, 0.2], "v": [0.1, 0.1]}
    with pytest.raises(ConfigError, match=words):
        rk.Observation.profile(**(good | change))


def test_a_dataset_of_16_bit_numbers_is_said_to_be_one():
    with pytest.warns(UserWarning, match="uo, vo: 16-bit numbers have three digits"):
        _replayed(_dataset().astype(np.float16))


def test_a_lazy_dataset_whose_file_vanished_names_the_cause(tmp_path):
    path = tmp_path / "gone.nc"
    _dataset().to_netcdf(path, engine="h5netcdf")
    lazy = xr.open_dataset(path, engine="h5netcdf")
    lazy.close()
    path.unlink()
    with pytest.raises(ForecastError, match="is the file that it was opened from still there"):
        _replayed(lazy)


def test_a_dataset_without_time_is_static_and_of_unordered_times_the_nearest_counts():
    without = _replayed(_dataset().drop_vars("time"))
    assert without.outcome.observations["used"] == 4
    times = np.array(["2018-11-20", "2018-11-16T06:00", "2018-11-25"], "datetime64[ns]")
    parts = [synthetic.dataset(seed, n_members=10) for seed in (5, 0, 6)]
    several = xr.concat(parts, "time").assign_coords(time=times)
    got, expected = (_replayed(each).estimate.latent for each in (several, _dataset()))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_a_dataset_with_two_time_axes_is_refused_by_their_names():
    two = _dataset().drop_vars("time").expand_dims(time=1, valid_time=2)
    two = two.assign_coords(
        time=[np.datetime64("2018-11-16", "ns")],
        valid_time=np.array(["2018-11-16", "2018-11-17"], "datetime64[ns]"),
    )
    with pytest.raises(ForecastError, match="valid_time"):
        _replayed(two)


def test_an_estimator_of_ones_own_is_an_object_or_what_makes_it():
    result = _replayed(_dataset(), estimator=nearest_member)
    usual = _replayed(_dataset())
    assert result.outcome.observations["used"] == 4
    east, other = (each.estimate.velocity_at(152.3, -39.8, 60.0).u for each in (result, usual))
    assert not np.allclose(east, other)
    lacks = "expected an Estimator, got int without initial, predict, assimilate, flow"
    with pytest.raises(ConfigError, match=lacks):
        _replayed(_dataset(), estimator=3)


def test_a_planner_of_ones_own_plans_and_its_result_cannot_be_verified(tmp_path):
    asked = []

    def mine(config, grid):
        asked.append(config.kind)
        return planner_of(config, grid)

    settings = SETTINGS | {
        "logs": {"end": "2018-11-16T04:00:00Z"},
        "forecast": {"levels": [5, 150, 500]},
    }
    sample = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"
    goal = (153.05, -40.2, 150.0)
    result = rk.replay(*sample, goal=goal, settings=settings, planner=mine, out=tmp_path / "a.mcap")
    assert asked
    assert len(result.plans)
    with pytest.raises(LogError, match="whose planner a script gave; run the script again"):
        verify(tmp_path / "a.mcap", [SAMPLES], planner_of)
    with pytest.raises(
        ConfigError, match="planner: expected a Planner, got str without plan, check"
    ):
        rk.replay(*sample, goal=goal, planner="mine")
    with pytest.raises(ConfigError, match="goal: the table has no vehicle position"):
        _replayed(_dataset(), goal=goal)


def test_nothing_that_is_no_measurement_is_taken_for_one():
    with pytest.raises(
        ConfigError, match="expected Observation values or tables, got str among them"
    ):
        rk.replay([next(_profiles()), "a.mcap"], _dataset())
    away = rk.Observation.profile(TIME, 10.0, 50.0, [5.0], [0.1], [0.1], 0.1)
    with pytest.raises(MeasurementError):
        rk.replay([away], _dataset())


def test_one_mission_gives_one_estimate_through_every_door(tmp_path):
    """As a Slocum's files, as OG1 and as values: equal to the rounding of the files' numbers (float32 of m/s and m).

    Mean currents that are given as values have a straight path of their own, in 128 pieces, in place of the positions every minute.
    """
    forecast = synthetic.dataset(n_members=10, west=-30.25, south=39.8).assign_coords(
        time=np.datetime64("2023-11-14T22:00", "ns")
    )
    slocum_samples.mission(tmp_path / "slocum")
    og1 = made.bodc(tmp_path / "a.nc")
    forecast.to_netcdf(tmp_path / "forecast.nc", engine="h5netcdf")
    means = [
        rk.Observation.mean(
            *(
                (round((made.START + seconds) * 1e9), lon, lat)
                for seconds, lon, lat in made.FIXES[2 * dive : 2 * dive + 2]
            ),
            *(100.0, *made.mean(dive), 0.03),
        )
        for dive in (0, 1)
    ]
    settings = SETTINGS | {"measurements": {"dac_std": 0.03, "fix_std": 1e-6}}
    # of the doors only Slocum's files have the CTD, which gives a shear
    of_slocum = settings | {"measurements": settings["measurements"] | {"without": ["shear"]}}
    doors = (
        (tmp_path / "slocum", forecast, of_slocum),
        (tmp_path / "slocum", tmp_path / "forecast.nc", of_slocum),
        (og1, forecast, settings),
        (means, forecast, settings),
    )
    found = [rk.replay(log, ensemble, settings=asked) for log, ensemble, asked in doors]
    assert [result.outcome.observations["used"] for result in found] == [2] * 4
    at = [result.estimate.velocity_at(-29.985, 40.015, 50.0) for result in found]
    speeds = np.array([(each.u, each.v) for each in at])
    np.testing.assert_array_equal(speeds[1], speeds[0])
    np.testing.assert_allclose(speeds[2], speeds[0], rtol=0.0, atol=2e-8)
    np.testing.assert_allclose(speeds[3], speeds[0], rtol=0.0, atol=2e-4)
