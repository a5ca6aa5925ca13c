"""Values taken out of results."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from replay_kit.core.geodesy import distance, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.surfacing import Ellipse
from replay_kit.results import ResultReader, ResultWriter
from replay_kit.results.views.along_track import (
    bins_along_track,
    mean_currents,
)
from replay_kit.results.views.history import EstimateHistory
from replay_kit.results.views.record import changed_settings, leaves
from replay_kit.results.views.slices import (
    calibration,
    error_through_time,
    information_by_dive,
    published_slices,
    slices_of,
)
from replay_kit.results.views.track import thinned, track_of
from replay_kit.show.figures.along_track import (
    QUANTITIES,
    limits_of,
    quantities_of,
)
from replay_kit.show.notebook import read_result
from tests.results.cases import one_bin
from tests.results.result_samples import CONFIG, METADATA
from tests.synthetic_flow import TIME_NS, synthetic_flow

SECOND = 10**9


@pytest.mark.parametrize(
    ("count", "most", "kept"),
    [(0, 3, []), (3, 3, [0, 1, 2]), (5, 3, [0, 2, 4]), (10, 2, [0, 9]), (4, 1, [0])],
)
def test_thinned_keeps_the_ends(count, most, kept):
    assert thinned(count, most).tolist() == kept


def test_a_track_is_sorted_and_measured():
    times = pd.to_datetime([TIME_NS + 2 * SECOND, TIME_NS, TIME_NS + SECOND])
    fixes = pd.DataFrame(
        {
            "longitude": [5.02, 5.0, 5.01],
            "latitude": 62.0,
            "depth": [1.0, np.nan, 3.0],
            "dead_reckoned": [0, 1, 1],
        },
        index=times,
    )
    track = track_of(fixes, Projection(5.0, 62.0))
    assert track.longitude.tolist() == [5.0, 5.01, 5.02]
    assert track.dead_reckoned.tolist() == [True, True, False]
    np.testing.assert_allclose(
        track.distance,
        [0.0, distance(5.0, 62.0, 5.01, 62.0), distance(5.0, 62.0, 5.02, 62.0)],
        rtol=1e-5,
    )
    east, north, along = track.at(
        np.array([TIME_NS - SECOND, TIME_NS + SECOND // 2, TIME_NS + 9 * SECOND])
    )
    np.testing.assert_allclose(east, [0.0, track.east[1] / 2, track.east[2]], atol=1e-6)
    np.testing.assert_allclose(along, [0.0, track.distance[1] / 2, track.distance[2]], atol=1e-6)
    np.testing.assert_allclose(north, [0.0, track.north[1] / 2, track.north[2]], atol=1e-6)
    empty = track_of(fixes.iloc[:0], Projection(5.0, 62.0))
    assert np.isnan(empty.at(np.array([TIME_NS]))).all()
    assert empty.distance.size == 0


def test_published_slices_are_those_of_the_flow(flow, tmp_path):
    later = replace(flow, latent=2.0 * flow.latent)
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        for k, value in enumerate((flow, later, flow)):
            writer.grids(TIME_NS + k * SECOND, value, (120.0, 0.5))
    slices = published_slices(ResultReader(tmp_path / "out.mcap"))
    assert slices is not None
    assert slices.depths.tolist() == [0.5, 120.0]
    assert slices.time_ns.tolist() == [TIME_NS, TIME_NS + SECOND, TIME_NS + 2 * SECOND]
    own = slices_of(flow, np.array([0.5, 120.0]))
    assert own.time_ns.tolist() == [TIME_NS]
    np.testing.assert_allclose(slices.fields[:, :1], own.fields, rtol=1e-6)
    np.testing.assert_allclose(slices.fields[:, 1, :2], 2.0 * own.fields[:, 0, :2], rtol=1e-6)
    np.testing.assert_array_equal(slices.east, own.east)
    np.testing.assert_array_equal(slices.north, own.north)
    np.testing.assert_allclose(
        own.fields[1, 0, :2, 2, 3], flow.velocity(own.east[3], own.north[2], 120.0), rtol=1e-12
    )
    np.testing.assert_allclose(
        own.fields[1, 0, 2:, 2, 3],
        flow.standard_error(own.east[3], own.north[2], 120.0),
        rtol=1e-12,
    )
    assert np.isnan(slices.fields[:, :, :, 0, 0]).all()
    few = published_slices(
        ResultReader(tmp_path / "out.mcap"), most_values=2 * 2 * slices.fields[0, 0].size
    )
    assert few is not None
    assert (few.time_ns.tolist(), few.left_out) == ([TIME_NS, TIME_NS + 2 * SECOND], 1)
    errors = error_through_time(slices)
    assert errors.shape == (2, 3)
    np.testing.assert_allclose(errors[1, 1] ** 2, np.nanmean(own.fields[1, 0, 2:] ** 2), rtol=1e-6)


def test_the_estimate_at_a_bin_is_what_was_measured_less_the_residual(
    flow, state, innovation, tmp_path
):
    place, later = {"longitude": 5.01, "latitude": 62.02}, TIME_NS + SECOND
    measured = 0.5 + innovation.innovation
    x = flow.unknowns.x + np.linspace(-1.0, 1.0, 12)
    moved = replace(flow, unknowns=replace(flow.unknowns, x=x))
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        writer.fix(replace(state, **place))
        first = replace(innovation, time_ns=TIME_NS, measured=measured)
        writer.innovations([first, replace(first, time_ns=later)])
        for dive in (2, 3):
            source = replace(innovation.source, topic="/dac")
            stated = {"mean_current": np.array([0.1, 0.2]), "mean_kind": "dac", "dive": dive}
            time_ns = TIME_NS + (dive + 1) * SECOND
            writer.innovations([one_bin(innovation, time_ns=time_ns, source=source, **stated)])
        writer.grids(later, moved, (0.5,))
        writer.grids(later + 1, synthetic_flow(seed=2), (0.5,))
        writer.finish(flow)
    result = read_result(tmp_path / "out.mcap")
    track = track_of(result.fixes, flow.grid.projection)
    history = EstimateHistory(result.reader, result.estimate)
    bins = bins_along_track(result.measured, track, history, result.estimate, 10)
    assert (bins.profiles, bins.left_out, bins.depth.tolist()) == (2, 0, [10.0, 20.0, 40.0] * 2)
    used = [0, 1, 3]
    expected = (measured - innovation.residual)[used]
    np.testing.assert_allclose(bins.estimated, [*expected, *expected], rtol=1e-6)
    np.testing.assert_array_equal(bins.residual[:3], innovation.residual[used])
    east, north = to_local(flow.grid.projection, 5.01, 62.02)
    np.testing.assert_allclose(
        bins.standard_error, flow.standard_error(east, north, bins.depth), rtol=1e-5
    )
    # the last one published of this basis
    before, *after = history.after(np.array([TIME_NS, later, later + 9]))
    assert before is None
    for one in after:
        latent = flow.unknowns.offset + flow.modes @ flow.unknowns.process.weights(x, 0).T
        np.testing.assert_allclose(one.latent, latent, atol=1e-6)
        assert one.time_ns == later
    thin = bins_along_track(result.measured, track, history, None, 1)
    assert (thin.profiles, thin.left_out) == (1, 1)
    assert np.isnan(thin.standard_error).all()
    means = mean_currents(result.measured)
    assert means.dive.tolist() == [2, 3]
    np.testing.assert_array_equal(means.residual, innovation.residual[[0, 0]])
    np.testing.assert_array_equal(means.standard_error, innovation.innovation_std[[0, 0]])
    assert information_by_dive(result.measured.sums).to_dict() == {2: 3 * 3.25, 3: 3.25}


def test_a_smoothed_result_keeps_the_estimate_before_smoothing(flow, state, innovation, tmp_path):
    before, innovation = (
        innovation.residual + np.array([0.01, -0.02]),
        replace(innovation, measured=innovation.innovation),
    )
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        writer.fix(state)
        writer.innovations([innovation])
        writer.innovations(
            [replace(innovation, time_ns=TIME_NS + SECOND, replayed_residual=before)]
        )
        writer.finish(flow)
    result = read_result(tmp_path / "out.mcap")
    table = result.innovations
    assert table["replayed_residual_east"].iloc[:4].isna().all()
    np.testing.assert_allclose(table["replayed_residual_north"].iloc[4:], before[:, 1], rtol=1e-6)
    bins = bins_along_track(
        result.measured,
        track_of(result.fixes, flow.grid.projection),
        EstimateHistory(result.reader, flow),
        flow,
        10,
    )
    assert np.isnan(bins.replayed[:3]).all()
    np.testing.assert_allclose(
        bins.replayed[3:], bins.estimated[3:] - np.array([0.01, -0.02]), atol=1e-6
    )
    names, values = quantities_of(bins)
    assert names[1:5] == (
        "estimated before smoothing",
        "smoothed",
        "measured minus before",
        "measured minus smoothed",
    )
    np.testing.assert_allclose(values[0], bins.estimated + bins.residual, rtol=1e-12)
    np.testing.assert_allclose(values[3][3:], before[[0, 1, 3]], atol=1e-6)
    np.testing.assert_array_equal(values[4], bins.residual)
    np.testing.assert_array_equal(values[5], bins.standard_error)
    assert (
        quantities_of(replace(bins, replayed=np.full_like(bins.replayed, np.nan)))[0] == QUANTITIES
    )
    limits = limits_of(
        names, np.stack([np.full((2, 3), value) for value in (0.1, 0.3, np.nan, 0.02, 0.04, 0.005)])
    )
    assert limits == [0.3, 0.3, 0.3, 0.04, 0.04, 0.005]


def test_calibration_counts_components():
    bins = pd.DataFrame(
        {
            "innovation_east": [0.5, -3.0, np.nan],
            "innovation_north": [2.5, 0.1, np.nan],
            "innovation_std_east": [1.0, 2.0, 1.0],
            "innovation_std_north": [1.0, 0.1, 1.0],
        }
    )
    found = calibration(bins)
    assert found.standardized.tolist() == [0.5, -1.5, 2.5, 1.0]
    assert found.coverage == {1.0: 0.5, 2.0: 0.75, 3.0: 1.0}
    assert found.mean == 0.625
    assert found.std == pytest.approx(np.std([0.5, -1.5, 2.5, 1.0]), rel=1e-12)
    assert calibration(bins.iloc[2:]).coverage == {}


def test_the_outline_of_an_ellipse_is_where_the_ellipse_ends():
    projection, ellipse = Projection(5.0, 62.0), Ellipse(5.1, 62.05, 900.0, 300.0, 30.0)
    outline = ellipse.outline(projection)
    np.testing.assert_array_equal(outline[0], outline[-1])
    centre = np.array(to_local(projection, 5.1, 62.05))
    for scale, inside in ((0.99, True), (1.01, False)):
        places = to_geographic(projection, *(centre + scale * (outline - centre)).T)
        assert all(
            ellipse.holds(float(lon), float(lat)) is inside
            for lon, lat in zip(*places, strict=True)
        )


def test_changed_settings_and_leaves():
    assert changed_settings("[estimator]\nmodes = 4\nnew = 1\n[planner]\nclearance = 20.0\n") == [
        ("estimator.modes", 4, 300),
        ("estimator.new", 1, None),
    ]
    assert list(leaves({"a": [1, {"b": None}], "c": "d"})) == [
        ("a.0", 1),
        ("a.1.b", None),
        ("c", "d"),
    ]
