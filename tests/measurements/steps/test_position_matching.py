"""Pings that wait: any number of them, in any order, each ends in one event."""

import math

import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.measurements.observed import begun
from tests.measurements.samples import (
    CONFIG,
    Skipped,
    Used,
    finish,
    fix,
    interpret,
    only,
    ping,
    reasons,
    run,
    the,
)

MANY = 1500


def test_many_pings_expire_at_once():
    """As many as would have ended a recursion."""
    waiting = [ping(0.1 * k) for k in range(MANY)]
    late = Message(5000 * 10**9, "/other", "std_msgs/String", {}, 0, 0)
    state = begun()
    for message in waiting:
        state, events = interpret(state, message, CONFIG)
        assert not events
    state, events = interpret(state, late, CONFIG)
    assert not sum(map(len, state.memory.waiting))
    assert [event.reason for event in only(Skipped, events)[:-1]] == [
        "no position within 600 s"
    ] * MANY
    assert not finish(state, CONFIG)


def test_many_pings_are_released_by_one_fix():
    events = run([fix(-1), *(ping(0.1 * k) for k in range(MANY)), fix(510, 152.01)])
    observed = only(Observation, events)
    assert len(observed) == MANY
    assert len(only(Used, events)) == MANY + 2
    assert [o.time_ns for o in observed] == sorted(o.time_ns for o in observed)


def test_pings_out_of_order_are_released_in_order_of_time():
    events = run([fix(0), ping(30), ping(10), ping(20), fix(25), fix(40)])
    assert [o.time_ns // 10**9 for o in only(Observation, events)] == [10, 20, 30]


def test_one_stamp_from_the_future_does_not_hold_up_the_others():
    state, events = interpret(begun(), ping(10**9), CONFIG)
    for k in range(100):
        state, more = interpret(state, ping(100.0 * k), CONFIG)
        events += more
    assert sum(map(len, state.memory.waiting)) <= 9
    assert len(only(Skipped, events)) >= 90


def test_a_ping_that_cannot_be_read_is_not_blamed_on_the_fix_that_releases_it():
    events = run([fix(0), ping(5, velocity_std=[[]] * 7), ping(6), fix(10)])
    assert [event.topic for event in only(Skipped, events)] == ["/adcp"]
    assert len(only(Observation, events)) == 1


@pytest.mark.parametrize("age", [1e-9, 1e300])
def test_any_age_that_the_configuration_takes(age):
    events = run([fix(0), ping(5), fix(10)], MeasurementConfig(position_max_age=age))
    assert len(only(Observation, events)) == (age > 1)


def test_fixes_on_opposite_sides_of_the_earth_give_the_nearer():
    observation = the(Observation, [fix(0, 10.0, 0.001), ping(4), fix(10, -170.0, -0.001)])
    assert math.isfinite(observation.longitude)
    assert math.isfinite(observation.latitude)


def _dive(**settings):
    """A dive of 4 h between fixes 0.06 degrees apart, with a ping each half hour; depths are known, positions only at its ends."""
    under = [ping(1800.0 * k, transducer_depth=100.0) for k in range(1, 8)]
    depths = [fix(60.0, 152.0, depth=20.0)]
    return run(
        [fix(0.0, depth=0.0), *depths, *under, fix(14_400.0, 152.06, depth=0.0)],
        MeasurementConfig(**settings),
    )


def test_pings_in_a_dive_are_placed_between_the_fixes_about_it():
    found = only(Observation, _dive())
    assert len(found) == 7
    # of the way from the position at 60 s
    share = [(1800.0 * k - 60.0) / 14_340.0 for k in range(1, 8)]
    assert [o.longitude for o in found] == pytest.approx(
        [152.0 + 0.06 * s for s in share], abs=1e-6
    )
    assert [o.position_std for o in found] == pytest.approx(
        [0.1 * 14_340.0 * s * (1.0 - s) for s in share]
    )


def test_a_longer_gap_than_allowed_loses_the_pings_of_a_dive():
    events = _dive(position_max_gap=14_339.0)
    assert len(only(Observation, events)) == 0
    assert reasons(events) == ["no position within 600 s"] * 7
    assert len(only(Observation, _dive(position_max_gap=14_341.0))) == 7


def test_a_ping_near_a_fix_has_no_error_of_its_place():
    assert [o.position_std for o in only(Observation, run([fix(0), ping(5), fix(10)]))] == [0.0]


def test_pings_at_the_surface_are_not_placed_across_a_gap():
    events = run([fix(0.0), ping(1800.0), fix(3600.0)])
    assert reasons(events) == ["no position within 600 s"]


def test_pings_of_a_dive_outlive_one_at_the_surface_before_it():
    early = [fix(0.0, depth=0.0), ping(700.0), fix(700.5, depth=20.0)]
    # the first ping has a position within its time; the next waits in the dive while a later message comes
    events = run(
        [
            *early,
            ping(2000.0, transducer_depth=100.0),
            ping(2700.0, transducer_depth=100.0),
            fix(6000.0, 152.1, depth=0.0),
        ]
    )
    assert [o.time_ns // 10**9 for o in only(Observation, events)] == [700, 2000, 2700]
