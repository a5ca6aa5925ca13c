"""Expected surfacings of a log without mean currents: from displacements, with the estimate's current and without."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.observation import (
    Fix,
    Flag,
    Observation,
    PathMean,
    Profiles,
    Source,
)
from replay_kit.results.outcome.parts import expected_part
from replay_kit.workflows.replay.surfacings.forecasts import (
    ForecastState,
    forecast_end,
    forecast_step,
    next_surfacing,
)
from tests import synthetic
from tests.reference import mean_currents as slow
from tests.workflows.replay.given import position

GRID = synthetic.ensemble(n_members=2).grid
LEVELS = np.array([0.0, 100.0, 400.0])
WAY = np.array([0.15, 0.1])
SECONDS, PAUSE, BELOW = 7200, 600, 10.0
SOURCE = Source(0, "/vehicle", 0, 0)


def currents(n, seed=0, std=0.08):
    """Of each dive, by level."""
    drawn = np.random.default_rng(seed).normal(0.0, std, (n, 1, 2))
    return drawn * np.array([1.5, 1.0, 0.5])[:, None]


def at(seconds, place, depth, reckoned):
    longitude, latitude = (float(value) for value in to_geographic(GRID.projection, *place))
    return position(seconds, longitude, latitude, depth, reckoned)


def dive(k, place, current, way=WAY):
    """Positions of a dive down to 300 m and up, from fix to fix; the current is the path's mean."""
    begin = k * (SECONDS + PAUSE)
    times, depths = np.array([0.0, 0.4 * SECONDS, SECONDS]), np.array([0.0, 300.0, 0.0])
    end = place + SECONDS * (way + slow.mean_along(times, depths, LEVELS, current))
    under = [
        at(begin + t, place, np.interp(t, times, depths), True)
        for t in np.arange(600.0, SECONDS, 600.0)
    ]
    return [
        at(begin, place, 0.0, False),
        *under,
        at(begin + SECONDS, end, 0.0, False),
    ], end


def mission(flows, begin=(-4000.0, -4000.0), way=WAY):
    place, out = np.array(begin), []
    for k, current in enumerate(flows):
        positions, place = dive(k, place, current, way)
        out += positions
    return out


def estimate(flows):
    """An estimate that knows the current of the dive that begins next."""

    def at(time_ns):
        k = min(round(time_ns / ((SECONDS + PAUSE) * 1e9)), len(flows) - 1)
        return SimpleNamespace(
            grid=GRID, levels=LEVELS, velocity=lambda east, north, depth, true_axes: flows[k]
        )

    return at


def followed(events, flow_at, state=None):
    state = ForecastState() if state is None else state
    written = []
    for event in events:
        given = Profiles.of([event]) if isinstance(event, Observation) else event
        state, ended = forecast_step(state, given, None, flow_at, BELOW)
        written += ended
    return state, written


def expected(events, flow_at):
    return forecast_end(followed(events, flow_at)[0])[0].outcomes


def stated(outcomes):
    """What a result states of surfacings and of the next one."""
    found = expected_part(outcomes, outcomes[-1].forecast)
    return [*found["each"], found["next"]]


def test_an_estimate_of_the_current_makes_the_ellipses_small():
    flows = currents(9)
    events = mission(flows)
    known, unknown = (expected(events, estimate(each)) for each in (flows, np.zeros_like(flows)))
    assert [one.forecast.earlier for one in known] == list(range(9))
    assert {one["basis"] for one in stated(known)} == {"estimate"}
    assert all(one.distance < 150.0 for one in known[2:])
    assert np.mean([one.forecast.radius for one in known[4:]]) < 0.5 * np.mean(
        [one.forecast.radius for one in unknown[4:]]
    )
    assert all(one.in_outer for one in known)


def test_what_is_taken_from_a_displacement_is_the_mean_along_the_path():
    (current,) = currents(1)
    state, _ = followed(mission([current]), estimate([current]))
    mean = forecast_end(state)[0].last.mean
    along = slow.mean_along([0.0, 0.4 * SECONDS, SECONDS], [0.0, 300.0, 0.0], LEVELS, current)
    np.testing.assert_allclose(mean.backgrounds[0], along, atol=2e-3)
    np.testing.assert_allclose(mean.velocity, WAY + along, atol=2e-4)


def test_how_the_vehicle_flew_is_what_the_estimate_leaves_of_its_displacements():
    flows = currents(5)
    state = forecast_end(followed(mission(flows), estimate(flows))[0])[0]
    down = 2.0 * 300.0 / SECONDS
    assert state.as_flown.speed == pytest.approx(np.hypot(np.hypot(*WAY), down), abs=0.006)
    assert state.as_flown.glide_angle_deg == pytest.approx(
        np.rad2deg(np.arctan2(down, np.hypot(*WAY))), abs=1.0
    )
    assert (state.as_flown.dives, state.as_flown.duration) == (5, SECONDS)
    # outside the region nothing tells a current from a way through the water
    far = mission(flows, begin=(4e5, 4e5))
    assert forecast_end(followed(far, estimate(flows))[0])[0].as_flown is None


