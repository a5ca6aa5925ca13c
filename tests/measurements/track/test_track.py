"""Dives, legs and places along a track: when dives begin and end, where pings that wait are placed, and a vessel's velocity."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import linregress

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Observation
from replay_kit.measurements.observed import new_stream
from replay_kit.measurements.track import positions
from replay_kit.measurements.track.dives import depths_of, legs_of, no_depths
from tests.measurements.samples import (
    CONFIG,
    SECOND,
    fix,
    interpret_block,
    only,
    ping,
    reasons,
    run,
)
from tests.reference.segments import way_of


def states(depths):
    order = np.arange(len(depths))
    found = depths_of(no_depths(), [(order, np.array(depths), True)], 3.0)
    at = np.searchsorted(found["order"], order, side="right") - 1
    return [(bool(found["submerged"][k]), int(found["dive"][k])) for k in at]


@pytest.mark.parametrize(
    ("depths", "found"),
    [
        # begins below twice the surface depth, and ends at the surface depth
        ([0.0, 50.0, 5.0, 50.0, 3.5, 6.5], [(False, 0)] + [(True, 1)] * 5),
        ([50.0, 2.9, 5.0, 6.5], [(True, 1), (False, 1), (False, 1), (True, 2)]),
        ([0.0, -1.0, 6.0, 6.001], [(False, 0)] * 3 + [(True, 1)]),
        ([50.0, 3.001, 3.0], [(True, 1), (True, 1), (False, 1)]),
        ([np.nan, 50.0, np.nan], [(False, 0), (True, 1), (True, 1)]),
    ],
)
def test_a_dive_ends_at_the_surface_depth_and_not_at_twice_of_it(depths, found):
    assert states(depths) == found


LEG, GAP, SURFACE = 10.0, 600.0, 3.0
MINUTE = 60 * 10**9


def legs(depth, time_ns=None, gap=GAP):
    depth = np.array(depth, np.float64)
    times = np.arange(depth.size) * MINUTE if time_ns is None else time_ns
    return legs_of(np.array(times, np.int64), depth, SURFACE, LEG, gap)


@pytest.mark.parametrize(
    ("depth", "minutes", "expected"),
    [
        ([0, 30, np.nan, 90, 50, 50, 7, 0], [0, 1, 3, 4, 5, 5, 7, 8], [0, 1, 0, 1, 2, 0, 2, 0]),
        # a gap as long as a leg's longest, and a longer one
        ([0, 20, 40, 60], [0, 1, 2, 12], [0, 1, 1, 1]),
        ([0, 20, 40, 60, 80], [0, 1, 2, 12.1, 13], [0, 1, 1, 2, 2]),
    ],
)
def test_legs_end_at_turns_gaps_and_the_surface(depth, minutes, expected):
    assert legs(depth, np.array(minutes) * MINUTE).tolist() == expected


@given(st.lists(st.integers(7, 40), max_size=12))
def test_as_the_obvious_way_has_it(depth):
    """All below the surface, so that the legs alone decide."""
    found = legs(depth)
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
    found = legs(depth, time_ns)
    inside = found[found > 0]
    assert set(np.diff(inside)) <= {0, 1}
    assert inside.size == 0 or inside[0] == 1
    assert np.array_equal(found, legs(depth, time_ns * scale, GAP * scale))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.lists(st.integers(0, 600), min_size=2, max_size=9, unique=True), st.permutations(range(8))
)
def test_pings_in_any_order_are_placed_between_the_fixes_about_them(seconds, order):
    seconds = np.sort(seconds)
    longitude = 179.9998 + 1e-5 * np.arange(seconds.size) ** 2
    fixes = [fix(t, (x + 180.0) % 360.0 - 180.0) for t, x in zip(seconds, longitude, strict=True)]
    at = np.linspace(*seconds[[0, -1]], 8).round()
    pings = [ping(at[k]) for k in order]
    found = only(Observation, run([fixes[0], *pings, *fixes[1:]]))
    assert [one.time_ns for one in found] == (at * 1e9).round().astype(int).tolist()
    expected = np.interp(at, seconds, longitude)
    np.testing.assert_allclose([one.longitude % 360.0 for one in found], expected, atol=1e-6)
    assert [one.position_std for one in found] == [0.0] * 8


def test_one_stamp_from_the_future_does_not_hold_up_the_others():
    pings = [ping(10**9), *(ping(100.0 * k) for k in range(100))]
    state, events = interpret_block(new_stream(), pings, CONFIG)
    assert sum(map(len, state.memory.waiting)) <= 9
    assert sum(len(reasons(each)) for each in events) >= 90


@pytest.mark.parametrize("age", [1e-9, 1e300])
def test_any_age_that_the_configuration_takes(age):
    events = run([fix(0), ping(5), fix(10)], MeasurementConfig(position_max_age=age))
    assert len(only(Observation, events)) == (age > 1)


def _dive(**settings):
    """A dive of 4 h between fixes 0.06 degrees apart, with a ping each half hour; depths are known, positions only at its ends."""
    under = [ping(1800.0 * k, transducer_depth=100.0) for k in range(1, 8)]
    depths = [fix(60.0, 152.0, depth=20.0)]
    return run(
        [fix(0.0, depth=0.0), *depths, *under, fix(14_400.0, 152.06, depth=0.0)],
        MeasurementConfig(**settings),
    )


def test_pings_in_a_dive_are_placed_between_the_fixes_about_it():
    found = only(Observation, _dive(position_max_gap=14_341.0))
    # of the way from the position at 60 s
    share = (1800.0 * np.arange(1, 8) - 60.0) / 14_340.0
    assert [o.longitude for o in found] == pytest.approx(152.0 + 0.06 * share, abs=1e-6)
    expected = 0.1 * 14_340.0 * share * (1.0 - share)
    assert [o.position_std for o in found] == pytest.approx(expected)
    assert reasons(_dive(position_max_gap=14_339.0)) == ["no position within 600 s"] * 7


def test_pings_at_the_surface_are_not_placed_across_a_gap():
    events = run([fix(0.0), ping(1800.0), fix(3600.0)])
    assert reasons(events) == ["no position within 600 s"]


def test_pings_of_a_dive_outlive_one_at_the_surface_before_it():
    early = [fix(0.0, depth=0.0), ping(700.0), fix(700.5, depth=20.0)]
    # the first ping has a position within its time; the next waits in the dive while a later message comes
    later = [ping(t, transducer_depth=100.0) for t in (2000.0, 2700.0)]
    found = only(Observation, run([*early, *later, fix(6000.0, 152.1, depth=0.0)]))
    assert [o.time_ns // 10**9 for o in found] == [700, 2000, 2700]


HOME = Projection(152.0, -40.0)


def track(since, east, north, home=HOME):
    times = np.round(np.asarray(since) * SECOND).astype(np.int64)
    longitude, latitude = to_geographic(home, east, north)
    return {
        **positions.no_rows(),
        "time": times,
        "longitude": longitude,
        "latitude": latitude,
        "submerged": np.zeros(times.size, bool),
        "dead_reckoned": np.zeros(times.size, bool),
    }


def vessel_velocity(time, fixes):
    """Return east, north and error; None for none."""
    all_of_them = np.full(1, fixes["time"].size)
    (found,) = positions.vessel_velocity(np.array([time]), fixes, all_of_them)
    return (
        None
        if np.isnan(found).all()
        else SimpleNamespace(east=found[0], north=found[1], error_std=found[2])
    )


def test_the_velocity_and_its_error_are_those_of_two_lines_through_the_fixes_within_twenty_seconds():
    rng = np.random.default_rng(3)
    seconds = np.sort(rng.uniform(0.0, 300.0, 90))
    place = seconds[:, None] * np.array([1.2, -0.4]) + rng.normal(0.0, 2.0, (90, 2))
    fixes = track(seconds, *place.T, Projection(20.0, 60.0))
    for time in range(30, 300, 30):
        found = vessel_velocity(time * SECOND, fixes)
        near = np.abs(seconds - time) <= 20.0
        lines = [linregress(seconds[near], part) for part in place[near].T]
        assert_allclose((found.east, found.north), [line.slope for line in lines], atol=1e-3)
        # one variance for both components: each line has n - 2 degrees of freedom, the two together twice as many
        expected = np.sqrt(np.mean([line.stderr**2 for line in lines]))
        assert found.error_std == pytest.approx(expected, rel=1e-3)


def test_fixes_on_a_line_have_the_error_of_their_rounding():
    since = np.arange(-5.0, 6.0)
    found = vessel_velocity(0, track(since, 2.0 * since, 0.0 * since))
    assert found.error_std == pytest.approx(0.5 / np.sqrt(since @ since), rel=1e-6)


@pytest.mark.parametrize(
    ("since", "known"),
    [
        ([-20, 0, 20], True),
        ([-21, 0, 20], False),
        ([-2, -1, 0], True),
        ([-3, -2, -1], False),
        ([1, 2, 3], False),
    ],
)
def test_three_fixes_on_both_sides_are_needed(since, known):
    away = np.array(since, np.float64)
    assert (vessel_velocity(0, track(since, away, away)) is not None) == known
