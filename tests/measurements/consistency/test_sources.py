"""Which vectors of two sources make a pair, and which cause a contradiction between profiles and mean currents is given."""

import math
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.observation import Observation, PathMean, Source
from replay_kit.measurements.consistency.monitor import ConsistencyState, check
from replay_kit.measurements.consistency.sources import (
    NearMean,
    SourceStatistics,
    blocks,
    mean_along,
    metres_per_degree,
)
from replay_kit.measurements.consistency.summary import EnsembleSpeeds
from replay_kit.measurements.consistency.usual_faults import KNOTS
from tests.measurements.samples import profile

SOURCE = Source(0, "/adcp", 0, 0)
MINUTE = 60.0
COMPASS, CONTRADICTION, IN_KNOTS = (
    "compass or instrument turned",
    "two sources of the current contradict each other",
    "scale of the velocities",
)


def near(seconds, velocity, depth=10.0, relative=False, place=(0.0, 0.0)):
    return NearMean(int(seconds * 1e9), *place, depth, velocity, None, relative)


def path_mean(velocity, start=0.0, seconds=3600.0, deepest=400.0, points=13, kind="dac"):
    """A dive down and up again."""
    share = np.linspace(0.0, 1.0, points)
    times = ((start + seconds * share) * 1e9).astype(np.int64)
    depth, weight = deepest * (1.0 - np.abs(2.0 * share - 1.0)), np.full(points, 1.0 / points)
    place = np.zeros(points)
    return PathMean(
        int(times[-1]), times, place, place, depth, weight, velocity, 0.02, kind, 1, SOURCE
    )


def test_profiles_are_averaged_over_the_time_of_the_path_and_not_over_their_number():
    # east grows with time by 0.1 m/s in an hour; most pings are early
    times = [0.0, *np.linspace(1.0, 600.0, 30), 3600.0]
    pings = [
        near(t, (0.1 * t / 3600.0, -0.2), depth=400.0 * (1.0 - abs(2.0 * t / 3600.0 - 1.0)))
        for t in times
    ]
    pings.insert(-1, near(1800.0, (0.05, -0.2), depth=400.0))
    assert mean_along(pings, path_mean((0.0, 0.0))) == pytest.approx((0.05, -0.2))
    assert mean_along(pings[::-1], path_mean((0.0, 0.0))) == pytest.approx((0.05, -0.2))


@pytest.mark.parametrize(("deepest", "pairs"), [(130.0, 1), (133.0, 1), (160.0, 0), (400.0, 0)])
def test_profiles_near_the_surface_say_nothing_of_a_deep_dives_mean_current(deepest, pairs):
    # pings at the surface alone are within 100 m of three quarters of the path down to 133 m
    pings = [near(t, (0.3, 0.0), depth=0.0) for t in (0.0, 3600.0)]
    mean = path_mean((0.1, 0.0), deepest=deepest, points=2001)
    statistics = SourceStatistics()
    for ping in pings:
        statistics = statistics.after_ping(ping)
    assert len(statistics.after_mean(mean).current.pairs) == pairs
    assert (mean_along(pings, mean) is not None) == bool(pairs)
    assert mean_along([], mean) is None


def dive(start, current, way, relative=False):
    """Pings of a dive at positions that the way over ground gives [m/s]."""
    per_longitude, per_latitude = metres_per_degree(0.0)
    found = []
    for t in np.arange(0.0, 3601.0, 300.0):
        place = way[0] * (start + t) / per_longitude, way[1] * (start + t) / per_latitude
        depth = 400.0 * (1.0 - abs(2.0 * t / 3600.0 - 1.0))
        velocity = (current[0] - way[0], current[1] - way[1]) if relative else current
        found.append(near(start + t, velocity, depth, relative, place))
    return found


def after(statistics, pings, mean):
    for ping in pings:
        statistics = statistics.after_ping(ping)
    return statistics.after_mean(mean)


