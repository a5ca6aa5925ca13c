"""One log end to end on a small synthetic ocean: what comes out, that it is the same twice, and every kind of bad input."""

import json
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
import xarray as xr

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, MeasurementConfig, RunConfig, load_config
from replay_kit.core.errors import ConfigError, ForecastError, LogError, MeasurementError, PlanError
from replay_kit.core.flow.file import load
from replay_kit.core.message import Message
from replay_kit.core.plan import Place
from replay_kit.estimator import ReducedBasisEstimator, embed_member
from replay_kit.forecast import read_truth
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs import checks
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.scan import open_readers
from replay_kit.workflows.replay.prepare import with_planner_kind
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.scoring import score_against_truth
from tests import synthetic
from tests.command import invoke, succeed
from tests.logs.mavlink.telemetry_samples import write_tlog
from tests.measurements.samples import fix, ping
from tests.results.result_samples import decoded

SETTINGS = RunConfig(
    planner=PlannerConfig(kind="glide"), estimator=EstimatorConfig(modes=20, sample_share=0.5)
)
GOAL = Place(152.3, -39.8, 150.0)


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    """A folder with an ensemble, the truth withheld from it, and logs of a survey and a glider in it."""
    folder = tmp_path_factory.mktemp("ocean")
    synthetic.write_ocean(folder, 40)
    truth = read_truth(str(folder / "truth.nc"), SETTINGS.forecast)
    make_twin(truth, Twin("vessel", 40, 0.05, 1), folder / "survey.mcap")
    make_twin(truth, Twin("glider", 40, 0.05, 1), folder / "glider.mcap")
    write_tlog(folder / "glider.tlog", open_log(folder / "glider.mcap").messages())
    return folder


def run(ocean, *logs, out=None, config=SETTINGS, **options):
    job = ReplayJob(
        tuple(ocean / log for log in logs),
        options.pop("ensemble", ocean / "ensemble.nc"),
        out,
        **options,
    )
    return replay(job, config, planner_of)


def test_the_main_job_beats_the_ensemble_s_mean_and_publishes_every_channel(ocean, tmp_path):
    out = tmp_path / "out.mcap"
    summary, flow = run(
        ocean,
        "survey.mcap",
        out=out,
        goal=GOAL,
        truth=str(ocean / "truth.nc"),
        netcdf=tmp_path / "grid.nc",
        save_estimate=tmp_path / "flow.nc",
    )
    assert summary.exit_code == 0
    assert summary.observations["used"] == 40
    assert summary.truth["rmse"] < 0.6 * summary.truth["ensemble_mean_rmse"]
    assert (
        summary.rms_innovation["after"]
        < summary.rms_innovation["before"]
        < summary.rms_innovation["prior"]
    )
    held = decoded(out)
    topics = set(held)
    fixed = {
        "/vehicle/fix",
        "/flow/estimate",
        "/flow/innovation",
        "/tf",
        "/plan/path",
        "/plan/geojson",
        "/plan/controls",
    }
    assert fixed < topics
    assert sum(topic.startswith("/flow/grid/") for topic in topics) == 3
    assert (
        sum(sum(message.dof) for _, message in held["/flow/innovation"])
        == 2 * summary.observations["bins_used"]
    )
    with xr.open_dataset(tmp_path / "grid.nc", engine="h5netcdf") as grid:
        names = {variable.attrs.get("standard_name") for variable in grid.variables.values()}
    assert "eastward_sea_water_velocity" in names
    loaded = load(tmp_path / "flow.nc")
    np.testing.assert_array_equal(loaded.latent, flow.latent)
    np.testing.assert_array_equal(loaded.unknowns.p, flow.unknowns.p)


@pytest.mark.parametrize(
    ("log", "asked", "kind", "depth"),
    [
        ("glider.mcap", {}, "mission", 300.0),
        ("glider.mcap", {"depth": 250.0}, "mission", 250.0),
        ("glider.mcap", {"kind": "glide"}, "glide", 300.0),
        ("survey.mcap", {}, "glide", 300.0),
        ("glider.tlog", {}, "glide", 300.0),
    ],
)
def test_a_glider_s_replay_plans_missions_where_nothing_else_is_asked_for(
    ocean, log, asked, kind, depth
):
    """The twin's forecast ends at 300 m, above the depth of dives that is assumed."""
    config = RunConfig(planner=PlannerConfig(**asked))
    job = ReplayJob((ocean / log,), ocean / "ensemble.nc", goal=GOAL)
    found = with_planner_kind(job, open_readers(job.logs, config), config).planner
    assert (found.kind, found.diving(deepest=300.0).depth) == (kind, depth)
    assert found.when == "interval"
    without = ReplayJob((ocean / log,), ocean / "ensemble.nc")
    assert with_planner_kind(without, open_readers(job.logs, config), config) is config


