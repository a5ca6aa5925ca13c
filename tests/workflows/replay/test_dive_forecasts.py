"""Expected surfacings in a replay: what they are made of, and that a dive's own fix does not enter."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, PathMean, Source
from replay_kit.core.surfacing import ellipse_of
from replay_kit.workflows.replay.surfacings.forecasts import (
    _CELL,
    ForecastState,
    Gathered,
    dive_mean,
    forecast_mean,
    next_surfacing,
)

WAY = np.array([0.15, 0.1])


def mean(k, velocity=(0.05, -0.02), seconds=7200):
    """Dive k of a straight course, two hours long, three hours after the one before."""
    begin = k * 3 * 3600 * 10**9
    start = Fix(begin, 5.0 + 0.01 * k, 62.0)
    longitude, latitude = to_geographic(
        Projection(start.longitude, start.latitude), *(seconds * (WAY + velocity))
    )
    end = Fix(begin + seconds * 10**9, float(longitude), float(latitude))
    two = np.array([0.0, 200.0])
    times = np.array([start.time_ns, end.time_ns])
    place = np.array([start.longitude, end.longitude]), np.array([start.latitude, end.latitude])
    source = Source(0, "/dac", k, end.time_ns)
    return PathMean(
        end.time_ns,
        times,
        *place,
        two,
        np.array([0.5, 0.5]),
        velocity,
        0.01,
        "dac",
        k + 1,
        source,
        (start, end),
    )


def test_profiles_are_averaged_by_depth_along_the_dive():
    sums = np.zeros((30, 3))
    sums[0], sums[20] = [2.0, 0.2, -0.4], [1.0, 0.3, 0.0]
    depths, found = (
        10.0 * _CELL * np.array([0.05, 2.05]),
        Gathered(mean(0).dive, sums).along(mean(0)),
    )
    expected = [
        np.interp([0.0, 200.0], depths, values).mean() for values in ([0.1, 0.3], [-0.2, 0.0])
    ]
    np.testing.assert_allclose(found, expected)
    assert Gathered(mean(0).dive, np.zeros((3, 3))).along(mean(0)) is None


def after(*means):
    state = ForecastState()
    for each in means:
        state, _ = forecast_mean(state, each)
    return state


def test_a_dives_mean_is_what_its_fixes_and_current_say():
    said = mean(0)
    found = dive_mean(Gathered(), said, np.empty((0, 2)))
    np.testing.assert_allclose(found.way, WAY, atol=1e-6)
    assert (found.seconds, found.inverted) == (7200.0, None)
    assert found.time_ns == sum(fix.time_ns for fix in said.fixes) // 2


def test_in_a_steady_current_surfacings_come_to_lie_where_they_were_expected():
    state = after(*(mean(k) for k in range(6)))
    distances = [one.distance for one in state.outcomes]
    assert [one.forecast.earlier for one in state.outcomes] == list(range(6))
    assert distances[0] == pytest.approx(7200.0 * np.hypot(0.05, 0.02), rel=1e-3)
    assert distances[-1] < 0.1 * distances[0]
    assert all(one.in_outer for one in state.outcomes)
    following = next_surfacing(state)
    expected = to_local(
        Projection(following.longitude, following.latitude), *state.outcomes[-1].fix[1:]
    )
    np.testing.assert_allclose(
        -np.array(expected), 7200.0 * (WAY + np.array([0.05, -0.02])), atol=30.0
    )


def test_a_dive_that_is_told_to_go_deeper_than_the_last_lasts_longer_and_leads_farther():
    state = after(*(replace(mean(k), deepest=400.0) for k in range(6)))
    usual, deeper = next_surfacing(state), next_surfacing(state, depth=600.0)
    begin = state.outcomes[-1].fix
    assert deeper.time_ns - begin.time_ns == pytest.approx(1.5 * (usual.time_ns - begin.time_ns))
    ways = [
        np.hypot(*to_local(Projection(*begin[1:]), one.longitude, one.latitude))
        for one in (usual, deeper)
    ]
    assert ways[1] == pytest.approx(1.5 * ways[0], rel=1e-3)


def test_the_current_of_a_dive_does_not_move_its_own_ellipse():
    before = after(mean(0), mean(1))
    plain, other = (
        forecast_mean(before, mean(2, velocity))[0].outcomes[-1]
        for velocity in ((0.05, -0.02), (-0.3, 0.4))
    )
    assert plain.forecast.outer.major == pytest.approx(other.forecast.outer.major)
    assert plain.forecast.longitude == pytest.approx(other.forecast.longitude, abs=1e-6)
    assert other.distance > plain.distance
    assert not other.in_outer


def test_how_the_vehicle_flew_comes_of_the_ways_through_the_water_and_not_of_the_currents():
    dives = [
        replace(mean(k, velocity), deepest=400.0)
        for k, velocity in enumerate([(0.0, 0.0), (0.3, 0.1), (-0.1, -0.4)])
    ]
    flown, down = after(*dives).as_flown, 2.0 * 400.0 / 7200.0
    assert (flown.dives, flown.depth, flown.duration) == (3, 400.0, 7200.0)
    assert flown.speed == pytest.approx(np.hypot(np.hypot(*WAY), down), abs=0.005)
    assert flown.glide_angle_deg == pytest.approx(
        np.rad2deg(np.arctan2(down, np.hypot(*WAY))), abs=0.5
    )
    # nor of what was taken from a mean current as the error of the flight model
    corrected = [replace(one, corrected=(0.5, 0.5)) for one in dives]
    assert after(*corrected).as_flown == flown
    assert after(mean(0)).as_flown is None


def test_a_mean_without_fixes_is_no_dive():
    assert after(replace(mean(0), fixes=None)).outcomes == ()
    assert next_surfacing(ForecastState()) is None


def test_an_ellipse_lies_along_the_largest_variance():
    along = np.array([np.sin(np.deg2rad(30.0)), np.cos(np.deg2rad(30.0))])
    cov = 100.0 * np.eye(2) + 9900.0 * np.outer(along, along)
    ellipse = ellipse_of(5.0, 62.0, cov, 2.0)
    assert (ellipse.major, ellipse.minor, ellipse.bearing_deg) == pytest.approx((200.0, 20.0, 30.0))
