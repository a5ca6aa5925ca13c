"""Legs flown in many currents at once: against an adaptive twin, one at a time, in currents that change."""

from dataclasses import replace

import numpy as np
import pytest

from planners.simulation.currents import currents_of
from planners.simulation.fly import DRIFT_STEPS, Legs, fly_leg
from planners.vehicle import Glider
from tests.planners.flow_samples import eddying_flow
from tests.reference.mission import fly_leg_slowly

VEHICLE = Glider()


def drawn(seed, count):
    """Return places [m], headings and glide angles [rad]."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-8e3, 8e3, (count, 2))
    return places, rng.uniform(0.0, 2.0 * np.pi, count), np.deg2rad(rng.uniform(16.0, 30.0, count))


@pytest.mark.parametrize("turns", [(80.0, 300.0, 120.0), (0.0, 250.0)])
def test_legs_end_where_an_adaptive_method_ends_them_in_the_flow_itself(turns):
    flow, (places, headings, angles) = eddying_flow(3, speed=0.25), drawn(1, 3)
    legs = Legs(headings, angles, np.array(turns)[:, None], np.zeros(3))
    path = fly_leg(currents_of(flow), VEHICLE, (places, np.zeros(3)), legs, 16)
    slow = [
        fly_leg_slowly(flow, *one, VEHICLE.speed, turns)
        for one in zip(places, headings, angles, strict=True)
    ]
    np.testing.assert_allclose(path.places[-1], slow, atol=0.5)
    np.testing.assert_allclose(path.times[-1], np.abs(np.diff(turns)).sum() / 0.3 / np.sin(angles))


def test_gliders_with_depths_of_their_own_fly_as_each_alone_and_drift_with_the_surface():
    flow, (places, headings, angles) = eddying_flow(4, speed=0.2), drawn(2, 3)
    currents, drift = currents_of(flow), np.array([0.0, 600.0, 1200.0])
    turns = np.array([[0.0, 0.0, 40.0], [390.0, 150.0, 220.0], [0.0, 0.0, 0.0]])
    legs = Legs(headings, angles, turns, drift)
    together = fly_leg(currents, VEHICLE, (places, np.zeros(3)), legs, 12)
    for k in range(3):
        one = np.s_[k : k + 1]
        alone = Legs(headings[one], angles[one], turns[:, one], drift[one])
        path = fly_leg(currents, VEHICLE, (places[one], np.zeros(1)), alone, 12)
        np.testing.assert_allclose(together.places[-1, k], path.places[-1, 0], atol=0.3)
        adrift = path.places[-1, 0] - path.places[-1 - DRIFT_STEPS, 0]
        surface = flow.velocity(*path.places[-1 - DRIFT_STEPS, 0], 0.0)
        np.testing.assert_allclose(adrift, surface * drift[k], atol=5.0)


def test_a_current_between_two_times_is_the_mean_of_both_for_each_glider_at_its_own_time():
    first, last = (replace(eddying_flow(k, speed=0.2), time_ns=k * 10**14) for k in (0, 1))
    changing, halves = currents_of((first, last)), np.array([0.0, 2.5e4, 5e4, 2e5])
    places = drawn(5, 4)[0]
    of_levels = changing.weights(np.full(4, 100.0))
    found = changing.velocity(places, of_levels, halves)
    share = np.clip(halves / 1e5, 0.0, 1.0)[:, None]
    each = [np.array([flow.velocity(*at, 100.0) for at in places]) for flow in (first, last)]
    np.testing.assert_allclose(found, (1.0 - share) * each[0] + share * each[1], atol=1e-9)