def test_outside_the_region_displacements_alone_tell():
    far = mission(currents(6, std=0.01), begin=(4e5, 4e5))
    outcomes = expected(far, estimate(currents(6)))
    assert {one["basis"] for one in stated(outcomes)} == {"displacements"}
    assert outcomes[-1].distance < 0.2 * outcomes[0].distance
    assert all(one.in_outer for one in outcomes)


def test_the_end_of_a_dive_does_not_move_its_own_ellipse():
    flows = currents(5)
    plain = mission(flows)
    other = [*plain[:-1], replace(plain[-1], longitude=plain[-1].longitude + 0.05)]
    one, two = (expected(events, estimate(flows))[-1] for events in (plain, other))
    # nothing but the local scale about the place, which is the same
    assert repr(one.forecast) == repr(two.forecast)
    assert two.distance > one.distance + 1000.0


def test_a_dive_is_concluded_when_the_next_begins_or_the_log_ends():
    flows = currents(3)
    events, flow_at = mission(flows), estimate(flows)
    per_dive = len(events) // 3
    state, written = followed(events[: per_dive + 1], flow_at)
    assert (written, state.outcomes) == ([], ())
    state, written = followed(events[per_dive + 1 : per_dive + 2], flow_at, state)
    assert len(written) == len(state.outcomes) == 1
    state, written = followed(events[per_dive + 2 :], flow_at, state)
    state, last = forecast_end(state)
    assert len(written) == len(last) == 1
    assert [one.forecast.dive for one in state.outcomes] == [1, 2, 3]


def test_the_current_of_the_next_dive_is_asked_for_halfway():
    flows, asked = currents(3), []

    def flow_at(time_ns):
        flow = estimate(flows)(time_ns)

        def velocity(east, north, depth, true_axes):
            asked.append((float(east), float(north)))
            return flows[0]

        return SimpleNamespace(grid=flow.grid, levels=flow.levels, velocity=velocity)

    events = mission(flows)
    followed(events, flow_at)
    fixes = [each for each in events if not each.dead_reckoned]
    begin, end = (
        np.array(to_local(GRID.projection, each.longitude, each.latitude)) for each in fixes[2:4]
    )
    np.testing.assert_allclose(asked[-1], end + 0.5 * (end - begin), atol=5.0)


def test_a_mean_current_takes_the_place_of_what_its_displacement_tells():
    flows = currents(3)
    events, flow_at = mission(flows), estimate(flows)
    per_dive = len(events) // 3
    first, end = events[0], events[per_dive - 1]
    fixes = tuple(Fix(each.time_ns, each.longitude, each.latitude) for each in (first, end))
    two = np.array([0.0, 200.0])
    mean = PathMean(
        end.time_ns,
        np.array([first.time_ns, end.time_ns]),
        two,
        two,
        two,
        two / 200.0,
        (0.1, 0.0),
        0.01,
        "dac",
        1,
        SOURCE,
        fixes,
    )
    state, written = followed([*events[:per_dive], mean, *events[per_dive:]], flow_at)
    assert [one.forecast.basis for one in written] == ["mean_currents"]
    assert forecast_end(state)[0].outcomes == tuple(written)


def test_where_positions_have_no_depths_the_number_of_the_dive_tells():
    flows = currents(4)
    events, flow_at = [], estimate(flows)
    for k, event in enumerate(mission(flows)):
        if not event.dead_reckoned:
            events.append(replace(event, depth=np.nan))
        elif k % 13 == 5:
            number, one = k // 13 + 1, np.ones(1)
            flags = np.full(1, Flag.GOOD, np.int8)
            reasons = np.zeros(1, np.int32)
            here = (event.time_ns, event.longitude, event.latitude)
            events.append(
                Observation(
                    *here,
                    300.0 * one,
                    np.zeros((1, 2)),
                    0.1 * one,
                    "earth",
                    flags,
                    reasons,
                    number,
                    SOURCE,
                )
            )
    outcomes = expected(events, flow_at)
    # the last surfacing is seen with the next dive, which does not come
    assert [one.forecast.dive for one in outcomes] == [1, 2, 3]
    assert [one.forecast.earlier for one in outcomes] == [0, 1, 2]
    ends = [event.time_ns for event in mission(flows) if not event.dead_reckoned]
    assert all(ends[2 * k] == one.forecast.start.time_ns for k, one in enumerate(outcomes[:1]))


def test_a_vessel_at_the_surface_has_no_surfacings():
    fixes = [at(60.0 * k, (100.0 * k, 0.0), 0.0, False) for k in range(20)]
    assert expected(fixes, estimate(currents(1))) == ()
    assert next_surfacing(ForecastState(), estimate(currents(1))(0)) is None


def test_the_coming_surfacing_is_of_a_dive_like_the_last_in_the_estimates_current():
    flows = currents(8)
    state, _ = forecast_end(followed(mission(flows), estimate(flows))[0])
    calm = SimpleNamespace(grid=GRID, levels=LEVELS, velocity=lambda *_, **__: np.zeros((3, 2)))
    coming = next_surfacing(state, calm)
    start = np.array(to_local(GRID.projection, *state.outcomes[-1].fix[1:]))
    moved = np.array(to_local(GRID.projection, coming.longitude, coming.latitude)) - start
    np.testing.assert_allclose(moved, SECONDS * WAY, atol=100.0)
    assert (coming.dive, coming.basis, coming.earlier) == (9, "estimate", 8)
