"""A section of a mission without profiles: the estimate along the track, and nothing said to be measured."""

import numpy as np

from replay_kit.results.views.along_track import estimate_along_track
from replay_kit.results.views.track import Track
from replay_kit.show.figures.along_track import gridded
from tests.synthetic_flow import synthetic_flow

HOUR = 3_600 * 10**9


class _History:
    """Nothing before the second hour; then the estimate."""

    def __init__(self, flow) -> None:
        self.flow = flow

    def after(self, times_ns):
        return (self.flow if time_ns >= 2 * HOUR else None for time_ns in times_ns)


def test_it_is_the_estimate_at_each_place_and_depth_once_there_is_one():
    flow = synthetic_flow()
    times = HOUR * np.arange(9)
    east, north = np.linspace(-9e3, 9e3, 9), np.linspace(-4e3, 5e3, 9)
    depth = np.array([0.0, 40.0, np.nan, 60.0, 0.0, 30.0, 50.0, 20.0, 0.0])
    track = Track(
        times,
        east,
        north,
        depth,
        east,
        north,
        np.hypot(east - east[0], north - north[0]),
        np.zeros(9, dtype=bool),
    )
    bins = estimate_along_track(track, _History(flow), flow)
    # down to the deepest position, not below the last level
    assert 0.0 < bins.depth.min() < bins.depth.max() < min(60.0, flow.levels[-1])
    known = bins.time_ns >= 2 * HOUR
    at_east, at_north, _ = track.at(bins.time_ns)
    for k in np.flatnonzero(known)[::97]:
        np.testing.assert_allclose(
            bins.estimated[k], flow.velocity(at_east[k], at_north[k], bins.depth[k]), atol=1e-12
        )
        np.testing.assert_allclose(
            bins.standard_error[k],
            flow.standard_error(at_east[k], at_north[k], bins.depth[k]),
            atol=1e-12,
        )
    assert np.isnan(bins.estimated[~known]).all()
    assert np.isfinite(bins.estimated[known]).all()
    assert np.isnan(bins.residual).all()
    values = gridded(bins).values
    # measured, estimated, measured minus estimated, standard error
    assert [bool(np.isfinite(one).any()) for one in values] == [False, True, False, True]


def test_a_track_outside_the_region_of_the_estimate_has_no_section():
    flow, times, far = synthetic_flow(), HOUR * np.arange(3, 6), np.full(3, 9e6)
    track = Track(times, far, far, np.full(3, 20.0), far, far, 0.0 * far, np.zeros(3, dtype=bool))
    bins = estimate_along_track(track, _History(flow), flow)
    assert (bins.time_ns.size, bins.depth.size, bins.estimated.shape, bins.profiles) == (
        0,
        0,
        (0, 2),
        0,
    )
