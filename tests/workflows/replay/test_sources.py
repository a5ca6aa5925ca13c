"""Measurements beside the vehicle's own in a replay: counted by source, withheld by source, the same from the result and after a pause."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit import open_result
from replay_kit.config.run import load_config
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.results import ResultReader
from replay_kit.results.views.contents import Contents
from replay_kit.show.export import export
from replay_kit.show.sentences import estimate_sentences
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.replay.replay import replay
from tests import synthetic
from tests.logs import surface_samples as made
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping
from tests.measurements.section.test_lines import mission
from tests.show.figures.texts import words
from tests.workflows.replay.interrupted import QUICK, goes_on, job_in

LEVELS = np.array([5.0, 100.0, 300.0, 600.0])


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    """A folder with an ensemble and a glider's line through it."""
    folder = tmp_path_factory.mktemp("line")
    made = synthetic.dataset(3, 8, (6, 10), LEVELS, west=-60.2, south=39.75)
    made.to_netcdf(folder / "ensemble.nc", engine="h5netcdf")
    write_mcap_log(folder / "glider.mcap", mission())
    return folder


def run(ocean, out=None, logs=("glider.mcap",), **settings):
    measurements = {"dead_reckoning": "through_water", **settings}
    config = load_config(None, {"estimator": QUICK, "measurements": measurements})
    return replay(job_in(ocean, out, logs=logs), config)[0]


def test_shear_is_counted_apart_and_the_result_says_the_same(ocean, tmp_path):
    summary = run(ocean, tmp_path / "out.mcap")
    (row,) = summary.observations["sources"]
    assert (row["kind"], row["used"], row["rejected"]) == ("shear", 3, 0)
    # nine of twelve levels are within the grid, relative to an unknown current
    assert row["values"] == 3 * 8
    assert row["rms_after"] < row["rms_before"]
    assert ResultReader(tmp_path / "out.mcap").outcome == summary
    said = "\n".join(map(str, estimate_sentences(summary)))
    assert "Also used: geostrophic shear: 3 measurements used (24 values), 0 rejected" in said


@pytest.fixture(scope="module")
def totals(ocean):
    """A radar's total vectors of four hours in that water."""
    made.totals((0.1, 0.05), 4, west=-59.9, south=39.8).to_netcdf(
        ocean / "totals.nc", engine="h5netcdf"
    )
    return ocean / "totals.nc"


def test_radar_and_drifters_are_used_beside_a_glider_and_alone(ocean, totals, tmp_path):
    others = totals, tmp_path / "one.ruv", tmp_path / "drifters.nc"
    made.write_radials(others[1], (0.1, 0.05), (-59.9, 40.0))
    made.drifters((0.1, 0.05), west=-59.6, south=40.0).to_netcdf(others[2], engine="h5netcdf")
    alone = run(ocean, tmp_path / "alone.mcap", others)
    rows = export(Contents(open_result(tmp_path / "alone.mcap")), tmp_path / "alone.nc")
    assert (rows["track"], rows["section"], rows["innovations"] > 0) == (0, 0, True)
    sources = alone.observations["sources"]
    assert {row["kind"]: row["rejected"] for row in sources} == {"drifters": 0, "radar": 0}
    assert all(row["rms_after"] < row["rms_before"] for row in sources)
    beside = run(ocean, tmp_path / "out.mcap", (*others, "glider.mcap"))
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
    assert set(result.observations["mean_current_kind"]) >= {"shear", "radar", "drifters"}
    rows = export(Contents(result), tmp_path / "surface.csv", table="surface")
    assert rows == {"surface": len(cells)}
    assert any("radars differ from the modes by a field of " in note for note in beside.notes)
    told = " ".join(map(str, estimate_sentences(beside)))
    assert all(f"{name}: " in told for name in ("geostrophic shear", "HF radar", "drifters"))
    denied = run(ocean, None, (*others, "glider.mcap"), without=["radar", "drifters"])
    assert [row["kind"] for row in denied.observations["sources"]] == ["shear"]
    content = inspect_logs(others, load_config(None))
    assert [info.content.surface for info in content] == [4, 11, 8]
    assert {info.use for info in content} == {"ready for replay: currents at the surface found"}


def test_after_radars_points_and_table_have_one_current_at_the_surface_and_one_error(
    ocean, totals, tmp_path
):
    run(ocean, tmp_path / "out.mcap", (totals,))
    result = open_result(tmp_path / "out.mcap")
    last = result.surface.loc[result.surface.index[-1]].dropna()
    names = ["u", "v", "u_standard_error", "v_standard_error"]

    def at(depth, **changes):
        estimate = replace(result.estimate, **changes)
        return estimate.velocity_at(last["longitude"], last["latitude"], depth).to_pandas()[names]

    found, before = at(0.0), at(0.0, surface=None)
    known = found["u"].notna().to_numpy()
    assert known.sum() > 20
    np.testing.assert_allclose(found[known], last[names][known], atol=2e-3)
    # below the first level it is the modes' alone, and later only the field's size is known
    np.testing.assert_array_equal(at(20.0), at(20.0, surface=None))
    old = result.estimate.surface.at(result.estimate.time_ns + 2 * 3600 * 10**9)
    later = at(0.0, surface=old)
    np.testing.assert_array_equal(later["u"], before["u"])
    grown = np.hypot(before["u_standard_error"], old.std)
    np.testing.assert_allclose(later["u_standard_error"], grown)
    here = last[["longitude", "latitude"]].iloc[0]
    for depth, told in ((5.0, True), (100.0, False)):
        assert ("what radars show" in words(result.plot.series(at=(*here, depth)))) == told


def test_recordings_that_overlap_hold_duplicates_that_contradict_nothing(tmp_path):
    forecast = synthetic.dataset(3, 8, (6, 10), LEVELS, west=151.7, south=-40.2)
    forecast.to_netcdf(tmp_path / "ensemble.nc", engine="h5netcdf")
    logs = tmp_path / "first.mcap", tmp_path / "second.mcap"
    for log, seconds in zip(logs, (range(0, 600, 30), range(300, 900, 30)), strict=True):
        both = [(k, one) for k in seconds for one in (fix(k), ping(k))]
        log.write_bytes(json_mcap([(k, one.topic, one.schema, one.payload) for k, one in both]))
    # this water is not the forecast's
    config = load_config(None, {"estimator": QUICK, "gating": {"gate": "off"}})
    found = replay(job_in(tmp_path, logs=logs), config)[0].observations
    assert (found["used"], found["rejected"]) == (30, 10)
    assert found["bins_rejected"] == {"duplicate": 30, "missing": 30}


@pytest.mark.full
def test_after_a_pause_the_surface_is_that_of_one_run(ocean, totals, tmp_path):
    settings = {"estimator": {"modes": 7}, "output": {"checkpoint_interval": 1.0}}
    job = job_in(ocean, tmp_path / "out.mcap", logs=(totals,))
    goes_on(job, load_config(None, settings), 3)
