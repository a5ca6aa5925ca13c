"""Where windows lie, what an estimator of windows does with measurements, and windows that follow several vehicles."""

from dataclasses import replace
from heapq import merge

import numpy as np
import pytest

from replay_kit.core.errors import ForecastError
from replay_kit.core.region import centre_of, inside_box, width_of
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.estimator.windows.placing import next_window, room_in
from tests.benchmarks.windows import QUICK, TINY, mission, sea, windowed

BOUNDS = (-20.0, 30.0, 20.0, 50.0)
WINDOW = (-2.0, 38.0, 2.0, 42.0)
MARGIN = 60_000.0


@pytest.mark.parametrize("place", [(0.0, 40.0), (1.6, 40.0), (0.0, 38.3), (-1.6, 41.7)])
def test_far_enough_from_the_sides_the_window_stays(place):
    assert next_window(WINDOW, MARGIN, BOUNDS, place) is None


@pytest.mark.parametrize(
    "place", [(1.8, 40.3), (-1.75, 39.0), (0.3, 41.8), (0.0, 38.1), (1.9, 41.9)]
)
def test_near_a_side_the_next_window_is_as_large_and_reaches_a_margin_and_a_half_behind(place):
    found = next_window(WINDOW, MARGIN, BOUNDS, place)
    assert found is not None
    assert width_of(found) == pytest.approx(4.0, abs=1e-3)
    assert found[3] - found[1] == pytest.approx(4.0, abs=1e-3)
    assert room_in(found, BOUNDS, place) > 1.4 * MARGIN
    ahead = np.sign(np.subtract(place, centre_of(WINDOW)))
    moved = np.subtract(centre_of(found), place)
    assert np.all(ahead * moved >= -1e-3)


def test_at_the_forecasts_own_side_no_window_has_more_room():
    at_edge = (16.0, 38.0, 20.0, 42.0)
    assert next_window(at_edge, MARGIN, BOUNDS, (19.99, 40.0)) is None
    assert next_window(at_edge, MARGIN, BOUNDS, (20.5, 40.0)) is None
    assert next_window(at_edge, MARGIN, BOUNDS, (19.99, 41.9)) == pytest.approx(
        (16.0, 40.8, 20.0, 44.8), abs=1.0
    )


def test_a_window_crosses_the_antimeridian():
    found = next_window(
        (175.0, -2.0, 179.0, 2.0), MARGIN, (-180.0, -90.0, 180.0, 90.0), (178.9, 0.0)
    )
    assert found is not None
    assert found[0] > found[2]
    assert inside_box(found, [178.9, -179.0], [0.0, 0.0]).all()


@pytest.fixture(scope="module")
def scene():
    of = sea(TINY)
    truth = of.part(None, slice(TINY.members, None))
    return of, mission(of, TINY, truth, 25_000.0)


def test_blocks_are_single_steps_and_windows_that_were_left_can_be_forgotten(scene):
    of, pings = scene
    estimator = windowed(of, TINY, pings[0], 25_000.0, QUICK)
    kept = brief = estimator.initial()
    flows = []
    for ping in pings:
        kept, _ = estimator.assimilate(kept, [ping])
        brief, _ = estimator.assimilate(brief, [ping])
        flows += estimator.left_flows(brief)
        brief = estimator.without_left(brief)
        assert brief.left == ()
    assert len(flows) == len(kept.left) == brief.number - 1 > 1
    assert estimator.remarks(brief) == estimator.remarks(kept)
    (last,), (same,) = (list(each.states.values()) for each in (brief, kept))
    assert np.array_equal(last.x, same.x)
    blocks, _ = estimator.assimilate(estimator.initial(), pings)
    assert [region for region, _ in blocks.left] == [region for region, _ in kept.left]
    (last,) = blocks.states.values()
    assert np.allclose(last.x, same.x, atol=1e-8)
    for one, other in zip(flows, estimator.left_flows(kept), strict=True):
        assert np.array_equal(one.latent, other.latent)


def test_one_measurement_far_away_does_not_move_the_window_but_three_do(scene):
    of, pings = scene
    estimator = windowed(of, TINY, pings[0], 25_000.0, QUICK)
    first, far = pings[:3], pings[-5:]
    state, steps = estimator.assimilate(estimator.initial(), [*first, far[0], *first])
    assert estimator.window(state) == estimator.first
    assert not state.strays
    assert steps[-1].innovation.decision != "unusable"
    state, _ = estimator.assimilate(estimator.initial(), [*first, *far])
    assert estimator.window(state) != estimator.first
    assert inside_box(estimator.window(state), far[-1].longitude, far[-1].latitude)


def test_a_window_that_cannot_be_made_leaves_the_vehicle_in_its_own_and_is_told(scene):
    of, pings = scene
    whole = windowed(of, TINY, pings[0], 25_000.0, QUICK)

    def only_first(region):
        if region != whole.first:
            raise ForecastError("every point of the first level is land")
        return whole.build(region)

    estimator = WindowedEstimator(whole.first, whole.margin, whole.bounds, only_first)
    state, _ = estimator.assimilate(estimator.initial(), pings)
    assert estimator.window(state) == whole.first
    assert any(
        "no window could be made at" in note and "is land" in note
        for note in estimator.remarks(state)
    )


@pytest.fixture(scope="module")
def fleet(scene):
    """An estimator whose window is at the west end of a strip, pings from there along its middle, and the window about a longitude."""
    of, pings = scene
    west = windowed(of, TINY, pings[0], 25_000.0, QUICK)
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


def test_vehicles_far_apart_are_each_as_alone(fleet):
    west, pings, about = fleet
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
        assert len(estimator.own_window(together).states) == len(alone.states) == 1


def test_each_measurement_counts_once_in_every_window_that_holds_it(fleet):
    west, pings, about = fleet
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


def test_a_vehicle_joins_the_window_that_holds_it_and_the_one_that_all_left_is_kept_once(fleet):
    west, pings, about = fleet
    east = west.of_vehicle(1, about(west.first[2]))
    events = [(1, next(ping for ping in pings if ping.longitude > west.first[2]))]
    state = estimates((west, east), [*events, *((0, ping) for ping in pings[:9])])
    (window,) = state.states
    assert (state.where, len(state.left), state.number) == ({1: window, 0: window}, 1, 2)
    assert state.left[0][0] == west.first
    assert west.without_left(state).left == ()
    assert len(list(west.left_flows(state))) == 1
    assert west.remarks(state)[0].startswith("2 windows followed the vehicles; up to")


def test_a_vehicle_whose_measurements_are_not_used_takes_its_window_with_it(fleet):
    west, pings, _ = fleet
    state = unused = west.initial()
    for ping in pings:
        state, unused = west.assimilate(state, [ping])[0], west.moved(unused, ping)
    assert [region for region, _ in unused.left] == [region for region, _ in state.left]
    prior = west.build(west.window(state))
    (own,) = unused.states.values()
    np.testing.assert_allclose(own.x, prior.initial().x, rtol=0.0, atol=1e-10)