@pytest.mark.parametrize(
    ("goal_depth", "expected"), [(150.0, 500.0), (600.0, 600.0), (900.0, 700.0)]
)
def test_the_dives_of_a_mission_that_is_not_asked_for_reach_its_goal(goal_depth, expected):
    # recorded settings state the kind and not the depth, and are planned with again
    for config in (PlannerConfig(), PlannerConfig(kind="mission")):
        assert config.diving(None, goal_depth, 700.0).depth == expected
    assert PlannerConfig(depth=500.0).diving(None, goal_depth, 700.0).depth == 500.0


@pytest.mark.full
@pytest.mark.parametrize("spread", ["fit", "as_given"])
def test_a_fitted_spread_is_in_the_notes(ocean, spread):
    config = SETTINGS.model_copy(update={"estimator": EstimatorConfig(spread=spread, modes=20)})
    said = " ".join(run(ocean, "survey.mcap", config=config)[0].notes)
    assert ("the variance of the ensemble was multiplied by 0." in said) == (spread == "fit")


def test_mcap_and_tlog_of_a_mission_give_the_same_estimate(ocean):
    # a telemetry log has no mean currents
    profiles = SETTINGS.model_copy(update={"measurements": MeasurementConfig(without=("dac",))})
    (_, one), (_, other) = run(ocean, "glider.mcap", config=profiles), run(ocean, "glider.tlog")
    grid = one.grid
    points = grid.east[None], grid.north[None], grid.levels[:, None, None]
    # the wire keeps positions to 1e-7 degrees and velocities to float32: 1e-2 m and 1e-8 m/s
    np.testing.assert_allclose(one.velocity(*points), other.velocity(*points), atol=1e-5)


def test_a_glider_s_dives_are_told_apart(ocean):
    summary, _ = run(ocean, "glider.mcap")
    assert [row["dive"] for row in summary.by_dive] == list(range(1, len(summary.by_dive) + 1))
    assert sum(row["profiles"] for row in summary.by_dive) <= summary.observations["used"]
    first = summary.by_dive[0]
    assert first["rms_innovation_predicted"] <= first["rms_innovation_prior"] * (1 + 1e-12)


def test_start_and_end_cut_the_log(ocean):
    with open_log(ocean / "survey.mcap") as log:
        times = [message.time_ns for message in log.messages() if message.topic == "/adcp"]
    middle = str(np.datetime64(times[20], "ns"))
    for end, used in (("end", 21), ("start", 20)):
        config = load_config(None, {"logs": {end: middle}})
        assert run(ocean, "survey.mcap", config=config)[0].observations["used"] == used


def test_a_truncated_log_is_used_as_far_as_it_is_whole_and_the_loss_said(ocean, tmp_path):
    # chunks so small that half of the log has whole ones
    with (
        mock.patch("replay_kit.logs.mcap.writer._CHUNK", 10_000),
        open_log(ocean / "survey.mcap") as log,
    ):
        write_mcap_log(tmp_path / "whole.mcap", log.messages())
    data = (tmp_path / "whole.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    summary, _ = run(
        tmp_path, "cut.mcap", ensemble=ocean / "ensemble.nc", out=tmp_path / "out.mcap"
    )
    assert summary.exit_code == 4
    assert 0 < summary.observations["used"] < 40
    assert summary.losses[0]["bytes"] > 0
    assert (tmp_path / "out.mcap").exists()


def nan_pings(folder):
    cells = {"n_cells": 2, "velocity": [[None] * 3] * 2}
    messages = [one for k in range(3) for one in (fix(k, 152.3, -39.8), ping(k, **cells))]
    write_mcap_log(folder / "bad.mcap", messages)


def no_adcp(folder):
    write_mcap_log(
        folder / "bad.mcap", [Message(1, "/camera", "sensor_msgs/msg/Image", {"x": 1}, 0, 0)]
    )


def empty_mcap(folder):
    write_mcap_log(folder / "bad.mcap", [])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda folder: None, LogError, "file not found"),
        (empty_mcap, MeasurementError, "no messages at all"),
        (no_adcp, MeasurementError, r"Found: /camera \(1"),
        (nan_pings, MeasurementError, "3 ADCP pings, none usable: 6 bins missing"),
    ],
)
def test_logs_that_cannot_be_used(ocean, tmp_path, make, error, message):
    make(tmp_path)
    with pytest.raises(error, match=message):
        run(tmp_path, "bad.mcap", ensemble=ocean / "ensemble.nc", out=tmp_path / "out.mcap")
    assert not list(tmp_path.glob("out.mcap*"))


def test_a_log_of_another_place(ocean, tmp_path):
    synthetic.dataset(west=10.0, south=50.0).to_netcdf(tmp_path / "far.nc", engine="h5netcdf")
    summary, flow = run(
        ocean,
        "survey.mcap",
        ensemble=tmp_path / "far.nc",
        config=load_config(None, {"forecast": {"place": True}}),
    )
    assert summary.observations["used"] > 0
    assert any("not a forecast" in note for note in summary.notes)
    assert abs(flow.grid.longitude.mean() - 152.3) < 0.3


