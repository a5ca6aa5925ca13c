"""Dives predicted from the dives before them: on twins, and each piece against brute force."""

import json
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig, RunConfig, load_config
from replay_kit.config.time import TimeConfig
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Flag, usable
from replay_kit.estimator.evolving import build_evolving
from replay_kit.studies.dives import read_dives, run_dives
from replay_kit.studies.dives.forecasts import (
    after_dive,
    baseline_means,
    baseline_profiles,
    before_dives,
    column,
    conditional,
)
from replay_kit.studies.dives.page import to_json
from replay_kit.studies.twins import Twin, make_twin
from replay_kit.workflows.replay.inputs.forecast import read_forecasts
from replay_kit.workflows.replay.inputs.scan import look_ahead
from tests import synthetic
from tests.places import DATA
from tests.reference import dives as slow
from tests.studies.results import experiment

MEMBERS = synthetic.ensemble(n_members=9, shape=(5, 6))
TRUTH = Ensemble(MEMBERS.grid, MEMBERS.velocity[:1], None, "truth")
FORECAST = Ensemble(MEMBERS.grid, MEMBERS.velocity[1:], None, "forecast")
TIME = TimeConfig(
    oscillators=("steady",), oscillator_std=0.1, oscillator_depth_length=60.0, oscillator_scale=3e5
)
DEPTH = np.arange(10.0, 300.0, 20.0)
_HOUR_NS = 3600 * 10**9


@pytest.fixture(scope="module")
def estimator():
    return build_evolving((FORECAST,), EstimatorConfig(modes=12), TIME)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("twin") / "glider.mcap"
    make_twin(TRUTH, Twin("glider", 40, 0.05, 3, interval_s=1200.0), path)
    return path


@pytest.fixture(scope="module")
def dives(log):
    return read_dives([log], RunConfig())


def legs(n_dives, rng):
    """Two profiles a dive."""
    return [
        synthetic.profile(
            MEMBERS.grid,
            2e3 * dive,
            500.0 * leg,
            DEPTH,
            0.1 * rng.standard_normal((DEPTH.size, 2)),
            0.03,
            (3 * dive + leg) * _HOUR_NS,
            dive,
        )
        for dive in range(1, n_dives + 1)
        for leg in range(2)
    ]


def test_withheld_values_are_conditioned_as_by_the_precision_matrix():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((9, 9))
    error, known = rng.standard_normal(9), np.arange(9) % 4 != 3
    for got, expected in zip(
        conditional(error, root @ root.T, known),
        slow.conditional(error, root @ root.T, known),
        strict=True,
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-10)


def test_a_column_is_the_mean_at_each_depth():
    profiles = legs(2, np.random.default_rng(5))
    flags = profiles[0].flags.copy()
    flags[3] = Flag.FAIL
    profiles[0] = replace(profiles[0], flags=flags)
    known = column(profiles)
    np.testing.assert_allclose(known.depth, DEPTH)
    np.testing.assert_allclose(known.velocity, slow.column(profiles, DEPTH), rtol=1e-12)
    np.testing.assert_allclose(
        known.at(np.array([0.0, 20.0])), [known.velocity[0], known.velocity[:2].mean(axis=0)]
    )
    assert column([replace(profiles[1], flags=np.full(DEPTH.size, Flag.FAIL, np.int8))]) is None


def test_dives_of_a_twin_have_their_parts(dives):
    assert len(dives) >= 3
    assert [dive.number for dive in dives] == list(range(1, len(dives) + 1))
    first = dives[0]
    down, up = first.legs
    assert (*down, *up) == first.profiles
    assert down[-1].time_ns < up[0].time_ns
    assert first.mean is not None
    predicted = baseline_profiles(dives[:2], DEPTH)
    np.testing.assert_array_equal(
        predicted["last_dac"], np.tile(dives[1].mean.velocity, (DEPTH.size, 1))
    )
    np.testing.assert_allclose(
        baseline_means(dives[:2])["mean_so_far"][0],
        np.mean([dive.mean.velocity for dive in dives[:2]], axis=0),
    )


