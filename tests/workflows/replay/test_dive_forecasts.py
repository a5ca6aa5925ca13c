"""Expected surfacings in a replay: of mean currents, and of displacements with the estimate's current and without."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, Observation, PathMean, Profiles, Source
from replay_kit.core.surfacing import ellipse_of
from replay_kit.results.outcome.parts import expected_part
from replay_kit.workflows.replay.steps import Step
from replay_kit.workflows.replay.surfacings import (
    ForecastState,
    Gathered,
    dive_mean,
    forecast_end,
    forecast_mean,
    forecast_step,
    next_surfacing,
)
from tests import synthetic
from tests.reference import mean_currents as slow
from tests.workflows.replay.given import position

WAY, CURRENT = np.array([0.15, 0.1]), (0.05, -0.02)
GRID = synthetic.ensemble(n_members=2).grid
LEVELS = np.array([0.0, 100.0, 400.0])
SECONDS, PAUSE, BELOW = 7200, 600, 10.0


def mean(k, velocity=CURRENT, ends=None, way=WAY):
    """The mean current of dive k of a straight course, two hours long, three hours after the one before."""
    if ends is None:
        begin, start = k * 3 * 3600 * 10**9, (5.0 + 0.01 * k, 62.0)
        end = map(float, to_geographic(Projection(*start), *(SECONDS * np.add(way, velocity))))
        ends = Fix(begin, *start), Fix(begin + SECONDS * 10**9, *end)
    time_ns, longitude, latitude = zip(*ends, strict=True)
    path = np.array(time_ns), np.array(longitude), np.array(latitude)
    rest = np.array([0.0, 200.0]), np.array([0.5, 0.5]), velocity, 0.01, "dac", k + 1
    return PathMean(time_ns[1], *path, *rest, Source(0, "/dac", k, time_ns[1]), ends)


def after(*means):
    state = ForecastState()
    for each in means:
        state = forecast_mean(state, each)
    return state


def test_profiles_are_averaged_by_depth_along_the_dive():
    sums = np.zeros((30, 3))
    sums[0], sums[20] = [2.0, 0.2, -0.4], [1.0, 0.3, 0.0]
    # the cells' middles are at 5 and 205 m, and the dive is at 0 and 200 m
    found = Gathered(mean(0).dive, sums).along(mean(0))
    np.testing.assert_allclose(found, np.mean([[0.1, -0.2], [0.295, -0.005]], axis=0))
    assert Gathered(mean(0).dive, np.zeros((3, 3))).along(mean(0)) is None


def test_a_dives_mean_is_what_its_fixes_and_current_say():
    said = mean(0)
    found = dive_mean(said, np.empty((0, 2)))
    np.testing.assert_allclose(found.way, WAY, atol=1e-6)
    assert (found.seconds, found.inverted) == (7200.0, None)
    assert found.time_ns == sum(fix.time_ns for fix in said.fixes) // 2
    assert after(replace(said, fixes=None)).outcomes == ()


def test_in_a_steady_current_surfacings_come_to_lie_where_they_were_expected():
    state = after(*(mean(k) for k in range(6)))
    distances = [one.distance for one in state.outcomes]
    assert [one.forecast.earlier for one in state.outcomes] == list(range(6))
    assert distances[0] == pytest.approx(7200.0 * np.hypot(*CURRENT), rel=1e-3)
    assert distances[-1] < 0.1 * distances[0]
    assert all(one.in_outer for one in state.outcomes)
    coming = next_surfacing(state)
    last = to_local(Projection(coming.longitude, coming.latitude), *state.outcomes[-1].fix[1:])
    np.testing.assert_allclose(-np.array(last), 7200.0 * np.add(WAY, CURRENT), atol=30.0)


def test_a_dive_that_is_told_to_go_deeper_than_the_last_lasts_longer_and_leads_farther():
    state = after(*(replace(mean(k), deepest=400.0) for k in range(6)))
    begin = state.outcomes[-1].fix
    (usual, way), (deeper, farther) = (
        (
            one.time_ns - begin.time_ns,
            np.hypot(*to_local(Projection(*begin[1:]), one.longitude, one.latitude)),
        )
        for one in (next_surfacing(state), next_surfacing(state, depth=600.0))
    )
    assert deeper == pytest.approx(1.5 * usual)
    assert farther == pytest.approx(1.5 * way, rel=1e-3)


def check_flown(flown, dives, depth):
    down = 2.0 * depth / SECONDS
    assert (flown.dives, flown.duration) == (dives, SECONDS)
    assert flown.speed == pytest.approx(np.hypot(np.hypot(*WAY), down), abs=0.006)
    angle = np.rad2deg(np.arctan2(down, np.hypot(*WAY)))
    assert flown.glide_angle_deg == pytest.approx(angle, abs=1.0)


def test_how_the_vehicle_flew_comes_of_the_ways_through_the_water_and_not_of_the_currents():
    currents = (0.0, 0.0), (0.3, 0.1), (-0.1, -0.4)
    dives = [replace(mean(k, one), deepest=400.0) for k, one in enumerate(currents)]
    flown = after(*dives).as_flown
    check_flown(flown, 3, 400.0)
    assert flown.depth == 400.0
    # nor of what was taken from a mean current as the error of the flight model
    corrected = [replace(one, corrected=(0.5, 0.5)) for one in dives]
    assert after(*corrected).as_flown == flown
    assert after(mean(0)).as_flown is None


def currents(n, std=0.08):
    """Of each dive, by level."""
    drawn = np.random.default_rng(0).normal(0.0, std, (n, 1, 2))
    return drawn * np.array([1.5, 1.0, 0.5])[:, None]


def mission(flows, begin=(-4000.0, -4000.0)):
    """Positions of dives down to 300 m and up, from fix to fix, each moved by the mean current along its path."""
    place, out = np.array(begin), []
    times, depths = np.array([0.0, 0.4 * SECONDS, SECONDS]), np.array([0.0, 300.0, 0.0])
    for k, current in enumerate(flows):
        end = place + SECONDS * (WAY + slow.mean_along(times, depths, LEVELS, current))
        for t in np.arange(0.0, SECONDS + 1.0, 600.0):
            at = map(float, to_geographic(GRID.projection, *(place if t < SECONDS else end)))
            under = 0.0 < t < SECONDS
            depth = np.interp(t, times, depths)
            out.append(position(k * (SECONDS + PAUSE) + t, *at, depth, under))
        place = end
    return out


def estimate(flows, asked=None):
    """An estimate that knows the current of the dive that begins next."""

    def at(time_ns):
        k = min(round(time_ns / ((SECONDS + PAUSE) * 1e9)), len(flows) - 1)

        def velocity(east, north, depth, true_axes):
            if asked is not None:
                asked.append((float(east), float(north)))
            return flows[k]

        return SimpleNamespace(grid=GRID, levels=LEVELS, velocity=velocity)

    return at


def followed(events, flow_at):
    """The state after events and the end of the log, and the outcomes that were written before it."""
    state = ForecastState()
    for event in events:
        given = Profiles.of([event]) if isinstance(event, Observation) else event
        state = forecast_step(state, Step(given, None, None), flow_at, BELOW, {})
    return forecast_end(state), state.outcomes


def stated(outcomes):
    """What the surfacings of a result and the next one are based on."""
    found = expected_part(outcomes, outcomes[-1].forecast)
    return {one["basis"] for one in (*found["each"], found["next"])}


def test_an_estimate_of_the_current_makes_the_ellipses_small():
    flows = currents(9)
    events = mission(flows)
    known, unknown = (
        followed(events, estimate(each))[0].outcomes for each in (flows, np.zeros_like(flows))
    )
    assert [one.forecast.dive for one in known] == list(range(1, 10))
    assert [one.forecast.earlier for one in known] == list(range(9))
    assert stated(known) == {"estimate"}
    assert all(one.distance < 150.0 for one in known[2:])
    small, large = (np.mean([one.forecast.radius for one in each[4:]]) for each in (known, unknown))
    assert small < 0.5 * large
    assert all(one.in_outer for one in known)


def test_neither_the_current_nor_the_end_of_a_dive_moves_its_own_ellipse():
    flows, before = currents(5), after(mean(0), mean(1))
    plain = mission(flows)
    other = [*plain[:-1], replace(plain[-1], longitude=plain[-1].longitude + 0.05)]
    by_means = (forecast_mean(before, mean(2, one)) for one in (CURRENT, (-0.3, 0.4)))
    by_fixes = (followed(events, estimate(flows))[0] for events in (plain, other))
    for states in (by_means, by_fixes):
        one, two = (state.outcomes[-1] for state in states)
        # nothing but the local scale about the place, which is the same
        assert two.forecast.outer.major == pytest.approx(one.forecast.outer.major)
        assert two.forecast.longitude == pytest.approx(one.forecast.longitude, abs=1e-6)
        assert two.distance > one.distance + 1000.0
        assert not two.in_outer


def test_what_is_taken_from_a_displacement_is_the_mean_along_the_path():
    (current,) = currents(1)
    mean = followed(mission([current]), estimate([current]))[0].last.mean
    along = slow.mean_along([0.0, 0.4 * SECONDS, SECONDS], [0.0, 300.0, 0.0], LEVELS, current)
    np.testing.assert_allclose(mean.backgrounds[0], along, atol=2e-3)
    np.testing.assert_allclose(mean.velocity, WAY + along, atol=2e-4)


def test_outside_the_region_displacements_alone_tell():
    far = mission(currents(6, std=0.01), begin=(4e5, 4e5))
    state, _ = followed(far, estimate(currents(6)))
    assert stated(state.outcomes) == {"displacements"}
    assert state.outcomes[-1].distance < 0.2 * state.outcomes[0].distance
    assert all(one.in_outer for one in state.outcomes)
    # there nothing tells a current from a way through the water
    assert state.as_flown is None


def test_the_current_of_the_next_dive_is_asked_for_halfway():
    flows, asked = currents(3), []
    events = mission(flows)
    # the last dive is concluded at the end of the log
    assert len(followed(events, estimate(flows, asked))[1]) == 2
    begin, end = (
        np.array(to_local(GRID.projection, each.longitude, each.latitude))
        for each in [one for one in events if not one.dead_reckoned][2:4]
    )
    np.testing.assert_allclose(asked[-1], end + 0.5 * (end - begin), atol=5.0)


def test_a_mean_current_takes_the_place_of_what_its_displacement_tells():
    flows = currents(3)
    events = mission(flows)
    n = len(events) // 3
    ends = tuple(
        Fix(one.time_ns, one.longitude, one.latitude) for one in (events[0], events[n - 1])
    )
    given = [*events[:n], mean(0, (0.1, 0.0), ends), *events[n:]]
    state, written = followed(given, estimate(flows))
    assert [one.forecast.basis for one in written] == ["mean_currents"]
    assert state.outcomes == written


def test_where_positions_have_no_depths_the_number_of_the_dive_tells():
    flows = currents(4)
    events, each = [], mission(flows)
    for k, event in enumerate(each):
        if not event.dead_reckoned:
            events.append(replace(event, depth=np.nan))
        elif k % 13 == 5:
            at, depth = (event.longitude, event.latitude), np.array([300.0])
            given = GRID, *to_local(GRID.projection, *at), depth, np.zeros((1, 2)), 0.1
            events.append(synthetic.profile(*given, event.time_ns, k // 13 + 1))
    outcomes = followed(events, estimate(flows))[0].outcomes
    # the last surfacing is seen with the next dive, which does not come
    assert [one.forecast.dive for one in outcomes] == [1, 2, 3]
    assert [one.forecast.earlier for one in outcomes] == [0, 1, 2]
    assert outcomes[0].forecast.start.time_ns == each[0].time_ns


def test_the_coming_surfacing_is_of_a_dive_like_the_last_in_the_estimates_current():
    flows = currents(8)
    state, _ = followed(mission(flows), estimate(flows))
    check_flown(state.as_flown, 8, 300.0)
    calm = SimpleNamespace(grid=GRID, levels=LEVELS, velocity=lambda *_, **__: np.zeros((3, 2)))
    coming = next_surfacing(state, calm)
    start, end = (
        np.array(to_local(GRID.projection, *at))
        for at in (state.outcomes[-1].fix[1:], (coming.longitude, coming.latitude))
    )
    np.testing.assert_allclose(end - start, SECONDS * WAY, atol=100.0)
    assert (coming.dive, coming.basis, coming.earlier) == (9, "estimate", 8)
    assert next_surfacing(ForecastState()) is None


def test_an_ellipse_lies_along_the_largest_variance():
    along = np.array([np.sin(np.deg2rad(30.0)), np.cos(np.deg2rad(30.0))])
    cov = 100.0 * np.eye(2) + 9900.0 * np.outer(along, along)
    ellipse = ellipse_of(5.0, 62.0, cov, 2.0)
    assert (ellipse.major, ellipse.minor, ellipse.bearing_deg) == pytest.approx((200.0, 20.0, 30.0))
