"""Measurements beside the vehicle's own in a replay: counted by source, withheld by source, the same from the result and after a pause."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import MeasurementError
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.results import ResultReader
from replay_kit.results.views.contents import Contents
from replay_kit.show.export.export import export
from replay_kit.show.sentences import estimate_sentences
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.report import report
from replay_kit.workflows.sound import open_result
from tests import synthetic
from tests.command import run_command
from tests.logs import surface_samples as made
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping
from tests.measurements.section.test_lines import mission
from tests.workflows.replay.interrupted import QUICK, goes_on

LEVELS = np.array([5.0, 100.0, 300.0, 600.0])


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    """A folder with an ensemble and a glider's line through it."""
    folder = tmp_path_factory.mktemp("line")
    made = synthetic.dataset(3, 8, (6, 10), LEVELS, west=-60.2, south=39.75)
    made.to_netcdf(folder / "ensemble.nc", engine="h5netcdf")
    write_mcap_log(folder / "glider.mcap", mission())
    return folder


def run(ocean, out=None, logs=None, **settings):
    measurements = {"dead_reckoning": "through_water", **settings}
    config = load_config(None, {"estimator": QUICK, "measurements": measurements})
    logs = logs or (ocean / "glider.mcap",)
    job = ReplayJob(logs, ocean / "ensemble.nc", out, overwrite=True)
    return replay(job, config)[0]


def test_shear_is_counted_apart_and_the_result_says_the_same(ocean, tmp_path):
    summary = run(ocean, tmp_path / "out.mcap")
    (row,) = summary.observations["sources"]
    assert (row["kind"], row["used"], row["rejected"]) == ("shear", 3, 0)
    # nine of twelve levels are within the grid, relative to an unknown current
    assert row["values"] == 3 * 8
    assert row["rms_after"] < row["rms_before"]
    assert ResultReader(tmp_path / "out.mcap").outcome == summary
    (said,) = [text for text in map(str, estimate_sentences(summary)) if "shear" in text]
    assert said.startswith(
        "Also used: geostrophic shear: 3 measurements used (24 values), 0 rejected"
    )


@pytest.mark.full
def test_withheld_it_leaves_the_other_measurements(ocean):
    whole, denied = run(ocean), run(ocean, without=["shear"])
    assert "sources" not in denied.observations
    assert denied.observations["used"] == whole.observations["used"] - 3
    with pytest.raises(MeasurementError, match="--without radar: the log holds nothing of that"):
        run(ocean, without=["radar"])


def test_radar_and_drifters_are_used_beside_a_glider_and_alone(ocean, tmp_path):
    at = {"west": -59.9, "south": 39.8}
    made.totals((0.1, 0.05), 4, **at).to_netcdf(tmp_path / "totals.nc", engine="h5netcdf")
    made.write_radials(tmp_path / "one.ruv", (0.1, 0.05), (-59.9, 40.0))
    made.drifters((0.1, 0.05), west=-59.6, south=40.0).to_netcdf(
        tmp_path / "drifters.nc", engine="h5netcdf"
    )
    others = tuple(tmp_path / name for name in ("totals.nc", "one.ruv", "drifters.nc"))
    alone = run(ocean, tmp_path / "alone.mcap", others)
    assert str(next(estimate_sentences(alone))).startswith(
        "Observations: 0 rejected; bins not used"
    )
    rows = export(Contents(open_result(tmp_path / "alone.mcap")), tmp_path / "alone.nc")
    assert (rows["track"], rows["section"]) == (0, 0)
    assert rows["innovations"] > 0
    assert {row["kind"]: row["rejected"] for row in alone.observations["sources"]} == {
        "drifters": 0,
        "radar": 0,
    }
    assert all(row["rms_after"] < row["rms_before"] for row in alone.observations["sources"])
    beside = run(ocean, tmp_path / "out.mcap", (*others, ocean / "glider.mcap"))
    assert [row["kind"] for row in beside.observations["sources"]] == ["drifters", "radar", "shear"]
    result = open_result(tmp_path / "out.mcap")
    cells = result.surface
    # of each hour's total vectors; radials see one component
    assert cells.index.nunique() == 4
    off = cells[["u", "v"]].to_numpy() - (0.1, 0.05)
    assert np.sqrt(np.mean(off**2)) < 0.01
    assert (cells["u_standard_error"] > 0.0).all()
    # the section is of the glider's own profiles
    assert result.measured.profiles == Contents(result).bins.time_ns.size == 0
    kinds = set(result.observations["mean_current_kind"])
    assert kinds >= {"shear", "radar", "drifters"}
    rows = export(Contents(result), tmp_path / "surface.csv", table="surface")
    assert rows == {"surface": len(cells)}
    (said,) = [note for note in beside.notes if "which the estimate at the surface" in note]
    assert said.startswith("radars differ from the modes by a field of ")
    report(tmp_path / "out.mcap", tmp_path / "out.html")
    told = (tmp_path / "out.html").read_text(encoding="utf-8")
    assert all(f"{name}: " in told for name in ("geostrophic shear", "HF radar", "drifters"))
    denied = run(ocean, None, (*others, ocean / "glider.mcap"), without=["radar", "drifters"])
    assert [row["kind"] for row in denied.observations["sources"]] == ["shear"]
    content = inspect_logs(others, load_config(None))
    assert [info.content.surface for info in content] == [4, 11, 8]
    assert {info.use for info in content} == {"ready for replay: currents at the surface found"}


