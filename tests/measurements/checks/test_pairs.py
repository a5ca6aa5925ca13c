"""Profiles beside mean currents and the platform's motion: which cause a contradiction is given, and in what order."""

import math

import numpy as np
import pytest

from replay_kit.measurements.checks.causes import (
    COMPASS,
    CONTRADICTION,
    MEANS,
    OFFSET,
    RECKONED,
    SCALE,
    UNDECIDED,
)
from replay_kit.measurements.checks.likelihood import UNITS
from replay_kit.measurements.checks.profile import UNIT
from tests.measurements.checks.made import EAST, NORTH, judged, mean, ping

CURRENTS = [(0.02, 0.08), (-0.03, 0.07), (0.06, -0.05), (-0.08, 0.02), (0.05, 0.09), (0.09, -0.03)]
LONG = 4000.0


def dive(number, logged, way, relative=False, stated=None):
    """Pings of a dive at positions that the way over ground gives [m/s], of a current as it is logged."""
    rng = np.random.default_rng(number)
    for t in np.arange(0.0, 3601.0, 300.0):
        seconds = LONG * number + t
        place = way[0] * seconds / EAST, way[1] * seconds / NORTH
        depth = 400.0 * (1.0 - abs(2.0 * t / 3600.0 - 1.0)) + np.array([5.0, 15.0, 25.0])
        velocity = np.array(logged) - (np.array(way) if relative else 0.0)
        velocity = velocity + 0.005 * rng.standard_normal((3, 2))
        changes = {"common_std": math.inf} if relative else {}
        changes |= {} if stated is None else {"platform": stated}
        yield ping(seconds, velocity, depth, 0.02, place, dive=number + 1, **changes)


def mission(currents, wrong=lambda current: current, way=(0.25, 0.0), means=lambda c: c, **how):
    for number, current in enumerate(currents):
        yield from dive(number, wrong(current), way, **how)
        yield mean(LONG * number + 3601.0, means(current), start=LONG * number, dive=number + 1)


def findings(events, **how):
    """Names of the findings, with the dive in which each came."""
    events = list(events)
    found = judged(events, **how)[1]
    return [(one.name, int(events[event][1]["time"] // LONG) + 1, one) for event, one in found]


def turned(degrees, way=(0.25, 0.0)):
    turn = np.exp(-1j * math.radians(degrees))

    def logged(current):
        here = complex(*way)
        made = (complex(*current) - here) * turn + here
        return made.real, made.imag

    return logged


@pytest.mark.parametrize("degrees", [30.0, -40.0, 180.0])
def test_a_turned_compass_is_named_when_no_other_cause_explains_the_dives(degrees):
    ((name, dives, finding),) = findings(mission(CURRENTS, turned(degrees)))
    assert (name, finding.distrusts) == (COMPASS, True)
    assert dives <= 4
    assert f"turned by {degrees:+.0f} degrees clockwise" in finding.evidence


@pytest.mark.parametrize(
    ("wrong", "name", "words"),
    [
        (
            lambda c: (UNITS["knots"] * c[0], UNITS["knots"] * c[1]),
            SCALE,
            "times as fast as the mean",
        ),
        (lambda c: (-c[0], -c[1]), CONTRADICTION, "both signs wrong"),
        (lambda c: (c[1], c[0]), CONTRADICTION, "east and north are exchanged"),
        (lambda c: (c[0] + 0.3, c[1]), OFFSET, "+0.2"),
    ],
)
def test_what_was_done_to_the_profiles_is_named(wrong, name, words):
    found = [one for one in findings(mission(CURRENTS * 2, wrong)) if one[0] != UNDECIDED]
    ((named, _, finding),) = found
    assert named == name
    assert words in finding.evidence


def test_a_factor_of_eight_or_more_is_unusable():
    currents = [(0.3, 0.1), (0.25, 0.14), (0.33, 0.02), (0.2, 0.2)]
    ((name, _, finding),) = findings(mission(currents, lambda c: (100.0 * c[0], 100.0 * c[1])))
    assert (name, finding.severity) == (UNIT, "unusable")
    assert 'measurements.velocity_unit = "cm/s"' in finding.advice


@pytest.mark.parametrize("relative", [False, True])
def test_sound_dives_are_not_accused_and_tell_of_directions(relative):
    rng = np.random.default_rng(0)
    means = {c: tuple(np.array(c) + 0.01 * rng.standard_normal(2)) for c in CURRENTS}
    state, found, _ = judged(mission(CURRENTS * 3, means=means.get, relative=relative))
    assert found == []
    assert state.can_tell_directions


def test_a_mean_current_of_other_water_makes_no_pair():
    # pings at the surface alone, within 100 m of three quarters of a path down to 130 m and of less of one to 160 m
    for deepest, pairs in ((130.0, 1), (160.0, 0)):
        events = [ping(60.0 * k, [[0.3, 0.0]] * 3, [1.0, 2.0, 3.0]) for k in range(61)]
        events.append(mean(3601.0, (0.1, 0.0), start=0.0, deepest=deepest, points=2001))
        state, _, _ = judged(events)
        assert len(state.memory["means", "/adcp"]["current"]) == pairs


@pytest.mark.parametrize(
    ("factor", "more", "names"), [(1.0, 0.0, []), (1.943844, 0.0, [SCALE]), (1.0, 0.25, [])]
)
def test_a_stated_motion_is_a_multiple_of_that_of_its_positions_or_has_a_current_more(
    factor, more, names
):
    events = []
    for number, way in enumerate([(0.3, 0.05), (0.26, -0.1)] * 4):
        stated = factor * way[0] + more, factor * way[1]
        events += dive(number, (0.05, 0.02), way, stated=stated)
    assert [one[0] for one in findings(events)] == names


def test_equal_mean_currents_and_a_slip_beside_dead_reckoning_are_named_and_explain_the_rest():
    still = findings(mission(CURRENTS, means=lambda c: (0.05, 0.05)))
    assert [(name, dives) for name, dives, _ in still] == [(MEANS, 3)]
    reckoned = [
        mean(LONG * k, (c[1], c[0]), dive=k + 1, reckoned=c) for k, c in enumerate(CURRENTS * 2)
    ]
    ((name, _, finding),) = findings(reckoned)
    assert name == RECKONED
    assert "east and north are exchanged" in finding.evidence


def test_depths_that_are_wrong_come_before_a_scale():
    # in the first dive the pressure is of another unit; the profiles lie at other depths than the path
    events = [
        (
            kind,
            {**one, "pressure_depth": 5.0, "depth": one["depth"] + 600.0} if "raw" in one else one,
        )
        for kind, one in mission(CURRENTS * 2)
    ]
    assert SCALE not in [name for name, _, _ in findings(events)]


@pytest.mark.parametrize("size", [1, 7, 64])
@pytest.mark.parametrize("degrees", [0.0, 90.0])
def test_nothing_depends_on_where_a_log_is_cut_into_blocks(size, degrees):
    events = list(mission(CURRENTS, turned(degrees)))
    whole, cut = judged(events), judged(events, size=size)
    assert cut[1] == whole[1]
    np.testing.assert_array_equal(np.array(cut[2]), np.array(whole[2]))
