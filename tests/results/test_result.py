"""A result as tables."""

from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import Odds, Place
from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results import ResultWriter
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import read_result
from tests.results.conftest import PLAN
from tests.results.result_samples import CONFIG, METADATA
from tests.synthetic_flow import TIME_NS, synthetic_flow

SECOND = 10**9


def at(*seconds):
    return [pd.Timestamp(TIME_NS + round(SECOND * each)) for each in seconds]


places = st.builds(Place, *[st.floats(-80.0, 80.0)] * 3)
flights = st.builds(Odds, st.integers(1, 99), *[st.floats()] * 6)


@settings(max_examples=25)
@given(places, st.text(), st.none() | flights, st.floats())
def test_a_plan_is_read_as_it_was_written(tmp_path_factory, place, text, odds, number):
    path, track = tmp_path_factory.mktemp("plan") / "out.mcap", np.array([[0.0] * 3, [5e2, 6e2, 5]])
    numbers = ("speed", "duration", "closest_approach", "energy", "battery")
    held = {"status": text, "message": text, **dict.fromkeys(numbers, number)}
    ways = {"track": track, "track_time": np.array([0.0, 1.5]), "bottom": np.array([number, 2.0])}
    plan = replace(PLAN, start=place, goal=place, via=(place,), odds=odds, **held, **ways)
    projection = synthetic_flow().grid.projection
    with ResultWriter(path) as writer:
        writer.start(projection, TIME_NS, METADATA, CONFIG)
        writer.plan(plan, projection)
    result = ResultFile(path)
    row = result.plans.iloc[0]
    for end in ("start", "goal"):
        held |= {f"{end}_{name}": value for name, value in asdict(place).items()}
    held |= {f"odds_{name}": getattr(odds, name, np.nan) for name in Odds.__slots__}
    np.testing.assert_equal({name: row[name] for name in held}, held)
    assert Contents(result).last_plan.via == plan.via
    tracks = result.plan_tracks
    assert (tracks.index - pd.Timestamp(plan.start_time_ns)).total_seconds().tolist() == [0.0, 1.5]
    places = to_geographic(projection, *track.T[:2])
    np.testing.assert_array_equal(tracks.T, [*places, track[:, 2], [0, 0], plan.bottom])


@pytest.fixture
def opened(flow, state, innovation, plan, tmp_path):
    """Three dives of profiles, the last rejected; a plan and a surfacing."""
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        writer.log(TIME_NS, "warning", "mind the gap")
        writer.fix(state)
        writer.fix(replace(state, time_ns=TIME_NS + SECOND, depth=np.nan, dead_reckoned=False))
        for second, about in (
            (0, {}),
            (2, {"nis": 6.5}),
            (3, {"dive": 5, "accepted": False, "decision": "rejected"}),
            (4, {"dive": 3, "innovation": 3.0 * innovation.innovation, "dof": 4, "nis": 9.0}),
        ):
            writer.innovations([replace(innovation, time_ns=TIME_NS + second * SECOND, **about)])
        writer.plan(plan, flow.grid.projection)
        predicted = Surfacing(TIME_NS + SECOND, 5.0, 62.0, Ellipse(5.0, 62.0, 300.0, 200.0, 10.0))
        writer.outcome(
            SurfacingOutcome(TIME_NS, predicted, TIME_NS + 5 * SECOND, 5.01, 62.01, 1234.5, 45.0)
        )
        writer.finish(flow)
    return read_result(tmp_path / "out.mcap")


def test_fixes_surfacings_and_events(opened, flow):
    assert opened.fixes.index.tolist() == at(0, 1)
    (one,) = opened.surfacings.itertuples()
    assert [one.Index, one.predicted_time] == at(5, 1)
    assert (one.predicted_longitude, one.actual_longitude, one.distance) == (5.0, 5.01, 1234.5)
    assert (one.delay, one.inside_ellipse, one.ellipse_bearing) == (4.0, False, 10.0)
    assert opened.events[["level", "message"]].to_numpy().tolist() == [["warning", "mind the gap"]]


def test_observations_and_their_dives(opened, innovation):
    table, dives = opened.observations, opened.dives
    rms = np.sqrt(np.nansum(innovation.innovation**2) / 6)
    expected = [rms, rms, rms, 3.0 * rms * np.sqrt(6 / 4)]
    np.testing.assert_allclose(table["rms_innovation"], expected, rtol=1e-6)
    np.testing.assert_allclose(table["rms_residual"].iloc[0], 0.1 * rms, rtol=1e-6)
    # a dive of which all was rejected is one, of nothing
    assert dives.index.tolist() == [2, 3, 5]
    assert (dives["profiles"].tolist(), dives["bins"].tolist()) == ([2, 1, 0], [6, 2, 0])
    np.testing.assert_equal(dives["nis_per_dof"].tolist(), [(5.5 + 6.5) / 12, 9.0 / 4, np.nan])
    np.testing.assert_allclose(dives["rms_innovation"], [rms, expected[3], np.nan], rtol=1e-6)
    assert dives["end"].tolist() == at(2, 4, 3)


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
    assert dives["start"].tolist() == at(5, 8, 0)
    assert dives["end"].tolist() == at(9, 8, 0)
    assert dives[["profiles", "mean_currents"]].to_numpy().tolist() == [[0, 1], [1, 0], [0, 1]]


def test_a_result_without_estimate_or_data_says_so_and_has_empty_tables(flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
    opened = read_result(tmp_path / "out.mcap")
    with pytest.raises(ForecastError, match="but no current: replay the log for an estimate"):
        _ = opened.estimate
    for name in ("fixes", "observations", "innovations", "plans", "plan_tracks", "surface"):
        assert len(getattr(opened, name)) == 0
    assert len(opened.surfacings) == len(opened.events) == 0
    assert opened.dives.columns.tolist()[:3] == ["start", "end", "profiles"]