@pytest.mark.parametrize(
    "goal", [Place(160.0, -39.8, 100.0), Place(152.3, -39.8, 5000.0), Place(152.6, -39.5, 100.0)]
)
def test_goals_outside_the_region_or_on_land(ocean, tmp_path, goal):
    with xr.open_dataset(ocean / "ensemble.nc") as ds:
        island = ds.load()
    for name in ("uo", "vo"):
        island[name][:, :, 5, 6] = np.nan
    island.to_netcdf(tmp_path / "island.nc", engine="h5netcdf")
    with pytest.raises(PlanError):
        run(ocean, "survey.mcap", ensemble=tmp_path / "island.nc", goal=goal)


def test_the_command_line_answers_in_words_and_in_json(ocean, tmp_path):
    inputs = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --goal 152.3,-39.8,150"
    scored = f"--planner glide --truth {ocean}/truth.nc"
    done = succeed(f"replay {inputs} {scored} -o {tmp_path}/o.mcap --json {tmp_path}/o.json")
    assert "Against the truth over" in done.output
    # the score against the truth takes two lines
    assert len(done.output.splitlines()) <= 12
    # terms of statistics are for -v
    assert not any(word in done.output for word in ("NIS", "likelihood", "e^", "mu ", "taper"))
    answer = json.loads((tmp_path / "o.json").read_text())
    keys = {
        "format_version",
        "status",
        "exit_code",
        "messages",
        "observations",
        "rms_innovation",
        "by_dive",
        "nis_per_dof",
        "seconds",
        "plan",
        "truth",
    }
    assert keys <= set(answer)
    assert answer["truth"]["points"] > 0
    assert set(answer["messages"][0]) == {"topic", "read", "used", "skipped", "reasons"}


def test_a_dry_run_says_what_would_be_used_and_writes_nothing(ocean, tmp_path, monkeypatch):
    # 2 s for each profile
    clock, assimilate = [0.0], ReducedBasisEstimator.assimilate

    def slow(estimator, state, block):
        clock[0] += 2.0 * len(block)
        return assimilate(estimator, state, block)

    monkeypatch.setattr(checks, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(ReducedBasisEstimator, "assimilate", slow)
    arguments = f"replay {ocean}/survey.mcap --ensemble {ocean}/ensemble.nc --modes 20 --dry-run"
    succeed(f"{arguments} -o {tmp_path}/o.mcap --json {tmp_path}/d.json")
    answer = json.loads((tmp_path / "d.json").read_text())
    assert (answer["profiles_used"], answer["members"], answer["modes"]) == (40, 40, 20)
    # the unknowns of members and their four copies at least
    assert 200 <= answer["state_size"] < 400
    assert answer["seconds"] == pytest.approx(80.0)
    assert [path.name for path in tmp_path.iterdir()] == ["d.json"]


def test_a_truth_with_another_centre_is_compared_along_the_same_axes():
    """The same field on a part of the grid has another projection: its vectors must be turned before they are compared."""
    ensemble = synthetic.ensemble(shape=(9, 16), south=70.0, step=1.0)
    flow = embed_member(ensemble, 0, EstimatorConfig(nugget=1e-9))
    part = synthetic.dataset(shape=(9, 16), south=70.0, step=1.0).isel(lon=slice(0, 5), member=[0])
    truth = synthetic.as_read(part)
    score = score_against_truth(flow, ensemble, truth, EstimatorConfig())
    # cells of 1 degree are embedded to 4 mm/s; unturned vectors would be 5 degrees off, 11 mm/s
    assert score["rmse"] < 6e-3


def test_a_truth_that_is_not_there_costs_no_time(ocean, tmp_path):
    with pytest.raises(ForecastError, match="no such file"):
        run(ocean, "survey.mcap", out=tmp_path / "other.mcap", truth=str(tmp_path / "absent.nc"))
    assert not list(tmp_path.glob("other.mcap*"))


def test_a_log_given_twice_is_refused(ocean, tmp_path):
    (tmp_path / "copy.mcap").write_bytes((ocean / "survey.mcap").read_bytes())
    job = ReplayJob(
        (ocean / "survey.mcap", tmp_path / "copy.mcap"), ocean / "ensemble.nc", tmp_path / "o.mcap"
    )
    with pytest.raises(ConfigError, match="identical to"):
        replay(job, SETTINGS)


def test_bins_under_the_sea_floor_and_pings_on_land_are_not_used(ocean, tmp_path):
    with xr.open_dataset(ocean / "ensemble.nc") as ds:
        shallow = ds.load()
    for name in ("uo", "vo"):
        shallow[name][:, 2:] = np.nan
        shallow[name][:, :, :, 5:] = np.nan
    shallow.to_netcdf(tmp_path / "shallow.nc", engine="h5netcdf")
    summary, _ = run(ocean, "survey.mcap", ensemble=tmp_path / "shallow.nc")
    assert summary.observations["bins_rejected"]["on_land"] > 0
    assert summary.observations["rejected"] > 0


def test_a_dry_run_of_a_baseline_is_refused(ocean, tmp_path):
    arguments = (
        f"replay {ocean}/survey.mcap --ensemble {ocean}/ensemble.nc --dry-run --estimator nearest"
    )
    done = invoke(f"{arguments} -o {tmp_path}/o.mcap")
    assert isinstance(done.exception, ConfigError)
