"""Positions: frozen, of two missions, and out of the vehicle's reach."""

import math

import numpy as np
import pytest

from replay_kit.measurements.checks.place import FROZEN, PLACES, REPEATED
from replay_kit.measurements.positions import ROW
from replay_kit.measurements.reach import DISPLACED, Reach, within_reach
from tests.measurements.checks.made import fix, judged, names, ping

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
        (dive(metres=math.nan), []),
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
    events = []
    for k, event in enumerate([*dive(8), fix(1600.0, 151.0)]):
        events += [event, ping(200.0 * k + 1.0, velocity[k])]
    flags = judged(events)[2]
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
    ids=["beside it", "after it", "a year later", "a year before"],
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


def glide(n=80, step=600.0, gap=0.0):
    """Dead-reckoned positions of a glider at 0.3 m/s eastwards, every eighth a fix, which puts the reckoning right by a gap [m]."""
    for k in range(n):
        is_fix = k % 8 == 0
        metres = 0.3 * step * k + (0.0 if is_fix else gap * (k % 8) / 7.0)
        yield fix(step * k, 150.0 + metres / 85_000.0, reckoned=not is_fix)


def moved(event, km):
    kind, one = event
    return kind, {**one, "longitude": one["longitude"] + km / 85.0}


def reached(events, size=4096):
    """Positions that count, those thrown, and what is found of them, in blocks of a size."""
    rows, state, kept, thrown, found = list(events), Reach(), [], [], []
    for first in range(0, len(rows), size):
        part = [one for _, one in rows[first : first + size]]
        columns = {
            "time": [round(one["time"] * 1e9) for one in part],
            "order": list(range(first, first + len(part))),
            "ordinal": list(range(first, first + len(part))),
            **{
                n: [one[n] for one in part]
                for n in ("longitude", "latitude", "depth", "dead_reckoned", "input")
            },
        }
        positions = {
            name: np.array(columns.get(name, [0] * len(part)), kind) for name, kind in ROW.items()
        }
        ends = first + size >= len(rows)
        state, done, counts, new = within_reach(state, positions, ends)
        kept += done["ordinal"][counts].tolist()
        thrown += done["ordinal"][~counts].tolist()
        found += [finding for _, finding in new]
    return kept, thrown, found


@pytest.mark.parametrize("size", [1, 7, 4096])
@pytest.mark.parametrize(("km", "thrown"), [(0.2, []), (3.0, [40]), (40.0, [40]), (-4700.0, [40])])
def test_one_fix_thrown_off_is_left_out_and_named_at_once(km, thrown, size):
    track = list(glide())
    track[40] = moved(track[40], km)
    kept, left_out, found = reached(track, size)
    assert left_out == thrown
    assert kept == [k for k in range(80) if k not in thrown]
    assert [(one.name, one.severity) for one in found] == [(DISPLACED, "warning")] * len(thrown)


def test_three_in_a_row_are_thrown_and_five_are_where_the_vehicle_is():
    track = list(glide())
    for number, gone in ((3, [40, 41, 42]), (80, [])):
        away = [moved(one, 30.0) if 40 <= k < 40 + number else one for k, one in enumerate(track)]
        kept, thrown, found = reached(away)
        assert thrown == gone
        assert kept == [k for k in range(80) if k not in gone]
        ((name, severity),) = {(one.name, one.severity) for one in found}
        assert (name, severity) == (DISPLACED, "warning" if gone else "inconsistent")


def test_a_vessel_that_leaves_its_station_and_a_fast_boat_are_within_reach():
    station = [fix(600.0 * k, 150.0) for k in range(60)]
    under_way = [fix(600.0 * (60 + k), 150.0 + 0.04 * k) for k in range(1, 30)]
    boat = [fix(600.0 * k, 150.0 + 0.16 * k) for k in range(30)]
    assert [reached(track)[1:] for track in ([*station, *under_way], boat)] == [([], [])] * 2


@pytest.mark.parametrize("gap", [500.0, 3000.0])
def test_dead_reckoning_that_a_fix_puts_right_is_no_displaced_position(gap):
    assert reached(glide(160, gap=gap))[1:] == ([], [])


def test_a_log_that_goes_on_after_a_pause_or_beside_another_throws_nothing():
    later = [fix(10 * HOUR + 600.0 * k, 151.0 + 1e-3 * k) for k in range(9)]
    assert reached([*(fix(600.0 * k, 150.0 + 1e-3 * k) for k in range(9)), *later])[1] == []
    two = [fix(600.0 * k, 150.0 + (k % 2), log=k % 2) for k in range(40)]
    assert reached(two)[1] == []
