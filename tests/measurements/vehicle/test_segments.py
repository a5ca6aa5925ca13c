"""Dives, yos and profiles of a track: what they are, and that no track is too bad to be looked at."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.measurements.vehicle.dives import SegmentClass, segments
from tests.reference.segments import way_of

LEG, GAP, SURFACE = 10.0, 600.0, 3.0
MINUTE = 60 * 10**9


def of(depth, time_ns=None, gap=GAP):
    depth = np.array(depth, np.float64)
    time_ns = (
        np.arange(depth.size, dtype=np.int64) * MINUTE
        if time_ns is None
        else np.array(time_ns, np.int64)
    )
    return segments(time_ns, depth, SURFACE, LEG, gap)


def test_two_dives_of_two_yos_and_one():
    found = of([0, 1, 20, 60, 40, 20, 50, 80, 30, 8, 1, 0, 30, 60, 30, 2])
    assert found.dive.tolist() == [0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 2, 2, 2, 0]
    assert found.yo.tolist() == [0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 0, 0, 3, 3, 3, 0]
    assert found.profile.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 0, 0, 5, 5, 6, 0]
    assert found.direction.tolist() == [0, 0, 1, 1, -1, -1, 1, 1, -1, -1, 0, 0, 1, 1, -1, 0]
    assert found.apogees.tolist() == [3, 7, 13]
    assert found.surfacings.tolist() == [10, 15]


def test_noise_smaller_than_a_leg_makes_no_turn():
    rng = np.random.default_rng(3)
    depth = 8.0 + 400.0 * np.sin(np.linspace(0.0, np.pi, 500)) + rng.uniform(-4.0, 4.0, 500)
    found = of(depth)
    assert found.profile.max() == 2
    assert abs(int(found.apogees[0]) - 250) < 30


def test_what_cannot_be_told_is_counted_and_leaves_the_rest():
    depth = [0, 30, 60, np.nan, 90, 50, 50, 20, 7, 0]
    time_ns = np.array([0, 1, 2, 3, 4, 5, 5, 6, 7, 8]) * MINUTE
    found = of(depth, time_ns)
    assert found.direction.tolist() == [0, 1, 1, 0, 1, -1, 0, -1, -1, 0]
    assert [found.count(what) for what in SegmentClass] == [6, 2, 1, 1, 0]
    assert of([8.0, 12.0, 9.0]).sample_class.tolist() == [SegmentClass.UNDETERMINED] * 3


def test_a_leg_ends_at_a_gap_and_the_dive_goes_on():
    found = of(
        [0, 20, 40, 60, 80, 100, 60, 20, 0], np.array([0, 1, 2, 3, 60, 61, 62, 63, 64]) * MINUTE
    )
    assert found.profile.tolist() == [0, 1, 1, 1, 2, 2, 3, 3, 0]
    assert found.dive.max() == 1
    assert found.yo.tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 0]


@pytest.mark.parametrize(("seconds", "legs"), [(600, 1), (601, 2)])
def test_a_gap_is_longer_than_the_longest_time_between_samples_of_one_leg(seconds, legs):
    time_ns = np.array([0, 60, 120, 120 + seconds, 180 + seconds, 240 + seconds]) * 10**9
    assert of([0, 20, 40, 60, 80, 100], time_ns).profile.max() == legs


def test_a_stamp_from_the_future_costs_one_leg_its_middle():
    time_ns = np.arange(10) * MINUTE
    time_ns[3] = 10**18
    found = of([0, 20, 40, 60, 80, 100, 60, 20, 8, 0], time_ns)
    assert found.direction.tolist() == [0, 1, 1, 0, 0, -1, -1, -1, -1, 0]
    assert found.sample_class[[3, 4, 5]].tolist() == [
        SegmentClass.UNDETERMINED,
        SegmentClass.TIME_BACK,
        SegmentClass.LEG,
    ]


@pytest.mark.parametrize(
    "depth", [[], [np.nan], [np.inf, -np.inf], [5.0], [0.0] * 4, [-20.0, -50.0, -20.0]]
)
def test_tracks_without_legs(depth):
    found = of(depth)
    assert found.profile.tolist() == [0] * len(depth)
    assert found.apogees.size == found.surfacings.size == 0


@given(st.lists(st.integers(7, 40), max_size=12))
def test_as_the_obvious_way_has_it(depth):
    """All below the surface, so that the legs alone decide."""
    assert of(depth).direction.tolist() == [way_of(depth, LEG, i) for i in range(len(depth))]


TRACKS = st.lists(
    st.tuples(
        st.integers(-5, 1200),
        st.one_of(st.floats(-5.0, 200.0), st.sampled_from([np.nan, np.inf, 0.0])),
    ),
    max_size=40,
)


@given(TRACKS, st.integers(1, 1000))
def test_every_track_has_sound_segments(track, scale):
    """Each sample in one profile at most; numbers grow and have no holes; a change of the unit of time changes nothing."""
    steps, depth = ([pair[k] for pair in track] for k in (0, 1))
    time_ns = np.cumsum(np.array(steps, np.int64) * 10**9)
    found = of(depth, time_ns)
    for numbers in (found.dive, found.yo, found.profile):
        inside = numbers[numbers > 0]
        assert set(np.diff(inside)) <= {0, 1}
        assert inside.size == 0 or inside[0] == 1
    assert np.array_equal(found.profile > 0, found.sample_class == SegmentClass.LEG)
    assert np.array_equal(found.direction != 0, found.profile > 0)
    assert not found.profile[found.dive == 0].any()
    for number in range(1, found.profile.max(initial=0) + 1):
        assert (
            len(
                {
                    (found.dive[k], found.yo[k], found.direction[k])
                    for k in np.flatnonzero(found.profile == number)
                }
            )
            == 1
        )
    scaled = of(depth, time_ns * scale, GAP * scale)
    for name in ("dive", "yo", "profile", "direction", "sample_class", "surfacings", "apogees"):
        assert np.array_equal(getattr(found, name), getattr(scaled, name))
