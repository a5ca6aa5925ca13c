"""Legs of a track: what they are, and that no track is too bad to be looked at."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.measurements.track.dives import legs_of
from tests.reference.segments import way_of

LEG, GAP, SURFACE = 10.0, 600.0, 3.0
MINUTE = 60 * 10**9


def of(depth, time_ns=None, gap=GAP):
    depth = np.array(depth, np.float64)
    times = np.arange(depth.size) * MINUTE if time_ns is None else time_ns
    return legs_of(np.array(times, np.int64), depth, SURFACE, LEG, gap)


@pytest.mark.parametrize(
    ("depth", "minutes", "legs"),
    [
        ([0, 30, np.nan, 90, 50, 50, 7, 0], [0, 1, 3, 4, 5, 5, 7, 8], [0, 1, 0, 1, 2, 0, 2, 0]),
        # a gap as long as a leg's longest, and a longer one
        ([0, 20, 40, 60], [0, 1, 2, 12], [0, 1, 1, 1]),
        ([0, 20, 40, 60, 80], [0, 1, 2, 12.1, 13], [0, 1, 1, 2, 2]),
    ],
)
def test_legs_end_at_turns_gaps_and_the_surface(depth, minutes, legs):
    assert of(depth, np.array(minutes) * MINUTE).tolist() == legs


@given(st.lists(st.integers(7, 40), max_size=12))
def test_as_the_obvious_way_has_it(depth):
    """All below the surface, so that the legs alone decide."""
    found = of(depth)
    ways = np.array([way_of(depth, LEG, i) for i in range(len(depth))], int)
    assert (found > 0).tolist() == (ways != 0).tolist()
    for number in range(1, found.max(initial=0) + 1):
        assert len(set(ways[found == number].tolist())) == 1


TRACKS = st.lists(
    st.tuples(
        st.integers(-5, 1200),
        st.one_of(st.floats(-5.0, 200.0), st.sampled_from([np.nan, np.inf, 0.0])),
    ),
    max_size=40,
)


@given(TRACKS, st.integers(1, 1000))
def test_every_track_has_sound_legs(track, scale):
    """Numbers grow and have no holes; a change of the unit of time changes nothing."""
    steps, depth = ([pair[k] for pair in track] for k in (0, 1))
    time_ns = np.cumsum(np.array(steps, np.int64) * 10**9)
    found = of(depth, time_ns)
    inside = found[found > 0]
    assert set(np.diff(inside)) <= {0, 1}
    assert inside.size == 0 or inside[0] == 1
    assert np.array_equal(found, of(depth, time_ns * scale, GAP * scale))
