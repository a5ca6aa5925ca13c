"""A glider that steers for waypoints: against still water, uniform currents and currents too strong."""

import numpy as np
import pytest

from replay_kit.results.views.steering import (
    Dives,
    GriddedCurrents,
    fly_to_waypoints,
    gridded_currents,
)

DIVES = Dives(0.5, 30.0, 100.0, 0.0, 10.0, 1e6)
ALONG, DIVE = 0.5 * np.cos(np.pi / 6), 200.0 / 0.25


def uniform(*flows: tuple[float, float]) -> GriddedCurrents:
    velocity = np.array(flows)[:, None, :, None, None] * np.ones((len(flows), 2, 2, 3, 4))
    return GriddedCurrents(np.array([0.0, 200.0]), 1e4 * np.arange(4), 1e4 * np.arange(3), velocity)


def test_still_water_takes_the_straight_way():
    assert DIVES.along == pytest.approx(ALONG, rel=1e-12)
    assert DIVES.duration == pytest.approx(DIVE, rel=1e-12)
    corner, goal = np.array([3_000.0, 4_000.0]), np.array([3_000.0, 4_500.0])
    found = fly_to_waypoints(uniform((0.0, 0.0)), 0, DIVES, np.zeros(2), [corner, goal])
    assert found.arrived
    assert found.duration == pytest.approx(5_500.0 / ALONG, rel=1e-9)
    assert found.miss == pytest.approx(0.0, abs=1e-6)
    # 5 km are 14.4 dives, 500 m 1.4
    assert len(found.surfacings) == 1 + 15 + 2
    np.testing.assert_allclose(found.surfacings[1], ALONG * DIVE * np.array([0.6, 0.8]), rtol=1e-9)
    np.testing.assert_allclose(found.surfacings[15], corner, atol=1e-6)


def test_a_current_across_and_along_is_cancelled():
    goal = np.array([0.0, 5_000.0])
    across = fly_to_waypoints(uniform((0.2, 0.0)), 0, DIVES, np.zeros(2), [goal])
    assert across.duration == pytest.approx(5_000.0 / np.sqrt(ALONG**2 - 0.04), rel=1e-9)
    np.testing.assert_allclose(across.surfacings[:, 0], 0.0, atol=1e-6)
    behind = fly_to_waypoints(uniform((0.0, 0.1)), 0, DIVES, np.zeros(2), [goal])
    assert behind.duration == pytest.approx(5_000.0 / (ALONG + 0.1), rel=1e-9)


def test_a_sample_is_met_with_the_expectation_of_the_mean():
    currents, goal = uniform((0.0, 0.0), (0.1, 0.0)), np.array([0.0, 5_000.0])
    found = fly_to_waypoints(currents, 1, DIVES, np.zeros(2), [goal])
    # the first dive drifts away unseen, from the second on the current is known
    np.testing.assert_allclose(found.surfacings[1], [0.1 * DIVE, ALONG * DIVE], rtol=1e-9)
    ahead, flown = goal - found.surfacings[1], found.surfacings[2:] - found.surfacings[1]
    np.testing.assert_allclose(ahead[0] * flown[:, 1] - ahead[1] * flown[:, 0], 0.0, atol=1e-3)
    assert found.arrived
    short = fly_to_waypoints(currents, 1, DIVES, np.zeros(2), [np.array([0.0, 0.5 * ALONG * DIVE])])
    # a first dive of half the depth misses by its drift, a second corrects it
    assert len(short.surfacings) == 3
    np.testing.assert_allclose(short.surfacings[1], [0.05 * DIVE, 0.5 * ALONG * DIVE], rtol=1e-9)
    assert short.miss < 1e-6


def test_too_strong_a_current_is_given_up():
    dives = Dives(0.5, 30.0, 100.0, 60.0, 10.0, 5.5 * (DIVE + 60.0))
    found = fly_to_waypoints(
        uniform((0.0, -1.0)),
        0,
        dives,
        np.array([0.0, 2e4]),
        [np.array([0.0, 2.1e4]), np.array([1e4, 2e4])],
    )
    assert not found.arrived
    assert found.duration == pytest.approx(6.0 * (DIVE + 60.0), rel=1e-12)
    np.testing.assert_allclose(
        found.surfacings[-1], [0.0, 2e4 - 6.0 * ((1.0 - ALONG) * DIVE + 60.0)], rtol=1e-9
    )
    assert found.miss == pytest.approx(np.hypot(1e4, found.surfacings[-1][1] - 2e4), rel=1e-12)


def test_currents_are_linear_between_points_and_constant_beyond(flow):
    depths, east, north = (
        np.array([0.0, 50.0, 200.0]),
        np.array([0.0, 10.0, 20.0]),
        np.array([-5.0, 5.0]),
    )
    z, y, x = np.meshgrid(depths, north, east, indexing="ij")
    velocity = np.stack([1.0 + 0.1 * x - 0.2 * y + 0.01 * z, 2.0 - 0.3 * x], axis=1)[None]
    currents = GriddedCurrents(depths, east, north, velocity)
    for e, n, d in ((3.0, 1.0, 20.0), (20.0, 5.0, 200.0), (15.0, -5.0, 120.0)):
        np.testing.assert_allclose(
            currents.at(0, np.array([e, n]), d),
            [1.0 + 0.1 * e - 0.2 * n + 0.01 * d, 2.0 - 0.3 * e],
            rtol=1e-12,
        )
    np.testing.assert_allclose(
        currents.at(0, np.array([99.0, -99.0]), 999.0),
        currents.at(0, np.array([20.0, -5.0]), 200.0),
        rtol=1e-12,
    )
    one = GriddedCurrents(depths[:1], east, north, velocity[:, :1])
    np.testing.assert_allclose(one.at(0, np.array([3.0, 1.0]), 70.0), [1.1, 1.1], rtol=1e-12)
    gridded = gridded_currents(flow, flow.levels, 2, 7)
    assert gridded.velocity.shape == (3, 3, 2, 5, 7)
    place = float(gridded.east[3]), float(gridded.north[2])
    for k, each in enumerate((flow, *flow.sample(2, 7))):
        np.testing.assert_allclose(
            gridded.at(k, np.array(place), 50.0), each.velocity(*place, 50.0), rtol=1e-9
        )
    assert (gridded.velocity[:, :, :, 0, 0] == 0.0).all()