def test_a_dive_is_one_pair_relative_to_the_vehicle_and_half_an_hour_one_of_relative_profiles():
    absolute = after(
        SourceStatistics(), dive(0.0, (0.1, 0.02), (0.3, -0.1)), path_mean((0.12, 0.0))
    )
    assert (
        len(absolute.current.pairs),
        len(absolute.vehicle.pairs),
        len(absolute.blocks.pairs),
    ) == (1, 1, 0)
    assert absolute.current.pairs[0] == pytest.approx((0.1, 0.02, 0.12, 0.0, 1.0, 0))
    # neighbouring changes of the motion share a ping
    assert {pair.weight for pair in absolute.motion.pairs} == {0.5}
    assert absolute.vehicle.pairs[0] == pytest.approx((-0.2, 0.12, -0.18, 0.1, 1.0, 0), abs=1e-6)
    relative = after(
        SourceStatistics(),
        dive(0.0, (0.1, 0.02), (0.3, -0.1), relative=True),
        path_mean((0.12, 0.0)),
    )
    assert (
        len(relative.current.pairs),
        len(relative.vehicle.pairs),
        len(relative.blocks.pairs),
    ) == (0, 0, 2)
    assert relative.blocks.pairs[0] == pytest.approx((-0.2, 0.12, -0.18, 0.1, 0.5, 0), abs=1e-6)


def test_positions_without_a_current_are_the_way_through_water():
    statistics = after(
        SourceStatistics(through_water=True),
        dive(0.0, (0.1, 0.02), (0.3, -0.1)),
        path_mean((0.12, 0.0)),
    )
    # over ground the vehicle moved with the mean current, too
    assert statistics.vehicle.pairs[0] == pytest.approx((-0.32, 0.12, -0.3, 0.1, 1.0, 0), abs=1e-6)


def test_a_block_is_half_an_hour_from_its_first_ping():
    pings = [near(60.0 * k, (0.0, 0.0)) for k in (0, 29, 30, 31, 60, 61, 62)]
    assert [len(block) for block in blocks(pings)] == [3, 3, 1]


def ping(one: NearMean) -> Observation:
    return profile(
        np.tile(one.velocity, (2, 1)),
        [one.depth + 5.0, one.depth + 15.0],
        0.05,
        one.time_ns,
        (one.longitude, one.latitude),
        common_std=math.inf if one.relative else 0.0,
    )


def findings_after(dives, wrong, way=(0.25, 0.0), relative=False):
    """Names of the findings, with the dive in which each came; ``wrong`` makes the logged current of the true one."""
    state, found = ConsistencyState(), []
    for number, current in enumerate(dives):
        start = 4000.0 * number
        for one in dive(start, wrong(current), way, relative):
            state, _ = check(state, ping(one))
        state, _ = check(state, path_mean(current, start))
        found += [(finding.name, number + 1) for finding in state.findings[len(found) :]]
    return found, state


CURRENTS = [(0.02, 0.08), (-0.03, 0.07), (0.06, -0.05), (-0.08, 0.02), (0.05, 0.09), (0.09, -0.03)]


def turned(degrees, way=(0.25, 0.0)):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))

    def logged(current):
        east, north = current[0] - way[0], current[1] - way[1]
        return c * east + s * north + way[0], c * north - s * east + way[1]

    return logged


@pytest.mark.parametrize(("degrees", "dives"), [(30.0, 3), (-40.0, 3), (90.0, 2), (180.0, 2)])
def test_a_turned_compass_is_named_when_no_other_cause_explains_the_dives(degrees, dives):
    found, state = findings_after(CURRENTS, turned(degrees))
    assert found == [(COMPASS, dives)]
    assert f"turned by {degrees:+.0f} degrees clockwise" in state.findings[0].evidence


@pytest.mark.parametrize(
    ("speed", "names"),
    [
        (0.3, []),
        (1.2, ["log and ensemble contradict each other"]),
        (4.1, ["unit of the velocities"]),
    ],
)
def test_a_tidal_stream_contradicts_a_slow_ensemble_and_ends_nothing(speed, names):
    state, slow = ConsistencyState(), EnsembleSpeeds(np.array([0.0, 100.0]), np.array([0.01, 0.01]))
    for number in range(40):
        state, _ = check(state, ping(near(60.0 * number, (speed, 0.0))), slow)
    assert [finding.name for finding in state.findings] == names
    assert [finding.severity for finding in state.findings] == [
        {"u": "unusable", "l": "warning"}[name[0]] for name in names
    ]
    assert all(
        f"30 pings are {10 * speed:.3g} times as fast as the ensemble's currents"
        in finding.evidence
        for finding in state.findings
    )


