"""Pings that wait: any number of them, in any order, each ends in one event."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation
from replay_kit.measurements.observed import begun
from tests.measurements.samples import (
    CONFIG,
    fix,
    interpret_block,
    only,
    ping,
    reasons,
    run,
)


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
    state, events = interpret_block(begun(), pings, CONFIG)
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