def test_after_radars_points_and_table_have_one_current_at_the_surface_and_one_error(
    ocean, tmp_path
):
    totals = made.totals((0.1, 0.05), 4, west=-59.9, south=39.8)
    totals.to_netcdf(tmp_path / "totals.nc", engine="h5netcdf")
    run(ocean, tmp_path / "out.mcap", (tmp_path / "totals.nc",))
    result = open_result(tmp_path / "out.mcap")
    last = result.surface.loc[result.surface.index[-1]].dropna()
    at = last["longitude"], last["latitude"]
    found = result.estimate.velocity_at(*at, 0.0).to_pandas()
    names = ["u", "v", "u_standard_error", "v_standard_error"]
    known = found["u"].notna().to_numpy()
    assert known.sum() > 20
    np.testing.assert_allclose(found[names][known], last[names][known], atol=2e-3)
    # below the first level it is the modes' alone, and later only the field's size is known
    deep = result.estimate.velocity_at(*at, 20.0).to_pandas()
    alone = replace(result.estimate, surface=None).velocity_at(*at, 20.0).to_pandas()
    np.testing.assert_array_equal(deep[names], alone[names])
    old = result.estimate.surface.at(result.estimate.time_ns + 2 * 3600 * 10**9)
    later = replace(result.estimate, surface=old).velocity_at(*at, 0.0).to_pandas()
    before = replace(result.estimate, surface=None).velocity_at(*at, 0.0).to_pandas()
    np.testing.assert_array_equal(later["u"], before["u"])
    grown = np.hypot(before["u_standard_error"], old.std)
    np.testing.assert_allclose(later["u_standard_error"], grown)


def test_recordings_that_overlap_hold_duplicates_that_contradict_nothing(tmp_path):
    forecast = synthetic.dataset(3, 8, (6, 10), LEVELS, west=151.7, south=-40.2)
    forecast.to_netcdf(tmp_path / "ensemble.nc", engine="h5netcdf")
    for name, seconds in (("first", range(0, 600, 30)), ("second", range(300, 900, 30))):
        rows = []
        for k in seconds:
            for message in (fix(k), ping(k)):
                rows.append((k, message.topic, message.schema, message.payload))
        (tmp_path / f"{name}.mcap").write_bytes(json_mcap(rows))
    # this water is not the forecast's
    (tmp_path / "c.toml").write_text('[gating]\ngate = "off"\n')
    line = "replay first.mcap second.mcap --ensemble ensemble.nc --config c.toml -o out.mcap"
    done = run_command(tmp_path, line)
    assert "30 of 40 observations used; 60 of 120 bins missing, duplicate" in done.stdout
    assert "contradicted the estimate and were rejected" not in done.stdout


@pytest.mark.full
def test_after_a_pause_the_surface_is_that_of_one_run(ocean, tmp_path):
    totals = made.totals((0.1, 0.05), 4, west=-59.9, south=39.8)
    totals.to_netcdf(tmp_path / "totals.nc", engine="h5netcdf")
    settings = {"estimator": {"modes": 7}, "output": {"checkpoint_interval": 1.0}}
    job = ReplayJob((tmp_path / "totals.nc",), ocean / "ensemble.nc", tmp_path / "out.mcap")
    goes_on(job, load_config(None, settings), 3)
