"""Positions of two missions are told from those of one, and from wrong fixes."""

from dataclasses import replace

import pytest

from replay_kit.core.observation import VehicleState
from replay_kit.measurements.consistency import findings
from tests.measurements.samples import checked, vehicle

HOUR, DAY = 3600.0, 86_400.0


def position(
    seconds: float, longitude: float, latitude: float = -40.0, log: int = 0
) -> VehicleState:
    return vehicle(seconds, longitude, latitude, log=log)


def found(*positions: VehicleState) -> list[str]:
    """What a log of these positions, in order of time, is said to be."""
    in_order = sorted(positions, key=lambda one: one.time_ns)
    return [str(finding) for finding in checked(in_order)[0].findings]


HERE = [position(HOUR * k, 152.0 + 0.01 * k) for k in range(20)]


@pytest.mark.parametrize(
    "other",
    [
        [position(HOUR * k + 60.0, 155.0, log=1) for k in range(20)],
        [position(HOUR * (30 + k), -30.0, 60.0, log=1) for k in range(5)],
        [position(400 * DAY + HOUR * k, 152.0, log=1) for k in range(5)],
        [position(-400 * DAY + HOUR * k, 152.0, log=1) for k in range(5)],
    ],
    ids=["beside it", "after it", "a year later", "a year before"],
)
def test_a_log_of_another_place_or_year_is_named_once_with_both(other):
    (words,) = found(*HERE, *other)
    assert words.startswith(findings.PLACES)
    assert "of log0)" in words
    assert "of log1)" in words
    # four positions are wrong fixes
    assert found(*HERE, *other[:4]) == []


def test_a_vehicle_that_goes_on_is_one_mission():
    # a ship's transit, a pause of months in the log, and a way across the antimeridian
    assert found(*(position(HOUR * k, 170.0 + 0.3 * k) for k in range(60))) == []
    assert found(*HERE, *(position(300 * DAY + HOUR * k, 160.0) for k in range(9))) == []


def test_wrong_fixes_are_no_mission():
    spikes = [position(HOUR * k + 60.0, 20.0 * k, 10.0 * k) for k in range(1, 9)]
    (words,) = found(*HERE, *spikes)
    assert words.startswith(findings.DISPLACED)
    # nor where the log begins with some
    assert found(*(position(-HOUR - k, 0.0, 0.0) for k in range(4)), *HERE) == []


def glide(n, step=600.0, gap=0.0):
    """Return dead-reckoned positions of a glider at 0.3 m/s eastwards, every eighth a fix, which puts the reckoning right by a gap [m]."""
    for k in range(n):
        is_fix = k % 8 == 0
        metres = 0.3 * step * k + (0.0 if is_fix else gap * (k % 8) / 7.0)
        yield vehicle(step * k, 150.0 + metres / 85_000.0, dead_reckoned=not is_fix)


def moved(one: VehicleState, km: float) -> VehicleState:
    return replace(one, longitude=one.longitude + km / 85.0)


def test_fixes_beyond_reach_are_named_and_not_used():
    track = list(glide(80))
    assert found(*track) == []
    for km, named in ((0.2, 0), (3.0, 1), (40.0, 1)):
        words = found(*(moved(one, km) if k % 16 == 8 else one for k, one in enumerate(track)))
        assert [one.startswith(findings.DISPLACED) for one in words] == [True] * named


def test_positions_that_move_away_and_stay_are_named_with_the_time():
    track = [moved(one, 30.0) if k >= 40 else one for k, one in enumerate(glide(80))]
    (finding,) = checked(track)[0].findings
    assert (finding.name, finding.since_ns) == (findings.DISPLACED, track[40].time_ns)


@pytest.mark.parametrize("gap", [500.0, 3000.0])
def test_dead_reckoning_that_a_fix_puts_right_is_no_displaced_position(gap):
    assert found(*glide(160, gap=gap)) == []
