"""Positions: frozen, of two missions, and out of the vehicle's reach."""

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.measurements.checks.place import FROZEN, PLACES, REPEATED
from replay_kit.measurements.observed import blocks
from replay_kit.measurements.track.reach import DISPLACED
from tests.measurements.checks.made import fix, judged, names, ping
from tests.measurements.samples import fix as position

HOUR, DAY = 3600.0, 86_400.0


def dive(n=4, seconds=200.0, metres=7.0, moves=0.0, **changes):
    return [
        fix(seconds * k, 150.0 + moves * k, depth=metres * k, reckoned=True, **changes)
        for k in range(n)
    ]


@pytest.mark.parametrize(
    ("track", "named"),
    [
        (dive(), [REPEATED]),
        (dive(3), []),
        (dive(seconds=199.9), []),
        (dive(metres=20.0 / 3.0 - 1e-9), []),
        (dive(moves=1e-9), []),
        ([*dive(), fix(800.0, 150.0, depth=0.0)], [REPEATED, FROZEN]),
    ],
)
def test_a_position_that_stays_while_the_vehicle_dives_is_frozen_once_a_fix_repeats_it(
    track, named
):
    assert names(track) == named


def test_pings_at_a_frozen_position_are_not_used():
    velocity = np.random.default_rng(0).normal(0.0, 0.1, (9, 3, 2))
    track = [*dive(8), fix(1600.0, 151.0)]
    pings = [ping(200.0 * k + 1.0, velocity[k]) for k in range(9)]
    flags = judged(one for pair in zip(track, pings, strict=True) for one in pair)[2]
    assert [bool((each == 1).all()) for each, _ in flags] == [True] * 3 + [False] * 5 + [True]


def sorted_by_time(*events):
    return sorted(events, key=lambda event: event[1]["time"])


HERE = [fix(HOUR * k, 152.0 + 0.01 * k) for k in range(20)]


@pytest.mark.parametrize(
    "other",
    [
        [fix(HOUR * k + 60.0, 155.0, log=1) for k in range(20)],
        [fix(HOUR * (30 + k), -30.0, 60.0, log=1) for k in range(5)],
        [fix(400 * DAY + HOUR * k, 152.0, log=1) for k in range(5)],
        [fix(-400 * DAY + HOUR * k, 152.0, log=1) for k in range(5)],
    ],
)
def test_a_log_of_another_place_or_year_is_named_once_with_both(other):
    ((_, finding),) = judged(sorted_by_time(*HERE, *other))[1]
    assert finding.name == PLACES
    assert "(log 0)" in finding.evidence
    assert "(log 1)" in finding.evidence
    # four positions are wrong fixes
    assert names(sorted_by_time(*HERE, *other[:4])) == []


def test_a_vehicle_that_goes_on_is_one_mission():
    # a ship's transit, a pause of months in the log, and a way across the antimeridian
    assert names([fix(HOUR * k, 170.0 + 0.3 * k) for k in range(60)]) == []
    assert names([*HERE, *(fix(300 * DAY + HOUR * k, 160.0) for k in range(9))]) == []


def glide(n=80, gap=0.0, off=(), since=0):
    """Dead-reckoned positions of a glider at 0.3 m/s eastwards, every eighth a fix, which closes a gap [m] since one, some off [km]."""
    off = dict(off)
    for k in range(n):
        metres = 180.0 * k + gap * (k >= since) * (k % 8) / 7.0 + 1e3 * off.get(k, 0.0)
        reckoned = {"dead_reckoned": k % 8 > 0}
        yield position(600.0 * k, 150.0 + metres / 85_000.0, metadata=reckoned)


def reached(track, size=4096):
    """Numbers of the positions that are thrown, and what is found of them."""
    messages = list(track)
    found = list(blocks(messages, MeasurementConfig(), size))
    kept = np.concatenate([block.position["time"] for block in found])
    thrown = [k for k, one in enumerate(messages) if one.time_ns not in kept]
    return thrown, [(one.name, one.severity) for block in found for _, one in block.findings]


@pytest.mark.parametrize("size", [1, 7, 4096])
@pytest.mark.parametrize(
    ("thrown", "km"), [([40], 3.0), ([40], 40.0), ([40], -4700.0), ([40, 41, 42], 30.0)]
)
def test_positions_thrown_off_are_left_out_and_named_at_once(thrown, km, size):
    found = reached(glide(off=[(k, km) for k in thrown]), size)
    assert found == (thrown, [(DISPLACED, "warning")])


def test_of_two_vehicles_at_the_same_times_one_is_thrown():
    both = [position(600.0 * (k // 2), 150.0 + k % 2) for k in range(40)]
    first, _ = blocks(both, MeasurementConfig())
    # of the first five none is known to be wrong
    assert first.position["longitude"].tolist().count(151.0) == 2


def at(seconds, longitudes, latitude=-40.0):
    for second, longitude in zip(seconds, longitudes, strict=True):
        yield position(second, longitude, latitude)


EVERY = 600.0 * np.arange(40)
STEPS = 150.0 + 1e-3 * np.arange(9)


@pytest.mark.parametrize(
    ("track", "found"),
    [
        (glide(off=[(40, 0.2)]), []),
        # five in a row are where the vehicle is
        (glide(off=[(k, 30.0) for k in range(40, 80)]), [(DISPLACED, "inconsistent")]),
        # a vessel that leaves its station, and a fast boat
        (at(EVERY, 150.0 + np.maximum(0.0, 0.04 * (np.arange(40) - 20))), []),
        (at(EVERY, 150.0 + 0.16 * np.arange(40)), []),
        # dead reckoning that a fix puts right
        (glide(160, 500.0), []),
        (glide(160, 3000.0), []),
        (glide(160, 3000.0, since=80), []),
        # where it came up in the end
        (glide(off=[(78, 5.0), (79, 5.0)]), []),
        # a log that goes on after a pause or beside another
        ([*at(EVERY[:9], STEPS), *at(36_000.0 + EVERY[:9], 1.0 + STEPS)], []),
        ([position(600.0 * k, 150.0 + k % 2)._replace(input=k % 2) for k in range(40)], []),
    ],
)
def test_where_a_vehicle_may_be_nothing_is_thrown(track, found):
    assert reached(track) == ([], found)
