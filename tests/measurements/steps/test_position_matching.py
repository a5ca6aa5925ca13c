"""Pings that wait: any number of them, in any order, each ends in one event."""

import math

import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.measurements import Skipped, Used, finish, initial_state, interpret
from tests.measurements.samples import CONFIG, fix, only, ping, run

MANY = 1500


def test_many_pings_expire_at_once():
    """As many as would have ended a recursion."""
    waiting = [ping(0.1 * k) for k in range(MANY)]
    late = Message(5000 * 10**9, "/other", "std_msgs/String", {}, 0, 0)
    state = initial_state()
    for message in waiting:
        state, events = interpret(state, message, CONFIG)
        assert not events
    state, events = interpret(state, late, CONFIG)
    assert state.waiting == ()
    assert [event.reason for event in only(Skipped, events)[:-1]] == ["no position within 600 s"] * MANY
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
    state, events = interpret(initial_state(), ping(10**9), CONFIG)
    for k in range(100):
        state, more = interpret(state, ping(100.0 * k), CONFIG)
        events += more
    assert len(state.waiting) <= 9
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
    (observation,) = only(Observation, run([fix(0, 10.0, 0.001), ping(4), fix(10, -170.0, -0.001)]))
    assert math.isfinite(observation.longitude)
    assert math.isfinite(observation.latitude)
