"""The part of a large forecast that a log needs: found by itself, kept, and followed by windows where one is not enough."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import ForecastConfig, RunConfig, load_config
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.plan import Place
from replay_kit.core.region import DEGREE
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.forecast.describe import open_extent
from replay_kit.results import ResultWriter
from replay_kit.results.mcap.topics import WINDOWS_RECORD
from replay_kit.show.notebook import Result
from replay_kit.workflows.replay.inputs.checks import check_logs
from replay_kit.workflows.replay.inputs.forecast import build
from replay_kit.workflows.replay.inputs.job import forecasts_of
from replay_kit.workflows.replay.inputs.region import window_points
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.smooth import smooth
from tests import synthetic
from tests.benchmarks.windows import LEVELS, Sea, Strip, sea
from tests.measurements.samples import ping
from tests.workflows.replay.interrupted import goes_on, job_in, often
from tests.workflows.replay.test_inputs import NS, START, fix, written

STRIP = Strip(14, 90, 20, 1.8, 420, 0)
CONFIG = RunConfig(estimator={"modes": 30, "sample_share": 0.3}, gating={"gate": "off"})


def with_forecast(**settings):
    return CONFIG.model_copy(update={"forecast": ForecastConfig(**settings)})


SMALL_WINDOWS = with_forecast(window_points=STRIP.window)


def as_dataset(of: Sea, members: slice) -> xr.Dataset:
    velocity = np.moveaxis(of.velocity[members], 1, 0)
    return synthetic.as_forecast(velocity, LEVELS, of.latitude, of.longitude)


def log_along(path: Path, of: Sea, longitude: np.ndarray) -> Path:
    """A vessel eastwards through the middle of the strip, a ping of the truth at the nearest grid point every ten minutes."""
    row = STRIP.rows // 2
    messages = []
    for k, x in enumerate(longitude):
        column = int(np.argmin(np.abs(of.longitude - x)))
        u, v = of.velocity[-1, :, 0, row, column]
        cells = {"n_cells": 2, "cell_size": 10.0, "bin0_distance": 10.0, "velocity_std": 0.05}
        found = ping(600 * k, velocity=[[float(u), float(v), 0.0]] * 2, **cells)
        messages.append(fix(600 * k, float(of.longitude[column]), float(of.latitude[row])))
        messages.append(found._replace(time_ns=START + 600 * k * NS))
    return written(path, messages)


@pytest.fixture(scope="module")
def strip(tmp_path_factory) -> Path:
    """A forecast of 14 x 90 points, a log of some cells of it, and one along all of it."""
    folder, of = tmp_path_factory.mktemp("strip"), sea(STRIP)
    as_dataset(of, slice(0, STRIP.members)).to_netcdf(folder / "ensemble.nc", engine="h5netcdf")
    as_dataset(of, slice(STRIP.members, None)).to_netcdf(folder / "truth.nc", engine="h5netcdf")
    log_along(folder / "short.mcap", of, np.repeat(of.longitude[30:38], 5))
    log_along(folder / "long.mcap", of, of.longitude[8:70:2])
    return folder


def job(strip, log="short.mcap", out=None, **more):
    return job_in(strip, out, logs=(log,), **more)


def test_the_log_the_goal_and_a_margin_are_read_and_told(strip):
    longitude, goal = sea(STRIP).longitude, Place(float(sea(STRIP).longitude[44]), 40.5, 50.0)
    for more, last in (({}, longitude[37]), ({"goal": goal}, goal.longitude)):
        forecasts = forecasts_of(job(strip, **more), CONFIG)
        grid, (note, *_) = forecasts.ensemble.grid, forecasts.notes
        assert grid.longitude.min() < longitude[30] - 3.0 / 12.0
        assert grid.longitude.max() > last + 3.0 / 12.0
        rows, columns = grid.east.shape
        assert columns < 46
        assert f"{rows} x {columns} of 14 x 90 points" in note
        assert ("the goal" in note, "--region all" in note) == (bool(more), True)
        # one window holds it all
        assert forecasts.read is None
        assert not isinstance(build(forecasts, CONFIG, None), WindowedEstimator)


@pytest.mark.parametrize(
    ("region", "shape"), [("all", (14, 90)), ((-14.0, 40.0, -10.0, 41.0), (13, 49))]
)
def test_a_stated_region_is_taken(strip, region, shape):
    forecasts = forecasts_of(job(strip), with_forecast(region=region))
    assert (forecasts.region, forecasts.ensemble.grid.east.shape) == (None, shape)


@pytest.mark.parametrize(
    ("config", "error", "words"),
    [
        (with_forecast(region=(-12.0, 40.3, -11.9, 41.0)), ForecastError, "widen --region"),
        (with_forecast(window_points=100), ForecastError, r"reaches \d+ km, and \d+ km are needed"),
        (
            load_config(None, {"time": {"scale": 6.0}, "estimator": {"preset": "paper"}}),
            ConfigError,
            "preset paper is static and takes each profile alone",
        ),
        (
            load_config(None, {"time": {"window": 600.0}, "estimator": {"name": "nearest"}}),
            ConfigError,
            "nearest is static and takes each profile alone",
        ),
    ],
)
def test_regions_and_windows_that_do_not_do_are_refused(strip, config, error, words):
    with pytest.raises(error, match=words):
        forecasts_of(job(strip, "long.mcap"), config)


@pytest.fixture(scope="module")
def followed(strip, tmp_path_factory):
    out = tmp_path_factory.mktemp("followed") / "long.mcap"
    summary, flow = replay(
        job(strip, "long.mcap", out, truth=str(strip / "truth.nc")), SMALL_WINDOWS
    )
    return out, summary, flow


def test_a_log_of_several_windows_is_compared_with_all_that_it_passes(strip):
    found = check_logs([strip / "long.mcap"], (strip / "ensemble.nc",), SMALL_WINDOWS)
    assert (found.profiles, found.refusal) == (31, None)


def test_windows_follow_the_vehicle_and_every_place_visited_stays_known(followed):
    out, summary, flow = followed
    result, of = Result(out), sea(STRIP)
    assert len(result.estimates) > 2
    # the half-open ends count a row or a column more or less
    assert max(one.grid.east.size for one in result.estimates) < 1.1 * STRIP.window
    assert f"{len(result.estimates)} windows followed the vehicle" in " ".join(summary.notes)
    assert summary.truth is not None
    assert np.array_equal(result.estimates[-1].latent, flow.latent)
    columns = np.arange(8, 70, 2)
    places = of.longitude[columns], of.latitude[STRIP.rows // 2], 5.0
    at = result.velocity_at(*places)
    *members, truth = of.velocity[:, :, 0, STRIP.rows // 2, columns]
    mean = np.mean(members, axis=0)
    assert np.linalg.norm([at.u, at.v] - truth) < 0.5 * np.linalg.norm(mean - truth)
    assert np.isnan(flow.velocity_at(*places).u[0])


def test_windows_of_an_estimate_that_was_rebuilt_do_not_count(followed, tmp_path):
    flows = Result(followed[0]).estimates
    writer = ResultWriter(tmp_path / "rebuilt.mcap")
    # those before the last are of an estimate that was rebuilt
    for number, flow in enumerate((*flows[:2], flows[1]), 1):
        writer.window(number, flow)
    writer.write_metadata(WINDOWS_RECORD, {"withdrawn": "2"})
    writer.finish(flows[-1])
    found = Result(tmp_path / "rebuilt.mcap").estimates
    assert len(found) == 2
    assert np.array_equal(found[0].latent, flows[1].latent)


def test_windows_are_not_smoothed(strip, tmp_path):
    with pytest.raises(ConfigError, match="windows that follow the vehicle are not smoothed"):
        smooth(job(strip, "long.mcap", tmp_path / "smooth.mcap"), SMALL_WINDOWS)


@pytest.mark.full
@pytest.mark.parametrize(
    ("log", "config", "stop_after"), [("short.mcap", CONFIG, 60), ("long.mcap", SMALL_WINDOWS, 45)]
)
def test_a_stopped_run_in_a_region_or_windows_goes_on_to_the_same_bytes(
    strip, tmp_path, log, config, stop_after
):
    again = job(strip, log, tmp_path / "out.mcap", truth=str(strip / "truth.nc"))
    goes_on(again, often(config), stop_after)


@pytest.mark.parametrize(("cells", "points"), [(1.0, 1600), (10.0, 140**2)])
def test_windows_are_squares_of_14_correlation_lengths_of_at_least_1600_points(
    strip, cells, points
):
    with open_extent(strip / "ensemble.nc", CONFIG.forecast, None) as extent:
        east, north = extent.step
        length = cells * DEGREE * np.sqrt(east * np.cos(np.deg2rad(40.5)) * north)
        assert window_points(extent, length, 40.5) == pytest.approx(points, rel=0.01)