def test_a_small_turn_is_no_fault():
    assert findings_after(CURRENTS, turned(10.0))[0] == []


def test_a_unit_is_not_taken_for_a_turned_compass():
    found, _ = findings_after(CURRENTS, lambda current: (KNOTS * current[0], KNOTS * current[1]))
    assert [name for name, _ in found] == [IN_KNOTS]


@pytest.mark.parametrize(
    ("factor", "more", "names"),
    [(1.0, 0.0, []), (KNOTS, 0.0, [IN_KNOTS]), (1.0 / KNOTS, 0.0, [IN_KNOTS]), (1.0, 0.25, [])],
)
def test_a_stated_motion_is_a_multiple_of_that_of_its_positions_or_has_a_current_more(
    factor, more, names
):
    state = ConsistencyState()
    for number, way in enumerate([(0.3, 0.05), (0.26, -0.1)] * 4):
        stated = factor * way[0] + more, factor * way[1]
        for one in dive(4000.0 * number, (0.05, 0.02), way):
            seen = replace(ping(one), platform_velocity=stated)
            state, _ = check(state, seen)
    assert [finding.name for finding in state.findings] == names


@pytest.mark.parametrize(
    ("factor", "dives", "words"),
    [
        (8.0, 2, "about 10 times"),
        (20.0, 3, "about 10 times"),
        (100.0, 2, ": the profiles are 100 times"),
    ],
)
def test_a_factor_of_eight_or_more_is_unusable(factor, dives, words):
    found, state = findings_after(
        [(0.3, 0.1), (0.25, 0.14), (0.33, 0.02), (0.2, 0.2)],
        lambda current: (factor * current[0], factor * current[1]),
    )
    assert found == [("unit of the velocities", dives)]
    assert words in state.findings[0].evidence
    assert state.findings[0].severity == "unusable"
    assert state.findings[0].advice.startswith(
        "state measurements.velocity_unit" + (' = "cm/s", or' if factor == 100.0 else ", or")
    )


def test_wrong_axes_are_not_taken_for_a_turned_compass():
    found, _ = findings_after(CURRENTS, lambda current: (-current[0], -current[1]))
    assert found == [(CONTRADICTION, 3)]


def test_sound_dives_are_not_accused_and_tell_of_directions():
    rng = np.random.default_rng(0)
    found, state = findings_after(
        CURRENTS * 3,
        lambda current: tuple((np.array(current) + 0.03 * rng.standard_normal(2)).tolist()),
    )
    assert found == []
    assert state.can_tell_directions


def test_a_straight_way_without_mean_currents_tells_nothing_of_directions_and_a_turn_does():
    straight, state = (
        dive(0.0, (0.05, 0.02), (0.25, 0.0)) + dive(4000.0, (0.05, 0.02), (0.25, 0.0)),
        ConsistencyState(),
    )
    for one in straight:
        state, _ = check(state, ping(one))
    assert not state.can_tell_directions
    state = ConsistencyState()
    for number, way in enumerate([(0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3)] * 3):
        for one in dive(4000.0 * number, (0.05, 0.02), way)[:4]:
            state, _ = check(state, ping(one))
    assert state.findings == ()
    assert state.can_tell_directions


@pytest.mark.parametrize(("relative", "dives"), [(False, 2), (True, 3)])
def test_mean_currents_tell_of_directions_after_some_dives(relative, dives):
    for number in (dives - 1, dives):
        _, state = findings_after(CURRENTS[:number], lambda current: current, relative=relative)
        assert state.can_tell_directions == (number == dives)


def test_a_log_in_which_a_wrong_direction_was_named_can_tell():
    assert findings_after(CURRENTS, turned(90.0))[1].can_tell_directions
