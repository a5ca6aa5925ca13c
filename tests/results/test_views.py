"""Values taken out of results."""

from dataclasses import replace

import numpy as np
import pandas as pd

from replay_kit.core.geodesy import distance, to_local
from replay_kit.core.grid import Projection
from replay_kit.results import ResultReader, ResultWriter
from replay_kit.results.views.along_track import (
    Track,
    bins_along_track,
    estimate_along_track,
    track_of,
)
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import (
    EstimateHistory,
    error_through_time,
    published_slices,
    slices_of,
)
from replay_kit.show.figures.trust import standardized
from replay_kit.show.notebook import read_result
from tests.results.cases import one_bin
from tests.results.result_samples import CONFIG, METADATA
from tests.synthetic_flow import TIME_NS, synthetic_flow

SECOND = 10**9


def test_a_track_is_sorted_and_measured():
    times = pd.to_datetime([TIME_NS + k * SECOND for k in (2, 0, 1)])
    places = {"longitude": [5.02, 5.0, 5.01], "latitude": 62.0, "depth": [1.0, np.nan, 3.0]}
    fixes = pd.DataFrame(places | {"dead_reckoned": [0, 1, 1]}, index=times)
    track = track_of(fixes, Projection(5.0, 62.0))
    assert track.dead_reckoned.tolist() == [True, True, False]
    lengths = [distance(5.0, 62.0, end, 62.0) for end in (5.0, 5.01, 5.02)]
    np.testing.assert_allclose(track.distance, lengths, rtol=1e-5)
    found = track.at(TIME_NS + SECOND * np.array([-2, 1, 18]) // 2)
    for values, each in zip(found, (track.east, track.north, track.distance), strict=True):
        np.testing.assert_allclose(values, [each[0], each[1] / 2, each[2]], atol=1e-6)
    empty = track_of(fixes.iloc[:0], Projection(5.0, 62.0))
    assert np.isnan(empty.at(np.array([TIME_NS]))).all()


def test_published_slices_are_those_of_the_flow(flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        for k in range(3):
            value = replace(flow, latent=(1.0 + k % 2) * flow.latent)
            writer.grids(TIME_NS + k * SECOND, value, (120.0, 0.5))
    reader, own = ResultReader(tmp_path / "out.mcap"), slices_of(flow, np.array([0.5, 120.0]))
    slices = published_slices(reader)
    assert slices.depths.tolist() == own.depths.tolist() == [0.5, 120.0]
    np.testing.assert_allclose(slices.fields[:, :1], own.fields, rtol=1e-6)
    np.testing.assert_allclose(slices.fields[:, 1, :2], 2.0 * own.fields[:, 0, :2], rtol=1e-6)
    few = published_slices(reader, most_values=2 * 2 * slices.fields[0, 0].size)
    assert (few.time_ns.tolist(), few.left_out) == ([TIME_NS, TIME_NS + 2 * SECOND], 1)
    errors = error_through_time(slices)
    assert errors.shape == (2, 3)
    np.testing.assert_allclose(errors[1, 1] ** 2, np.nanmean(own.fields[1, 0, 2:] ** 2), rtol=1e-6)


def test_the_estimate_at_a_bin_is_what_was_measured_less_the_residual(
    flow, state, innovation, tmp_path
):
    later, measured, used = TIME_NS + SECOND, 0.5 + innovation.innovation, [0, 1, 3]
    x = flow.unknowns.x + np.linspace(-1.0, 1.0, 12)
    moved = replace(flow, unknowns=replace(flow.unknowns, x=x))
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        writer.fix(state)
        first = replace(innovation, time_ns=TIME_NS, measured=measured)
        writer.innovations([first, replace(first, time_ns=later)])
        for dive in (2, 3):
            stated = {"mean_current": np.array([0.1, 0.2]), "mean_kind": "dac", "dive": dive}
            time_ns = TIME_NS + (dive + 1) * SECOND
            writer.innovations([one_bin(innovation, time_ns=time_ns, **stated)])
        writer.grids(later, moved, (0.5,))
        writer.grids(later + 1, synthetic_flow(seed=2), (0.5,))
        writer.finish(flow)
    contents = Contents(read_result(tmp_path / "out.mcap"))
    bins, means = contents.bins, contents.mean_currents
    assert (bins.profiles, bins.left_out, bins.depth.tolist()) == (2, 0, [10.0, 20.0, 40.0] * 2)
    expected = np.tile((measured - innovation.residual)[used], (2, 1))
    np.testing.assert_allclose(bins.values["estimated"], expected, rtol=1e-6)
    place = to_local(flow.grid.projection, state.longitude, state.latitude)
    error = flow.standard_error(*place, bins.depth)
    np.testing.assert_allclose(bins.values["error"], error, rtol=1e-5)
    # the last one published of this basis
    before, *after = contents.history.after(np.array([TIME_NS, later, later + 9]))
    assert before is None
    for one in after:
        latent = flow.unknowns.offset + flow.modes @ flow.unknowns.process.weights(x, 0).T
        np.testing.assert_allclose(one.latent, latent, atol=1e-6)
        assert one.time_ns == later
    without = EstimateHistory(contents.result.reader, None)
    thin = bins_along_track(contents.measured, contents.track, without, 1)
    assert (thin.profiles, thin.left_out) == (1, 1)
    assert np.isnan(thin.values["error"]).all()
    assert means["dive"].tolist() == [2, 3]
    std = means[["innovation_std_east", "innovation_std_north"]]
    np.testing.assert_array_equal(std, innovation.innovation_std[[0, 0]])
    known = contents.measured.sums.groupby("dive")["signal_dof"].sum()
    assert known.to_dict() == {2: 3 * 3.25, 3: 3.25}


def test_a_smoothed_result_keeps_the_estimate_before_smoothing(flow, state, innovation, tmp_path):
    off = np.array([0.01, -0.02])
    innovation = replace(innovation, measured=innovation.innovation)
    smoothed = {"time_ns": TIME_NS + SECOND, "replayed_residual": innovation.residual + off}
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        writer.fix(state)
        writer.innovations([innovation])
        writer.innovations([replace(innovation, **smoothed)])
        writer.finish(flow)
    values = Contents(read_result(tmp_path / "out.mcap")).bins.values
    assert np.isnan(values["replayed"][:3]).all()
    np.testing.assert_allclose(values["replayed"][3:], values["estimated"][3:] - off, atol=1e-6)


def test_calibration_counts_components():
    bins = pd.DataFrame(
        {
            "innovation_east": [0.5, -3.0, np.nan],
            "innovation_north": [2.5, 0.1, np.nan],
            "innovation_std_east": [1.0, 2.0, 1.0],
            "innovation_std_north": [1.0, 0.1, 1.0],
        }
    )
    assert standardized(bins).tolist() == [0.5, -1.5, 2.5, 1.0]
    assert standardized(bins.iloc[2:]).size == 0


HOUR = 3_600 * 10**9


class _History:
    """Nothing before the second hour; then the estimate."""

    def __init__(self, flow) -> None:
        self.flow = flow

    def after(self, times_ns):
        return (self.flow if time_ns >= 2 * HOUR else None for time_ns in times_ns)


def test_without_profiles_a_section_is_the_estimate_once_there_is_one(flow):
    times, reckoned = HOUR * np.arange(9), np.zeros(9, dtype=bool)
    east, north = np.linspace(-9e3, 9e3, 9), np.linspace(-4e3, 5e3, 9)
    depth = np.array([0.0, 40.0, np.nan, 60.0, 0.0, 30.0, 50.0, 20.0, 0.0])
    along = np.hypot(east - east[0], north - north[0])
    track = Track(times, east, north, depth, east, north, along, reckoned)
    bins = estimate_along_track(track, _History(flow), flow)
    # down to the deepest position, not below the last level
    assert 0.0 < bins.depth.min() < bins.depth.max() < min(60.0, flow.levels[-1])
    known = bins.time_ns >= 2 * HOUR
    place = (*(each[known] for each in track.at(bins.time_ns)[:2]), bins.depth[known])
    estimated, error = bins.values["estimated"], bins.values["error"]
    np.testing.assert_allclose(estimated[known], flow.velocity(*place), atol=1e-12)
    np.testing.assert_allclose(error[known], flow.standard_error(*place), atol=1e-12)
    for unknown in (estimated[~known], bins.values["residual"]):
        assert np.isnan(unknown).all()
    # nor has a track outside its region
    far = track._replace(east=east + 9e6)
    assert estimate_along_track(far, _History(flow), flow).values["estimated"].shape == (0, 2)
