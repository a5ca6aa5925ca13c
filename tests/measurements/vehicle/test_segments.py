"""Legs of a track: what they are, and that no track is too bad to be looked at."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.measurements.dives import legs_of
from tests.reference.segments import way_of

LEG, GAP, SURFACE = 10.0, 600.0, 3.0
MINUTE = 60 * 10**9


def of(depth, time_ns=None, gap=GAP):
    depth = np.array(depth, np.float64)
    times = np.arange(depth.size) * MINUTE if time_ns is None else time_ns
    return legs_of(np.array(times, np.int64), depth, SURFACE, LEG, gap)


FUTURE = np.arange(10) * MINUTE
FUTURE[3] = 10**18


@pytest.mark.parametrize(
    ("depth", "time_ns", "legs"),
    [
        (
            [0, 1, 20, 60, 40, 20, 50, 80, 30, 8, 1, 0, 30, 60, 30, 2],
            None,
            [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 0, 0, 5, 5, 6, 0],
        ),
        (
            [0, 30, 60, np.nan, 90, 50, 50, 20, 7, 0],
            np.array([0, 1, 2, 3, 4, 5, 5, 6, 7, 8]) * MINUTE,
            [0, 1, 1, 0, 1, 2, 0, 2, 2, 0],
        ),
        ([8.0, 12.0, 9.0], None, [0, 0, 0]),
        (
            [0, 20, 40, 60, 80, 100, 60, 20, 0],
            np.array([0, 1, 2, 3, 60, 61, 62, 63, 64]) * MINUTE,
            [0, 1, 1, 1, 2, 2, 3, 3, 0],
        ),
        ([0, 20, 40, 60, 80, 100, 60, 20, 8, 0], FUTURE, [0, 1, 1, 0, 0, 2, 2, 2, 2, 0]),
        *(
            (depth, None, [0] * len(depth))
            for depth in ([], [np.nan], [np.inf, -np.inf], [5.0], [0.0] * 4, [-20.0, -50.0, -20.0])
        ),
    ],
)
def test_legs_end_at_turns_gaps_and_the_surface(depth, time_ns, legs):
    assert of(depth, time_ns).tolist() == legs


def test_noise_smaller_than_a_leg_makes_no_turn():
    rng = np.random.default_rng(3)
    depth = 8.0 + 400.0 * np.sin(np.linspace(0.0, np.pi, 500)) + rng.uniform(-4.0, 4.0, 500)
    assert of(depth).max() == 2


@pytest.mark.parametrize(("seconds", "legs"), [(600, 1), (601, 2)])
def test_a_gap_is_longer_than_the_longest_time_between_samples_of_one_leg(seconds, legs):
    time_ns = np.array([0, 60, 120, 120 + seconds, 180 + seconds, 240 + seconds]) * 10**9
    assert of([0, 20, 40, 60, 80, 100], time_ns).max() == legs


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
