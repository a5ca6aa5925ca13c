"""A result as tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from replay_kit import open_result
from replay_kit.core.errors import ForecastError, LogError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results import ResultWriter
from replay_kit.show.notebook import Result, read_result
from tests.results.cases import failed
from tests.results.result_samples import CONFIG, METADATA
from tests.synthetic_flow import TIME_NS

SECOND = 10**9


@pytest.fixture
def opened(
    flow: FlowEstimate, state: VehicleState, innovation: Innovation, plan: Plan, tmp_path: Path
) -> Result:
    """Two dives of two profiles, one of them rejected; two plans and a surfacing."""
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        writer.log(TIME_NS, "warning", "mind the gap")
        writer.fix(state)
        writer.fix(replace(state, time_ns=TIME_NS + SECOND, depth=np.nan, dead_reckoned=False))
        rejected = replace(
            innovation, time_ns=TIME_NS + 3 * SECOND, accepted=False, decision="rejected"
        )
        louder = replace(
            innovation,
            time_ns=TIME_NS + 4 * SECOND,
            dive=3,
            innovation=3.0 * innovation.innovation,
            dof=4,
            nis=9.0,
        )
        for value in (
            innovation,
            replace(innovation, time_ns=TIME_NS + 2 * SECOND, nis=6.5),
            rejected,
            louder,
        ):
            writer.innovations([value])
        writer.plan(plan, flow.grid.projection)
        writer.plan(failed(plan), flow.grid.projection)
        predicted = Surfacing(TIME_NS + SECOND, 5.0, 62.0, Ellipse(5.0, 62.0, 300.0, 200.0, 10.0))
        writer.outcome(
            SurfacingOutcome(TIME_NS, predicted, TIME_NS + 5 * SECOND, 5.01, 62.01, 1234.5, 45.0)
        )
        writer.finish(flow)
    return read_result(tmp_path / "out.mcap")


def test_fixes(opened):
    fixes = opened.fixes
    assert fixes.index.tolist() == [pd.Timestamp(TIME_NS), pd.Timestamp(TIME_NS + SECOND)]
    assert fixes["longitude"].tolist() == [5.01, 5.01]
    assert fixes["latitude"].tolist() == [62.02, 62.02]
    np.testing.assert_array_equal(fixes["depth"], [12.5, np.nan])
    assert fixes["dead_reckoned"].tolist() == [True, False]


def test_observations_and_their_bins(opened, innovation):
    table, bins = opened.observations, opened.innovations
    assert table["decision"].tolist() == ["accepted", "accepted", "rejected", "accepted"]
    assert table["dive"].tolist() == [2, 2, 2, 3]
    assert table["gate_threshold"].tolist() == [20.5] * 4
    assert table.index[0] == pd.Timestamp(innovation.time_ns)
    assert table["source_time"].iloc[0] == pd.Timestamp(TIME_NS + 4)
    rms = np.sqrt(np.nansum(innovation.innovation**2) / 6)
    np.testing.assert_allclose(
        table["rms_innovation"], [rms, rms, rms, 3.0 * rms * np.sqrt(6 / 4)], rtol=1e-6
    )
    np.testing.assert_allclose(table["rms_residual"].iloc[0], 0.1 * rms, rtol=1e-6)
    np.testing.assert_allclose(table["rms_prior_innovation"].iloc[0], 2.0 * rms, rtol=1e-6)
    assert len(bins) == 16
    first = bins[bins["observation"] == 0]
    assert first["depth"].tolist() == [10.0, 20.0, 30.0, 40.0]
    np.testing.assert_array_equal(
        first[["innovation_east", "innovation_north"]], innovation.innovation
    )
    assert first["flags"].tolist() == [1, 1, 9, 1]
    assert first["reasons"].tolist() == [0, 0, 1, 0]
    assert (first.index == pd.Timestamp(innovation.time_ns)).all()


def test_a_dive_with_a_mean_current_alone_begins_at_the_fix_before_it(
    tmp_path, flow, state, innovation
):
    current = {"mean_current": np.array([0.1, 0.2]), "mean_kind": "dac"}
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        for second, reckoned in ((0, False), (5, False), (6, True), (9, False)):
            writer.fix(replace(state, time_ns=TIME_NS + second * SECOND, dead_reckoned=reckoned))
        for second, dive, more in ((9, 1, current), (8, 2, {}), (0, 3, current)):
            writer.innovations(
                [replace(innovation, time_ns=TIME_NS + second * SECOND, dive=dive, **more)]
            )
    dives = read_result(tmp_path / "out.mcap").dives
    # a profile begins when it was measured; so does a mean current without a fix before it
    for name, seconds in (("start", [5, 8, 0]), ("end", [9, 8, 0])):
        assert dives[name].tolist() == [pd.Timestamp(TIME_NS + each * SECOND) for each in seconds]


def test_dives_count_what_was_used(opened, innovation):
    dives = opened.dives
    assert dives.index.tolist() == [2, 3]
    assert dives["profiles"].tolist() == [2, 1]
    assert dives["bins"].tolist() == [6, 2]
    assert dives["nis_per_dof"].tolist() == [(5.5 + 6.5) / 12, 9.0 / 4]
    np.testing.assert_allclose(
        dives["rms_innovation"], opened.observations["rms_innovation"].iloc[[0, 3]], rtol=1e-12
    )
    assert dives["start"].iloc[0] == pd.Timestamp(innovation.time_ns)
    assert dives["end"].iloc[0] == pd.Timestamp(TIME_NS + 2 * SECOND)


def test_plans_their_tracks_and_surfacings(opened, plan, flow):
    assert opened.plans["status"].tolist() == ["reached", "failed"]
    assert opened.plans["goal_latitude"].tolist() == [62.05, 62.05]
    assert opened.plans["heading_deg"].iloc[0] == 45.0
    tracks = opened.plan_tracks
    assert tracks["plan"].tolist() == [0, 0, 0]
    assert tracks.index.tolist() == [
        pd.Timestamp(plan.start_time_ns + hours * 1800 * SECOND) for hours in range(3)
    ]
    longitude, latitude = to_geographic(flow.grid.projection, plan.track[:, 0], plan.track[:, 1])
    np.testing.assert_array_equal(
        tracks[["longitude", "latitude", "depth"]],
        np.column_stack([longitude, latitude, plan.track[:, 2]]),
    )
    (surfacing,) = opened.surfacings.itertuples()
    assert (surfacing.predicted_longitude, surfacing.actual_longitude, surfacing.distance) == (
        5.0,
        5.01,
        1234.5,
    )
    assert (surfacing.delay, surfacing.inside_ellipse, surfacing.Index) == (
        4.0,
        False,
        pd.Timestamp(TIME_NS + 5 * SECOND),
    )
    assert surfacing.predicted_time == pd.Timestamp(TIME_NS + SECOND)


def test_events_and_estimate(opened, flow):
    assert opened.events["level"].tolist() == ["warning"]
    assert opened.events["message"].tolist() == ["mind the gap"]
    np.testing.assert_array_equal(opened.estimate.latent, flow.latent)
    assert opened.estimate is opened.estimate
    assert repr(opened).splitlines() == [
        "Result out.mcap, 2023-11-14 22:13:20Z to 2023-11-14 22:13:25Z",
        "  estimate; tables fixes (2), plans (2), surfacings (1), events (1), observations, innovations, dives, plan_tracks",
    ]


def test_a_result_without_estimate_or_data_says_so_and_has_empty_tables(flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
    opened = read_result(tmp_path / "out.mcap")
    assert "no estimate; tables fixes (0)" in repr(opened)
    with pytest.raises(
        ForecastError,
        match="its fixes, innovations and plans can be read, but no current: replay the log for an estimate",
    ):
        _ = opened.estimate
    for name in (
        "fixes",
        "observations",
        "innovations",
        "dives",
        "plans",
        "plan_tracks",
        "surface",
        "surfacings",
        "events",
    ):
        assert len(getattr(opened, name)) == 0
    assert opened.dives.columns.tolist()[:3] == ["start", "end", "profiles"]


def test_other_files_are_refused(run, tmp_path):
    with pytest.raises(LogError, match="cannot read the result: No such file"):
        read_result(tmp_path / "none.mcap")
    path = run(tmp_path / "out.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(
        LogError, match=r"expected a complete result of replay-kit replay.*convert recovers"
    ):
        read_result(cut)
    with pytest.warns(UserWarning, match=r"LOST: cut\.mcap: cut inside a record"):
        assert len(open_result(cut).fixes) == len(read_result(path).fixes)
    with ResultWriter(tmp_path / "bare.mcap") as writer:
        writer.log(1, "info", "a log of somebody")
    with pytest.raises(LogError, match=r"no metadata record 'contract'.*open a log with open_log"):
        read_result(tmp_path / "bare.mcap")
