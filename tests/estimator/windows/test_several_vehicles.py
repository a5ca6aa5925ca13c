"""Windows that follow several vehicles: apart as if each were alone, together as one estimate, and each measurement in all that hold it."""

from dataclasses import replace
from heapq import merge

import numpy as np
import pytest

from tests.benchmarks.windows import QUICK, TINY, mission, sea, windowed

MARGIN = 25_000.0


@pytest.fixture(scope="module")
def scene():
    """An estimator whose window is at the west end of a strip, pings from there along its middle, and the window about a longitude."""
    of = sea(TINY)
    pings = mission(of, TINY, of.part(None, slice(TINY.members, None)), MARGIN)
    west = windowed(of, TINY, pings[0], MARGIN, QUICK)
    half = 0.5 * (west.first[2] - west.first[0])
    pings = [replace(ping, latitude=float(of.latitude.mean())) for ping in pings]
    return west, pings, lambda x: (x - half, west.first[1], x + half, west.first[3])


def at(number, ping):
    return replace(ping, time_ns=number * 10**9)


def estimates(estimators, events):
    """The state after measurements, each with the number of its vehicle."""
    state = estimators[0].initial()
    for number, ping in events:
        state, _ = estimators[number].assimilate(state, [ping])
    return state


def weights(estimator, state):
    return estimator.flow(state).latent


def test_vehicles_far_apart_are_each_as_alone(scene):
    west, pings, about = scene
    east = west.of_vehicle(1, about(pings[-1].longitude))
    own = [(0, at(2 * k, ping)) for k, ping in enumerate(pings[:5])]
    other = [(1, at(2 * k + 1, ping)) for k, ping in enumerate(pings[:-6:-1])]
    together = estimates((west, east), merge(own, other, key=lambda event: event[1].time_ns))
    assert list(together.where) == [0, 1]
    assert list(together.states) == list(together.where.values())
    for estimator, events in ((west, own), (east, other)):
        alone = estimates((west, east), events)
        np.testing.assert_allclose(
            weights(estimator, together), weights(estimator, alone), rtol=0.0, atol=1e-10
        )
        assert len(estimator.of_own(together).states) == len(alone.states) == 1


def test_each_measurement_counts_once_in_every_window_that_holds_it(scene):
    west, pings, about = scene
    other = west.of_vehicle(1, about(west.first[2] + 0.2))
    far = next(ping for ping in pings if ping.longitude > west.first[2] + 0.1)
    near = next(ping for ping in pings if ping.longitude > other.first[0] + 0.02)
    begun = estimates((west, other), [(0, pings[0]), (1, far)])
    assert len(begun.states) == 2
    state = estimates((west, other), [(0, pings[0]), (1, far), (0, near)])
    for (region, own), events in zip(
        state.states.items(), ([pings[0], near], [far, near]), strict=True
    ):
        one = west.build(region)
        expected, _ = one.assimilate(one.initial(), events)
        np.testing.assert_allclose(own.x, expected.x, rtol=0.0, atol=1e-10)


def test_a_vehicle_joins_the_window_that_holds_it_and_the_one_that_all_left_is_kept_once(scene):
    west, pings, about = scene
    east = west.of_vehicle(1, about(west.first[2]))
    events = [(1, next(ping for ping in pings if ping.longitude > west.first[2]))]
    state = estimates((west, east), [*events, *((0, ping) for ping in pings[:9])])
    (window,) = state.states
    assert (state.where, len(state.left), state.number) == ({1: window, 0: window}, 1, 2)
    assert state.left[0][0] == west.first
    assert west.without_left(state).left == ()
    assert len(list(west.left_flows(state))) == 1
    assert west.remarks(state)[0].startswith("2 windows followed the vehicles; up to")


def test_a_vehicle_whose_measurements_are_not_used_takes_its_window_with_it(scene):
    west, pings, _ = scene
    state = unused = west.initial()
    for ping in pings:
        state, unused = west.assimilate(state, [ping])[0], west.moved(unused, ping)
    assert [region for region, _ in unused.left] == [region for region, _ in state.left]
    prior = west.build(west.window(state))
    (own,) = unused.states.values()
    np.testing.assert_allclose(own.x, prior.initial().x, rtol=0.0, atol=1e-10)
