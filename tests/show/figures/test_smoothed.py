"""The section of a smoothed result shows the estimate before and after."""

from dataclasses import replace

import numpy as np

from replay_kit.results.views.along_track import BinsAlongTrack
from replay_kit.show.figures.section import QUANTITIES, limits_of, quantities_of


def test_a_section_shows_the_estimate_before_smoothing_where_there_is_one():
    estimated, residual, replayed, error = np.random.default_rng(0).normal(size=(4, 6, 2))
    times = np.arange(6)
    bins = BinsAlongTrack(
        times, times, times, estimated, residual, replayed, error, profiles=6, left_out=0
    )
    names, values = quantities_of(bins)
    assert names[1:5] == (
        *("estimated before smoothing", "smoothed"),
        *("measured minus before", "measured minus smoothed"),
    )
    measured = estimated + residual
    expected = measured, replayed, estimated, measured - replayed, residual, error
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    plain = replace(bins, replayed=np.full((6, 2), np.nan))
    assert quantities_of(plain)[0] == QUANTITIES
    sizes = [np.full((2, 3), value) for value in (0.1, 0.3, np.nan, 0.02, 0.04, 0.005)]
    assert limits_of(names, np.stack(sizes)) == [0.3, 0.3, 0.3, 0.04, 0.04, 0.005]