def test_a_dive_is_predicted_from_the_dives_before_it_alone(estimator, dives):
    config = RunConfig()
    dives = [replace(dive, given=dive.profiles[::2]) for dive in dives]
    other = [
        *dives[:2],
        replace(
            dives[2],
            given=(),
            profiles=tuple(replace(p, velocity=p.velocity + 0.2) for p in dives[2].profiles),
        ),
    ]
    (*partial, ours), (*_, theirs) = (
        run_dives(estimator, which, config, "e.nc") for which in (dives[:3], other)
    )
    assert [(len(part.dives), to_json(part).get("unfinished")) for part in (*partial, ours)] == [
        (1, True),
        (2, True),
        (3, None),
    ]
    np.testing.assert_allclose(
        ours.dives[1].errors["profiles"]["estimate"],
        theirs.dives[1].errors["profiles"]["estimate"],
        atol=1e-9,
    )
    shift = (
        theirs.dives[2].errors["profiles"]["estimate"]
        - ours.dives[2].errors["profiles"]["estimate"]
    )
    np.testing.assert_allclose(np.hypot(*shift.T), 0.2 * np.sqrt(2.0), atol=1e-6)
    answer = json.loads(json.dumps(to_json(ours), allow_nan=False))
    level = MEMBERS.grid.levels[-1]
    seen = np.concatenate(
        [p.velocity[usable(p.flags) & (p.depth <= level)] for p in dives[1].profiles]
    )
    assert answer["dives"][1]["rmse_profiles"]["zero"] == pytest.approx(
        np.sqrt(np.mean(np.sum(seen**2, axis=1))), rel=1e-9
    )
    assert answer["dives"][1]["bins"] == len(seen)
    assert [row["dive"] for row in answer["dives"]] == [1, 2, 3]
    assert answer["dives"][0]["rmse_profiles"] == {}
    assert 0.7 <= answer["coverage"]["withheld"]["0.9"] <= 1.0


def test_a_surfacing_is_off_by_the_error_of_the_mean_times_the_duration(estimator, dives):
    known, state, found = before_dives(dives), estimator.initial(), []
    for dive in dives[:3]:
        known, forecasts = after_dive(known, estimator, state, dive, [])
        found.append(forecasts)
    for dive, each in zip(dives[:3], found, strict=True):
        start, end = dive.mean.fixes
        seconds, outcome = (end.time_ns - start.time_ns) * 1e-9, each.outcome
        np.testing.assert_allclose(each.mean_error[0], np.array(outcome.off) / seconds)
        assert outcome.forecast.earlier == dive.number - dives[0].number
    # the first is expected with no current of its own, about zero or the ensemble's
    assert np.hypot(*found[0].mean_error[0]) < 1.0


def test_one_dive_is_none_to_predict(tmp_path):
    make_twin(TRUTH, Twin("glider", 3, 0.05, 3), tmp_path / "short.mcap")
    with pytest.raises(MeasurementError, match="at least two dives"):
        read_dives([tmp_path / "short.mcap"], RunConfig())


@pytest.mark.full
def test_the_command_says_what_it_found_and_refuses_other_estimators(log, tmp_path):
    synthetic.dataset(n_members=9, shape=(5, 6)).to_netcdf(
        tmp_path / "ensemble.nc", engine="h5netcdf"
    )
    (tmp_path / "paper.toml").write_text('[estimator]\npreset = "paper"\n')
    command = f"dives {log} --ensemble {tmp_path}/ensemble.nc --modes 6"
    answer = tmp_path / "dives.json"
    done = experiment(f"{command} --time-scale 86400 --oscillators inertial,M2 --json {answer}")
    assert done.exit_code == 0, done.output
    assert "Surfacings:" in done.output
    found = json.loads(answer.read_text())
    assert found["oscillators"] == ["inertial", "M2"]
    assert found["rmse"]["profiles"]["estimate"] < found["rmse"]["profiles"]["zero"]
    refused = experiment(f"{command} --config {tmp_path}/paper.toml")
    assert isinstance(refused.exception, ConfigError)
    synthetic.dataset(n_members=9, shape=(5, 6), west=20.0).to_netcdf(
        tmp_path / "far.nc", engine="h5netcdf"
    )
    elsewhere = experiment(f"dives {log} --ensemble {tmp_path}/far.nc --modes 6")
    assert isinstance(elsewhere.exception, MeasurementError)
    assert "--place-ensemble" in str(elsewhere.exception)


@pytest.mark.full
@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data are not on this machine")
def test_real_mean_currents_and_surfacings_are_told_as_well_as_by_the_last_one():
    config = load_config(
        None,
        {"forecast": {"place": True, "levels": (25, 150, 355, 725)}, "estimator": {"modes": 20}},
    )
    logs = sorted((DATA / "seaglider").glob("p24900*.nc"))
    place_at, first_ns = look_ahead(logs, config)
    series = read_forecasts(DATA / "qg" / "climatology.nc", config, first_ns, place_at).series
    *_, result = run_dives(
        build_evolving(series, config.estimator, config.time),
        read_dives(logs, config),
        config,
        "qg",
    )
    rmse = result.rmse("mean")
    assert rmse["estimate"] <= min(rmse["last_dac"], rmse["zero"], rmse["ensemble_mean"])
    assert sum(dive.surfacing.in_outer for dive in result.dives if dive.surfacing is not None) >= 5
    assert len(result.dives) == 6
