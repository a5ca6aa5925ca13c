"""One log end to end on a small synthetic ocean: what comes out, and every kind of bad input."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from replay_kit import open_estimate
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError, ForecastError, LogError, MeasurementError, PlanError
from replay_kit.core.message import Message
from replay_kit.core.plan import Place
from replay_kit.estimator import ReducedBasisEstimator, embed_member
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.conclude import score_against_truth
from replay_kit.workflows.replay.inputs import checks
from replay_kit.workflows.replay.replay import replay
from tests import synthetic
from tests.command import invoke, succeed
from tests.logs.mavlink.telemetry_samples import write_tlog
from tests.measurements.samples import fix, ping
from tests.results.result_samples import decoded
from tests.workflows.replay.interrupted import QUICK, job_in, truth_in

CONFIG = RunConfig(planner={"kind": "glide"}, estimator=QUICK)
GOAL = Place(152.3, -39.8, 150.0)


def run(ocean, log="survey.mcap", **more):
    return replay(job_in(ocean, logs=(log,), **more), CONFIG, planner_of)


def test_the_main_job_beats_the_ensemble_s_mean_and_writes_every_file(tmp_path):
    synthetic.write_ocean(tmp_path, 40)
    make_twin(truth_in(tmp_path, CONFIG), Twin("vessel", 40, 0.05, 1), tmp_path / "survey.mcap")
    job = job_in(
        tmp_path,
        tmp_path / "out.mcap",
        logs=("survey.mcap",),
        truth=str(tmp_path / "truth.nc"),
        netcdf=tmp_path / "grid.nc",
        save_estimate=tmp_path / "flow.nc",
    )
    summary, flow = replay(job, RunConfig(estimator=EstimatorConfig(modes=20, sample_share=0.5)))
    assert (summary.exit_code, summary.observations["used"]) == (0, 40)
    assert summary.truth["rmse"] < 0.6 * summary.truth["ensemble_mean_rmse"]
    rms = summary.rms_innovation
    assert rms["after"] < rms["before"] < rms["prior"]
    innovations = decoded(job.out)["/flow/innovation"]
    values = sum(sum(message.dof) for _, message in innovations)
    assert values == 2 * summary.observations["bins_used"]
    # grids and digests come with the first profile, and then at the interval after the last ones
    held = decoded(job.out)
    for topic in ("/flow/grid/5m", "/flow/estimate"):
        times = [time for time, _ in held[topic]]
        assert times[0] == held["/vehicle/fix"][0][0]
        # six hours, and a ping at most
        assert set(np.diff(times)[:-1] // (2400 * 10**9)) == {9}
    with xr.open_dataset(job.netcdf, engine="h5netcdf") as grid:
        assert "eastward_sea_water_velocity" in {
            one.attrs.get("standard_name") for one in grid.variables.values()
        }
    loaded = open_estimate(job.save_estimate)
    np.testing.assert_array_equal(loaded.latent, flow.latent)
    np.testing.assert_array_equal(loaded.unknowns.p, flow.unknowns.p)


@pytest.mark.parametrize(
    ("name", "asked", "depth"),
    [
        # its dives went to 290 m
        ("glider.tlog", {}, 290.0),
        ("glider.mcap", {"depth": 250.0}, 250.0),
        ("glider.mcap", {"kind": "glide"}, None),
        ("survey.mcap", {}, None),
    ],
)
def test_a_glider_s_replay_plans_a_mission_where_nothing_else_is_asked_for(
    ocean, tmp_path, name, asked, depth
):
    log = ocean / name
    if name.endswith(".tlog"):
        log = tmp_path / name
        write_tlog(log, open_log(ocean / "glider.mcap").messages())
    config = RunConfig(estimator=QUICK, planner={"samples": 0, "interval": 1e9} | asked)
    outcome, _ = replay(job_in(ocean, goal=GOAL, logs=(log,)), config, planner_of)
    legs = [json.loads(v) for k, v in outcome.plan["statistics"].items() if k.startswith("leg")]
    assert max((leg["depth_m"] for leg in legs), default=None) == depth
    # a glide that was not asked for is explained
    said = any("--planner mission" in note for note in outcome.notes)
    assert said == (name == "survey.mcap")


def test_a_goal_without_a_position_to_start_from_is_answered(ocean, tmp_path):
    log = tmp_path / "pings.csv"
    log.write_text(
        "time,longitude,latitude,depth,u,v,error\n"
        "2018-11-16T01:00:00Z,152.3,-39.8,60,0.1,0.05,0.05\n"
    )
    use = inspect_logs([log], CONFIG)[0].use
    assert use == "ready for replay: placed current profiles found"
    outcome, _ = replay(job_in(ocean, goal=GOAL, logs=(log,)), CONFIG, planner_of)
    assert outcome.plan["status"] == "failed"
    assert outcome.plan["message"].startswith("the log has no position of the vehicle")


def test_dives_that_are_not_stated_reach_their_goal_as_far_as_the_forecast():
    goals = 150.0, 600.0, 900.0
    for planner, depths in (
        (PlannerConfig(), [500.0, 600.0, 700.0]),
        # recorded settings state the kind and not the depth, and are planned with again
        (PlannerConfig(kind="mission"), [500.0, 600.0, 700.0]),
        (PlannerConfig(depth=500.0), [500.0] * 3),
    ):
        assert [planner.diving(None, goal, 700.0).depth for goal in goals] == depths


LOGS = {
    "empty.mcap": [],
    "camera.mcap": [Message(1, "/camera", "sensor_msgs/msg/Image", {"x": 1}, 0, 0)],
    **{
        f"{name}.mcap": [
            message
            for k in range(3)
            for message in (fix(k, 152.3, -39.8), ping(k, n_cells=2, velocity=[[speed] * 3] * 2))
        ]
        for name, speed in (("missing", None), ("centimetres", 20.0))
    },
}


@pytest.mark.parametrize(
    ("log", "more", "error", "words"),
    [
        ("absent.mcap", {}, LogError, "file not found"),
        ("empty.mcap", {}, MeasurementError, "no messages at all"),
        ("camera.mcap", {}, MeasurementError, r"Found: /camera \(1"),
        ("missing.mcap", {}, MeasurementError, "3 profiles, none usable: 6 values missing"),
        (
            "centimetres.mcap",
            {},
            MeasurementError,
            r"range \(a component beyond .*: check its unit",
        ),
        ("survey.mcap", {"truth": "absent.nc"}, ForecastError, "no such file"),
        ("survey.mcap", {"goal": Place(160.0, -39.8, 100.0)}, PlanError, "outside"),
        ("survey.mcap", {"goal": Place(152.3, -39.8, 5000.0)}, PlanError, "deep"),
        ("survey.mcap", {"goal": Place(152.6, -39.5, 100.0)}, PlanError, "land"),
    ],
)
def test_inputs_that_cannot_be_used_cost_no_result(ocean, tmp_path, log, more, error, words):
    if log in LOGS:
        write_mcap_log(tmp_path / log, LOGS[log])
    if "goal" in more:
        with xr.open_dataset(ocean / "ensemble.nc") as ds:
            island = ds.load()
        for name in ("uo", "vo"):
            island[name][:, :, 5, 6] = np.nan
        more = more | {"ensemble": tmp_path / "island.nc"}
        island.to_netcdf(more["ensemble"], engine="h5netcdf")
    path = ocean / log if log == "survey.mcap" else tmp_path / log
    with pytest.raises(error, match=words):
        run(ocean, path, out=tmp_path / "out.mcap", **more)
    assert not list(tmp_path.glob("out.mcap*"))


@pytest.mark.parametrize(
    ("goal", "error"), [(None, MeasurementError), (Place(152.3, -39.8, 0.0), PlanError)]
)
def test_a_forecast_of_the_surface_alone_is_said_not_to_reach_the_dives(
    ocean, tmp_path, goal, error
):
    surface = tmp_path / "surface.nc"
    with xr.open_dataset(ocean / "ensemble.nc") as ds:
        ds.isel(depth=[0]).assign_coords(depth=[0.0]).to_netcdf(surface, engine="h5netcdf")
    job = job_in(ocean, goal=goal, logs=("glider.mcap",), ensemble=surface)
    with pytest.raises(error, match=r"only the level 0 m, and the log goes to \d+ m"):
        replay(job, RunConfig(estimator=QUICK), planner_of)


def test_a_log_given_twice_is_refused(ocean, tmp_path):
    (tmp_path / "copy.mcap").write_bytes((ocean / "survey.mcap").read_bytes())
    job = job_in(ocean, tmp_path / "o.mcap", logs=("survey.mcap", tmp_path / "copy.mcap"))
    with pytest.raises(ConfigError, match="identical to"):
        replay(job, CONFIG)


def test_a_dry_run_says_what_would_be_used_and_writes_nothing(ocean, tmp_path, monkeypatch):
    # 2 s for each profile
    clock, assimilate = [0.0], ReducedBasisEstimator.assimilate

    def slow(estimator, state, block):
        clock[0] += 2.0 * len(block)
        return assimilate(estimator, state, block)

    monkeypatch.setattr(checks, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(ReducedBasisEstimator, "assimilate", slow)
    line = f"replay {ocean}/survey.mcap --ensemble {ocean}/ensemble.nc --dry-run"
    answer = json.loads(succeed(f"{line} --modes 10 -o {tmp_path}/o.mcap --json -").stdout)
    assert (answer["profiles_used"], answer["members"], answer["modes"]) == (40, 12, 10)
    # the unknowns of members and their four copies at least
    assert 60 <= answer["state_size"] < 200
    assert answer["seconds"] == pytest.approx(80.0)
    baseline = invoke(f"{line} --estimator nearest -o {tmp_path}/o.mcap")
    assert isinstance(baseline.exception, ConfigError)
    assert not list(tmp_path.iterdir())


def test_a_baseline_takes_no_mean_currents_and_that_is_said(ocean):
    config = RunConfig(estimator={"name": "nearest"})
    outcome, _ = replay(job_in(ocean), config)
    assert "5 mean currents (dac): not supported by this estimator" in outcome.notes
    found = outcome.observations
    assert (found["mean_currents"], found["used"] + found["rejected"]) == (0, 45)


def test_a_truth_with_another_centre_is_compared_along_the_same_axes():
    """The same field on a part of the grid has another projection: its vectors must be turned before they are compared."""
    ensemble = synthetic.ensemble(shape=(9, 16), south=70.0, step=1.0)
    flow = embed_member(ensemble, 0, EstimatorConfig(nugget=1e-9))
    part = synthetic.dataset(shape=(9, 16), south=70.0, step=1.0).isel(lon=slice(0, 5), member=[0])
    truth = synthetic.as_read(part)
    score = score_against_truth(flow, ensemble, truth, EstimatorConfig())
    # cells of 1 degree are embedded to 4 mm/s; unturned vectors would be 5 degrees off, 11 mm/s
    assert score["rmse"] < 6e-3


def test_bins_under_the_sea_floor_and_pings_on_land_are_not_used(ocean, tmp_path):
    with xr.open_dataset(ocean / "ensemble.nc") as ds:
        shallow = ds.load()
    for name in ("uo", "vo"):
        shallow[name][:, 2:] = np.nan
        shallow[name][:, :, :, 5:] = np.nan
    shallow.to_netcdf(tmp_path / "shallow.nc", engine="h5netcdf")
    summary, _ = run(ocean, ensemble=tmp_path / "shallow.nc")
    assert summary.observations["bins_rejected"]["on_land"] > 0
    assert summary.observations["rejected"] > 0
