"""Several vehicles in a sea of a basin's size: one estimate in windows, whatever the order of the logs and however often it is stopped."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.plan import Place
from replay_kit.core.region import bounds_of, inside_box
from replay_kit.results.slices import slice_axes
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import read_result
from replay_kit.workflows.follow.follow import follow
from replay_kit.workflows.follow.watch import FollowOptions
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.planning.request import read_flow
from replay_kit.workflows.replay.inputs.job import Following, ReplayJob, Vehicle, forecasts_of
from replay_kit.workflows.replay.replay import replay
from tests.benchmarks.windows import Strip, sea
from tests.workflows.follow.delivery import contents
from tests.workflows.replay.interrupted import goes_on, job_in, often
from tests.workflows.replay.test_region import CONFIG, STRIP, as_dataset, log_along

BASIN = Strip(12, 104, 10, 1.2, 300, 0)
SETTINGS = often(CONFIG).model_copy(
    update={
        "estimator": EstimatorConfig(modes=20, sample_share=0.3, shift_distance=0.0),
        "forecast": ForecastConfig(window_points=BASIN.window),
        "time": TimeConfig(scale="static"),
    }
)
# Columns of the grid along which each goes: one in the west, one that comes into its window, one in the east.
TRACKS = {
    "a": np.repeat(range(24, 32), 2),
    "b": np.repeat(range(40, 24, -2), 2),
    "c": np.repeat(range(66, 70), 2),
}


@pytest.fixture(scope="module")
def basin(tmp_path_factory):
    folder, of = tmp_path_factory.mktemp("basin"), sea(BASIN)
    as_dataset(of, slice(0, BASIN.members)).to_netcdf(folder / "ensemble.nc", engine="h5netcdf")
    for name, columns in TRACKS.items():
        log_along(folder / f"{name}.mcap", of, of.longitude[columns])
    return folder


def job_of(basin, out=None, names="abc", folder: Path | None = None, **more) -> ReplayJob:
    logs = {name: folder / name if folder else basin / f"{name}.mcap" for name in names}
    vehicles = tuple(Vehicle(name, (path,)) for name, path in logs.items())
    return job_in(basin, out, logs=tuple(logs.values()), vehicles=vehicles, **more)


@pytest.fixture(scope="module")
def pooled(basin, tmp_path_factory):
    out = tmp_path_factory.mktemp("pooled") / "out.mcap"
    summary, flow = replay(job_of(basin, out), SETTINGS)
    return read_result(out), summary, flow


def columns_of(name):
    return sea(BASIN).longitude[TRACKS[name]]


def test_every_vehicle_has_the_estimate_of_its_window_and_every_place_visited_is_known(pooled):
    result, summary, flow = pooled
    latitude = sea(BASIN).latitude[STRIP.rows // 2]
    assert np.array_equal(result.estimate.latent, flow.latent)
    for name, part in result.vehicles.items():
        last = part.fixes.iloc[-1]
        assert inside_box(bounds_of(part.estimate.grid), last.longitude, last.latitude)
        assert len(part.estimates) == len(result.estimates)
        assert np.isfinite(result.velocity_at(columns_of(name), latitude, 5.0).u).all()
        slices = Contents(part).slices
        assert np.isfinite(slices.fields[:, -1]).any()
        own = slice_axes(part.estimate.grid)
        np.testing.assert_allclose(slices.east, own[0])
        np.testing.assert_allclose(slices.north, own[1])
    assert any("windows followed the vehicles" in note for note in summary.notes)
    assert any("are of the window of a; the result holds all" in note for note in summary.notes)


def test_windows_are_shared_by_vehicles_that_meet_and_a_plan_is_made_in_the_one_that_holds_it(
    pooled,
):
    result, _, flow = pooled
    a, b, c = (bounds_of(part.estimate.grid) for part in result.vehicles.values())
    assert a == b != c
    # that of both, that of c, and the one that b left
    assert len(result.estimates) == 3
    held = read_flow(result.path)
    for name, part in result.vehicles.items():
        start = Place(float(columns_of(name)[-1]), 40.5, 0.0)
        assert np.array_equal(held.at([start]).latent, part.estimate.latent)
    assert np.array_equal(held.at([Place(10.0, 40.5, 0.0)]).latent, flow.latent)


@pytest.mark.full
def test_following_logs_of_which_one_is_late_ends_with_the_bytes_of_one_replay(basin, tmp_path):
    folders = {name: tmp_path / "inbox" / name for name in TRACKS}
    for name, folder in folders.items():
        folder.mkdir(parents=True)
        if name != "b":
            shutil.copy(basin / f"{name}.mcap", folder)
    settings = SETTINGS.model_copy(update={"planner": PlannerConfig(when="surfacing")})
    job = job_of(basin, tmp_path / "out.mcap", folder=tmp_path / "inbox")
    options = FollowOptions(tmp_path / "states", tmp_path / "s.html", 0.1, 0.0, tell=lambda _: None)
    assert list(follow(job, settings, planner_of, options).vehicles) == ["a", "c"]
    shutil.copy(basin / "b.mcap", folders["b"])
    assert list(follow(job, settings, planner_of, options).vehicles) == list(TRACKS)
    assert "s.b.html" in options.status.read_text()
    first = forecasts_of(job_of(basin, names="ac"), SETTINGS).region
    replay(job_of(basin, tmp_path / "at_once.mcap", region=first), settings)
    assert contents(tmp_path / "out.mcap") == contents(tmp_path / "at_once.mcap")


@pytest.mark.full
def test_a_followed_vehicle_beyond_the_region_of_the_first_logs_is_refused_by_name(basin, tmp_path):
    found = forecasts_of(job_in(basin, logs=("a.mcap",)), SETTINGS).region
    assert not found.follows
    job = job_of(basin, names="ac", region=found, following=Following(tmp_path / "states"))
    with pytest.raises(MeasurementError, match=r"c: was at .* or delete the folder of states"):
        replay(job, SETTINGS)


def test_in_one_window_the_estimate_is_that_of_its_region(basin, tmp_path):
    log_along(tmp_path / "d.mcap", sea(BASIN), sea(BASIN).longitude[24:18:-1])
    region = forecasts_of(job_of(basin), SETTINGS).region
    paths = {"a": basin / "a.mcap", "d": tmp_path / "d.mcap"}
    vehicles = tuple(Vehicle(name, (path,)) for name, path in paths.items())
    job = replace(job_of(basin), logs=tuple(paths.values()), vehicles=vehicles)
    begin = float(columns_of("a")[0].round(2)), float(sea(BASIN).latitude[STRIP.rows // 2].round(2))
    stated = {"forecast": ForecastConfig(region=region.about(begin))}
    found, expected = (
        replay(one, config)[1].velocity_at(columns_of("a"), 40.5, 20.0)
        for one, config in (
            (replace(job, region=region), SETTINGS),
            (job, SETTINGS.model_copy(update=stated)),
        )
    )
    for name in ("u", "v", "u_standard_error"):
        pair = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(*pair, rtol=0.0, atol=1e-10)


@pytest.mark.full
def test_logs_in_another_order_and_a_run_that_was_stopped_give_the_same_bytes(
    basin, pooled, tmp_path
):
    goes_on(job_of(basin, tmp_path / "out.mcap", "cab"), SETTINGS, 50)
    assert (tmp_path / "out.mcap").read_bytes() == pooled[0].path.read_bytes()
